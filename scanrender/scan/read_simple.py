"""STL (ascii, binary) and OFF (with its colour variants): triangles or polygons, hardly more."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from scanrender.errors import ScanError
from scanrender.images import linear_from_srgb
from scanrender.scan.raw import RawMesh
from scanrender.scan.triangulate import fan_corners

_NUMBER = rb"[-+0-9.eEnaifNAIF]+"
_VERTEX = re.compile(rb"vertex\s+(%b)\s+(%b)\s+(%b)" % (_NUMBER, _NUMBER, _NUMBER), re.IGNORECASE)
_RECORD = np.dtype([("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("attribute", "<u2")])


def read_stl(path: Path) -> RawMesh:
    """Read an STL: three own vertices per face, welded later. Raises ScanError."""
    data = path.read_bytes()
    count = int(np.frombuffer(data, "<u4", 1, 80)[0]) if len(data) >= 84 else -1
    # "solid" also begins many binary files: the size is the better evidence.
    if count >= 0 and len(data) == 84 + _RECORD.itemsize * count:
        corners = np.frombuffer(data, _RECORD, count, 84)["corner"].astype(np.float64)
    elif data.lstrip()[:5].lower() == b"solid":
        numbers = np.array(_VERTEX.findall(data), dtype="S")
        if len(numbers) % 3:
            raise ScanError(f"{path.name} ends inside a triangle", str(path), "export it again")
        corners = (numbers if len(numbers) else np.zeros(0)).astype(np.float64).reshape(-1, 3, 3)
    elif count >= 0 and len(data) > 84 + _RECORD.itemsize * count > 84:
        corners = np.frombuffer(data, _RECORD, count, 84)["corner"].astype(np.float64)
    else:
        raise ScanError(
            f"{path.name} ends before its {max(count, 0)} triangles do",
            str(path),
            "the file was cut short: copy or export it again",
        )
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return RawMesh(corners.reshape(-1, 3), faces)


def read_off(path: Path) -> RawMesh:
    """Read OFF, COFF, NOFF, STOFF: vertex lines `x y z [...]`, then `n i j k ... [colour]`."""
    lines = [
        words
        for line in path.read_bytes().splitlines()
        if (words := line.split(b"#", 1)[0].split())
    ]
    if not lines or not lines[0][0].upper().endswith(b"OFF"):
        raise ScanError(f"{path.name} does not begin like an OFF file", str(path), "export again")
    kind = lines[0][0].upper()
    head = lines[0][1:] or lines[1]
    body = lines[1:] if lines[0][1:] else lines[2:]
    if kind.startswith(b"4") or b"N4" in kind or len(head) < 2:
        raise ScanError(f"{path.name} is an unusual kind of OFF", str(path), "export it as PLY")
    vertices, polygons = int(head[0]), int(head[1])
    if vertices < 0 or polygons < 0 or len(body) < vertices + polygons:
        raise ScanError(
            f"{path.name} ends before its {vertices} vertices and {polygons} faces do",
            str(path),
            "the file was cut short: copy or export it again",
        )
    rows = body[:vertices]
    positions = np.array([row[:3] for row in rows], dtype="S").astype(np.float64).reshape(-1, 3)
    colors = None
    if b"C" in kind and rows and len(rows[0]) >= 6:
        start = 6 if b"N" in kind else 3
        stored = np.array([row[start : start + 3] for row in rows], dtype="S").astype(np.float64)
        scale = 255.0 if stored.max() > 1.5 else 1.0
        colors = np.asarray(linear_from_srgb(stored / scale), np.float32)
    face_rows = body[vertices : vertices + polygons]
    sizes = np.array([int(row[0]) for row in face_rows], np.int64)
    flat = [index for row, n in zip(face_rows, sizes, strict=True) for index in row[1 : n + 1]]
    corners = np.array(flat, dtype="S").astype(np.int64) if flat else np.zeros(0, np.int64)
    return RawMesh(positions, corners[fan_corners(sizes)], colors=colors)
