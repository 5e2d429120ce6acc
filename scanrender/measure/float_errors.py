"""Passes in float32 on the device against float64 NumPy, from the very same input buffers.

Each pass is written anew from its equation. A table that the device filters (directional albedo,
the weights over sigma, T(d), the view) is interpolated here exactly: where hardware filters with 8
bits of fraction, that is part of the error, and the table says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.measure.float_filters import curvature_step, gaussian_step, separable_step
from scanrender.measure.float_lights import (
    disk_step,
    lab_step,
    transmission_step,
    transmittance_step,
    visibility_step,
)
from scanrender.render.check import pixels_of
from scanrender.render.frame import Renderer
from scanrender.render.passes._lamp import light_uniforms
from scanrender.render.passes._scatter import _ray
from scanrender.render.passes.curvature_raw import LIMIT_PER_MM
from scanrender.render.passes.energy_ratio import LEAST_SHARE
from scanrender.render.scene import RHO_COSINES, Scene, Shot
from scanrender.render.view import LOG2_RANGE, TABLE_SIZE, view_table

Array = npt.NDArray[np.float64]
Buffers = Mapping[str, Array]
FLOOR = 1e-3  # of the largest value: below it an error is that of the sum it comes from


@dataclass(frozen=True)
class FloatError:
    """Relative error of one buffer, largest and 99.9 %; and whether the device filters a table.

    `known` is the share of values that are compared: not those that hang on a decision (a tap in
    one texel or the next) nearer to its border than float32 resolves.
    """

    buffer: str
    largest: float
    p999: float
    is_filtered: bool
    known: float = 1.0


def float_errors(renderer: Renderer, frame: int = 0) -> list[FloatError]:
    """All passes of `renderer` that can be evaluated here, on one frame's pixel-centre sample."""
    shot = renderer._shot(renderer.view(frame))
    scene = renderer.scene
    wanted = {n for n in renderer.graph.writes if not n.startswith("_") or n in PRIVATE}
    wanted -= {"display"}
    made = renderer.graph.run(renderer.device, renderer.pool, shot, wanted)
    # Rows bottom-up, as the passes address them.
    buffers = {name: pixels_of(t)[::-1].astype(np.float64) for name, t in made.items()}
    given = {"beauty": made["radiance"]}
    shown = renderer.graph.run(renderer.device, renderer.pool, shot, {"display"}, given)
    buffers["display"] = pixels_of(shown["display"])[::-1].astype(np.float64)
    for texture in (*made.values(), *shown.values()):
        renderer.pool.give_back(texture)
    buffers["beauty"] = buffers["radiance"]
    found = []
    for name, (evaluate, is_filtered) in PASSES.items():
        if name in buffers and (expected := evaluate(scene, shot, buffers)) is not None:
            found.append(_error(name, buffers[name], expected, is_filtered, shot.guard_px))
    return found


def _error(name: str, got: Array, expected: Array, is_filtered: bool, guard: int) -> FloatError:
    # What no filter reads leaves the guard band alone (Pass.in_picture).
    inner = slice(guard, -guard or None)
    got, expected = got[inner, inner, : expected.shape[2]], expected[inner, inner]
    size = np.abs(expected)
    if name in VECTORS:
        size = np.broadcast_to(size.max(axis=2, keepdims=True), size.shape)
    floor = 1.0 if name in SHARES else FLOOR
    size = np.maximum(size, floor * np.nanmax(np.abs(expected)))
    off = (np.abs(got - expected) / np.maximum(size, 1e-300))[np.isfinite(expected)]
    known = float(np.isfinite(expected).mean())
    quantile = float(np.quantile(off, 0.999)) if off.size else np.inf
    return FloatError(name, float(off.max(initial=0.0)), quantile, is_filtered, known)


def _covered(b: Buffers, value: Array) -> Array:
    """`value` where there is a surface, 0 elsewhere."""
    return np.where(b["position"][:, :, 3:] > 0.0, value, 0.0)


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.sum(a * b, axis=-1, keepdims=True))


def _unit(v: Array) -> Array:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-300))


def _to_eye(shot: Shot, b: Buffers) -> Array:
    p = b["position"][:, :, :3]
    return np.broadcast_to([0.0, 0.0, 1.0], p.shape) if shot.is_orthographic else -_unit(p)


