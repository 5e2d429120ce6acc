"""Stanford PLY: ascii and binary, polygons, triangle strips, vertex and face colours, textures.

Texture coordinates come per vertex (s t, u v, texture_u texture_v) or per corner (`texcoord` with
`texnumber`, MeshLab's way); the image is named by a `comment TextureFile` line.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from scanrender.errors import ScanError
from scanrender.scan.beside import lone_image
from scanrender.scan.pages import Page, read_page
from scanrender.scan.ply_rows import (
    AsciiRows,
    BinaryRows,
    Element,
    ListColumn,
    Property,
    truncated,
)
from scanrender.scan.raw import NO_PAGE, RawMesh
from scanrender.scan.safe_path import inside
from scanrender.scan.triangulate import onto_vertices, polygon_corners, strip_faces
from scanrender.scan.vertex_colors import colors_from_stored

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
_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("s0", "t0"), ("u0", "v0"))
_WHITE = {"u1": 255.0, "i1": 255.0, "u2": 65535.0, "i2": 65535.0, "u4": 255.0, "i4": 255.0}
_SINGLE = {"x", "y", "z", "texnumber"}.union(*_COLOR_NAMES, *_UV_NAMES)  # never lists
_LONGEST_LINE = 10_000  # bytes of a header
Array = npt.NDArray[Any]


@dataclass
class _Header:
    order: str  # "<", ">" or "" for ascii
    elements: list[Element]
    textures: list[str]


def read_ply(path: Path) -> RawMesh:
    """Read a PLY. Raises ScanError for what cannot be parsed."""
    with path.open("rb") as stream:
        header = _header(stream, path)
        order = header.order
        reader = BinaryRows(stream, path, order) if order else AsciiRows(stream, path)
        tables = {element.name: reader.element(element) for element in header.elements}
    notes: list[str] = []
    vertex = _singles(tables.get("vertex", {}), "vertices", notes)
    if not all(axis in vertex for axis in "xyz"):
        raise ScanError(f"{path.name} has no vertex positions", str(path), "export it again")
    positions = np.stack([vertex[axis] for axis in "xyz"], axis=1).astype(np.float64)
    faces, corner_uv, polygon_of = _faces(tables, vertex, positions, notes)
    face_table = tables.get("face", {})
    if face_table and _index_list(face_table) is None and not len(faces):
        raise ScanError(
            f"{path.name} has faces without a list of vertex indices, only {', '.join(face_table)}",
            str(path),
            "export it again as a mesh",
        )
    of_face = _singles(face_table, "faces", notes)
    textures = header.textures
    if not textures and corner_uv is not None and (image := lone_image(path, notes)) is not None:
        notes.append(f"the file names no texture: {image.name}, beside the scan, is used")
        textures = [image.name]
    pages, index = _pages(path, textures, notes)
    page = _page_of(index, of_face, polygon_of, len(faces))
    white = {element.name: _white(element) for element in header.elements}
    colors = _colors(vertex, white["vertex"], "vertices", notes)
    if colors is None and len(polygon_of) == len(faces):
        shades = _colors(of_face, white.get("face"), "faces", notes)
        colors = _from_faces(shades, polygon_of, faces, len(positions), notes)
    return RawMesh(
        positions, faces, corner_uv, page, pages, (None,) * len(pages), colors, tuple(notes)
    )


def _header(stream: BinaryIO, path: Path) -> _Header:
    order, elements, textures = None, [], []
    head = stream.read(5)
    stream.seek(0)
    old_mac = head[3:4] == b"\r" and head[4:] != b"\n"
    for _ in range(10_000):
        line = _old_mac_line(stream) if old_mac else stream.readline()
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
            elements.append(Element(words[1].lower(), int(words[2])))
            if elements[-1].count < 0:
                raise truncated(path, elements[-1])
        elif words[0] == "property" and elements:
            elements[-1].properties.append(_property(words, path))
    if order is None or not elements:
        raise ScanError(f"{path.name} has no usable PLY header", str(path), "export it again")
    return _Header(order, elements, textures)


def _old_mac_line(stream: BinaryIO) -> bytes:
    line = bytearray()
    while (byte := stream.read(1)) and byte != b"\r" and len(line) < _LONGEST_LINE:
        line += byte
    return bytes(line + byte)


def _property(words: list[str], path: Path) -> Property:
    types = words[2:4] if words[1] == "list" else words[1:2]
    for unknown in (word for word in types if word not in _TYPES):
        raise ScanError(
            f"{path.name} has properties of the type {unknown[:40]!r}, which PLY does not know",
            str(path),
            "export it again with float and int properties",
        )
    if words[1] == "list":
        return Property(words[4].lower(), _TYPES[types[1]], _TYPES[types[0]])
    return Property(words[2].lower(), _TYPES[types[0]])


def _singles(table: dict[str, Any], what: str, notes: list[str]) -> dict[str, Any]:
    """The columns that hold one value a row; a list where one is expected is noted."""
    lists = [name for name, column in table.items() if isinstance(column, tuple)]
    if strange := [name for name in lists if name in _SINGLE]:
        notes.append(f"{', '.join(strange)} of its {what} are lists, not numbers: not read")
    return {name: column for name, column in table.items() if name not in lists}


def _whole(values: Any) -> npt.NDArray[np.int64]:
    """As whole numbers; -2, which names nothing, for what is no number or beyond all of them."""
    values = np.asarray(values)
    if values.dtype.kind == "f":
        values = np.where(np.abs(values) < 2.0**62, values, -2.0)
    return np.asarray(values, np.int64)


def _faces(
    tables: dict[str, Any], vertex: dict[str, Any], positions: Array, notes: list[str]
) -> tuple[Array, Array | None, Array]:
    """Triangles, corner UV or None, and the row of `face` that each triangle came from."""
    vertex_uv = _vertex_uv(vertex)
    face = tables.get("face", {})
    indices = _index_list(face)
    if indices is not None and len(indices[0]):
        sizes = np.asarray(indices[0], np.int64)
        corners = _whole(indices[1])
        if _strips(tables) is not None:
            notes.append("the scan has faces and triangle strips: the strips are not read")
        triangles = polygon_corners(sizes, corners, positions, notes)
        polygon_of = np.repeat(np.arange(len(sizes)), np.maximum(sizes - 2, 0))
        faces = np.take(corners, triangles)
        uv = _corner_uv(face.get("texcoord"), sizes)
        if uv is not None:
            return faces, uv[triangles], polygon_of
    elif (found := _strips(tables)) is not None:
        lengths, values = found
        # Rows are strips of their own, and -1 cuts a strip within a row.
        strips = np.insert(_whole(values), np.cumsum(lengths)[:-1], -1)
        strips = np.where(strips == 0xFFFFFFFF, -1, strips)
        faces, polygon_of = strip_faces(strips), np.zeros(0, np.int64)
    else:
        faces, polygon_of = np.zeros((0, 3), np.int64), np.zeros(0, np.int64)
    if vertex_uv is None or not len(vertex_uv):
        return faces, None, polygon_of
    # Faces that name no vertex are dropped by `ingest`: any coordinate will do for them.
    return faces, vertex_uv[np.clip(faces, 0, len(vertex_uv) - 1)], polygon_of


def _strips(tables: dict[str, Any]) -> ListColumn | None:
    lists = [x for x in tables.get("tristrips", {}).values() if isinstance(x, tuple)]
    return lists[0] if lists and len(lists[0][1]) else None


def _index_list(face: dict[str, Any]) -> ListColumn | None:
    """The list of vertex indices, whatever it is called: the first list that is no coordinate."""
    for name in ("vertex_indices", "vertex_index"):
        if name in face:
            return face[name] if isinstance(face[name], tuple) else None
    lists = [x for name, x in face.items() if isinstance(x, tuple) and name[:3] != "tex"]
    return lists[0] if lists else None


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
    for u, v in _UV_NAMES:
        if u in vertex and v in vertex:
            return np.stack([vertex[u], 1.0 - np.asarray(vertex[v])], axis=1).astype(np.float32)
    return None


def _white(element: Element) -> float | None:
    """What white is stored as in the element's colours, by their type; None for fractions."""
    types = {p.name: p.dtype for p in element.properties}
    return next((_WHITE.get(types[name]) for name, *_ in _COLOR_NAMES if name in types), None)


def _colors(
    table: dict[str, Any], white: float | None, what: str, notes: list[str]
) -> npt.NDArray[np.float32] | None:
    for names in _COLOR_NAMES:
        if all(name in table for name in names):
            stored = np.stack([np.asarray(table[name]) for name in names], axis=1)
            if white == 65535.0 and stored.max(initial=0) <= 255:  # bytes in wider numbers
                white = 255.0
            return colors_from_stored(stored, white, notes, what)
    return None


def _from_faces(
    shades: Array | None, polygon_of: Array, faces: Array, vertex_count: int, notes: list[str]
) -> npt.NDArray[np.float32] | None:
    """Colours of polygons, averaged onto the vertices around."""
    if shades is None or not len(faces):
        return None
    notes.append("the scan is coloured per face: averaged onto its vertices")
    return onto_vertices(shades[polygon_of], faces, vertex_count)


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
    number = _whole(face_table["texnumber"])[polygon_of]
    known = (number >= 0) & (number < len(index))
    return np.where(known, index[np.where(known, number, 0)], NO_PAGE).astype(np.int16)
