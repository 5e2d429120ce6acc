"""Stanford PLY: ascii and binary, polygons, triangle strips, vertex and face colours, textures.

Texture coordinates come per vertex (s t, u v, texture_u texture_v) or per corner (`texcoord` with
`texnumber`, MeshLab's way); the image is named by a `comment TextureFile` line.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from scanrender.errors import ScanError
from scanrender.images import linear_from_srgb
from scanrender.scan.pages import Page, read_page
from scanrender.scan.raw import NO_PAGE, RawMesh
from scanrender.scan.read_mtl import lone_image
from scanrender.scan.safe_path import inside
from scanrender.scan.triangulate import fan_corners, onto_vertices, strip_faces

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_COLOR_NAMES = (
    ("red", "green", "blue"),
    ("r", "g", "b"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
)
Array = npt.NDArray[Any]
# A list column: how many values each row has, and all values end to end.
ListColumn = tuple[Array, Array]


@dataclass
class _Property:
    name: str
    dtype: str
    count_dtype: str | None = None  # set for lists


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)


@dataclass
class _Header:
    order: str  # "<", ">" or "" for ascii
    elements: list[_Element]
    textures: list[str]


def read_ply(path: Path) -> RawMesh:
    """Read a PLY. Raises ScanError for what cannot be parsed."""
    with path.open("rb") as stream:
        header = _header(stream, path)
        reader = _AsciiRows(stream, path) if not header.order else _BinaryRows(stream, path, header)
        tables = {element.name: reader.element(element) for element in header.elements}
    vertex = tables.get("vertex", {})
    if not all(axis in vertex for axis in "xyz"):
        raise ScanError(f"{path.name} has no vertex positions", str(path), "export it again")
    positions = np.stack([vertex[axis] for axis in "xyz"], axis=1).astype(np.float64)
    notes: list[str] = []
    faces, corner_uv, polygon_of = _faces(tables, vertex)
    face_table = tables.get("face", {})
    textures = header.textures
    if not textures and corner_uv is not None and (image := lone_image(path)) is not None:
        notes.append(f"the file names no texture: {image.name}, beside the scan, is used")
        textures = [image.name]
    pages, index = _pages(path, textures, notes)
    page = _page_of(index, face_table, polygon_of, len(faces))
    colors = _colors(vertex)
    if colors is None and len(polygon_of) == len(faces):
        colors = _face_colors(face_table, polygon_of, faces, len(positions), notes)
    return RawMesh(
        positions, faces, corner_uv, page, pages, (None,) * len(pages), colors, tuple(notes)
    )


def _header(stream: BinaryIO, path: Path) -> _Header:
    order, elements, textures = None, [], []
    for _ in range(10_000):
        line = stream.readline()
        words = line.decode("ascii", "replace").split()
        if not line or words == ["end_header"]:
            break
        if not words:
            continue
        if words[0] == "format" and len(words) > 1:
            order = _ORDERS.get(words[1])
        elif words[0] == "comment" and len(words) > 2 and words[1].lower() == "texturefile":
            textures.append(line.decode("utf-8", "replace").split(None, 2)[2].strip())
        elif words[0] == "element":
            elements.append(_Element(words[1], int(words[2])))
            if elements[-1].count < 0:
                raise _truncated(path, elements[-1])
        elif words[0] == "property" and elements:
            elements[-1].properties.append(
                _Property(words[4], _TYPES[words[3]], _TYPES[words[2]])
                if words[1] == "list"
                else _Property(words[2], _TYPES[words[1]])
            )
    if order is None or not elements:
        raise ScanError(f"{path.name} has no usable PLY header", str(path), "export it again")
    return _Header(order, elements, textures)


def _truncated(path: Path, element: _Element) -> ScanError:
    return ScanError(
        f"{path.name} ends before its {element.count} {element.name} elements do",
        str(path),
        "the file was cut short: copy or export it again",
    )


class _BinaryRows:
    """Rows of the body. Nothing is read or allocated that the file is not long enough for."""

    def __init__(self, stream: BinaryIO, path: Path, header: _Header) -> None:
        self.stream, self.path, self.order = stream, path, header.order
        self.size = path.stat().st_size

    def _holds(self, size: int) -> bool:
        return size <= self.size - self.stream.tell()

    def element(self, element: _Element) -> dict[str, Any]:
        lists = [p for p in element.properties if p.count_dtype]
        smallest = sum(np.dtype(p.count_dtype or p.dtype).itemsize for p in element.properties)
        if not element.properties:
            return {}
        if not self._holds(smallest * element.count):
            raise _truncated(self.path, element)
        if not lists:
            dtype = np.dtype([(p.name, self.order + p.dtype) for p in element.properties])
            return self._plain(element, dtype)
        return self._uniform(element) or self._general(element)

    def _plain(self, element: _Element, dtype: np.dtype[Any]) -> dict[str, Any]:
        data = self.stream.read(dtype.itemsize * element.count)
        table = np.frombuffer(data, dtype, element.count)
        return {p.name: table[p.name] for p in element.properties}

    def _uniform(self, element: _Element) -> dict[str, Any] | None:
        """The usual case: each list has the same length in every row, so rows have one layout."""
        start = self.stream.tell()
        first = self._row(element)
        fields: list[Any] = []
        for p, value in zip(element.properties, first or [], strict=False):
            if p.count_dtype:
                fields.append((p.name + "#", self.order + p.count_dtype))
                fields.append((p.name, self.order + p.dtype, (len(value),)))
            else:
                fields.append((p.name, self.order + p.dtype))
        self.stream.seek(start)
        if not fields:
            return {p.name: _no_rows(p) for p in element.properties} if not element.count else None
        dtype = np.dtype(fields)
        if self._holds(dtype.itemsize * element.count):
            data = self.stream.read(dtype.itemsize * element.count)
            table = np.frombuffer(data, dtype, element.count)
            lengths = {p.name: dtype[p.name].shape[0] for p in element.properties if p.count_dtype}
            if all((table[name + "#"] == length).all() for name, length in lengths.items()):
                return {
                    p.name: (
                        (np.full(element.count, lengths[p.name]), table[p.name].reshape(-1))
                        if p.count_dtype
                        else table[p.name]
                    )
                    for p in element.properties
                }
        self.stream.seek(start)
        return None

    def _general(self, element: _Element) -> dict[str, Any]:
        rows = []
        for _ in range(element.count):
            row = self._row(element)
            if row is None:
                raise _truncated(self.path, element)
            rows.append(row)
        return _columns(element, rows)

    def _row(self, element: _Element) -> list[Any] | None:
        row: list[Any] = []
        for p in element.properties:
            count = 1
            if p.count_dtype:
                head = self._values(p.count_dtype, 1)
                if head is None:
                    return None
                count = int(head[0])
            values = self._values(p.dtype, count)
            if values is None:
                return None
            row.append(values if p.count_dtype else values[0])
        return row

    def _values(self, dtype: str, count: int) -> Array | None:
        kind = np.dtype(self.order + dtype)
        if count < 0 or not self._holds(kind.itemsize * count):
            return None
        return np.frombuffer(self.stream.read(kind.itemsize * count), kind)


class _AsciiRows:
    def __init__(self, stream: BinaryIO, path: Path) -> None:
        self.lines = [line for line in stream.read().splitlines() if line.strip()]
        self.path, self.next = path, 0

    def element(self, element: _Element) -> dict[str, Any]:
        lines = self.lines[self.next : self.next + element.count]
        if len(lines) < element.count:
            raise _truncated(self.path, element)
        self.next += element.count
        width = len(element.properties)
        if not width:
            return {}
        if not any(p.count_dtype for p in element.properties):
            flat = np.array(b" ".join(lines).split(), dtype="S").astype(np.float64)
            if len(flat) != width * element.count:
                raise _truncated(self.path, element)
            table = flat.reshape(element.count, width)
            return {p.name: table[:, i] for i, p in enumerate(element.properties)}
        rows = []
        for line in lines:
            words, position = line.split(), 0
            row: list[Any] = []
            for p in element.properties:
                if p.count_dtype:
                    count = int(words[position])
                    values = words[position + 1 : position + 1 + count]
                    row.append(np.array(values, "S").astype(np.float64))
                    if len(values) != count:
                        raise _truncated(self.path, element)
                    position += 1 + count
                else:
                    row.append(float(words[position]))
                    position += 1
            rows.append(row)
        return _columns(element, rows)


def _no_rows(p: _Property) -> Any:
    return (np.zeros(0, np.int64), np.zeros(0)) if p.count_dtype else np.zeros(0)


def _columns(element: _Element, rows: list[list[Any]]) -> dict[str, Any]:
    if not rows:
        return {p.name: _no_rows(p) for p in element.properties}
    columns: dict[str, Any] = {}
    for i, p in enumerate(element.properties):
        column = [row[i] for row in rows]
        if p.count_dtype:
            columns[p.name] = (np.array([len(x) for x in column]), np.concatenate(column))
        else:
            columns[p.name] = np.array(column)
    return columns


def _faces(tables: dict[str, Any], vertex: dict[str, Any]) -> tuple[Array, Array | None, Array]:
    """Triangles, corner UV or None, and the row of `face` that each triangle came from."""
    vertex_uv = _vertex_uv(vertex)
    face = tables.get("face", {})
    indices = face.get("vertex_indices", face.get("vertex_index"))
    if indices is not None and len(indices[0]):
        sizes = np.asarray(indices[0], np.int64)
        corners = np.asarray(indices[1], np.int64)
        triangles = fan_corners(sizes)
        polygon_of = np.repeat(np.arange(len(sizes)), np.maximum(sizes - 2, 0))
        faces = corners[triangles]
        uv = _corner_uv(face.get("texcoord"), sizes)
        if uv is not None:
            return faces, uv[triangles], polygon_of
    elif "tristrips" in tables:
        lengths, strips = next(iter(tables["tristrips"].values()))
        # Rows are strips of their own, and -1 cuts a strip within a row.
        strips = np.insert(np.asarray(strips, np.int64), np.cumsum(lengths)[:-1], -1)
        strips = np.where(strips == 0xFFFFFFFF, -1, strips)
        faces, polygon_of = strip_faces(strips), np.zeros(0, np.int64)
    else:
        faces, polygon_of = np.zeros((0, 3), np.int64), np.zeros(0, np.int64)
    if vertex_uv is None or not len(vertex_uv):
        return faces, None, polygon_of
    # Faces that name no vertex are dropped by `ingest`: any coordinate will do for them.
    return faces, vertex_uv[np.clip(faces, 0, len(vertex_uv) - 1)], polygon_of


def _corner_uv(texcoord: Any, sizes: Array) -> Array | None:
    """UV (c, 2) of all corners end to end; NaN for polygons that have none of their own."""
    if not isinstance(texcoord, tuple) or len(texcoord[0]) != len(sizes):
        return None
    lengths, values = np.asarray(texcoord[0], np.int64), np.asarray(texcoord[1], np.float32)
    own = (lengths == 2 * sizes) & (sizes > 0)
    if not own.any():
        return None
    uv = np.full((int(sizes.sum()), 2), np.nan, np.float32)
    kept = values[np.repeat(own, lengths)].reshape(-1, 2)
    uv[np.repeat(own, sizes)] = np.stack([kept[:, 0], 1.0 - kept[:, 1]], axis=1)
    return uv


def _vertex_uv(vertex: dict[str, Any]) -> Array | None:
    for u, v in (("s", "t"), ("u", "v"), ("texture_u", "texture_v")):
        if u in vertex and v in vertex:
            return np.stack([vertex[u], 1.0 - np.asarray(vertex[v])], axis=1).astype(np.float32)
    return None


def _colors(table: dict[str, Any]) -> npt.NDArray[np.float32] | None:
    for names in _COLOR_NAMES:
        if all(name in table for name in names):
            stored = np.stack([np.asarray(table[name], np.float64) for name in names], axis=1)
            integers = np.asarray(table[names[0]]).dtype.kind in "iu"
            if not len(stored):
                return None
            scale = 255.0 if integers or stored.max() > 1.5 else 1.0
            scale = 65535.0 if stored.max() > 255.0 else scale
            return np.asarray(linear_from_srgb(np.nan_to_num(stored) / scale), np.float32)
    return None


def _face_colors(
    table: dict[str, Any], polygon_of: Array, faces: Array, vertex_count: int, notes: list[str]
) -> npt.NDArray[np.float32] | None:
    """Colours per face, averaged onto the vertices around."""
    stored = _colors(table)
    if stored is None or not len(faces) or faces.min() < 0 or faces.max() >= vertex_count:
        return None
    notes.append("the scan is coloured per face: averaged onto its vertices")
    return onto_vertices(stored[polygon_of], faces, vertex_count)


def _pages(path: Path, names: list[str], notes: list[str]) -> tuple[tuple[Page, ...], Array]:
    """The textures that are there, and the page of each `texnumber` (NO_PAGE for a missing one)."""
    pages: list[Page] = []
    index = np.full(max(len(names), 1), NO_PAGE, np.int16)
    for number, name in enumerate(names):
        image = inside(path.parent, name, path)
        if image is None:
            notes.append(f"the texture {name} is missing")
        else:
            index[number] = len(pages)
            pages.append(read_page(image))
    return tuple(pages), index


def _page_of(
    index: Array, face_table: dict[str, Any], polygon_of: Array, count: int
) -> npt.NDArray[np.int16]:
    """The page (count,) of each triangle; without texnumber all have the first texture."""
    if len(index) < 2 or "texnumber" not in face_table or not len(polygon_of):
        return np.full(count, index[0], np.int16)
    number = np.asarray(face_table["texnumber"])[polygon_of].astype(np.int64)
    known = (number >= 0) & (number < len(index))
    return np.where(known, index[np.where(known, number, 0)], NO_PAGE).astype(np.int16)
