"""A pipeline's plain data while it is put together: files over files, overrides over those."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from scanrender.errors import ConfigError
from scanrender.settings.pipeline import Pipeline

Key = tuple[str | int, ...]


@dataclass(frozen=True)
class Layer:
    """One file's plain data, and where each of its keys stands (`file:line`)."""

    data: dict[str, Any]
    places: dict[Key, str]


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