def _px_per_mm(shot: Shot, b: Buffers) -> Array:
    depth = np.maximum(-b["position"][:, :, 2:3], 1e-6)
    return np.full_like(depth, shot.px_per_mm(1.0)) / (1.0 if shot.is_orthographic else depth)


def _rho(scene: Scene, cosine: Array) -> Array:
    return np.interp(np.clip(cosine, 0.0, 1.0), RHO_COSINES, scene._rho.astype(np.float32))


def _jacobian(scene: Scene, shot: Shot, b: Buffers) -> Array:
    """The cosine of the normal is the mean of its root at both edges of the pixel."""
    eye, p = _to_eye(shot, b), b["position"]
    t = _dot(b["normal_geometry"][:, :, :3], eye) ** 2
    wide = 0.5 * sum(_change(p, t, axis) for axis in (0, 1))
    edges = np.sqrt(np.maximum(t - wide, 0.0)) + np.sqrt(np.minimum(t + wide, 1.0))
    undrawn = 0.26 * np.maximum(1.0 - t / np.maximum(wide, 1e-12), 0.0)
    cos_j = np.maximum(0.5 * edges / (1.0 + undrawn), 0.05)
    side = shot.px_per_mm(shot.working_distance_mm) / _px_per_mm(shot, b)
    return _covered(b, side**2 * eye[:, :, 2:] / cos_j)


def _change(p: Array, t: Array, axis: int) -> Array:
    """How much `t` changes to the neighbour along `axis` that is nearer in depth."""
    found, nearest = np.zeros_like(t), np.full_like(t, np.inf)
    for way in (-1, 1):
        q = _neighbour(p, axis, way)
        gap = np.abs(q[:, :, 2:3] - p[:, :, 2:3])
        nearer = (q[:, :, 3:] > 0.0) & (gap < nearest)
        found = np.where(nearer, np.abs(_neighbour(t, axis, way) - t), found)
        nearest = np.where(nearer, gap, nearest)
    return found


def _edge_guide(scene: Scene, shot: Shot, b: Buffers) -> Array:
    eye, n = _to_eye(shot, b), b["normal_geometry"][:, :, :3]
    guide = b["albedo"][:, :, :3].mean(axis=2, keepdims=True) * eye[:, :, 2:]
    guide = guide / np.maximum(np.abs(_dot(n, eye)), 0.05)
    if scene.pipeline.diffusion.halo == "cbf":
        p = 1e-3 * b["position"][:, :, :3]
        guide = guide * eye[:, :, 2:] ** 2 * _dot(p, p)
    return _covered(b, guide)


def _diffusion_input(scene: Scene, shot: Shot, b: Buffers) -> Array:
    albedo = b["albedo"][:, :, :3]
    light = b["irradiance"][:, :, :3] * albedo**scene.albedo_power
    mask = np.maximum(b["skin"] if scene.uses_skin_map else np.ones_like(b["skin"]), 1e-4)
    if scene.pipeline.diffusion.halo == "measure" and scene.pipeline.diffusion.method != "disk":
        mask = mask * b["jacobian"] * _px_per_mm(shot, b)
        mask = mask * shot.px_per_mm(shot.far_mm) / shot.px_per_mm(shot.working_distance_mm) ** 2
    return _covered(b, np.dstack([light * mask, mask]))


def _incident(uniforms: Mapping[str, Any], p: Array) -> tuple[Array, Array]:
    """(unit vector to the light, irradiance at normal incidence) of light.glsl."""
    axis, light = uniforms["light_to_light"], uniforms["light_irradiance"]
    if not uniforms["light_is_near"]:
        return np.broadcast_to(axis, p.shape), np.broadcast_to(light, p.shape)
    d = uniforms["light_position"] - p
    fall = uniforms["light_distance_mm"] ** 2 / np.maximum(
        _dot(d, d), max(uniforms["light_radius_mm"] ** 2, 1e-6)
    )
    full, rim = uniforms["light_cone"]
    chord = _unit(d) - axis
    t = np.clip((0.5 * _dot(chord, chord) - full) / (rim - full), 0.0, 1.0)
    return _unit(d), light * fall * (1.0 - t * t * (3.0 - 2.0 * t))


def _lamps(scene: Scene, shot: Shot, b: Buffers) -> list[tuple[Array, Array]]:
    """(unit vector to the light, irradiance that arrives) of each lamp."""
    found = []
    for lamp in scene.lamps:
        to_light, light = _incident(light_uniforms(lamp, shot), b["position"][:, :, :3])
        seen = b[f"visibility_{lamp.index}"] if lamp.settings.shadow else 1.0
        cosine = np.maximum(_dot(b["normal_shading"][:, :, :3], to_light), 0.0)
        found.append((to_light, light * seen * cosine))
    return found


