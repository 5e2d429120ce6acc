"""Wavefront OBJ with its MTL: polygons, several materials, vertex colours, negative indices.

The text is classified line by line once, then numbers are parsed in bulk by NumPy: about 2 s per
million triangles.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.errors import ScanError
from scanrender.images import linear_from_srgb
from scanrender.scan.pages import Page, constant_page, read_page
from scanrender.scan.raw import NO_PAGE, RawMesh
from scanrender.scan.safe_path import inside
from scanrender.scan.triangulate import fan_corners

_IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".tga", ".exr", ".webp")


@dataclass
class _Lines:
    """The lines of an OBJ by kind, without their keywords."""

    vertices: list[bytes] = field(default_factory=list)
    texture: list[bytes] = field(default_factory=list)
    polygons: list[bytes] = field(default_factory=list)
    # Polygons so far and the material that begins there; vertices and texture vertices so far.
    switches: list[tuple[int, str]] = field(default_factory=list)
    counts: list[tuple[int, int]] = field(default_factory=list)
    libraries: list[str] = field(default_factory=list)


def _sorted_lines(text: bytes, relative: bool) -> _Lines:
    found = _Lines()
    for line in text.splitlines():
        line = line.lstrip()
        key = line[:2]
        if key in (b"v ", b"v\t"):
            found.vertices.append(line[2:])
        elif key == b"vt":
            found.texture.append(line[2:])
        elif key in (b"f ", b"f\t"):
            found.polygons.append(line[2:].split(b"#", 1)[0])
            if relative:
                found.counts.append((len(found.vertices), len(found.texture)))
        elif line[:6] == b"usemtl":
            name = line[6:].decode("utf-8", "replace").strip()
            found.switches.append((len(found.polygons), name))
        elif line[:6] == b"mtllib":
            found.libraries.append(line[6:].decode("utf-8", "replace").strip())
    return found


def read_obj(path: Path) -> RawMesh:
    """Read an OBJ. Raises ScanError for what cannot be parsed."""
    text = path.read_bytes().replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    relative = b" -" in text or b"/-" in text  # negative indices need the running counts
    lines = _sorted_lines(text, relative)
    vertices, texture, polygons = lines.vertices, lines.texture, lines.polygons
    if not vertices or not polygons:
        missing = "vertices" if not vertices else "faces"
        raise ScanError(f"{path.name} has no {missing}", str(path), "export it again as a mesh")
    table = _floats(vertices, path, "v")
    running = lines.counts if relative else None
    corners, sizes = _corners(polygons, running, len(table), len(texture), path)
    triangles = fan_corners(sizes)
    polygon_of = np.repeat(np.arange(len(sizes)), np.maximum(sizes - 2, 0))
    notes: list[str] = []
    pages, normal_pages, page = _materials(
        path, lines.libraries, lines.switches, len(polygons), notes
    )
    corner_uv = None
    if texture and (corners[:, 1] >= 0).any():
        uv = _floats(texture, path, "vt")[:, :2]
        uv = np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=1)
        corner_uv = np.where(
            (corners[:, 1] >= 0)[:, None], uv[np.maximum(corners[:, 1], 0)], np.nan
        )[triangles].astype(np.float32)
    colors = None
    if table.shape[1] >= 6:
        colors = _colors(table[:, 3:6])
    return RawMesh(
        positions=np.ascontiguousarray(table[:, :3]),
        faces=corners[triangles, 0],
        corner_uv=corner_uv,
        page=page[polygon_of],
        pages=pages,
        normal_pages=normal_pages,
        colors=colors,
        notes=tuple(notes),
    )


def _colors(stored: npt.NDArray[Any]) -> npt.NDArray[np.float32] | None:
    """`v x y z r g b`: sRGB in [0, 1], or in [0, 255] as some exporters write."""
    if not np.isfinite(stored).all():
        stored = np.nan_to_num(stored)
    scale = 255.0 if stored.max() > 1.5 else 1.0
    return np.asarray(linear_from_srgb(stored / scale), np.float32)


def _floats(lines: list[bytes], path: Path, key: str) -> npt.NDArray[np.float64]:
    """(n, columns) numbers; lines of different length are cut or padded to the first one's."""
    width = len(lines[0].split())
    try:
        flat = np.array(b" ".join(lines).split(), dtype="S").astype(np.float64)
        if len(flat) == width * len(lines) and width >= 2:
            return flat.reshape(-1, width)
        rows = [(line.split(b"#", 1)[0].split() + [b"nan"] * width)[:width] for line in lines]
        return np.array(rows, dtype="S").astype(np.float64).reshape(-1, width)
    except ValueError as error:
        raise ScanError(
            f"{path.name}: a '{key}' line is not made of numbers", str(path), "export it again"
        ) from error


