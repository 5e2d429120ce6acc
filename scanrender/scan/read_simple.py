"""STL (ascii, binary) and OFF (with its colour variants): triangles or polygons, hardly more."""

from __future__ import annotations

import codecs
import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.errors import ScanError
from scanrender.scan.raw import RawMesh
from scanrender.scan.triangulate import onto_vertices, polygon_corners
from scanrender.scan.vertex_colors import colors_from_stored
from scanrender.scan.words import floats, integers

_NUMBER = rb"[-+0-9.eEnaifNAIF]+(?:#\w+)?"  # -1.#IND: how Windows once wrote NaN
_VERTEX = re.compile(rb"vertex\s+(%b)\s+(%b)\s+(%b)" % (_NUMBER, _NUMBER, _NUMBER), re.IGNORECASE)
_STEP = re.compile(rb"^\s*(vertex|endloop)\b", re.IGNORECASE | re.MULTILINE)
_OFF = re.compile(rb"([A-Z0-9]*OFF)(\d*)$", re.IGNORECASE)
_RECORD = np.dtype([("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("attribute", "<u2")])
Array = npt.NDArray[Any]
Colors = npt.NDArray[np.float32] | None


def read_stl(path: Path) -> RawMesh:
    """Read an STL: three own vertices per face, welded later. Raises ScanError."""
    data = path.read_bytes()
    notes: list[str] = []
    colors = None
    count = int(np.frombuffer(data, "<u4", 1, 80)[0]) if len(data) >= 84 else -1
    size = 84 + _RECORD.itemsize * max(count, 0)
    # "solid" also begins many binary files: the size, and facets in words, are better evidence.
    is_whole = count >= 0 and len(data) == size
    text = b"" if is_whole else _as_ascii(data)
    solid = text.lstrip()[:5].lower() == b"solid"
    if is_whole:
        corners, colors = _binary_facets(data, count, notes)
    elif solid and b"facet" in text[:65536].lower():
        corners = _ascii_corners(text, path, notes)
    elif solid and b"endsolid" in text.lower():
        corners = np.zeros((0, 3, 3))
    elif count >= 0 and len(data) > size > 84:
        corners, colors = _binary_facets(data, count, notes)
    else:
        raise _unlike_stl(data, count, path)
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return RawMesh(corners.reshape(-1, 3), faces, colors=colors, notes=tuple(notes))


def _as_ascii(data: bytes) -> bytes:
    """Text without its byte order mark, recoded where it is UTF-16; anything else as it is."""
    if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):  # what PowerShell's `>` writes
        return data.decode("utf-16", "replace").encode()
    return data.removeprefix(codecs.BOM_UTF8)


def _unlike_stl(data: bytes, count: int, path: Path) -> ScanError:
    fix = "export it again"
    if count == 0 and len(data) > 84:
        what = f"says that it has no triangles, but goes on for {len(data) - 84} bytes"
    elif count > 0 and b"\0" not in data[:84]:  # the count would be a billion: it is text
        what = "is neither a binary STL nor one in words"
    else:
        what = f"ends before its {max(count, 0)} triangles do"
        fix = "the file was cut short: copy or export it again"
    return ScanError(f"{path.name} {what}", str(path), fix)


def _binary_facets(data: bytes, count: int, notes: list[str]) -> tuple[Array, Colors]:
    """Corners (m, 3, 3), and colours (3 m, 3) where the attribute of the facets holds five bits of
    each: Magics' (`COLOR=` in the header, red lowest, bit 15 for the header's own colour), or
    VisCAM's (blue lowest, bit 15 where there is a colour)."""
    table = np.frombuffer(data, _RECORD, count, 84)
    attribute = table["attribute"].astype(np.int64)
    fives = np.stack([attribute & 31, attribute >> 5 & 31, attribute >> 10 & 31], axis=1) / 31.0
    marked = attribute >= 1 << 15
    place = data[:80].find(b"COLOR=")
    if 0 <= place <= 70:
        whole = np.frombuffer(data, np.uint8, 3, place + 6) / 255.0
        shades = np.where(marked[:, None], whole, fives)
    elif count and marked.mean() > 0.5:
        shades = np.where(marked[:, None], fives[:, ::-1], np.nan)
    else:  # anything else in those two bytes is no colour: many programs leave rubbish there
        shades = None
    colors = None
    if shades is not None:
        colors = colors_from_stored(np.repeat(shades, 3, axis=0), 1.0, notes)
        notes.append("the scan is coloured per face: averaged onto its vertices")
    return table["corner"].astype(np.float64), colors


def _ascii_corners(data: bytes, path: Path, notes: list[str]) -> Array:
    found = _VERTEX.findall(data)
    sizes = _loop_sizes(data, len(found))
    if sizes is None:
        raise ScanError(f"{path.name} ends inside a triangle", str(path), "export it again")
    words = [word for corner in found for word in corner]
    if b"#" in data:
        words = [b"nan" if b"#" in word else word for word in words]
    positions = floats(words).reshape(-1, 3)
    return positions[polygon_corners(sizes, np.arange(len(positions)), positions, notes)]


def _loop_sizes(data: bytes, count: int) -> npt.NDArray[np.int64] | None:
    """Corners of each facet, three by the letter of the format; None where they do not add up."""
    ends = np.array([word[:1] in b"eE" for word in _STEP.findall(data)], bool)
    begun = int((~ends).sum())
    if begun != count or not ends.any():  # fewer: several words on a line
        return None if begun > count or count % 3 else np.full(count // 3, 3)
    sizes = np.diff(np.cumsum(~ends)[ends], prepend=0, append=count)
    sizes = sizes[sizes > 0]
    return None if sizes.min(initial=3) < 3 else sizes


def read_off(path: Path) -> RawMesh:
    """Read OFF, COFF, NOFF, STOFF: vertex lines `x y z [...]`, then `n i j k ... [colour]`."""
    lines = [
        words
        for line in _as_ascii(path.read_bytes()).splitlines()
        if (words := line.split(b"#", 1)[0].split())
    ]
    begin = _OFF.match(lines[0][0]) if lines else None
    if begin is None:
        raise ScanError(f"{path.name} does not begin like an OFF file", str(path), "export again")
    kind = begin[1].upper()
    counts = [word for word in (begin[2], *lines[0][1:]) if word]  # some write OFF8 12 0
    head = counts or (lines[1] if len(lines) > 1 else [])
    body = lines[1:] if counts else lines[2:]
    if kind.startswith(b"4") or b"N4" in kind or len(head) < 2 or not head[0].isdigit():
        raise ScanError(f"{path.name} is an unusual kind of OFF", str(path), "export it as PLY")
    vertices, polygons = int(head[0]), int(head[1])
    if polygons < 0 or len(body) < vertices + polygons:
        raise ScanError(
            f"{path.name} ends before its {vertices} vertices and {polygons} faces do",
            str(path),
            "the file was cut short: copy or export it again",
        )
    rows = body[:vertices]
    if any(len(row) < 3 for row in rows):
        raise ScanError(f"{path.name}: a vertex line is cut short", str(path), "export it again")
    positions = floats([word for row in rows for word in row[:3]]).reshape(-1, 3)
    face_rows = body[vertices : vertices + polygons]
    sizes = np.array([int(row[0]) for row in face_rows], np.int64)
    if any(n < 0 or n >= len(row) for n, row in zip(sizes, face_rows, strict=True)):
        raise ScanError(f"{path.name}: a face line is cut short", str(path), "export it again")
    flat = [index for row, n in zip(face_rows, sizes, strict=True) for index in row[1 : n + 1]]
    corners = integers(flat)
    notes: list[str] = []
    faces = corners[polygon_corners(sizes, corners, positions, notes)]
    colors = _vertex_colors(kind, rows, notes)
    if colors is None:
        per_face = _face_colors(face_rows, sizes, notes)
        if per_face is not None and len(faces):
            notes.append("the scan is coloured per face: averaged onto its vertices")
            polygon_of = np.repeat(np.arange(len(sizes)), np.maximum(sizes - 2, 0))
            colors = onto_vertices(per_face[polygon_of], faces, vertices)
    return RawMesh(positions, faces, colors=colors, notes=tuple(notes))


def _vertex_colors(kind: bytes, rows: list[list[bytes]], notes: list[str]) -> Colors:
    start = 6 if b"N" in kind else 3
    if b"C" not in kind or not rows or min(map(len, rows)) < start + 3:
        return None
    stored = floats([word for row in rows for word in row[start : start + 3]]).reshape(-1, 3)
    return colors_from_stored(stored, None, notes)


def _face_colors(rows: list[list[bytes]], sizes: npt.NDArray[np.int64], notes: list[str]) -> Colors:
    """`n i j k r g b [a]`: integers up to 255 or floats up to 1; a lone number is a colour map's
    index, which says nothing without the map."""
    tails = [row[n + 1 : n + 4] for row, n in zip(rows, sizes, strict=True)]
    if not tails or min(map(len, tails)) < 3:
        return None
    stored = floats([word for tail in tails for word in tail]).reshape(-1, 3)
    whole = not any(b"." in value for tail in tails[:64] for value in tail)
    return colors_from_stored(stored, 255.0 if whole else 1.0, notes, "faces")
