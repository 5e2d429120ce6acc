"""The materials of an OBJ: its MTL files, also when they are misnamed or lost, as texture pages."""

from __future__ import annotations

import codecs
import re
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from scanrender.errors import ScanError
from scanrender.scan.beside import IMAGE_SUFFIXES, NOTES, lone_image
from scanrender.scan.pages import Encoding, Page, constant_page, read_page
from scanrender.scan.raw import NO_PAGE
from scanrender.scan.safe_path import Listings, inside

_MTL_BYTES = 16 << 20  # twenty materials are 4 KiB: a larger file is something else
_LARGEST_COLOR = 1e6  # Kd is from 0 to 1
_MOST_PAGES = 32_767  # pages are numbered in 16 bits
# How many words may follow an option of a texture map; of numbers, fewer are allowed.
_OPTION_WORDS = {
    "-blendu": 1, "-blendv": 1, "-bm": 1, "-boost": 1, "-cc": 1, "-clamp": 1, "-colorspace": 1,
    "-imfchan": 1, "-mm": 2, "-o": 3, "-s": 3, "-t": 3, "-texres": 1, "-type": 1,
}  # fmt: skip
_NUMBERS_ONLY = ("-bm", "-boost", "-mm", "-o", "-s", "-t", "-texres")
_TILE = re.compile(r"(?<!\d)1001(?!\d)")
Material = dict[str, str]
# The file names of an image and of its normal map with `<UDIM>` for the number, and `folder`.
Tiles = tuple[str, str | None, str]


class Paged(NamedTuple):
    """The pages of an OBJ, the normal map of each or None, the page of each polygon, and of pages
    that are one tile of several (UDIM) `Tiles`."""

    pages: tuple[Page, ...]
    normals: tuple[Page | None, ...]
    page: npt.NDArray[np.int16]
    tiled: dict[int, Tiles]


@dataclass
class _Shelf:
    """Pages as materials are met, and what had to be decided on the way."""

    path: Path
    notes: list[str]
    pages: list[Page] = field(default_factory=list)
    normals: list[Page | None] = field(default_factory=list)
    index_of: dict[str, int] = field(default_factory=dict)
    tiled: dict[int, Tiles] = field(default_factory=dict)
    # Forty materials may name one image: it is read once, and is one page where all else agrees.
    read: dict[tuple[Path, Encoding], Page] = field(default_factory=dict)
    shared: dict[tuple[int, int, Tiles | None], int] = field(default_factory=dict)
    listings: Listings = field(default_factory=dict)

    def index(self, name: str, material: Material) -> int:
        """The page of a material, or NO_PAGE when it has neither an image nor a telling colour."""
        if name not in self.index_of:
            self.index_of[name] = self._add(name, material)
        return self.index_of[name]

    def _add(self, name: str, material: Material) -> int:
        color, tiles = self._image(name, material, "map_kd", "srgb"), None
        if color is None:
            rgb = _color(material.get("kd", ""))
            if not all(abs(value) < _LARGEST_COLOR for value in rgb):  # nor with NaN
                self.notes.append(f"the Kd of material {name} is no colour: it is ignored")
                return NO_PAGE
            # A grey Kd is every exporter's default and says nothing about skin.
            if max(rgb) - min(rgb) < 0.02:
                return NO_PAGE
            color = constant_page(name, rgb)
        else:
            if "moved" in material:
                self.notes.append(f"the scale or offset of the image of {name} is not read")
            if tile := tile_pattern(material["map_kd"]):
                tiles = tile, tile_pattern(material.get("normal", "")), material.get("folder", "")
        normal = self._image(name, material, "normal", "linear")
        key = id(color), id(normal), tiles
        if key not in self.shared:
            self.shared[key] = self._put(color, normal, tiles)
        return self.shared[key]

    def _put(self, color: Page, normal: Page | None, tiles: Tiles | None) -> int:
        number = len(self.pages)
        if number == _MOST_PAGES:
            raise ScanError(
                f"{self.path.name} has more than {_MOST_PAGES} materials",
                str(self.path),
                "bake them into one texture",
            )
        if tiles is not None:
            self.tiled[number] = tiles
        self.pages.append(color)
        self.normals.append(normal)
        return number

    def _image(self, name: str, material: Material, key: str, encoding: Encoding) -> Page | None:
        if key not in material:
            return None
        named, folder = material[key], material.get("folder", "")
        file = self._file(named, folder) or self._file(named.split(" #", 1)[0], folder)
        if file is None:
            what = f"material {name} names {named}, which is missing"
            stem = PurePosixPath(named.replace("\\", "/")).stem
            others = (self._inside(stem + suffix, folder) for suffix in IMAGE_SUFFIXES)
            file = next((other for other in others if other is not None), None)
            self.notes.append(what if file is None else f"{what}: {file.name} is used")
        if file is None:
            return None
        if (file, encoding) not in self.read:
            self.read[file, encoding] = read_page(file, encoding)
        return self.read[file, encoding]

    def _file(self, named: str, folder: str) -> Path | None:
        return self._inside(tile_name(tile_pattern(named) or named, 1001), folder)

    def _inside(self, named: str, folder: str) -> Path | None:
        return inside(self.path.parent, named, self.path, folder, self.listings)