def _corners(
    polygons: list[bytes],
    counts: list[tuple[int, int]] | None,
    vertex_count: int,
    texture_count: int,
    path: Path,
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Corner table (c, 2) of 0-based (vertex, texture or -1), and the corners of each polygon."""
    tokens = [line.split() for line in polygons]
    sizes = np.array([len(row) for row in tokens], np.int64)
    flat = [token for row in tokens for token in row]
    try:
        corners = _indices(flat)
    except ValueError as error:
        raise ScanError(
            f"{path.name}: a face line is not made of indices", str(path), "export it again"
        ) from error
    if counts is not None:
        per_corner = np.repeat(np.array(counts, np.int64), sizes, axis=0)
        corners = np.where(corners < 0, corners + per_corner + 1, corners)
    corners -= 1
    bad = (corners[:, 0] < 0) | (corners[:, 0] >= vertex_count)
    if bad.any():
        # Whole polygons are dropped by `ingest` with a note; keep an index that it will recognise.
        corners[bad, 0] = -1
    corners[(corners[:, 1] < 0) | (corners[:, 1] >= texture_count), 1] = -1
    return corners, sizes


def _indices(flat: list[bytes]) -> npt.NDArray[np.int64]:
    """(c, 2) one-based vertex and texture index of each corner, 0 where there is no texture."""
    slashes = {token.count(b"/") for token in flat[:64]} | {flat[-1].count(b"/")} if flat else {0}
    joined = b" ".join(flat)
    if len(slashes) == 1 and joined.count(b"/") == len(flat) * (count := slashes.pop()):
        if count == 0:
            vertex = np.array(flat, dtype="S").astype(np.int64)
            return np.stack([vertex, np.zeros_like(vertex)], axis=1)
        numbers = joined.replace(b"//", b"/0/").replace(b"/", b" ").split()
        if len(numbers) == len(flat) * (count + 1):
            table = np.array(numbers, dtype="S").astype(np.int64).reshape(-1, count + 1)
            return np.ascontiguousarray(table[:, :2])
    rows = [[*token.split(b"/"), b"", b""][:2] for token in flat]
    return np.array([[int(row[0]), int(row[1] or 0)] for row in rows], np.int64)


def _materials(
    path: Path,
    libraries: list[str],
    switches: list[tuple[int, str]],
    polygon_count: int,
    notes: list[str],
) -> tuple[tuple[Page, ...], tuple[Page | None, ...], npt.NDArray[np.int16]]:
    """The pages, their normal maps, and the page of each polygon."""
    materials: dict[str, dict[str, str]] = {}
    for library in libraries:
        file = inside(path.parent, library, path)
        if file.is_file():
            materials.update(read_mtl(file))
        else:
            notes.append(f"the material file {library} is missing")
    pages: list[Page] = []
    normals: list[Page | None] = []
    index_of: dict[str, int] = {}
    page = np.full(polygon_count, NO_PAGE, np.int16)
    for position, (start, name) in enumerate(switches):
        end = switches[position + 1][0] if position + 1 < len(switches) else polygon_count
        if start < end and name in materials:
            if name not in index_of:
                index_of[name] = _add_material(path, name, materials[name], pages, normals, notes)
            page[start:end] = index_of[name]
    if not pages and (image := _lone_image(path)) is not None:
        notes.append(f"no material names a texture: {image.name}, beside the scan, is used")
        pages, normals = [read_page(image)], [None]
        page[:] = 0
    return tuple(pages), tuple(normals), page


def _add_material(
    path: Path,
    name: str,
    material: dict[str, str],
    pages: list[Page],
    normals: list[Page | None],
    notes: list[str],
) -> int:
    loaded: dict[str, Page | None] = {"map_kd": None, "normal": None}
    for key, encoding in (("map_kd", "srgb"), ("normal", "linear")):
        if key in material:
            image = inside(path.parent, material[key], path)
            if image.is_file():
                loaded[key] = read_page(image, "srgb" if encoding == "srgb" else "linear")
            else:
                notes.append(f"material {name} names {material[key]}, which is missing")
    color = loaded["map_kd"]
    if color is None:
        rgb = tuple(float(x) for x in material.get("kd", "").split()[:3] or (1.0, 1.0, 1.0))
        # A grey Kd is every exporter's default and says nothing about skin.
        if len(rgb) < 3 or max(rgb) - min(rgb) < 0.02:
            return NO_PAGE
        color = constant_page(name, (rgb[0], rgb[1], rgb[2]))
    pages.append(color)
    normals.append(loaded["normal"])
    return len(pages) - 1


def read_mtl(path: Path) -> dict[str, dict[str, str]]:
    """Materials by name: `map_kd`, `normal` (a tangent-space map) as file names, and `kd`."""
    materials: dict[str, dict[str, str]] = {}
    current: dict[str, str] = {}
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
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
        elif key in ("norm", "map_kn"):
            current["normal"] = _texture_name(value)
        elif key in ("map_bump", "bump") and "norm" in value.lower():
            # map_bump is a height map by the standard, a normal map by several exporters.
            current.setdefault("normal", _texture_name(value))
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


def _lone_image(path: Path) -> Path | None:
    """The image that obviously belongs to an OBJ whose material file is lost, or None."""
    found = sorted(f for f in path.parent.iterdir() if f.suffix.lower() in _IMAGE_SUFFIXES)
    stem = path.stem.lower()
    same = [f for f in found if f.stem.lower() == stem]
    if same:
        return same[0]
    color = [f for f in found if "norm" not in f.name.lower()]
    objects = [f for f in path.parent.iterdir() if f.suffix.lower() == ".obj"]
    return color[0] if len(color) == 1 and len(objects) == 1 else None
