"""One YAML 1.2 file as plain data, with the line on which each of its keys stands.

Nothing in a file can execute code or fetch anything: ruamel's round-trip loader builds plain data,
and unknown tags are refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq, TaggedScalar
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from scanrender.errors import ConfigError
from scanrender.settings.layers import Key, Layer

MAX_FILE_BYTES = 4_000_000
PLAIN_TAGS = {
    f"tag:yaml.org,2002:{kind}" for kind in ("str", "int", "float", "bool", "null", "map", "seq")
}
# A file of a few lines whose aliases repeat each other unfolds to more than any memory holds.
MAX_VALUES = 20_000
MAX_NESTING = 32


def read_layer(path: Path) -> Layer:
    """Raises ConfigError for what is no mapping, too large, or more than data."""
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise ConfigError("this is far too large for a pipeline file", where=str(path))
        document = YAML(typ="rt", pure=True).load(path.read_text(encoding="utf-8"))
    except MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        problem = str(error.problem or error.context).split("\n")[0]
        raise ConfigError(f"not valid YAML: {problem}", where=f"{path}:{line}") from error
    except (YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigError(f"not valid YAML: {error}", where=str(path)) from error
    except OSError as error:
        raise ConfigError(f"cannot read it: {error.strerror}", where=str(path)) from error
    if document is None:
        document = CommentedMap()
    if not isinstance(document, CommentedMap):
        raise ConfigError("a pipeline file is a mapping of sections", where=f"{path}:1")
    places: dict[Key, str] = {}
    return Layer(_plain(document, (), path, places), places)


def _plain(node: Any, key: Key, path: Path, places: dict[Key, str]) -> Any:
    """Plain Python data from ruamel's, recording where each key stands."""
    if len(places) > MAX_VALUES or len(key) > MAX_NESTING:
        # A value that holds itself is nested for ever.
        raise ConfigError("too many values, or nested too deeply", places.get(key[:1], str(path)))
    if isinstance(node, TaggedScalar) or getattr(node, "tag", None) is not None:
        tag = getattr(getattr(node, "tag", None), "value", None)
        if tag is not None and str(tag) not in PLAIN_TAGS:
            raise ConfigError(f"YAML tag {tag} is not allowed", where=places.get(key, str(path)))
    if isinstance(node, CommentedMap):
        result = {}
        start = f"{path}:{(node.lc.line or 0) + 1}"
        for name, value in node.items():
            if not isinstance(name, str):
                raise ConfigError(f"keys are words, not {name!r}", where=start)
            # What a merge key (<<) brings in stands elsewhere: then the mapping's own line.
            own = name in (node.lc.data or {})
            places[(*key, name)] = f"{path}:{node.lc.key(name)[0] + 1}" if own else start
            result[name] = _plain(value, (*key, name), path, places)
        return result
    if isinstance(node, CommentedSeq):
        for index in range(len(node)):
            places[(*key, index)] = f"{path}:{node.lc.item(index)[0] + 1}"
        return [_plain(value, (*key, i), path, places) for i, value in enumerate(node)]
    if isinstance(node, bool) or node is None:
        return node
    for kind in (int, float, str):
        if isinstance(node, kind):
            return kind(node)
    # Dates and binary data, which YAML 1.2 does not have and no setting takes.
    name = ".".join(str(part) for part in key)
    raise ConfigError(f"{name}: put this value into quotes: {node}", places.get(key, str(path)))
