"""Shadows, light through skin, the limit's guide and the disk in float64, tap by tap.

These passes decide: a tap lies in one texel or the next, an occluder before the surface or not.
Where a decision is nearer to its border than float32 resolves, both answers are right: NaN is
returned for such a pixel, which is then not compared.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from scanrender.optics.kernels import GOLDEN_ANGLE_RAD, disk_taps
from scanrender.render.lamps import Lamp
from scanrender.render.passes._lamp import DISK_TAPS, shadow_uniforms
from scanrender.render.passes.transmission import (
    TABLE_SIZE,
    _transmittance_table,
    blur_mm,
    tap_count,
)
from scanrender.render.passes.visibility import MAX_PENUMBRA
from scanrender.render.scene import Scene, Shot

Array = npt.NDArray[np.float64]
Buffers = Mapping[str, Array]
Incident = Callable[[Mapping[str, Any], Array], tuple[Array, Array]]
# Of a texel, and of a depth, that float32 may be off after the matrices of camera and lamp.
NEAR_BORDER = 1e-4
# Of the largest transmittance, by which the rounding of a depth may change one that is compared.
HANGS_ON_ROUNDING = 1e-4
ROW_TURN_RAD = 2.0 * np.pi * (np.sqrt(2.0) - 1.0)


class _Map:
    """A lamp's shadow map; `size` alone is what the uniforms ask of a texture."""

    def __init__(self, depths: Array) -> None:
        self.depths = depths[:, :, 0]
        self.size = self.depths.shape[::-1]


class LightPoint(NamedTuple):
    """Surface points in the light's view, as in shadow_lookup.glsl; (h, w) or (h, w, 2)."""

    uv: Array
    in_map: Array
    depth_mm: Array
    mm_per_uv: Array
    way_per_depth: Array
    slope: Array


def disk_point(i: int, count: int, spiral: tuple[Array | float, Array | float]) -> Array:
    turn, hand = spiral
    radius, angle = np.sqrt((i + 0.5) / count), i * GOLDEN_ANGLE_RAD + turn
    return np.asarray(radius * np.stack([hand * np.cos(angle), np.sin(angle)], axis=-1))


def spirals_of(
    pixels: tuple[int, ...], turn: float, is_shared: bool
) -> tuple[Array | float, Array | float]:
    """`spiral_here` of every pixel, rows bottom-up."""
    if not is_shared:
        return turn, 1.0
    y, x = np.indices(pixels) & 1
    return turn + ROW_TURN_RAD * y, 1.0 - 2.0 * x


def light_point(u: Mapping[str, Any], p: Array, normal: Array) -> LightPoint:
    turn = np.asarray(u["light_from_view"], dtype=np.float64)
    at, n = p @ turn[:3, :3].T + turn[:3, 3], normal @ turn[:3, :3].T
    clip_from_light = np.asarray(u["clip_from_light"], dtype=np.float64)
    clip = np.concatenate([at, np.ones_like(at[..., :1])], axis=-1) @ clip_from_light.T
    w = np.maximum(clip[..., 3], 1e-6)
    uv = clip[..., :2] / w[..., None] * 0.5 + 0.5
    from_lamp = np.maximum(u["light_distance_mm"] - at[..., 2], 1e-6)
    way, facing = np.ones_like(from_lamp), n[..., 2]
    if u["light_is_near"]:
        way = np.sqrt(np.sum(at[..., :2] ** 2, axis=-1) + from_lamp**2) / from_lamp
        facing = facing - np.sum(n[..., :2] * at[..., :2], axis=-1) / from_lamp
    facing = np.where(facing < 0.0, np.minimum(facing, -0.1), np.maximum(facing, 0.1))
    return LightPoint(
        uv=uv,
        in_map=(clip[..., 3] > 0.0) & np.all((uv >= 0.0) & (uv <= 1.0), axis=-1),
        depth_mm=u["light_front_mm"] - at[..., 2],
        mm_per_uv=2.0 * w / clip_from_light[0, 0],
        way_per_depth=way,
        slope=np.clip(n[..., :2] / facing[..., None], -8.0, 8.0),
    )


def _plane_depth(u: Mapping[str, Any], p: LightPoint, offset: Array) -> Array:
    rise = np.sum(p.slope * offset, axis=-1)
    if u["light_is_near"]:
        far = np.maximum(p.depth_mm + u["light_distance_mm"] - u["light_front_mm"], 1e-6)
        rise = rise / np.maximum(1.0 - rise / far, 0.25)
    return np.asarray(p.depth_mm + rise)


