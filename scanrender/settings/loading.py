"""YAML 1.2 in, `Pipeline` out: extends, overrides, and errors that name file, key and line.

Nothing in a file can execute code or fetch anything: ruamel's round-trip loader builds plain data,
and unknown tags are refused.
"""

from __future__ import annotations

import copy
import difflib
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq, TaggedScalar
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from scanrender.errors import ConfigError, UsageError
from scanrender.resources import shipped_pipelines, shipped_presets
from scanrender.settings.light import BUILT_IN_SKIES
from scanrender.settings.pipeline import Pipeline

Key = tuple[str | int, ...]
MAX_EXTENDS_DEPTH = 8
MAX_FILE_BYTES = 4_000_000
PLAIN_TAGS = {
    f"tag:yaml.org,2002:{kind}" for kind in ("str", "int", "float", "bool", "null", "map", "seq")
}
# A file of a few lines whose aliases repeat each other unfolds to more than any memory holds.
MAX_VALUES = 20_000
MAX_NESTING = 32


@dataclass(frozen=True)
class Layer:
    """One file's plain data, and where each of its keys stands (`file:line`)."""

    data: dict[str, Any]
    places: dict[Key, str]


def load_pipeline(source: str | Path, overrides: Sequence[str] = ()) -> Pipeline:
    """Read a pipeline file or a shipped pipeline's name, then apply `a.b=c` overrides.

    Raises UsageError when the file is not there, ConfigError for anything wrong in it.
    """
    path = find_pipeline(source)
    layer = _read_with_extends(path, ())
    for text in overrides:
        _apply_override(layer, text)
    _find_pictures(layer)
    pipeline = validated(layer, str(path))
    panel_pipelines(pipeline, str(path))  # a slip in the last panel is told before the first
    if pipeline.matrix:
        from scanrender.settings.matrix import check_matrix

        check_matrix(pipeline, str(path))
    return pipeline


def panel_pipelines(pipeline: Pipeline, source: str) -> list[Pipeline]:
    """One pipeline for each panel of the figure: the pipeline with what the panel sets, and no
    figure of its own. Raises ConfigError that names the panel's key in `source`."""
    base = pipeline.model_dump(mode="json", exclude_unset=True)
    base.pop("figure", None)
    base.pop("matrix", None)
    found = []
    for number, panel in enumerate(pipeline.figure.panels):
        where = f"{source}, figure.panels.{number}.set"
        layer = Layer(copy.deepcopy(base), {})
        for name, value in panel.set.items():
            set_key(layer, name, value, where)
        found.append(validated(layer, where))
    return found


def find_pipeline(source: str | Path) -> Path:
    path = Path(source)
    if path.is_file():
        return path
    shipped = shipped_pipelines()
    name = str(source).removeprefix("pipelines/").removesuffix(".yaml")
    if name in shipped:
        return shipped[name]
    hint = difflib.get_close_matches(name, shipped, 1)
    known = f"did you mean {hint[0]!r}?" if hint else f"shipped pipelines: {', '.join(shipped)}"
    raise UsageError(f"no such pipeline: {source}", fix=known)


def resolved_yaml(pipeline: Pipeline) -> str:
    """The pipeline with every default written out: what is saved beside a result."""
    stream = io.StringIO()
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.dump(pipeline.model_dump(mode="json"), stream)
    return stream.getvalue()


def _read_with_extends(path: Path, seen: tuple[Path, ...]) -> Layer:
    path = path.resolve()
    if path in seen or len(seen) > MAX_EXTENDS_DEPTH:
        chain = " extends ".join(p.name for p in (*seen, path))
        raise ConfigError(f"files extend each other in a circle: {chain}", where=str(path))
    own = _read_file(path)
    _extend_choices(own, path, (*seen, path))
    bases = own.data.pop("extends", [])
    merged = _bases(bases, own.places.get(("extends",), str(path)), path, (*seen, path))
    merge(merged, own)
    return merged


def _bases(bases: Any, where: str, path: Path, seen: tuple[Path, ...]) -> Layer:
    """What `extends` names, the later over the earlier."""
    bases = [bases] if isinstance(bases, str) else bases
    if not isinstance(bases, list) or not all(isinstance(base, str) for base in bases):
        raise ConfigError("extends names one file or preset, or a list of them", where)
    merged = Layer({}, {})
    for base in bases:
        merge(merged, _read_with_extends(_find_base(base, path, where), seen))
    return merged


