"""Asset: what a prepared scan is. The only thing that scan preparation and rendering share.

On disk an asset is one folder that other tools read too:

    mesh.glb             indexed triangles, normals, tangents, UV0; millimetres under a root node of
                         scale 0.001 (glTF is in metres); right-handed, +Y up, the subject faces +Z
    albedo.png           sRGB, 8 bit                      normal_ts.png   tangent space, +Y, 16 bit
    normal_geometry.exr  object space, no detail map      curvature.exr   mean curvature, 1/mm
    ao.exr               ambient visibility in [0, 1]     thickness_mm.exr
    skin.exr             probability of skin in [0, 1]    asset.json      `info`, see below
    lod1.glb, lod2.glb   coarser meshes on the same maps, where they were asked for
    prep_report.json, prep_sheet.png                      what was done and lost, for people

UV origin is glTF's: (0, 0) is the top left corner of the first texel row.
"""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender import __version__, images
from scanrender.errors import OutputError, ScanError, UsageError
from scanrender.files import atomic_folder, write_json

FloatArray = npt.NDArray[np.float32]
FORMAT_VERSION = 1
# Beside the asset's own files, for people; `load_asset` does not read them.
PREP_REPORT, PREP_SHEET, PREP_VIEWS = "prep_report.json", "prep_sheet.png", "prep_views.npz"
LOD_FILE = "lod{}.glb"
METRES_PER_MM = 0.001
# glTF's numbers for types of components, and for what a buffer view holds.
_UINT32, _FLOAT32, _VERTICES, _INDICES = 5125, 5126, 34962, 34963


@dataclass(frozen=True)
class MapFormat:
    """How one map is stored: file name, number of channels, and what the numbers mean."""

    file: str
    channels: int
    unit: str


MAPS: Mapping[str, MapFormat] = {
    "albedo": MapFormat("albedo.png", 3, "lin_rec709_scene in memory, sRGB on disk"),
    "normal_ts": MapFormat("normal_ts.png", 3, "unit vector, MikkTSpace, +Y; (n+1)/2 on disk"),
    "normal_geometry": MapFormat("normal_geometry.exr", 3, "unit vector, object space"),
    "curvature": MapFormat("curvature.exr", 1, "mean curvature in 1/mm, convex positive"),
    "ao": MapFormat("ao.exr", 1, "ambient visibility, 0 to 1"),
    "thickness_mm": MapFormat("thickness_mm.exr", 1, "mm along the inward normal"),
    "skin": MapFormat("skin.exr", 1, "probability of skin, 0 to 1"),
}


@dataclass(frozen=True)
class Mesh:
    """Triangles ready to draw.

    positions_mm (n, 3) float32; normals (n, 3) unit *geometry* normals; tangents (n, 4) with the
    bitangent's sign in w; uv (n, 2); faces (m, 3) uint32, counter-clockwise seen from outside.
    """

    positions_mm: FloatArray
    normals: FloatArray
    tangents: FloatArray
    uv: FloatArray
    faces: npt.NDArray[np.uint32]

    @property
    def bounds_mm(self) -> tuple[FloatArray, FloatArray]:
        return self.positions_mm.min(axis=0), self.positions_mm.max(axis=0)


@dataclass(frozen=True)
class Asset:
    """A prepared scan. `maps[name]` is (h, w, channels) float32 in the units of `MAPS`.

    `info` is plain JSON data: `source` (file, hash), `units` (mm_per_unit, reason, confidence),
    `raw_from_asset` (4x4, float64 as nested lists), `counts`, `stages` (name, seconds, notes),
    `lost` (errors against the raw scan), `warnings` (sentences), and for each of `lods` its
    triangles and error_mm. `lods` are coarser meshes that use the same maps, finest first.
    """

    mesh: Mesh
    maps: Mapping[str, images.Image]
    info: Mapping[str, Any] = field(default_factory=dict)
    lods: Sequence[Mesh] = ()


def check_mesh(mesh: Mesh, where: str | None = None) -> None:
    """Raise ScanError for a mesh that cannot be drawn: empty, not finite, or with faces of vertices
    that are not there. One vertex that is no number is enough for a triangle across the picture."""
    count = len(mesh.positions_mm)
    what = ""
    if count == 0 or len(mesh.faces) == 0:
        what = "the mesh is empty"
    elif int(mesh.faces.max()) >= count:
        what = f"a face names vertex {int(mesh.faces.max())} of {count}"
    for name in ("positions_mm", "normals", "tangents", "uv"):
        bad = int((~np.isfinite(getattr(mesh, name))).any(axis=1).sum())
        what = what or (f"{bad} vertices have {name} that are not finite" if bad else "")
    if what:
        raise ScanError(what, where, "prepare the scan again: scanrender prep")


def is_asset(folder: Path | str) -> bool:
    """Whether this is a prepared scan's folder and not a raw scan."""
    return (Path(folder) / "asset.json").is_file()