def _first_depth(p: LightPoint, offset: Array, shadow: _Map) -> tuple[Array, Array, Array]:
    """(depth in the texel nearest to `offset`, that texel's offset, whether it may be another)."""
    size = np.array(shadow.size, dtype=np.float64)
    place = (p.uv + offset / p.mm_per_uv[..., None]) * size
    texel = np.clip(np.floor(place), 0.0, size - 1.0)
    unsure = np.any(np.abs(place - np.round(place)) < NEAR_BORDER, axis=-1)
    moved = ((texel + 0.5) / size - p.uv) * p.mm_per_uv[..., None]
    x, y = texel.astype(np.int64)[..., 0], texel.astype(np.int64)[..., 1]
    return shadow.depths[y, x], moved, unsure


def visibility_step(scene: Scene, shot: Shot, b: Buffers, lamp: Lamp) -> Array | None:
    """visibility_N of a lamp without a size."""
    if not lamp.settings.shadow or lamp.size > 0.0:
        return None
    shadow = _Map(b[f"shadow_{lamp.index}"])
    u: Any = shadow_uniforms(lamp, shot, shadow)  # type: ignore[arg-type]
    p, n = b["position"][:, :, :3], b["normal_geometry"][:, :, :3]
    d = np.asarray(u["light_position"]) - p
    to_light = np.broadcast_to(u["light_to_light"], p.shape)
    if u["light_is_near"]:
        to_light = d / np.linalg.norm(d, axis=-1, keepdims=True)
    shading = b["normal_shading"][:, :, :3]
    geometric, shaded = np.sum(n * to_light, axis=-1), np.sum(shading * to_light, axis=-1)
    agree = np.maximum(np.sum(n * shading, axis=-1), 1e-3)
    g = np.clip(geometric / (np.maximum(shaded, 1e-12) * agree), 0.0, 1.0)
    share = np.where((geometric > 0.0) & (shaded > 0.0), g * (1.0 + g * (1.0 - g)), 0.0)

    texel = u["texel_mm"]
    lit = light_point(u, p + n * (0.5 * texel), n)
    blur = min(lamp.settings.shadow_blur_mm, MAX_PENUMBRA * scene.radius_mm)
    squared = np.sum(lit.slope**2, axis=-1)
    narrower = 1.0 - 1.0 / np.sqrt(1.0 + squared)
    seen, unsure = np.zeros_like(share), np.zeros(share.shape, dtype=bool)
    own = spirals_of(share.shape, u["turn"], u["shares_taps"])
    for i in range(DISK_TAPS):
        way = disk_point(i, DISK_TAPS, own) * max(blur, texel)
        along = np.sum(way * lit.slope, axis=-1) / np.maximum(squared, 1e-12) * narrower
        way = np.where(squared[..., None] < 1e-12, way, way - lit.slope * along[..., None])
        first, offset, border = _first_depth(lit, way, shadow)
        facets = 0.03 * (1.0 + squared) * np.linalg.norm(offset, axis=-1)
        before = _plane_depth(u, lit, offset) - texel * 0.5 - np.minimum(facets, 4.0 * texel)
        seen += first >= before
        unsure |= border | (np.abs(first - before) < NEAR_BORDER * texel)
    found = share * np.where(lit.in_map, seen / DISK_TAPS, 1.0)
    found[unsure & lit.in_map & (share > 0.0)] = np.nan
    return np.where(b["position"][:, :, 3] > 0.0, found, 0.0)[:, :, None]


