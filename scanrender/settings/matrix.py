"""`matrix:` one shot in several ways: every combination of named changes is a pipeline of its own.

matrix:
  look: {natural: {extends: skin/natural}, oily: {extends: skin/oily}}
  light: {key: {extends: light/key_only}, dim: {lights.0.irradiance: 0.5}}
"""

from __future__ import annotations

import copy
import itertools
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from scanrender.errors import ConfigError
from scanrender.settings.layers import Layer, merge, set_key
from scanrender.settings.pipeline import Pipeline
from scanrender.settings.validation import panel_pipelines, validated

MOST_VARIANTS = 10_000
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")
_TAKEN = re.compile(r"asset.*|frames|buffers|raw_scan", re.IGNORECASE)  # folders beside variants


@dataclass(frozen=True)
class Variant:
    """A pipeline without a matrix, and the names of the choices that made it: `oily-key`."""

    name: str
    pipeline: Pipeline


def variants(pipeline: Pipeline, source: str) -> list[Variant]:
    """Every combination, the last axis fastest; without a matrix the pipeline alone, unnamed.

    Raises ConfigError that names the choice in `source`.
    """
    if not pipeline.matrix:
        return [Variant("", pipeline)]
    base = _base(pipeline)
    axes = [list(choices.items()) for choices in pipeline.matrix.values()]
    found = []
    for combination in itertools.product(*axes):
        layer = Layer(copy.deepcopy(base), {})
        for axis, (name, choice) in zip(pipeline.matrix, combination, strict=True):
            _apply(layer, choice, _where(source, axis, name))
        joined = "-".join(name for name, _ in combination)
        made = validated(layer, f"{source}, the variant {joined}")
        panel_pipelines(made, source)
        found.append(Variant(joined, made))
    _check_names([variant.name for variant in found], source)
    return found


def check_matrix(pipeline: Pipeline, source: str) -> None:
    """Each choice is valid alone: a slip in the last one is told before the first is rendered.
    Raises ConfigError."""
    count = 1
    for axis, choices in pipeline.matrix.items():
        count *= len(choices)
        if not choices:
            raise ConfigError(f"matrix.{axis} has nothing to choose from", source, "name one")
        for name, choice in choices.items():
            where = _where(source, axis, name)
            if not _NAME.fullmatch(name):
                raise ConfigError(
                    f"{name!r} cannot be a folder's name", where, "use letters, digits, - _ and ."
                )
            layer = Layer(_base(pipeline), {})
            _apply(layer, choice, where)
            validated(layer, where)
    if count > MOST_VARIANTS:
        raise ConfigError(
            f"the matrix has {count:,} combinations", source, f"at most {MOST_VARIANTS:,}"
        )


def _base(pipeline: Pipeline) -> dict[str, Any]:
    data: dict[str, Any] = pipeline.model_dump(mode="json", exclude_unset=True)
    data.pop("matrix", None)
    return data


def _where(source: str, axis: str, name: str) -> str:
    return f"{source}, matrix.{axis}.{name}"


def _apply(layer: Layer, choice: Mapping[str, Any], where: str) -> None:
    """Sections merge key by key as with `extends`, dotted keys are set as with `--set`."""
    for key, value in choice.items():
        if "." not in key and isinstance(value, dict):
            merge(layer, Layer({key: copy.deepcopy(value)}, {(key,): where}))
        else:
            set_key(layer, key, copy.deepcopy(value), where)


def _check_names(names: list[str], source: str) -> None:
    for name in names:
        if _TAKEN.fullmatch(name):
            raise ConfigError(
                f"a variant called {name!r} would lie where other results do",
                source,
                "rename its choice",
            )
    lower = [name.lower() for name in names]
    if twice := next((name for name in lower if lower.count(name) > 1), None):
        raise ConfigError(
            f"two combinations of the matrix are called {twice!r}", source, "rename a choice"
        )