def _irradiance(scene: Scene, shot: Shot, b: Buffers) -> Array | None:
    if scene.environments:
        return None
    total = scene.ambient * b["ao"] * (1.0 - scene.mean_directional_albedo)
    for to_light, arrives in _lamps(scene, shot, b):
        cosine = _dot(b["normal_shading"][:, :, :3], to_light)
        total = total + arrives * (1.0 - _rho(scene, cosine))
    return _covered(b, total)


def _specular(scene: Scene, shot: Shot, b: Buffers) -> Array | None:
    if scene.environments:
        return None
    s, v, n = scene.pipeline.skin.specular, _to_eye(shot, b), b["normal_shading"][:, :, :3]
    total = scene.ambient * b["ao"] * _rho(scene, _dot(n, v))
    for to_light, arrives in _lamps(scene, shot, b):
        h = to_light + v
        hh = _dot(h, h)
        half = _unit(h)
        nh = _dot(n, half)
        c2 = np.maximum(np.maximum(nh, 0.0) ** 2, 1e-4)
        across = np.cross(n, half)
        s2 = np.where(nh > 0.0, _dot(across, across), 1.0)
        lobes = [np.exp(-s2 / (c2 * m * m)) / (m * m * c2 * c2) for m in s.roughness]
        d = (1.0 - s.second_lobe) * lobes[0] + s.second_lobe * lobes[1]
        fresnel = s.f0 + (1.0 - s.f0) * (1.0 - np.clip(_dot(half, v), 0.0, 1.0)) ** 5
        lit = s.strength * d * fresnel / np.maximum(hh, 1e-300) * arrives
        total = total + np.where(hh < 1e-4, 0.0, lit)
    return _covered(b, total)


def _diffuse(scene: Scene, shot: Shot, b: Buffers) -> Array:
    def unmasked(name: str) -> Array:
        return b[name][:, :, :3] / np.maximum(b[name][:, :, 3:], 1e-8)

    scatters = scene.pipeline.diffusion.method != "none"
    light = unmasked("scattered" if scatters else "diffusion_input")
    if scatters and scene.uses_skin_map:
        light = b["skin"] * light + (1.0 - b["skin"]) * unmasked("diffusion_input")
    leaves = 1.0 - _rho(scene, _dot(b["normal_shading"][:, :, :3], _to_eye(shot, b)))
    tint = b["albedo"][:, :, :3] ** (1.0 - scene.albedo_power)
    return _covered(b, tint * light * leaves)


def _radiance(scene: Scene, shot: Shot, b: Buffers) -> Array:
    names = [n for n in ("diffuse", "specular", "transmission") if n in b]
    return _covered(b, np.asarray(sum(b[name][:, :, :3] for name in names)))


def _energy_ratio(scene: Scene, shot: Shot, b: Buffers) -> Array:
    before = b["diffusion_input"]
    least = max(LEAST_SHARE * scene.light_level, 1e-30) * before[:, :, 3:]
    ratio = b["scattered"][:, :, :3] / np.maximum(np.maximum(before[:, :, :3], least), 1e-300)
    return _covered(b, ratio)


def _kernel_px(scene: Scene, shot: Shot, b: Buffers) -> Array | None:
    if scene.pipeline.curvature.modulation != "none":
        return None
    return _covered(b, scene.reach_mm * _px_per_mm(shot, b))


def _display(scene: Scene, shot: Shot, b: Buffers) -> Array:
    """The view's table, interpolated between its eight neighbours."""
    from scipy.ndimage import map_coordinates

    view, beauty = scene.pipeline.view, b["beauty"]
    light = beauty[:, :, :3] + (1.0 - beauty[:, :, 3:]) * np.asarray(view.background)
    low, high = LOG2_RANGE
    stops = np.log2(np.maximum(light * 2.0**view.exposure_ev, 0.0) + 2.0**low)
    at = np.clip((stops - low) / (high - low), 0.0, 1.0) * (TABLE_SIZE - 1.0)
    place = np.moveaxis(at[:, :, ::-1], 2, 0)  # the table is blue, green, red
    table = view_table(view.transform).astype(np.float64)
    planes = [map_coordinates(table[..., c], place, order=1, mode="nearest") for c in range(3)]
    return np.asarray(np.clip(np.stack(planes, axis=-1), 0.0, 1.0))