def transmittance_step(scene: Scene, shot: Shot, b: Buffers) -> Array | None:
    """transmittance of the first lamp, from its shadow map; T(d) interpolated in the same table."""
    settings = scene.pipeline.skin.transmission
    bends = scene.pipeline.curvature.forward_scattering
    if settings.method != "shadow_map" or not scene.transmitting_lamps or bends:
        return None
    lamp = scene.transmitting_lamps[0]
    shadow = _Map(b[f"shadow_{lamp.index}"])
    u: Any = shadow_uniforms(lamp, shot, shadow)  # type: ignore[arg-type]
    p, n = b["position"][:, :, :3], b["normal_geometry"][:, :, :3]
    d = np.asarray(u["light_position"]) - p
    to_light = np.broadcast_to(u["light_to_light"], p.shape)
    if u["light_is_near"]:
        to_light = d / np.linalg.norm(d, axis=-1, keepdims=True)
    facing = np.sum(to_light * n, axis=-1)
    texel = u["texel_mm"]
    slope = light_point(u, p, n).slope
    bias = np.maximum(settings.bias_mm, 2.0 * texel * np.minimum(np.sum(slope**2, axis=-1), 1.0))
    inside = light_point(u, p - n * bias[..., None], n)
    buried = bias * np.maximum(0.0, -facing)
    _, opaque_mm = _transmittance_table(scene)
    root = np.linspace(0.0, 1.0, TABLE_SIZE)
    table = scene.profile.transmittance(opaque_mm * root**2).astype(np.float32)
    blur = max(blur_mm(scene), texel)

    def passes(thick: Array) -> Array:
        t = np.clip((thick - bias) / np.maximum(bias, 1e-300), 0.0, 1.0)
        fades = np.where(thick >= opaque_mm, 0.0, t * t * (3.0 - 2.0 * t))
        at = np.sqrt(np.minimum(thick / opaque_mm, 1.0))
        through = [np.interp(at, root, table[:, c]) for c in range(3)]
        return np.asarray(fades[..., None] * np.stack(through, axis=-1))

    # A thickness is the difference of two depths, each of which a distant camera rounds.
    rounding_mm = 4.0 * float(np.spacing(np.float32(np.abs(p).max())))
    total, unsure = np.zeros(p.shape), np.zeros(facing.shape, dtype=bool)
    moved = np.zeros(facing.shape)
    own, taps = spirals_of(facing.shape, u["turn"], u["shares_taps"]), tap_count(scene)
    for i in range(taps):
        way = disk_point(i, taps, own) * blur
        entry, offset, border = _first_depth(inside, way, shadow)
        leaves = _plane_depth(u, inside, offset)
        no_path = (facing < 0.0) & (entry > leaves + bias)
        thick = np.maximum(0.0, leaves - entry) * inside.way_per_depth + buried
        through = passes(thick)
        total += np.where(no_path[..., None], 0.0, through)
        moved += np.abs(passes(thick + rounding_mm) - through).max(axis=-1) / taps
        unsure |= border | (np.abs(entry - leaves - bias) < NEAR_BORDER * texel)
        unsure |= np.abs(thick / opaque_mm - 1.0) < NEAR_BORDER
    lights = (settings.wrap - facing > 0.0) & inside.in_map & (b["position"][:, :, 3] > 0.0)
    found = np.where(lights[..., None], total / taps, 0.0)
    unsure |= moved > HANGS_ON_ROUNDING * float(found.max())
    found[unsure & lights] = np.nan
    return found


def transmission_step(scene: Scene, shot: Shot, b: Buffers, incident: Incident) -> Array | None:
    """transmission of one lamp, from its transmittance on the device."""
    lamps = scene.transmitting_lamps
    if len(lamps) != 1 or "transmittance" not in b:
        return None
    depths = np.zeros((1, lamps[0].settings.shadow_px, 1))
    u: Any = shadow_uniforms(lamps[0], shot, _Map(depths))  # type: ignore[arg-type]
    p, n = b["position"][:, :, :3], b["normal_geometry"][:, :, :3]
    to_light, light = incident(u, p)
    wrap = scene.pipeline.skin.transmission.wrap
    back = np.maximum(0.0, wrap - np.sum(to_light * n, axis=-1, keepdims=True))
    skin = b["skin"] if scene.uses_skin_map else 1.0
    found = b["albedo"][:, :, :3] * b["transmittance"][:, :, :3] * light * back * skin
    return np.where(b["position"][:, :, 3:] > 0.0, found, 0.0)


M_XYZ = np.array([
    [0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750],
    [0.0193339, 0.1191920, 0.9503041],
]) / [[0.9504559], [1.0], [1.0890578]]  # fmt: skip


def lab_step(scene: Scene, shot: Shot, b: Buffers) -> Array:
    """_lab_raw, or lab where nothing smooths it: CIE Lab (D65) of the albedo."""
    xyz = np.maximum(np.clip(b["albedo"][:, :, :3], 0.0, 1.0) @ M_XYZ.T, 1e-9)
    linear = xyz * (841.0 / 108.0) + 4.0 / 29.0
    f = np.where(xyz > 216.0 / 24389.0, np.cbrt(xyz), linear)
    x, y, z = f[..., 0], f[..., 1], f[..., 2]
    found = np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)
    return np.where(b["depth_mm"] > 0.0, found, 0.0)