def check_replaceable(folder: Path | str) -> None:
    """An asset replaces its whole folder, so only one that is free, empty, or an asset may be it.

    Raises OutputError: `prep SCAN --out ~/Documents` must not empty that folder.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder} is a file: it would be replaced", str(folder), "name a folder")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / "asset.json").is_file():
        raise OutputError(
            f"{folder} holds other files and is not an asset: it would be replaced whole",
            str(folder),
            "name a folder that does not exist yet, e.g. --out out/asset",
        )


def save_asset(asset: Asset, folder: Path | str) -> Path:
    """Write the asset folder complete or not at all. Raises OutputError."""
    folder = Path(folder)
    check_replaceable(folder)
    with atomic_folder(folder) as temporary:
        with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:  # zlib takes most of the time
            list(pool.map(lambda item: _write_map(temporary, *item), asset.maps.items()))
        _write_glb(temporary / "mesh.glb", asset.mesh, asset.maps)
        for number, lod in enumerate(asset.lods, 1):
            _write_glb(temporary / LOD_FILE.format(number), lod, asset.maps)
        document = {"format": FORMAT_VERSION, "scanrender": __version__, **asset.info}
        document["maps"] = {name: MAPS[name].file for name in asset.maps}
        document["lods"] = _listed_lods(asset)
        write_json(temporary / "asset.json", document)
    return folder


def load_asset(folder: Path | str, maps: Collection[str] | None = None) -> Asset:
    """Read an asset folder, with all its maps or only those named in `maps`.

    Raises UsageError when the folder is not there, ScanError when it is not a usable asset.
    """
    folder = Path(folder)
    if not folder.exists():
        raise UsageError(f"no such asset: {folder}", fix="make one: scanrender prep SCAN --out …")
    description = folder / "asset.json"
    try:
        info = json.loads(description.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ScanError(
            f"{folder} is not an asset folder: {error}", str(description), "run: scanrender prep"
        ) from error
    if not isinstance(info, dict) or info.get("format") != FORMAT_VERSION:
        found = info.get("format") if isinstance(info, dict) else "of no kind"
        raise ScanError(
            f"asset format {found} is not {FORMAT_VERSION}",
            str(description),
            "prepare the scan again: scanrender prep",
        )
    listed = info.get("maps")
    if not isinstance(listed, dict) or not set(listed) <= set(MAPS):
        raise ScanError("the asset does not list its maps", str(description), "prepare it again")
    levels = info.get("lods", [])
    if not isinstance(levels, list):
        raise ScanError("the asset does not list its lods", str(description), "prepare it again")
    wanted = [name for name in listed if maps is None or name in maps]
    files = ["mesh.glb", *(LOD_FILE.format(number) for number in range(1, 1 + len(levels)))]
    meshes = [_read_glb(folder / file) for file in files]
    for mesh, file in zip(meshes, files, strict=True):
        check_mesh(mesh, str(folder / file))
    with ThreadPoolExecutor(2) as pool:
        maps_read = dict(
            zip(wanted, pool.map(lambda name: _read_map(folder, name), wanted), strict=True)
        )
    return Asset(
        mesh=meshes[0],
        maps=maps_read,
        info=info,
        lods=tuple(meshes[1:]),
    )


def _listed_lods(asset: Asset) -> list[dict[str, Any]]:
    """Each level with its file and what `info` says of it."""
    said = asset.info.get("lods", ())
    return [
        {
            **(said[i] if i < len(said) else {}),
            "file": LOD_FILE.format(i + 1),
            "triangles": len(lod.faces),
        }
        for i, lod in enumerate(asset.lods)
    ]


def _write_map(folder: Path, name: str, pixels: images.Image) -> None:
    path = folder / MAPS[name].file
    if name == "albedo":
        images.write_srgb_png(path, pixels)
    elif name == "normal_ts":
        levels = images.by_rows(pixels, np.uint16, _levels16)
        images.write_image(path, levels, attributes=images.FAST_PNG)
    else:
        channels = ("X", "Y", "Z") if MAPS[name].channels == 3 else ("Y",)
        images.write_image(
            path,
            pixels.astype(np.float32),
            channels=channels,
            attributes={"compression": "zip", "DateTime": "1970:01:01 00:00:00"},
        )


def _levels16(vectors: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return np.asarray(np.clip(vectors * 0.5 + 0.5, 0.0, 1.0) * 65535.0 + 0.5)


def _read_map(folder: Path, name: str) -> images.Image:
    path = folder / MAPS[name].file
    if images.channel_count(path) < MAPS[name].channels:
        raise ScanError(f"{path} has too few channels", str(path), "prepare it again")
    if name == "albedo":
        return _decoded(images.read_colors(path))
    if name == "normal_ts":
        return _unit_vectors(images.read_colors(path))
    return images.read_image(path)[:, :, : MAPS[name].channels]


def _decoded(stored: npt.NDArray[Any]) -> images.Image:
    """Linear albedo of sRGB levels; by a table, since powers of 17 million texels take seconds."""
    if not np.issubdtype(stored.dtype, np.integer):
        return images.linear_from_srgb(stored).astype(np.float32)
    levels = int(np.iinfo(stored.dtype).max)
    table = images.linear_from_srgb(np.arange(levels + 1) / levels).astype(np.float32)
    linear = np.empty(stored.shape, np.float32)
    for row, levels_of_row in zip(linear, stored, strict=True):
        row[:] = table[levels_of_row]  # all at once, the indices would be 400 MB of fresh memory
    return linear


def _unit_vectors(stored: npt.NDArray[Any]) -> images.Image:
    """Levels of [-1, 1] to vectors of length 1, in place: the map may have 50 million numbers."""
    whole = np.iinfo(stored.dtype).max if np.issubdtype(stored.dtype, np.integer) else 1
    vectors: images.Image = np.multiply(stored, np.float32(2.0 / whole), dtype=np.float32)
    vectors -= np.float32(1.0)
    length = np.sqrt(np.einsum("ijk,ijk->ij", vectors, vectors))
    vectors /= np.maximum(length, np.float32(1e-6))[:, :, None]
    return vectors


def _write_glb(path: Path, mesh: Mesh, maps: Mapping[str, images.Image]) -> None:
    """glTF 2.0 in one file: Khronos specification, sections 3 and 4.4.

    By hand: the libraries for it take longer to load than a mesh takes to write.
    """
    arrays = [
        (mesh.positions_mm, "VEC3"), (mesh.normals, "VEC3"), (mesh.tangents, "VEC4"),
        (mesh.uv, "VEC2"), (mesh.faces.reshape(-1), "SCALAR"),
    ]  # fmt: skip
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    blob = b""
    for array, kind in arrays:
        data = np.ascontiguousarray(array, "<u4" if kind == "SCALAR" else "<f4").tobytes()
        target = _INDICES if kind == "SCALAR" else _VERTICES
        views.append(
            {"buffer": 0, "byteOffset": len(blob), "byteLength": len(data), "target": target}
        )
        component = _UINT32 if kind == "SCALAR" else _FLOAT32
        count, view = len(array), len(accessors)
        accessors.append(
            {"bufferView": view, "componentType": component, "count": count, "type": kind}
        )
        blob += data
    low, high = mesh.bounds_mm
    accessors[0].update(min=low.tolist(), max=high.tolist())
    attributes = {"POSITION": 0, "NORMAL": 1, "TANGENT": 2, "TEXCOORD_0": 3}
    document = {
        "asset": {"version": "2.0", "generator": f"scanrender {__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "root_mm", "scale": [METRES_PER_MM] * 3, "mesh": 0}],
        "meshes": [
            {
                "name": "skin",
                "primitives": [{"attributes": attributes, "indices": 4, "material": 0}],
            }
        ],
        **_gltf_material(maps),
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(blob)}],
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(blob), b"BIN\0") + blob
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def _gltf_material(maps: Mapping[str, images.Image]) -> dict[str, Any]:
    """Reference albedo and normal by file name, so that the folder opens textured elsewhere."""
    shown = [name for name in ("albedo", "normal_ts") if name in maps]
    # 0.45 is the GGX roughness that looks closest to our two Beckmann lobes in other viewers.
    pbr: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 0.45}
    material: dict[str, Any] = {"name": "skin", "pbrMetallicRoughness": pbr}
    if "albedo" in shown:
        pbr["baseColorTexture"] = {"index": shown.index("albedo")}
    if "normal_ts" in shown:
        material["normalTexture"] = {"index": shown.index("normal_ts")}
    if not shown:
        return {"materials": [material]}
    return {
        "materials": [material],
        "samplers": [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}],
        "images": [{"uri": MAPS[name].file} for name in shown],
        "textures": [{"source": source, "sampler": 0} for source in range(len(shown))],
    }


def _read_glb(path: Path) -> Mesh:
    """What `_write_glb` wrote, or another tool from it in the same layout."""
    try:
        data = path.read_bytes()
        magic, version, size = struct.unpack_from("<4sII", data)
        if magic != b"glTF" or version != 2 or size != len(data):
            raise ValueError("it is no GLB, or not all of one")
        (text_size,) = struct.unpack_from("<I", data, 12)
        document, start = json.loads(data[20 : 20 + text_size]), 28 + text_size
        primitive = document["meshes"][0]["primitives"][0]
        attributes = primitive["attributes"]

        def array(index: int, dtype: str, width: int) -> npt.NDArray[Any]:
            accessor = document["accessors"][index]
            view = document["bufferViews"][accessor["bufferView"]]
            offset = start + view.get("byteOffset", 0)
            flat = np.frombuffer(data, dtype, accessor["count"] * width, offset)
            return flat.reshape(-1, width).copy()

        return Mesh(
            positions_mm=array(attributes["POSITION"], "<f4", 3),
            normals=array(attributes["NORMAL"], "<f4", 3),
            tangents=array(attributes["TANGENT"], "<f4", 4),
            uv=array(attributes["TEXCOORD_0"], "<f4", 2),
            faces=array(primitive["indices"], "<u4", 1).reshape(-1, 3),
        )
    except (OSError, ValueError, LookupError, TypeError, AttributeError, struct.error) as error:
        raise ScanError(f"cannot read {path}: {error}", str(path), "prepare it again") from error
