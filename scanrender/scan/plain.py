"""The plain library call beside each stage of the preparation: what the work costs without us.

For `scanrender bench prep --plain` only. Each runs in a child of its own, on the same scan: its
inputs are loaded first, then the one call is timed, and its peak memory is counted from there.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.asset import Asset, load_asset
from scanrender.scan.clean import clean
from scanrender.scan.ingest import read_scan
from scanrender.scan.journal import peak_mib
from scanrender.scan.raw import RawMesh
from scanrender.scan.surface import Surface
from scanrender.settings.prep import CleanSettings
from scanrender.settings.scan import ScanSettings

Array = npt.NDArray[Any]
Call = Callable[[], object]
SAMPLES = 20_000


@dataclass(frozen=True)
class Inputs:
    """What the calls work on: the scan file, and the asset that was made of it."""

    scan: Path
    folder: Path

    @cached_property
    def asset(self) -> Asset:
        return load_asset(self.folder, ())

    @cached_property
    def raw(self) -> RawMesh:
        return read_scan(self.scan)

    @cached_property
    def surface(self) -> Surface:
        """The cleaned scan in millimetres, as all later stages get it."""
        settings = self.asset.info["settings"]
        scan = ScanSettings.model_validate(settings["scan"])
        return clean(
            self.raw, scan, CleanSettings.model_validate(settings["prep"]["clean"])
        ).surface

    @cached_property
    def simple(self) -> tuple[Array, Array]:
        """The prepared mesh, welded: positions in float64 and faces in int64."""
        mesh = self.asset.mesh
        unique, index = np.unique(mesh.positions_mm, axis=0, return_inverse=True)
        return unique.astype(np.float64), index.reshape(-1)[mesh.faces].astype(np.int64)

    def rays(self, key: str) -> tuple[Array, Array]:
        """Origins and ways (k, 3) from 1 mm above each texel of a map of prep.bake.`key`."""
        from scanrender.scan.rasterize import rasterize

        mesh, size = self.asset.mesh, self.asset.info["settings"]["prep"]["bake"][key]
        texels = rasterize(mesh.uv, mesh.faces, size)
        both = np.concatenate([mesh.positions_mm, mesh.normals], axis=1)[mesh.faces]
        place = texels.interpolate(both)
        origin, way = place[:, :3] + place[:, 3:], -place[:, 3:]
        return np.ascontiguousarray(origin), np.ascontiguousarray(way)

    def hits(self, key: str) -> tuple[Array, Array]:
        """Faces (k,) of the raw surface and barycentric coordinates (k, 3) under the texels."""
        found = _cast(_scene(self.surface), *self.rays(key))
        u, v = found["u"], found["v"]
        bary = np.stack([1.0 - u - v, u, v], axis=1).astype(np.float32)
        return np.maximum(found["primID"], 0), bary


def _ingest(inputs: Inputs) -> Call:
    import trimesh

    return lambda: trimesh.load(inputs.scan, process=False)


def _clean(inputs: Inputs) -> Call:
    import trimesh

    raw = inputs.raw

    def call() -> object:
        mesh = trimesh.Trimesh(raw.positions, raw.faces, process=True, validate=True)
        mesh.fill_holes()
        return mesh

    return call


def _simplify(inputs: Inputs) -> Call:
    import fast_simplification

    positions, faces = inputs.surface.positions, inputs.surface.faces.astype(np.int32)
    target = len(inputs.asset.mesh.faces)
    return lambda: fast_simplification.simplify(positions, faces, target_count=target)


def _unwrap(inputs: Inputs) -> Call:
    import xatlas

    positions, faces = inputs.simple
    return lambda: xatlas.parametrize(positions.astype(np.float32), faces.astype(np.uint32))


def _raw_surface(inputs: Inputs) -> Call:
    import igl

    surface = inputs.surface

    def call() -> object:
        positions, faces = surface.positions, surface.faces
        normals = igl.per_vertex_normals(positions, faces)
        laplacian = igl.cotmatrix(positions, faces)
        mass = igl.massmatrix(positions, faces, igl.MASSMATRIX_TYPE_VORONOI)
        curved = laplacian @ positions / np.maximum(mass.diagonal(), 1e-12)[:, None]
        return _scene(surface), np.einsum("ij,ij->i", curved, normals)

    return call


def _occlusion(inputs: Inputs) -> Call:
    import igl

    positions, faces = inputs.simple
    normals = igl.per_vertex_normals(positions, faces)
    rays = inputs.asset.info["settings"]["prep"]["bake"]["ao_rays"]
    return lambda: igl.ambient_occlusion(positions, faces, positions, normals, rays)


def _distance(inputs: Inputs) -> Call:
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(inputs.surface.positions, inputs.surface.faces))
    meshes.add_mesh(pymeshlab.Mesh(*inputs.simple))

    def call() -> object:
        for first, second in ((0, 1), (1, 0)):
            meshes.get_hausdorff_distance(
                sampledmesh=first,
                targetmesh=second,
                samplevert=False,
                sampleface=True,
                samplenum=SAMPLES,
            )
        return meshes

    return call


def _project(inputs: Inputs) -> Call:
    scene, rays = _scene(inputs.surface), inputs.rays("albedo_px")
    return lambda: _cast(scene, *rays)


def _albedo(inputs: Inputs) -> Call:
    from scipy import ndimage

    face, bary = inputs.hits("albedo_px")
    surface, pages = inputs.surface, inputs.raw.pages
    if not pages or surface.corner_uv is None:
        colors = np.zeros((len(surface.positions), 3), np.float32)
        colors = colors if surface.colors is None else surface.colors
        return lambda: np.einsum("kc,kcd->kd", bary, colors[surface.faces[face]])
    corner_uv = np.nan_to_num(surface.corner_uv)

    def call() -> object:
        uv = np.einsum("kc,kcd->kd", bary, corner_uv[face])
        out = np.empty((len(face), 3), np.uint8)
        for number, page in enumerate(pages):
            rows = np.flatnonzero(surface.page[face] == number)
            place = uv[rows, ::-1].T * np.array(page.size[::-1])[:, None] - 0.5
            for channel in range(3):
                plane = page.pixels[:, :, channel]
                out[rows, channel] = ndimage.map_coordinates(plane, place, order=1, mode="nearest")
        return out

    return call


def _normals(inputs: Inputs) -> Call:
    import igl

    face, bary = inputs.hits("normal_px")
    surface = inputs.surface
    normals = igl.per_vertex_normals(surface.positions, surface.faces).astype(np.float32)
    return lambda: np.einsum("kc,kcd->kd", bary, normals[surface.faces[face]])


def _geometry(inputs: Inputs) -> Call:
    face, bary = inputs.hits("data_px")
    surface = inputs.surface
    values = np.ones((len(surface.positions), 4), np.float32)
    return lambda: np.einsum("kc,kcd->kd", bary, values[surface.faces[face]])


def _skin(inputs: Inputs) -> Call:
    from scipy.cluster.vq import kmeans2
    from skimage.color import rgb2lab

    image = load_asset(inputs.folder, ("albedo",)).maps["albedo"]
    step = max(1, image.shape[0] // inputs.asset.info["settings"]["prep"]["bake"]["data_px"])
    small = image[::step, ::step]
    return lambda: kmeans2(rgb2lab(small).reshape(-1, 3), 4, minit="++", rng=0)


def _scene(surface: Surface) -> Any:
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene()
    TriangleMesh(scene, surface.positions.astype(np.float32), surface.faces.astype(np.int32))
    return scene


def _cast(scene: Any, origin: Array, way: Array) -> Any:
    return scene.run(origin, way, np.full(len(origin), 6.0, np.float32), output=True)


# Stage of the preparation -> (what the plain call is, how it is set up).
CALLS: dict[str, tuple[str, Callable[[Inputs], Call]]] = {
    "ingest": ("trimesh.load, unprocessed", _ingest),
    "clean": ("trimesh: process, validate, fill_holes", _clean),
    "simplify": ("fast_simplification.simplify", _simplify),
    "unwrap": ("xatlas.parametrize, default options", _unwrap),
    "raw surface": ("igl: normals, cotangent curvature; Embree's tree", _raw_surface),
    "occlusion, thickness": ("igl.ambient_occlusion, as many rays; no thickness", _occlusion),
    "distance": ("pymeshlab: get_hausdorff_distance, both ways", _distance),
    "project": ("embreex: one ray a texel", _project),
    "albedo": ("NumPy, SciPy: one linear look-up a texel", _albedo),
    "normals": ("NumPy: one normal a texel, not smoothed, no tangents", _normals),
    "geometry": ("NumPy: four values a texel", _geometry),
    "skin": ("skimage rgb2lab, SciPy kmeans2 of four colours", _skin),
}


def plain_call(
    arrays: dict[str, Any], params: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """In a child: the call of params["stage"] on params["scan"] and params["asset"], timed."""
    _, setup = CALLS[params["stage"]]
    call = setup(Inputs(Path(params["scan"]), Path(params["asset"])))
    _forget_peak()
    start = time.perf_counter()
    result = call()
    seconds = time.perf_counter() - start
    del result
    return {}, {"seconds": seconds, "peak_mib": peak_mib()}


def _forget_peak() -> None:
    """Count the peak of this process anew, where the system can (Linux)."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
