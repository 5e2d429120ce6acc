"""The materials of an OBJ: its MTL files, also when they are misnamed or lost, as texture pages."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.scan.pages import Encoding, Page, constant_page, read_page
from scanrender.scan.raw import NO_PAGE
from scanrender.scan.safe_path import inside

_IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".tga", ".exr", ".webp")
_MTL_BYTES = 16 << 20  # twenty materials are 4 KiB: a larger file is something else
Material = dict[str, str]
# Per polygon page of the OBJ: pages, the normal map of each or None, page index of each polygon.
Paged = tuple[tuple[Page, ...], tuple[Page | None, ...], npt.NDArray[np.int16]]


@dataclass
class _Shelf:
    """Pages as materials are met, and what had to be decided on the way."""

    path: Path
    notes: list[str]
    pages: list[Page] = field(default_factory=list)
    normals: list[Page | None] = field(default_factory=list)
    index_of: dict[str, int] = field(default_factory=dict)

    def index(self, name: str, material: Material) -> int:
        """The page of a material, or NO_PAGE when it has neither an image nor a telling colour."""
        if name not in self.index_of:
            self.index_of[name] = self._add(name, material)
        return self.index_of[name]

    def _add(self, name: str, material: Material) -> int:
        color = self._image(name, material, "map_kd", "srgb")
        if color is None:
            rgb = tuple(float(x) for x in material.get("kd", "").split()[:3] or (1.0, 1.0, 1.0))
            # A grey Kd is every exporter's default and says nothing about skin.
            if len(rgb) < 3 or max(rgb) - min(rgb) < 0.02:
                return NO_PAGE
            color = constant_page(name, (rgb[0], rgb[1], rgb[2]))
        self.pages.append(color)
        self.normals.append(self._image(name, material, "normal", "linear"))
        return len(self.pages) - 1

    def _image(self, name: str, material: Material, key: str, encoding: Encoding) -> Page | None:
        if key not in material:
            return None
        file = inside(self.path.parent, material[key], self.path)
        if file is None:
            self.notes.append(f"material {name} names {material[key]}, which is missing")
            return None
        return read_page(file, encoding)


def read_materials(
    path: Path,
    libraries: list[str],
    switches: list[tuple[int, str]],
    polygon_count: int,
    notes: list[str],
) -> Paged:
    """The pages of the OBJ at `path`. switches: (first polygon, material name), in order."""
    materials: dict[str, Material] = {}
    for file in _files(path, libraries, notes):
        materials.update(read_mtl(file))
    shelf = _Shelf(path, notes)
    page = np.full(polygon_count, NO_PAGE, np.int16)
    unknown = []
    for position, (start, name) in enumerate(switches):
        end = switches[position + 1][0] if position + 1 < len(switches) else polygon_count
        if start < end and name in materials:
            page[start:end] = shelf.index(name, materials[name])
        elif start < end:
            unknown.append(name)
    if not shelf.pages and materials:
        _only_textured(shelf, materials, page)
    if materials and unknown:
        names = ", ".join(dict.fromkeys(unknown))
        notes.append(f"the material file does not describe {names[:200]}")
    if not shelf.pages and (image := lone_image(path)) is not None:
        notes.append(f"no material names a texture: {image.name}, beside the scan, is used")
        shelf.pages, shelf.normals = [read_page(image)], [None]
        page[:] = 0
    return tuple(shelf.pages), tuple(shelf.normals), page


def _only_textured(shelf: _Shelf, materials: dict[str, Material], page: npt.NDArray[Any]) -> None:
    """When no face names a known material but one with an image exists, it is meant for all."""
    textured = [name for name, material in materials.items() if "map_kd" in material]
    if len(textured) == 1:
        page[:] = shelf.index(textured[0], materials[textured[0]])
        if shelf.pages:
            shelf.notes.append(f"no face names a known material: {textured[0]} is used for all")


def _files(path: Path, libraries: list[str], notes: list[str]) -> list[Path]:
    """The MTL files that the OBJ names, or else the one that obviously belongs to it."""
    found: list[Path] = []
    for library in libraries:
        whole = inside(path.parent, library, path)
        # Several files may stand on one line, but one name may hold blanks too.
        parts = [whole] if whole else [inside(path.parent, x, path) for x in library.split()]
        if None in parts or not parts:
            notes.append(f"the material file {library} is missing")
        found += [part for part in parts if part is not None]
    if found:
        return list(dict.fromkeys(found))
    present = sorted(f for f in path.parent.iterdir() if f.suffix.lower() == ".mtl")
    likely = [f for f in present if f.name.lower() in (f"{path.stem}.mtl".lower(),
                                                       f"{path.name}.mtl".lower())]  # fmt: skip
    if not likely and libraries and len(present) == 1:
        likely = present
    if likely and (file := inside(path.parent, likely[0].name, path)) is not None:
        notes.append(f"{file.name}, beside the scan, is used as its material file")
        return [file]
    return []


def read_mtl(path: Path) -> dict[str, Material]:
    """Materials by name: `map_kd`, `normal` (a tangent-space map) as file names, and `kd`."""
    materials: dict[str, Material] = {}
    current: Material = {}
    with path.open(encoding="utf-8", errors="replace") as stream:
        text = stream.read(_MTL_BYTES)
    for line in text.splitlines():
        words = line.split(None, 1)
        if len(words) < 2:
            continue
        key, value = words[0].lower(), words[1].strip()
        if key == "newmtl":
            current = materials.setdefault(value, {})
        elif key == "kd":
            current["kd"] = value
        elif key == "map_kd":
            current["map_kd"] = _texture_name(value)
        elif key == "map_ka":
            # Some exporters name their one image as the ambient map only.
            current.setdefault("map_ka", _texture_name(value))
        elif key in ("norm", "map_kn"):
            current["normal"] = _texture_name(value)
        elif key in ("map_bump", "bump") and "norm" in value.lower():
            # map_bump is a height map by the standard, a normal map by several exporters.
            current.setdefault("normal", _texture_name(value))
    for material in materials.values():
        if "map_ka" in material:
            material.setdefault("map_kd", material["map_ka"])
    return materials


def _texture_name(value: str) -> str:
    """The file name after options such as `-bm 1.0` or `-o 0 0 0`; names may hold blanks."""
    words = value.split(" ")
    index = 0
    while index < len(words) and words[index].startswith("-"):
        index += 1
        while index < len(words) - 1 and _is_option_value(words[index]):
            index += 1
    return " ".join(words[index:]).strip() or value


def _is_option_value(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return word in ("on", "off", "")
    return True


def lone_image(path: Path) -> Path | None:
    """The image that obviously belongs to a scan whose file names none, or None."""
    files = [f for f in sorted(path.parent.iterdir()) if f.is_file()]
    found = [f for f in files if f.suffix.lower() in _IMAGE_SUFFIXES]
    found = [f for f in found if f.resolve().is_relative_to(path.parent.resolve())]
    same = [f for f in found if f.stem.lower() == path.stem.lower()]
    if same:
        return same[0]
    color = [f for f in found if not any(word in f.name.lower() for word in ("norm", "mask"))]
    objects = [f for f in files if f.suffix.lower() == path.suffix.lower()]
    return color[0] if len(color) == 1 and len(objects) == 1 else None
