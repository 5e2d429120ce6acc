"""Pictures that lights name: where they may lie, and where they are."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from scanrender.errors import ConfigError
from scanrender.settings.layers import Key, Layer
from scanrender.settings.light import BUILT_IN_SKIES


def anchor_pictures(layer: Layer, path: Path) -> None:
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


def find_pictures(layer: Layer) -> None:
    """What stands relative by now came from the command line: it counts from where we are."""
    for light, place in _pictures(layer):
        if not Path(light["map"]).is_file():
            raise ConfigError(
                f"lights: there is no picture {light['map']!r}",
                place,
                f"built in: {', '.join(BUILT_IN_SKIES)}; otherwise a .exr or .hdr file",
            )
        light["map"] = str(Path(light["map"]).resolve())


def _pictures(layer: Layer) -> Iterator[tuple[dict[str, Any], str]]:
    """Each light that names a picture, and where it does."""
    lights = layer.data.get("lights")
    for index, light in enumerate(lights if isinstance(lights, list) else ()):
        named = light.get("map") if isinstance(light, dict) else None
        if isinstance(named, str) and named not in BUILT_IN_SKIES:
            keys: tuple[Key, ...] = ("lights", index, "map"), ("lights", index), ("lights",)
            yield light, next((layer.places[key] for key in keys if key in layer.places), "")
