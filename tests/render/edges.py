"""A half-lit plane seen by a camera: what diffusion makes of its edge, and the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from render.synthetic import MATT, WHITE, flat_map, joined, mesh, pipeline, quad, turned

from scanrender.asset import Asset
from scanrender.reference.analytic import half_lit_plane_seen
from scanrender.render.device import Device
from scanrender.render.frame import Renderer

Floats = npt.NDArray[np.floating]

# Seven pixels a millimetre: the narrowest Gaussian of skin (0.08 mm) is over half a pixel wide.
HALF_MM = 10.0
CLOSE = {"camera": {"width_px": 160, "height_px": 160, "focal_mm": 200}}
# Where the plane's outer rim, past which there is no light, does not matter.
MARGIN_MM = 3.0


def half_lit_asset(half_mm: float = HALF_MM, vertical: bool = True, edge_mm: float = 0.0) -> Asset:
    """A white plane whose normal map faces +Z where x > `edge_mm` (or y), and sideways elsewhere.

    A light along +Z leaves the other half black. Albedo is the same on both, so that guides made
    of albedo see one skin. Each half has a texel for all its vertices: the step is sharp.
    """
    h, e = half_mm, edge_mm
    dark, lit = {"u": (0.25, 0.25), "v": (0.5, 0.5)}, {"u": (0.75, 0.75), "v": (0.5, 0.5)}
    if vertical:
        halves = quad((-h, -h), (e, h), **dark), quad((e, -h), (h, h), **lit)
    else:
        halves = quad((-h, -h), (h, e), **dark), quad((-h, e), (h, h), **lit)
    normals = np.array([[(1.0, 0.0, 0.0), (0.0, 0.0, 1.0)]], np.float32)
    return Asset(joined(halves), {"albedo": flat_map(*WHITE), "normal_ts": normals})


@dataclass(frozen=True)
class Edge:
    """Pixels across the edge: `x_mm` (n,) on the plane, (n, 3) light found, and the truth."""

    x_mm: Floats
    found: Floats
    truth: Floats
    px_per_mm: float

    @property
    def error(self) -> float:
        return float(np.abs(self.found - self.truth).max())


def lit_edge(
    gl: Device,
    *layers: dict[str, Any],
    vertical: bool = True,
    tilt_deg: float = 0.0,
    axis: str = "y",
    half_mm: float = HALF_MM,
    edge_mm: float = 0.0,
    **changes: Any,
) -> Edge:
    """A half-lit plane tilted about x, y or (1, 1, 0), through the middle row (or column).

    The picture itself is read, so that supersampling counts. Pixels near the plane's rim are left
    out, and one that the edge cuts, whose single sample is on one side or the other.
    """
    nx, ny, nz = _turn(tilt_deg, axis)[:, 2]
    lamp = {"type": "directional", "azimuth_deg": float(np.rad2deg(np.arctan2(nx, nz))),
            "elevation_deg": float(np.rad2deg(np.arcsin(ny))), "shadow": False}  # fmt: skip
    settings = pipeline(
        MATT, CLOSE, {"diffusion": {"samples": 25}}, {"lights": [lamp]},
        *layers, changes,
    )  # fmt: skip
    asset = half_lit_asset(half_mm, vertical, edge_mm)
    if axis == "diagonal":
        old, matrix = asset.mesh, _turn(tilt_deg, axis)
        tangents = np.hstack([old.tangents[:, :3] @ matrix.T, old.tangents[:, 3:]])
        asset = Asset(
            mesh(old.positions_mm @ matrix.T, old.normals @ matrix.T, old.uv, old.faces, tangents),
            asset.maps,
        )
    else:
        asset = turned(asset, tilt_deg, axis)
    renderer = Renderer(gl, asset, settings)
    frame = renderer.render(renderer.view(0), ["position"])
    height, width = frame.alpha.shape
    line = np.s_[height // 2] if vertical else np.s_[:, width // 2]
    view = frame.buffers["position"][line].astype(np.float64)
    homogeneous = np.hstack([view, np.ones((len(view), 1))])
    world = homogeneous @ np.linalg.inv(renderer.camera.view_from_world).T
    x = (world[:, :3] @ _turn(tilt_deg, axis))[:, 0 if vertical else 1]
    footprint = np.abs(np.gradient(x))
    seen = (frame.alpha[line] == 1) & (np.abs(x) < half_mm - MARGIN_MM)
    if settings.quality.supersampling == 1:
        seen &= np.abs(x - edge_mm) > 0.49 * footprint
    truth = [
        half_lit_plane_seen(at - edge_mm, size, renderer.scene.scattering)
        for at, size in zip(x[seen], footprint[seen], strict=True)
    ]
    middle = footprint[seen][np.argmin(np.abs(x[seen]))]
    found = frame.buffers["beauty"][line][seen]
    return Edge(x[seen], found.astype(np.float64), np.array(truth), float(1.0 / middle))


def _turn(degrees: float, axis: str) -> Floats:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    if axis == "diagonal":  # about (1, 1, 0): about x, between turns about z
        h = np.sqrt(0.5)
        z = np.array([[h, -h, 0], [h, h, 0], [0, 0, 1]])
        return z @ _turn(degrees, "x") @ z.T
    if axis == "x":
        return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def width_mm(x: Floats, edge: Floats) -> float:
    """Distance between the places where the edge has 10 % and 90 % of the light."""
    order = np.argsort(x)
    a, b = np.interp([0.1, 0.9], edge[order], x[order])
    return float(b - a)
