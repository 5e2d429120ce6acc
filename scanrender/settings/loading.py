"""A file in, `Pipeline` out: extends, overrides, and errors that name file, key and line."""

from __future__ import annotations

import difflib
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from scanrender.errors import ConfigError, UsageError
from scanrender.resources import shipped_pipelines, shipped_presets
from scanrender.settings.layers import Layer, merge, set_key
from scanrender.settings.matrix import check_matrix
from scanrender.settings.pictures import anchor_pictures, find_pictures
from scanrender.settings.pipeline import Pipeline
from scanrender.settings.validation import panel_pipelines, validated
from scanrender.settings.yaml_file import read_layer

MAX_EXTENDS_DEPTH = 8


def load_pipeline(source: str | Path, overrides: Sequence[str] = ()) -> Pipeline:
    """Read a pipeline file or a shipped pipeline's name, then apply `a.b=c` overrides.

    Raises UsageError when the file is not there, ConfigError for anything wrong in it.
    """
    path = find_pipeline(source)
    layer = _read_with_extends(path, ())
    for text in overrides:
        _apply_override(layer, text)
    find_pictures(layer)
    pipeline = validated(layer, str(path))
    panel_pipelines(pipeline, str(path))  # a slip in the last panel is told before the first
    if pipeline.matrix:
        check_matrix(pipeline, str(path))
    return pipeline


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
    own = read_layer(path)
    anchor_pictures(own, path)
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
            anchor_pictures(Layer(choice, {("lights",): where}), path)
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