def disk_step(scene: Scene, shot: Shot, b: Buffers, ray: tuple[float, ...]) -> Array | None:
    """scattered of the disk: the profile itself, not the table of its logarithm."""
    from scanrender.render.passes.disk import INNER_PX, _table, tap_count

    diffusion = scene.pipeline.diffusion
    plain = diffusion.limit == "none" and not diffusion.jitter and diffusion.normalize == "visible"
    bends = scene.pipeline.curvature.modulation != "none"
    if diffusion.method != "disk" or shot.is_orthographic or bends or not plain:
        return None
    inner_mm = INNER_PX / shot.px_per_mm(shot.working_distance_mm)
    disk = disk_taps(scene.scattering, tap_count(scene, shot), inner_mm)
    table = _table(disk)
    z, light = b["depth_mm"][:, :, 0], b["diffusion_input"]
    height, width = z.shape
    y, x = np.mgrid[0:height, 0:width]
    centre = np.stack([x + 0.5, y + 0.5], axis=-1)
    scale, shift = np.array(ray[:2]), np.array(ray[2:])

    def ways(pixel: Array) -> Array:
        return np.dstack([pixel * scale + shift, -np.ones(pixel.shape[:2])])

    point = ways(centre) * np.where(z > 0.0, z, 1.0)[:, :, None]
    normals = b["normal_geometry"][:, :, :3]
    n, t, bit = _tangent_plane(normals, point)
    total = disk.centre * light[:, :, :3]
    weights = disk.centre * light[:, :, 3:]
    unsure = np.zeros(z.shape, dtype=bool)
    for i in range(len(disk.radius_mm)):
        radius, (c, s, right, up) = disk.radius_mm[i], table[1, i]
        on_plane = point + radius * (c * t + s * bit)
        xy = on_plane[..., :2] / np.maximum(-on_plane[..., 2:], 1e-6)
        at = (xy - shift) / scale + [right, up]
        unsure |= np.any(np.abs(at - np.round(at)) < NEAR_BORDER, axis=-1)
        texel = np.clip(np.floor(at), 0, [width - 1, height - 1]).astype(np.int64)
        tx, ty = texel[..., 0], texel[..., 1]
        z_q, w = z[ty, tx], ways(texel + 0.5)
        plane_z = np.sum(n * point, axis=-1) / np.minimum(np.sum(n * w, axis=-1), -1e-4)
        space = on_plane + (z_q - plane_z)[..., None] * w - point
        r3 = np.maximum(np.linalg.norm(space, axis=-1), radius)
        u = w / np.linalg.norm(w, axis=-1, keepdims=True)
        area = np.abs(np.sum(n * u, axis=-1))
        area /= np.maximum(np.abs(np.sum(normals[ty, tx] * u, axis=-1)), 0.05)
        area *= z_q**2 / np.maximum(plane_z**2, 1e-12)
        ratio = scene.scattering.R(r3) / np.maximum(scene.scattering.R(np.array(radius)), 1e-300)
        k = disk.weights[i] * np.where(z_q > 0.0, np.minimum(area, 20.0), 0.0)[..., None] * ratio
        total = total + k * light[ty, tx, :3]
        weights = weights + k * light[ty, tx, 3:]
    keep, mask = 1e-5, light[:, :, 3:]
    found = (total + keep * light[:, :, :3]) / np.maximum(weights + keep * mask, 1e-12) * mask
    found = np.dstack([found, mask])
    found[unsure] = np.nan
    return np.where(z[:, :, None] > 0.0, found, 0.0)


def _tangent_plane(normals: Array, point: Array) -> tuple[Array, Array, Array]:
    """(normal turned to the eye as far as disk.frag does, tangent, bitangent)."""
    least = 0.2
    eye = -point / np.linalg.norm(point, axis=-1, keepdims=True)
    facing = np.sum(normals * eye, axis=-1, keepdims=True)
    side = normals - facing * eye
    across = np.linalg.norm(side, axis=-1, keepdims=True)
    side = np.where(across > 1e-6, side / np.maximum(across, 1e-300), 0.0)
    turned = least * eye + np.sqrt(1.0 - least**2) * side
    turned /= np.linalg.norm(turned, axis=-1, keepdims=True)
    n = np.where(facing < least, turned, normals)
    aside = np.where(np.abs(n[..., 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    t = np.cross(n, aside)
    t /= np.maximum(np.linalg.norm(t, axis=-1, keepdims=True), 1e-300)
    return n, t, np.cross(n, t)