def _curvature_raw(scene: Scene, shot: Shot, b: Buffers) -> Array:
    """S = [dn] [dp]^-1 in the tangent plane, H = trace / 2, toward the nearer neighbours."""
    p, n = b["position"], b["normal_geometry"][:, :, :3]
    steps = []
    known = p[:, :, 3] > 0.0
    for axis in (1, 0):
        ahead, behind = (_neighbour(p, axis, way) for way in (1, -1))
        gaps = [
            np.where(q[:, :, 3] > 0.0, np.abs(q[:, :, 2] - p[:, :, 2]), np.inf)
            for q in (ahead, behind)
        ]
        known &= np.isfinite(np.minimum(*gaps))
        first = (gaps[0] <= gaps[1])[:, :, None]
        n_q = np.where(first, _neighbour(n, axis, 1), _neighbour(n, axis, -1))
        steps.append((np.where(first, ahead, behind)[:, :, :3] - p[:, :, :3], n_q - n))
    side = np.where(np.abs(n[:, :, :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    t = _unit(np.cross(n, side))
    basis = np.stack([t, np.cross(n, t)], axis=-1)
    e, d = (
        np.stack([np.einsum("hwi,hwij->hwj", s[k], basis) for s in steps], axis=-1) for k in (0, 1)
    )
    squares = np.einsum("hwij,hwij->hw", e, e)
    known &= np.abs(np.linalg.det(e)) > 1e-6 * squares
    e[~known] = np.eye(2)
    trace = np.einsum("hwij,hwji->hw", d, np.linalg.inv(e))
    found = np.where(known, np.clip(0.5 * trace, -LIMIT_PER_MM, LIMIT_PER_MM), 0.0)
    return np.asarray(found[:, :, None])


def _neighbour(a: Array, axis: int, way: int) -> Array:
    """The next pixel's value, 0 beyond the picture."""
    moved = np.roll(a, -way, axis=axis)
    edge: list[Any] = [slice(None)] * a.ndim
    edge[axis] = -1 if way > 0 else 0
    moved[tuple(edge)] = 0.0
    return moved


def _visibility(scene: Scene, shot: Shot, b: Buffers) -> Array | None:
    lamp = next((lamp for lamp in scene.lamps if lamp.index == 0), None)
    return None if lamp is None else visibility_step(scene, shot, b, lamp)


def _transmission(scene: Scene, shot: Shot, b: Buffers) -> Array | None:
    return transmission_step(scene, shot, b, _incident)


def _lab(scene: Scene, shot: Shot, b: Buffers) -> Array | None:
    return lab_step(scene, shot, b) if scene.pipeline.diffusion.limit_smooth_mm == 0.0 else None


def _disk(scene: Scene, shot: Shot, b: Buffers) -> Array | None:
    return disk_step(scene, shot, b, _ray(shot))


Evaluate = Callable[[Scene, Shot, Buffers], "Array | None"]
# Buffer -> (its evaluation, whether tables are filtered on the way).
PASSES: Mapping[str, tuple[Evaluate, bool]] = {
    "jacobian": (_jacobian, False),
    "edge_guide": (_edge_guide, False),
    "kernel_px": (_kernel_px, False),
    "curvature_raw": (_curvature_raw, False),
    "_curvature_1": (curvature_step, False),
    "diffusion_input": (_diffusion_input, False),
    "diffuse_horizontal": (separable_step, False),
    "_horizontal_0": (gaussian_step, True),
    "energy_ratio": (_energy_ratio, False),
    "radiance": (_radiance, False),
    "visibility_0": (_visibility, False),
    "transmission": (_transmission, False),
    "_lab_raw": (lab_step, False),
    "lab": (_lab, False),
    "transmittance": (transmittance_step, True),
    "scattered": (_disk, True),
    "irradiance": (_irradiance, True),
    "specular": (_specular, True),
    "diffuse": (_diffuse, True),
    "display": (_display, True),
}
# Differences of larger numbers, 0 for grey: relative to the largest of the three.
VECTORS = ("lab", "_lab_raw")
# Shares of light that fade in where two depths of a hundred millimetres cancel each other to the
# last micrometres: relative to the largest of all pixels.
SHARES = ("transmittance",)
PRIVATE = ("_curvature_1", "_horizontal_0", "_lab_raw")
