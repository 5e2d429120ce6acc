"""Plain data in, `Pipeline` out, or an error that names file, key and line."""

from __future__ import annotations

import copy
import difflib
from collections.abc import Sequence
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from scanrender.errors import ConfigError
from scanrender.settings.layers import Key, Layer, set_key
from scanrender.settings.pipeline import Pipeline


def validated(layer: Layer, source: str) -> Pipeline:
    try:
        return Pipeline.model_validate(layer.data)
    except ValidationError as error:
        problems = error.errors(include_url=False)
        # A mistyped key often stands behind a missing one.
        mistyped = [problem for problem in problems if problem["type"] == "extra_forbidden"]
        raise _explain((mistyped or problems)[0], layer, source) from error


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
    models = models_in(model.model_fields[part].annotation)
    return models if isinstance(data, list) else models[0]


def models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for arg in get_args(annotation) for found in models_in(arg)]
