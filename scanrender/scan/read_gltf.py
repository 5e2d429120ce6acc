"""glTF and GLB: every triangle of the default scene, nodes, morph targets and skins applied.

Vertices come out in the file's own unit, which the specification fixes as metres with +Y up.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.errors import ScanError
from scanrender.scan.gltf_file import GltfFile
from scanrender.scan.gltf_scene import Instance, instances, morphed, skinned
from scanrender.scan.pages import Page, constant_page
from scanrender.scan.printable import printable
from scanrender.scan.raw import NO_PAGE, RawMesh
from scanrender.scan.triangulate import strip_faces

Array = npt.NDArray[Any]
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_MOST_TRIANGLES = 1 << 28
_WIDTHS: dict[str, tuple[int, ...]] = {
    "positions": (3,), "uv": (2,), "colors": (3, 4), "joints": (4,), "weights": (4,)
}  # fmt: skip
# What the mesh is usable without; the others are refused where they do not fit.
_SPARED = {"uv": "texture coordinates", "colors": "vertex colours"}
_INSTANCING = "EXT_mesh_gpu_instancing"


# Places and coordinates that are not finite are for `ingest` to drop, not for NumPy to warn of.
@np.errstate(over="ignore", invalid="ignore")
def read_gltf(path: Path) -> RawMesh:
    """Read a .gltf or .glb. Raises ScanError."""
    file = GltfFile(path)
    notes: list[str] = []
    parts = _Parts()
    materials = _Materials(file, notes)
    if _INSTANCING in (file.json.get("extensionsUsed") or ()):
        notes.append(f"the copies that {_INSTANCING} makes are ignored: each mesh is read once")
    for (mesh, weights), places in _by_shape(instances(file)).items():
        for primitive in file.entry("meshes", mesh).get("primitives", []):
            if primitive.get("mode", _TRIANGLES) not in (_TRIANGLES, _STRIP, _FAN):
                notes.append("points and lines are ignored")
                continue
            part = _primitive(file, primitive, weights, materials)
            for place in places:
                parts.add(*_placed(part, place, path))
                if parts.triangles > _MOST_TRIANGLES:
                    what = f"{path.name} has too many triangles"
                    raise ScanError(what, str(path), "export a part")
    if not parts.positions:
        raise _nothing(file)
    return parts.joined(materials, notes)


def _by_shape(found: list[Instance]) -> dict[tuple[int, tuple[float, ...]], list[Instance]]:
    """Where each mesh stands: whatever stands in several places is decoded once."""
    places: dict[tuple[int, tuple[float, ...]], list[Instance]] = {}
    for instance in found:
        places.setdefault((instance.mesh, instance.weights), []).append(instance)
    return places


def _placed(part: dict[str, Any], place: Instance, path: Path) -> tuple[dict[str, Any], Array]:
    if place.joints is None or "joints" not in part or "weights" not in part:
        return part, place.matrix
    # The node of a skinned mesh does not move it.
    return {**part, "positions": skinned(part, place.joints, path)}, np.eye(4)


def _nothing(file: GltfFile) -> ScanError:
    where, name = str(file.path), file.path.name
    if file.json.get("meshes") and not instances(file):
        return ScanError(
            f"{name}: no node of its scene shows its meshes", where, "export the scene, not parts"
        )
    return ScanError(f"{name} has no triangles", where, "export it again as a mesh")


class _Materials:
    """Pages by material index, read once each."""

    def __init__(self, file: GltfFile, notes: list[str]) -> None:
        self.file, self.notes = file, notes
        self.pages: list[Page] = []
        self.normals: list[Page | None] = []
        self._known: dict[int, tuple[int, int, dict[str, Any]]] = {}

    def page(self, material: int | None) -> tuple[int, int, dict[str, Any]]:
        """(page or NO_PAGE, texture coordinate set, texture transform) of a material."""
        if material is None:
            return NO_PAGE, 0, {}
        if material not in self._known:
            self._known[material] = self._read(self.file.entry("materials", material))
        return self._known[material]

    def _read(self, entry: dict[str, Any]) -> tuple[int, int, dict[str, Any]]:
        pbr = entry.get("pbrMetallicRoughness", {})
        color, factor = pbr.get("baseColorTexture"), pbr.get("baseColorFactor", [1, 1, 1, 1])
        glossy = entry.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness", {})
        if color is None and "diffuseTexture" in glossy:
            color, factor = glossy["diffuseTexture"], glossy.get("diffuseFactor", factor)
        glow = entry.get("emissiveTexture")
        if color is None and glow is not None:  # how exporters keep a photograph from being lit
            color, factor = glow, entry.get("emissiveFactor", [1, 1, 1])
            self.notes.append("a material has its image as light of its own: it is the colour here")
        rgb = _fractions(factor, self.notes)
        page = None
        if color is not None:
            page = self.file.page(color["index"], "srgb", self.notes)
            if page is not None:
                page = Page(page.name, page.pixels, page.encoding, rgb)
        if page is None:
            if max(rgb) - min(rgb) < 0.02:
                return NO_PAGE, 0, {}
            page, color = constant_page(printable(entry.get("name", "material")), rgb), {}
        normal = entry.get("normalTexture")
        channel = (color or {}).get("texCoord", 0)
        same_set = normal is not None and normal.get("texCoord", 0) == channel
        self.pages.append(page)
        self.normals.append(
            self.file.page(normal["index"], "linear", self.notes) if normal and same_set else None
        )
        transform = (color or {}).get("extensions", {}).get("KHR_texture_transform", {})
        return len(self.pages) - 1, int(transform.get("texCoord", channel)), transform

    def tinted(self, colors: Array, page: int) -> tuple[Array | None, int]:
        """COLOR_0 and the page it leaves: the specification multiplies it with the base colour.

        A material without an image gives its colour to the vertices. Beside an image, vertex
        colours are masks or leftovers far more often than tints of a scan: they are left out.
        """
        # Linear by the specification, which also wants integers to be marked as fractions.
        full = float(np.iinfo(colors.dtype).max) if colors.dtype.kind in "iu" else 1.0
        colors = colors[:, :3].astype(np.float32) / np.float32(full)
        known = np.isfinite(colors).all(axis=1)
        full = 255.0 if colors[known].max(initial=0.0) > 1.5 else 1.0
        colors = np.clip(colors / np.float32(full), 0.0, 1.0)
        if page != NO_PAGE and max(self.pages[page].size) > 1:
            if (colors < 0.99).any():
                self.notes.append(
                    "vertex colours beside a texture are ignored: the texture is used"
                )
            return None, page
        if len(colors) and not known.any():
            self.notes.append("the vertex colours are not numbers: they are ignored")
            return None, page
        if not known.all():
            count = int((~known).sum())
            self.notes.append(f"{count} vertices have no colour: they take the mean one")
            colors = np.where(known[:, None], colors, colors[known].mean(axis=0))
        if page == NO_PAGE:
            return colors, page
        return colors * np.asarray(self.pages[page].factor, np.float32), NO_PAGE


class _Parts:
    """Primitives in world space, waiting to be joined."""

    def __init__(self) -> None:
        self.positions: list[Array] = []
        self.faces: list[Array] = []
        self.uv: list[Array | None] = []
        self.page: list[Array] = []
        self.colors: list[Array | None] = []
        self.count = self.triangles = 0

    def add(self, part: dict[str, Any], matrix: Array) -> None:
        world = part["positions"] @ matrix[:3, :3].T + matrix[:3, 3]
        faces = part["faces"]
        if np.linalg.det(matrix[:3, :3]) < 0:  # a mirrored node turns its triangles inside out
            faces = faces[:, ::-1]
        bad = (faces < 0) | (faces >= len(world))
        self.faces.append(np.where(bad, -1, faces + self.count))
        safe = np.where(bad, 0, faces)
        self.uv.append(None if part["uv"] is None else part["uv"][safe])
        self.page.append(np.full(len(faces), part["page"], np.int16))
        self.colors.append(part["colors"])
        self.positions.append(world)
        self.count += len(world)
        self.triangles += len(faces)

    def joined(self, materials: _Materials, notes: list[str]) -> RawMesh:
        corner_uv = None
        if any(uv is not None for uv in self.uv):
            pairs = zip(self.uv, self.faces, strict=True)
            blank = [np.full((len(f), 3, 2), np.nan) if uv is None else uv for uv, f in pairs]
            corner_uv = np.concatenate(blank).astype(np.float32)
        colors = None
        if any(c is not None for c in self.colors):
            if materials.pages and all(max(page.size) == 1 for page in materials.pages):
                self._plain_to_vertices(materials.pages)
            both = zip(self.colors, self.positions, strict=True)
            colors = np.concatenate([np.ones((len(p), 3)) if c is None else c for c, p in both])
        return RawMesh(
            positions=np.concatenate(self.positions).astype(np.float64),
            faces=np.concatenate(self.faces).astype(np.int64),
            corner_uv=corner_uv,
            page=np.concatenate(self.page),
            pages=tuple(materials.pages),
            normal_pages=tuple(materials.normals),
            colors=None if colors is None else colors.astype(np.float32),
            notes=tuple(dict.fromkeys(notes)),
            up_hint="+y",
            mm_hint=1000.0,
        )

    def _plain_to_vertices(self, pages: list[Page]) -> None:
        """Beside vertex colours, materials of one colour become vertex colours too."""
        for i, page in enumerate(self.page):
            if self.colors[i] is None and len(page) and page[0] != NO_PAGE:
                count = len(self.positions[i])
                self.colors[i] = np.tile(np.asarray(pages[page[0]].factor), (count, 1))
                self.page[i] = np.full_like(page, NO_PAGE)


def _fractions(stored: list[Any], notes: list[str]) -> tuple[float, float, float]:
    """Red, green and blue of a factor, which the specification wants to be in [0, 1]."""
    red, green, blue = (float(value) for value in stored[:3])
    rgb = (red, green, blue)
    if all(0.0 <= value <= 1.0 for value in rgb):
        return rgb
    notes.append("a material has a colour that is not a fraction: it is made one")
    red, green, blue = (min(max(v, 0.0), 1.0) if math.isfinite(v) else 1.0 for v in rgb)
    return red, green, blue


def _primitive(
    file: GltfFile,
    primitive: dict[str, Any],
    weights: tuple[float, ...],
    materials: _Materials,
) -> dict[str, Any]:
    page, channel, transform = materials.page(primitive.get("material"))
    names = {
        "POSITION": "positions",
        f"TEXCOORD_{channel}": "uv",
        "COLOR_0": "colors",
        "JOINTS_0": "joints",
        "WEIGHTS_0": "weights",
    }
    draco = primitive.get("extensions", {}).get("KHR_draco_mesh_compression")
    if draco is not None:
        found, faces = _draco(file, draco, names)
    else:
        present = {k: v for k, v in primitive["attributes"].items() if k in names}
        found = {names[k]: file.accessor(v) for k, v in present.items()}
        faces = _triangles(file, primitive, len(found["positions"]))
    found = _fitting(found, file, materials.notes)
    uv, colors = found.get("uv"), found.get("colors")
    if uv is not None and transform:
        uv = _transformed(uv, transform)
    if colors is not None:
        colors, page = materials.tinted(colors, page)
    positions = morphed(file, primitive, found["positions"].astype(np.float64), weights)
    return {
        **found, "positions": positions, "faces": faces, "uv": uv, "colors": colors, "page": page
    }  # fmt: skip


def _fitting(found: dict[str, Array], file: GltfFile, notes: list[str]) -> dict[str, Array]:
    """The attributes that have one row of the right width for each vertex."""
    fitting = {}
    for name, values in found.items():
        if len(values) == len(found["positions"]) and values.shape[1] in _WIDTHS[name]:
            fitting[name] = values
        elif name in _SPARED:
            notes.append(f"{_SPARED[name]} that do not fit the vertices are ignored")
        else:
            raise file.broken(f"its {name} are not {_WIDTHS[name][0]} numbers for each vertex")
    return fitting


def _triangles(file: GltfFile, primitive: dict[str, Any], vertex_count: int) -> Array:
    if "indices" in primitive:
        stored = file.accessor(primitive["indices"])
        if stored.dtype.kind not in "iu" or stored.shape[1] != 1:
            raise file.broken("its indices are not whole numbers, one for each corner")
        indices = stored[:, 0].astype(np.int64)
    else:
        indices = np.arange(vertex_count)
    mode = primitive.get("mode", _TRIANGLES)
    if mode == _STRIP:
        return strip_faces(indices)
    if mode == _FAN:
        hub = np.full(max(0, len(indices) - 2), indices[0] if len(indices) else 0)
        return np.stack([hub, indices[1:-1], indices[2:]], axis=1)
    return indices[: len(indices) // 3 * 3].reshape(-1, 3)


def _draco(
    file: GltfFile, extension: dict[str, Any], names: dict[str, str]
) -> tuple[dict[str, Array], Array]:
    import DracoPy

    try:
        mesh = DracoPy.decode(file.view(extension["bufferView"]))
    except DracoPy.FileTypeException as error:  # derived from nothing narrower than Exception
        raise file.broken("its Draco data is damaged") from error
    by_id = {a["unique_id"]: a for a in mesh.attributes}
    found: dict[str, Array] = {}
    for semantic, unique_id in extension["attributes"].items():
        if semantic in names:
            data = np.asarray(by_id[unique_id]["data"])
            found[names[semantic]] = data.reshape(len(data), -1)
    if not np.asarray(found["positions"]).any():
        raise file.broken("Draco gave only zeros")
    return found, np.asarray(mesh.faces, np.int64).reshape(-1, 3)


def _transformed(uv: Array, transform: dict[str, Any]) -> Array:
    """KHR_texture_transform: offset + rotation * scale * uv."""
    scale, offset = transform.get("scale", [1, 1]), transform.get("offset", [0, 0])
    c, s = np.cos(transform.get("rotation", 0.0)), np.sin(transform.get("rotation", 0.0))
    rotation = np.array([[c, s], [-s, c]])
    return np.asarray((uv * np.asarray(scale)) @ rotation.T + np.asarray(offset))