def _extend_choices(own: Layer, path: Path, seen: tuple[Path, ...]) -> None:
    """A choice of a matrix may start from files and presets too, and from pictures beside it."""
    matrix = own.data.get("matrix")
    for axis, choices in (matrix if isinstance(matrix, dict) else {}).items():
        for name, choice in (choices if isinstance(choices, dict) else {}).items():
            if not isinstance(choice, dict):
                continue
            where = own.places.get(("matrix", axis, name), str(path))
            _anchor_pictures(Layer(choice, {("lights",): where}), path)
            if "extends" in choice:
                base = _bases(choice.pop("extends"), where, path, seen)
                for key in ("version", "description", "matrix"):
                    base.data.pop(key, None)
                merge(base, Layer(choice, {}))
                choices[name] = base.data


def _find_base(name: str, beside: Path, where: str) -> Path:
    for candidate in (beside.parent / name, beside.parent / f"{name}.yaml"):
        if candidate.is_file():
            return candidate
    shipped = {**shipped_pipelines(), **shipped_presets()}
    key = name.removesuffix(".yaml")
    if key in shipped:
        return shipped[key]
    hint = difflib.get_close_matches(key, shipped, 1)
    fix = f"did you mean {hint[0]!r}?" if hint else f"presets: {', '.join(shipped)}"
    raise ConfigError(f"extends names {name!r}, which is no file and no preset", where, fix)


def _read_file(path: Path) -> Layer:
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
    layer = Layer(_plain(document, (), path, places), places)
    _anchor_pictures(layer, path)
    return layer


def _pictures(layer: Layer) -> Iterator[tuple[dict[str, Any], str]]:
    """Each light that names a picture, and where it does."""
    lights = layer.data.get("lights")
    for index, light in enumerate(lights if isinstance(lights, list) else ()):
        named = light.get("map") if isinstance(light, dict) else None
        if isinstance(named, str) and named not in BUILT_IN_SKIES:
            keys: tuple[Key, ...] = ("lights", index, "map"), ("lights", index), ("lights",)
            yield light, next((layer.places[key] for key in keys if key in layer.places), "")


def _anchor_pictures(layer: Layer, path: Path) -> None:
    """Paths in a file count from its folder and stay in it: a pipeline may come from anybody."""
    folder = path.resolve().parent
    for light, place in _pictures(layer):
        picture = (folder / light["map"]).resolve()
        if Path(light["map"]).is_absolute() or not picture.is_relative_to(folder):
            raise ConfigError(
                f"lights: the map {light['map']!r} lies outside this file's folder",
                place,
                "move it there, or name it on the command line: --set lights.N.map=PATH",
            )
        light["map"] = str(picture)


def _find_pictures(layer: Layer) -> None:
    """What stands relative by now came from the command line: it counts from where we are."""
    for light, place in _pictures(layer):
        if not Path(light["map"]).is_file():
            raise ConfigError(
                f"lights: there is no picture {light['map']!r}",
                place,
                f"built in: {', '.join(BUILT_IN_SKIES)}; otherwise a .exr or .hdr file",
            )
        light["map"] = str(Path(light["map"]).resolve())


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


def merge(under: Layer, over: Layer) -> None:
    """Mappings merge key by key; everything else (lists too) replaces."""

    def lay(base: dict[str, Any], top: Mapping[str, Any]) -> None:
        for name, value in top.items():
            if isinstance(value, dict) and isinstance(base.get(name), dict):
                lay(base[name], value)
            else:
                base[name] = value

    lay(under.data, over.data)
    under.places.update(over.places)


def _apply_override(layer: Layer, text: str) -> None:
    name, equals, value_text = text.partition("=")
    place = f"--set {text}"
    if not equals or not name.strip():
        raise UsageError(f"--set needs KEY=VALUE, not {text!r}", fix="e.g. --set camera.fill=0.8")
    try:
        value = YAML(typ="safe", pure=True).load(value_text)
    except YAMLError as error:
        raise ConfigError(f"the value is not valid YAML: {value_text!r}", where=place) from error
    set_key(layer, name, value, place)


