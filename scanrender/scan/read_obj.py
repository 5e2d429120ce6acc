"""Wavefront OBJ: polygons, several materials, vertex colours, negative indices; MTL: `read_mtl`.

The text is classified line by line once, then numbers are parsed in bulk by NumPy: about 2 s per
million triangles. Vertex colours are `v x y z r g b`, or ZBrush's `#MRGB` comments.
"""

from __future__ import annotations

import codecs
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from scanrender.errors import ScanError
from scanrender.scan.raw import RawMesh
from scanrender.scan.read_mtl import decoded, read_materials
from scanrender.scan.triangulate import polygon_corners
from scanrender.scan.udim import unfold_tiles
from scanrender.scan.vertex_colors import colors_from_stored
from scanrender.scan.words import floats, integers

_NOT_BETWEEN = bytes(set(range(256)) - set(b" /"))  # what does not stand between numbers
_NOT_FINITE = re.compile(rb"[-+]?\d+\.#(?:IND|INF|[QS]NAN|J)\w*")  # Microsoft's, until 2015
_LONG = 80  # letters of a bad line that are quoted


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
    polypaint: list[bytes] = field(default_factory=list)


def _text(path: Path) -> bytes:
    """The file as UTF-8 without its byte order mark, each statement on one line."""
    text = path.read_bytes()
    if text[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):  # what PowerShell's `>` writes
        text = decoded(text).encode()
    text = text.removeprefix(codecs.BOM_UTF8)
    return text.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")


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
        elif key == b"#M" and line[:6] == b"#MRGB ":
            found.polypaint.append(line[6:].strip())
        elif (word := line[:6].lower()) == b"usemtl":
            name = decoded(line[6:]).strip()
            found.switches.append((len(found.polygons), name))
        elif word == b"mtllib":
            found.libraries.append(decoded(line[6:]).strip())
    return found


def read_obj(path: Path) -> RawMesh:
    """Read an OBJ. Raises ScanError for what cannot be parsed."""
    text = _text(path)
    # Negative indices need the running counts.
    relative = b" -" in text or b"\t-" in text or b"/-" in text
    lines = _sorted_lines(text, relative)
    vertices, texture, polygons = lines.vertices, lines.texture, lines.polygons
    if not vertices or not polygons:
        missing = "vertices" if not vertices else "faces"
        raise ScanError(f"{path.name} has no {missing}", str(path), "export it again as a mesh")
    table = _floats(vertices, path, "v", 3)
    running = lines.counts if relative else None
    corners, sizes = _corners(polygons, running, len(table), len(texture), path)
    notes: list[str] = []
    triangles = polygon_corners(sizes, corners[:, 0], table[:, :3], notes)
    polygon_of = np.repeat(np.arange(len(sizes)), np.maximum(sizes - 2, 0))
    paged = read_materials(path, lines.libraries, lines.switches, len(polygons), notes)
    page = paged.page[polygon_of]
    corner_uv = None
    if texture and (corners[:, 1] >= 0).any():
        uv = _floats(texture, path, "vt", 2)[:, :2]
        uv = np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=1)
        corner_uv = np.where(
            (corners[:, 1] >= 0)[:, None], uv[np.maximum(corners[:, 1], 0)], np.nan
        )[triangles].astype(np.float32)
        paged, page, corner_uv = unfold_tiles(paged, page, corner_uv, path, notes)
    return RawMesh(
        positions=np.ascontiguousarray(table[:, :3]),
        faces=corners[triangles, 0],
        corner_uv=corner_uv,
        page=page,
        pages=paged.pages,
        normal_pages=paged.normals,
        colors=_colors(table, lines.polypaint, notes),
        notes=tuple(notes),
    )


def _colors(
    table: npt.NDArray[np.float64], polypaint: list[bytes], notes: list[str]
) -> npt.NDArray[np.float32] | None:
    """`v x y z r g b`: sRGB in [0, 1], or in [0, 255] as some exporters write; or polypaint,
    eight hexadecimal digits MMRRGGBB a vertex, where MM is a mask. A seventh number is alpha, or
    else blue behind a weight w."""
    if table.shape[1] >= 6:
        red = (
            4 if table.shape[1] == 7 and _all_one(table[:, 3]) and not _all_one(table[:, 6]) else 3
        )
        return colors_from_stored(table[:, red : red + 3], None, notes)
    if polypaint:
        try:
            packed = np.frombuffer(bytes.fromhex(b"".join(polypaint).decode("ascii")), np.uint8)
        except ValueError:
            packed = np.zeros(0, np.uint8)
        if len(packed) == 4 * len(table):
            return colors_from_stored(packed.reshape(-1, 4)[:, 1:], 255.0, notes)
        notes.append("the colours in #MRGB lines are not one a vertex: they are ignored")
    return None


def _all_one(column: npt.NDArray[np.float64]) -> bool:
    """Whether all are 1 but for those that the lines leave out."""
    return bool(((column == 1.0) | np.isnan(column)).all())


def _floats(lines: list[bytes], path: Path, key: str, least: int) -> npt.NDArray[np.float64]:
    """(n, columns) numbers, of `least` columns or more; what a shorter line leaves out is NaN."""
    widths = set(map(len, map(bytes.split, lines)))
    width = max(widths)
    if len(widths) == 1 and width >= least:
        try:
            return floats(b" ".join(lines).split()).reshape(-1, width)
        except ValueError:  # a comment at the end of a line, or no numbers
            pass
    lines = [_NOT_FINITE.sub(b"nan", line) if b".#" in line else line for line in lines]
    rows = [line.split(b"#", 1)[0].split() for line in lines]
    width = max(least, *map(len, rows))
    try:
        flat = floats([word for row in rows for word in row + [b"nan"] * (width - len(row))])
    except ValueError as error:
        bad = next((line for line, row in zip(lines, rows, strict=True) if not _numeric(row)), b"")
        shown = decoded(bad).strip()[:_LONG]
        raise ScanError(
            f"{path.name}: a '{key}' line is not made of numbers: {shown!r}",
            str(path),
            "export it again, with a point as the decimal sign",
        ) from error
    return flat.reshape(-1, width)


def _numeric(row: list[bytes]) -> bool:
    try:
        return bool(len(floats(row)) == len(row))
    except ValueError:
        return False


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
    joined = b" ".join(flat)
    count = flat[0].count(b"/") if flat else 0
    # Every corner must be of one style: totals agree too where one has a slash more, one fewer.
    if joined.translate(None, _NOT_BETWEEN) + b" " == (b"/" * count + b" ") * len(flat):
        if count == 0:
            vertex = integers(flat)
            return np.stack([vertex, np.zeros_like(vertex)], axis=1)
        numbers = joined.replace(b"//", b"/0/").replace(b"/", b" ").split()
        if len(numbers) == len(flat) * (count + 1):
            table = integers(numbers).reshape(-1, count + 1)
            return np.ascontiguousarray(table[:, :2])
    rows = [[*token.split(b"/"), b"", b""][:2] for token in flat]
    return integers([word or b"0" for row in rows for word in row]).reshape(-1, 2)
