"""Pictures' worth of data of the raw and the prepared surface side by side, for the report's sheet.

Two parallel projections, from the front and from a side; what is drawn from them is `outputs`'.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.images import Image
from scanrender.scan.bake_albedo import ColorSource
from scanrender.scan.high import High, Low
from scanrender.scan.pages import Page
from scanrender.scan.rays import Hits, Target
from scanrender.scan.report import face_density
from scanrender.scan.tangents import from_tangent_space
from scanrender.scan.topology import face_areas, unit

Array = npt.NDArray[Any]

ANGLES_DEG = {"front": 0.0, "side": 55.0}
PICTURE_PX = 560
THUMB_PX = 512


def make_views(
    high: High, low: Low, color: ColorSource, maps: Mapping[str, Image], size_px: int
) -> dict[str, Array]:
    """Arrays by name: VIEW.raw_color, VIEW.chart, …, (h, w, c) float16, NaN or -1 beside the
    subject; VIEW.light (3,) toward the lamp; map.NAME reduced maps; density_median."""
    result: dict[str, Array] = {}
    target = Target(low.positions, low.faces)
    for view, degrees in ANGLES_DEG.items():
        origin, way, pixel_mm, shape = _rays(low.positions, np.radians(degrees))
        seen = high.target.cast(origin, way, np.inf)
        found = target.cast(origin, way, np.inf)
        layers = {**_raw_layers(high, color, seen), **_low_layers(low, maps, found, size_px)}
        layers["edge"] = _edge_px(low, found, pixel_mm)
        for name, (hits, values) in layers.items():
            picture = np.full((shape[0] * shape[1], values.shape[1]), np.nan, np.float32)
            picture[hits] = values
            result[f"{view}.{name}"] = picture.reshape(*shape, -1).astype(np.float32)
        result[f"{view}.light"] = _turned(np.array([-0.35, 0.45, 0.82]), np.radians(degrees))
    for name, image in maps.items():
        step = max(1, image.shape[0] // THUMB_PX)
        rows = image.shape[0] // step
        cut = image[: rows * step, : rows * step].reshape(rows, step, rows, step, -1)
        result[f"map.{name}"] = cut.mean(axis=(1, 3)).astype(np.float32)
    result["density_median"] = np.array(np.median(face_density(low, size_px)))
    return result


def _turned(vector: Array, angle: float) -> Array:
    """About +Y: at 90 degrees what was toward +Z is toward +X."""
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(vector @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]]))


def _rays(positions: Array, angle: float) -> tuple[Array, Array, float, tuple[int, int]]:
    """Origins (h * w, 3), directions, mm per pixel and (h, w) of a view that holds everything."""
    right, up = _turned(np.array([1.0, 0.0, 0.0]), angle), np.array([0.0, 1.0, 0.0])
    back = _turned(np.array([0.0, 0.0, 1.0]), angle)
    across, height, depth = positions @ right, positions @ up, positions @ back
    extent = max(float(np.ptp(across)), float(np.ptp(height)), 1e-6) * 1.04
    pixel_mm = extent / PICTURE_PX
    shape = (PICTURE_PX, PICTURE_PX)
    rows, columns = shape
    y = 0.5 * (height.max() + height.min()) + (0.5 * rows - np.arange(rows) - 0.5) * pixel_mm
    x = 0.5 * (across.max() + across.min()) + (np.arange(columns) + 0.5 - 0.5 * columns) * pixel_mm
    start = (depth.max() + 10.0) * back
    grid = y[:, None, None] * up + x[None, :, None] * right + start
    way = np.broadcast_to(-back, (rows * columns, 3))
    return grid.reshape(-1, 3), way, float(pixel_mm), (rows, columns)


def _chosen(hits: Hits) -> tuple[npt.NDArray[np.bool_], Hits]:
    there = hits.face >= 0
    return there, Hits(hits.face[there], hits.bary[there], hits.distance[there])


def _raw_layers(high: High, color: ColorSource, seen: Hits) -> dict[str, tuple[Array, Array]]:
    there, hits = _chosen(seen)
    normal = unit(high.target.interpolate(hits, high.normals), fallback=(0.0, 0.0, 1.0))
    return {"raw_color": (there, color.at(hits)), "raw_normal": (there, normal)}


def _low_layers(
    low: Low, maps: Mapping[str, Image], found: Hits, size_px: int
) -> dict[str, tuple[Array, Array]]:
    there, hits = _chosen(found)
    mesh, chart = low.mesh, low.unwrapped.chart

    def at(values: Array) -> Array:
        return np.asarray(np.einsum("kc,kcd->kd", hits.bary, values[mesh.faces[hits.face]]))

    uv, normal = at(mesh.uv), at(mesh.normals)
    layers = {
        "normal": unit(normal, fallback=(0.0, 0.0, 1.0)),
        "uv": uv,
        "chart": chart[hits.face][:, None].astype(np.float32),
        "density": face_density(low, size_px)[hits.face][:, None],
    }
    if "normal_ts" in maps:
        local = Page("", maps["normal_ts"], "linear").sample(uv)
        layers["normal"] = from_tangent_space(local, normal, at(mesh.tangents))
    for name in ("albedo", "skin", "curvature", "ao", "thickness_mm"):
        if name in maps:
            image = np.repeat(maps[name], 3 // maps[name].shape[2], axis=2)
            values = Page("", image, "linear").sample(uv)
            layers[name] = values[:, : maps[name].shape[2]]
    return {name: (there, values) for name, values in layers.items()}


def _edge_px(low: Low, found: Hits, pixel_mm: float) -> tuple[Array, Array]:
    """Distance in pixels from the nearest edge of the triangle, measured on the surface."""
    there, hits = _chosen(found)
    corner = low.positions[low.faces[hits.face]]
    area = face_areas(low.positions, low.faces)[hits.face]
    sides = np.linalg.norm(corner[:, [2, 0, 1]] - corner[:, [1, 2, 0]], axis=2)
    height = 2.0 * area[:, None] / np.maximum(sides, 1e-9)
    return there, (hits.bary * height).min(axis=1, keepdims=True) / pixel_mm