def set_key(layer: Layer, name: str, value: Any, place: str) -> None:
    parts: list[str | int] = [int(p) if p.isdigit() else p for p in name.strip().split(".")]
    if parts[0] == "extends":
        raise ConfigError("extends can stand in a file only", place, "set the values themselves")
    # Where the path crosses a list that no file gives, it starts from the default one.
    default: Any = Pipeline().model_dump(mode="json")
    target: Any = layer.data
    for part in parts[:-1]:
        default = default.get(part) if isinstance(default, dict) else None
        if isinstance(default, list) and isinstance(target, dict) and part not in target:
            target[part] = copy.deepcopy(default)
        target = _step(target, part, place)
    if isinstance(target, list):
        _step(target, parts[-1], place)
    target[parts[-1]] = value
    for depth in range(1, len(parts) + 1):
        layer.places[tuple(parts[:depth])] = place


def _step(target: Any, part: str | int, place: str) -> Any:
    if isinstance(target, list):
        if not isinstance(part, int) or part >= len(target):
            raise ConfigError(f"there is no item {part!r} in a list of {len(target)}", where=place)
        return target[part]
    if not isinstance(target.setdefault(part, {}), dict | list):
        target[part] = {}
    return target[part]


def validated(layer: Layer, source: str) -> Pipeline:
    try:
        return Pipeline.model_validate(layer.data)
    except ValidationError as error:
        problems = error.errors(include_url=False)
        # A mistyped key often stands behind a missing one.
        mistyped = [problem for problem in problems if problem["type"] == "extra_forbidden"]
        raise _explain((mistyped or problems)[0], layer, source) from error


def _explain(problem: Any, layer: Layer, source: str) -> ConfigError:
    """Turn pydantic's first complaint into what, where, what to do."""
    # Union branches (`scan.units`, light types) put their own names into the location: keep only
    # what really stands in the file.
    key = _real_key(problem["loc"], layer.data)
    dotted = ".".join(str(part) for part in key)
    where = next(
        (layer.places[key[:n]] for n in range(len(key), 0, -1) if key[:n] in layer.places), source
    )
    if problem["type"] == "extra_forbidden":
        known = _fields_at(key[:-1], layer.data)
        hint = difflib.get_close_matches(str(key[-1]), known, 1)
        fix = f"did you mean {hint[0]!r}?" if hint else f"known here: {', '.join(known)}"
        return ConfigError(f"unknown key {dotted!r}", where, fix)
    message = str(problem["msg"]).removeprefix("Value error, ")
    given = problem.get("input")
    shown = f" (given: {given!r})" if isinstance(given, int | float | str | bool) else ""
    return ConfigError(
        f"{dotted or 'the file'}: {message[:1].lower() + message[1:]}{shown}",
        where,
        "see `scanrender schema` or docs/settings.md for units and ranges",
    )


def _real_key(location: Sequence[str | int], data: Any) -> Key:
    key: list[str | int] = []
    for part in location:
        inside = (isinstance(data, dict) and part in data) or (
            isinstance(data, list) and isinstance(part, int) and part < len(data)
        )
        if inside:
            data = data[part]
            key.append(part)
    missing = location[-1] if location else None
    if isinstance(missing, str) and isinstance(data, dict) and missing not in key:
        key.append(missing)
    return tuple(key)


def _fields_at(key: Key, data: Any) -> list[str]:
    model: Any = Pipeline
    for part in key:
        data = _item(data, part)
        model = _model_of(model, part, data)
    return [*model.model_fields, *(["extends"] if not key else [])]


def _item(data: Any, part: str | int) -> Any:
    if isinstance(data, list) and isinstance(part, int) and part < len(data):
        return data[part]
    return data.get(part) if isinstance(data, dict) else None


def _model_of(model: Any, part: str | int, data: Any) -> Any:
    """The section model under `part`; a list item is chosen by its `type`."""
    if isinstance(part, int):
        kind = data.get("type") if isinstance(data, dict) else None
        fits = [
            m
            for m in model
            if m.model_fields.get("type", None) is None
            or kind in get_args(m.model_fields["type"].annotation)
        ]
        return (fits or model)[0]
    models = _models_in(model.model_fields[part].annotation)
    return models if isinstance(data, list) else models[0]


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for arg in get_args(annotation) for found in _models_in(arg)]