def tile_pattern(name: str) -> str | None:
    """`skin.<UDIM>.png` of that, of `skin.<udim>.png` and of `skin.1001.png`; else None."""
    name = re.sub("<udim>", "<UDIM>", name, flags=re.IGNORECASE)
    if "<UDIM>" not in name:
        folder, slash, last = name.rpartition("/")
        name = folder + slash + _TILE.sub("<UDIM>", last, count=1)
    return name if "<UDIM>" in name else None


def tile_name(pattern: str, number: int) -> str:
    return pattern.replace("<UDIM>", str(number))


def _color(words: str) -> tuple[float, float, float]:
    """Kd, white where it is not three numbers (`spectral file.rfl`, `xyz ...`)."""
    try:
        red, green, blue = (float(word) for word in words.split()[:3])
    except ValueError:
        return 1.0, 1.0, 1.0
    return red, green, blue


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
        folder = file.parent.relative_to(path.parent).as_posix()
        for name, material in read_mtl(file).items():
            materials[name] = material if folder == "." else {**material, "folder": folder}
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
    if not shelf.pages and (image := lone_image(path, notes)) is not None:
        notes.append(f"no material names a texture: {image.name}, beside the scan, is used")
        shelf.pages, shelf.normals = [read_page(image)], [None]
        page[:] = 0
    return Paged(tuple(shelf.pages), tuple(shelf.normals), page, shelf.tiled)


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
    listings: Listings = {}
    for library in libraries:
        whole = inside(path.parent, library, path, "", listings)
        # Several files may stand on one line, but one name may hold blanks too.
        names = [] if whole else library.split()
        parts = [whole] if whole else [inside(path.parent, x, path, "", listings) for x in names]
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
    for file in likely:
        if not file.resolve().is_relative_to(path.parent.resolve()):
            notes.append(f"{file.name}, beside the scan, is a link that leaves its folder: ignored")
        elif inside(path.parent, file.name, path) is not None:
            notes.append(f"{file.name}, beside the scan, is used as its material file")
            return [file]
    NOTES.missing.add(f"{path.stem}.mtl")
    return []


def read_mtl(path: Path) -> dict[str, Material]:
    """Materials by name: `map_kd`, `normal` (a tangent-space map) as file names, and `kd`."""
    materials: dict[str, Material] = {}
    current: Material = {}
    with path.open("rb") as stream:
        text = decoded(stream.read(_MTL_BYTES))
    for line in text.replace("\\\n", " ").splitlines():
        words = [*line.split(None, 1), "", ""]
        key, value = words[0].lower(), words[1].strip()
        if key == "newmtl":
            current = materials.setdefault(value, {})
        elif not value:
            continue
        elif key == "kd":
            current["kd"] = value
        elif key == "map_kd":
            current["map_kd"] = _texture_name(value)
            if _is_moved(value):
                current["moved"] = value
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


def decoded(text: bytes) -> str:
    """Text whose encoding nobody states: Unicode by its mark, UTF-8, or what Windows wrote."""
    if text[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        return text.decode("utf-16", "replace")
    try:
        return text.decode("utf-8-sig")
    except UnicodeDecodeError:
        return text.decode("cp1252", "replace")


def _texture_name(value: str) -> str:
    return _texture(value)[0]


def _is_moved(value: str) -> bool:
    """Whether options scale or move the image; exporters also write those that change nothing."""
    still = {"-s": 1.0, "-o": 0.0}
    return any(key in still and float(word) != still[key] for key, word in _texture(value)[1])


def _texture(value: str) -> tuple[str, list[tuple[str, str]]]:
    """The file name after options such as `-bm 1.0` or `-o 0 0 0`, and what follows each option;
    names may hold blanks."""
    rest, said = value, []
    while (option := rest.split(None, 1)) and option[0].lower() in _OPTION_WORDS:
        key, rest = option[0].lower(), option[1] if len(option) > 1 else ""
        for _ in range(_OPTION_WORDS[key]):
            word = rest.split(None, 1)
            if len(word) < 2 or (key in _NUMBERS_ONLY and not _is_number(word[0])):
                break
            said.append((key, word[0]))
            rest = word[1]
    return rest.strip() or value, said


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
