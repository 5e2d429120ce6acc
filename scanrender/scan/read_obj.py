"""Wavefront OBJ: polygons, several materials, vertex colours, negative indices; MTL: `read_mtl`.

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
from scanrender.scan.raw import RawMesh
from scanrender.scan.read_mtl import read_materials
from scanrender.scan.triangulate import fan_corners


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
    pages, normal_pages, page = read_materials(
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
        colors = _colors(table[:, 3:6], notes)
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


def _colors(stored: npt.NDArray[Any], notes: list[str]) -> npt.NDArray[np.float32] | None:
    """`v x y z r g b`: sRGB in [0, 1], or in [0, 255] as some exporters write."""
    known = np.isfinite(stored).all(axis=1)
    if not known.any():
        notes.append("the vertex colours are not numbers: they are ignored")
        return None
    if not known.all():
        notes.append(f"{int((~known).sum())} vertices have no colour: they take the mean one")
        stored = np.where(known[:, None], stored, stored[known].mean(axis=0))
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
