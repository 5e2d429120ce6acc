"""The scene on the device: geometry, maps, tables; and the shot, which is one sample of a frame."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import moderngl
import numpy as np
import numpy.typing as npt

from scanrender.asset import Asset, check_mesh
from scanrender.optics.kernels import gaussian_taps
from scanrender.optics.profiles._checks import MIN_LENGTH_MM
from scanrender.optics.profiles.gaussians import D_EON_SKIN, GaussianSum
from scanrender.optics.surface import SpecularLobes, rho_dt
from scanrender.render.camera import Camera, Matrix, bounding_radius_mm, linear_depth, rotation_y
from scanrender.render.device import Device
from scanrender.render.environment import Environment
from scanrender.render.lamps import Lamp, light_level, resolve_lights
from scanrender.render.maps import NEUTRAL_MAPS, upload_map
from scanrender.render.view import TABLE_SIZE, view_table
from scanrender.settings.light import EnvironmentLight, Follows
from scanrender.settings.pipeline import Pipeline
from scanrender.settings.skin import SkinSettings

RHO_TABLE_SIZE = 64
RHO_COSINES = (np.arange(RHO_TABLE_SIZE) + 0.5) / RHO_TABLE_SIZE
SEPARABLE = ("separable_preintegrated", "separable_artistic")
CRUMB = 0.01  # of the mean area of triangles
# How far outside the picture a pixel may be that one of the picture's own is made from, after light
# has scattered: `reproject` looks 2 px around, in a picture of half the size.
PICTURE_EDGE_PX = 4


@dataclass(frozen=True)
class Shot:
    """One sample of one frame: matrices (float64, `target_from_source`) and the pixels it fills.

    `size` is (width, height) in px with the guard band; `scissor` the (x, y, w, h) in GL's
    bottom-up pixels that the subject can touch; `near_mm` and `far_mm` the least and greatest
    depth it can have. `sample` numbers the supersample, whose place in the pixel is `jitter_px`
    (right, down); it stands for `footprint_px` of the pixel along each side. `is_halved`: of the
    picture of half the size, whose light scatters for all samples.
    """

    size: tuple[int, int]
    scissor: tuple[int, int, int, int]
    view_from_world: Matrix
    world_from_object: Matrix
    clip_from_view: Matrix
    near_mm: float
    far_mm: float
    working_distance_mm: float
    sample: int
    guard_px: int
    jitter_px: tuple[float, float] = (0.0, 0.0)
    footprint_px: float = 1.0
    is_halved: bool = False

    @property
    def picture_scissor(self) -> tuple[int, int, int, int]:
        """`scissor` without the guard band, but for the pixels that neighbours of the picture's own
        are read from."""
        beyond = max(self.guard_px - PICTURE_EDGE_PX, 0)
        left, low, wide, high = self.scissor
        right, top = min(left + wide, self.size[0] - beyond), min(low + high, self.size[1] - beyond)
        left, low = max(left, beyond), max(low, beyond)
        return left, low, max(right - left, 0), max(top - low, 0)

    @property
    def view_from_object(self) -> Matrix:
        return self.view_from_world @ self.world_from_object

    def rig_from_world(self, follows: Follows) -> Matrix:
        """Axes that a light is fixed to, around the subject's centre."""
        if follows == "subject":
            return np.asarray(np.linalg.inv(self.world_from_object))
        turn = np.eye(4)
        if follows == "camera":
            turn[:3, :3] = self.view_from_world[:3, :3]
        return turn

    @property
    def is_orthographic(self) -> bool:
        return bool(self.clip_from_view[3, 2] == 0.0)

    @property
    def linear_depth(self) -> dict[str, tuple[float, float]]:
        """`depth_range_mm` where the depth buffer is linear."""
        return linear_depth(self.clip_from_view, self.far_mm)

    def px_per_mm(self, depth_mm: float) -> float:
        """Pixels per millimetre at a depth: 0.5 H P11 / z, without /z when orthographic."""
        scale = float(0.5 * self.size[1] * self.clip_from_view[1, 1])
        return scale if self.is_orthographic else scale / depth_mm

    @property
    def screen_uniforms(self) -> dict[str, Any]:
        """What `screen.glsl` takes."""
        return {
            "px_per_mm_at_1mm": self.px_per_mm(1.0),
            "is_orthographic": self.is_orthographic,
        }


class Scene:
    """An asset under lights with a material, on the device. Everything a pass may read."""

    def __init__(
        self,
        device: Device,
        asset: Asset,
        pipeline: Pipeline,
        like: Scene | None = None,
        scattering: GaussianSum | None = None,
    ) -> None:
        """`like` is a scene of the same asset whose mesh and maps are on the device already;
        `scattering` is what light spreads by, where it is not what the method says."""
        self.device = device
        self.asset = asset
        self.pipeline = pipeline
        self._like = like
        if like is None:
            check_mesh(asset.mesh)
        self.radius_mm = bounding_radius_mm(asset.mesh.positions_mm)
        self.lamps, self.ambient = resolve_lights(pipeline.lights, self.radius_mm)
        self.light_level = light_level(pipeline.lights)
        self.profile = profile_of(pipeline.skin)
        self.albedo_power = {"pre": 1.0, "mixed": 0.5, "post": 0.0}[pipeline.skin.texturing]
        # Radius of 99.9 % of the profile per channel: guard band, culling, kernel_px.
        self.scattering = scattering or scattering_of(pipeline)
        self.levels = self.scattering.merged(pipeline.diffusion.gaussians)
        self.reach_mm = np.asarray(self.scattering.radius_for(0.999), dtype=np.float64)
        scatters = pipeline.diffusion.method != "none"
        self.uses_skin_map = scatters and pipeline.diffusion.mask == "skin" and "skin" in asset.maps
        if like is None:
            self._index = device.context.buffer(asset.mesh.faces.astype(np.uint32).tobytes())
            self._vertices = device.context.buffer(_interleaved(asset).tobytes())
        else:
            self._index, self._vertices = like._index, like._vertices
        # How close the camera comes to anything: the renderer knows.
        self.nearest_px_per_mm = 0.0
        self._tap_blocks: dict[int, moderngl.Buffer] = {}
        self._data_maps: dict[str, moderngl.Texture] = {} if like is None else like._data_maps
        self._arrays: dict[str, moderngl.VertexArray] = {}

    def draw_mesh(self, program: moderngl.Program) -> None:
        """Draw all triangles with a program that takes any of the mesh's attributes."""
        key = str(program.glo)
        if key not in self._arrays:
            layout = [("3f", "position_mm"), ("3f", "normal"), ("4f", "tangent"), ("2f", "uv")]
            # Attributes that the compiler removed are skipped over, not bound.
            form = " ".join(f if n in program else _padding(f) for f, n in layout)
            names = [n for _, n in layout if n in program]
            self._arrays[key] = self.device.context.vertex_array(
                program, [(self._vertices, form, *names)], self._index
            )
        self._arrays[key].render(moderngl.TRIANGLES)

    @cached_property
    def maps(self) -> dict[str, moderngl.Texture]:
        """Albedo, normal, AO and skin maps, mipmapped; a neutral texel for a missing one."""
        if self._like is not None:
            return self._like.maps
        return {
            name: upload_map(self.device, name, self.asset.maps.get(name)) for name in NEUTRAL_MAPS
        }

    def gaussian_taps(self, count: int, size: int) -> bytes:
        """(offset in sigma, weight) of a unit Gaussian by exact cell integrals, as vec2[size]."""
        taps = gaussian_taps(count)
        array = np.zeros((size, 2), dtype=np.float32)
        array[:count] = np.stack([taps.offsets_sigma, taps.weights], axis=1)
        return array.tobytes()

    def tap_block(self, count: int, make: Callable[[Scene, int], bytes]) -> moderngl.Buffer:
        """The uniform block of a kernel with `count` taps, made once by `make(scene, count)`."""
        if count not in self._tap_blocks:
            self._tap_blocks[count] = self.device.context.buffer(make(self, count))
        return self._tap_blocks[count]

    @cached_property
    def smoothing_taps(self) -> moderngl.Texture:
        taps = gaussian_taps(15)
        return self.device.table(np.stack([taps.offsets_sigma, taps.weights], axis=1)[None])

    @cached_property
    def _lobes(self) -> SpecularLobes:
        specular = self.pipeline.skin.specular
        return SpecularLobes(
            m_first=specular.roughness[0],
            m_second=specular.roughness[1],
            mix=1.0 - specular.second_lobe,
            f0=specular.f0,
        )

    @cached_property
    def environments(self) -> list[Environment]:
        """Environment lights, prefiltered for this material."""
        if self._like is not None and self._reflects_like(self._like):
            return self._like.environments
        found = [light for light in self.pipeline.lights if isinstance(light, EnvironmentLight)]
        return [
            Environment(self.device, light, self._lobes, RHO_COSINES, self._rho) for light in found
        ]

    def _reflects_like(self, other: Scene) -> bool:
        mine, theirs = self.pipeline, other.pipeline
        return mine.skin.specular == theirs.skin.specular and all(
            light in theirs.lights for light in mine.lights if isinstance(light, EnvironmentLight)
        )

    @cached_property
    def lobe_albedo(self) -> moderngl.Texture:
        """Row over cos theta: what each lobe reflects with its share; they sum to
        `directional_albedo`.
        """
        lobes = self._lobes
        parts = np.stack([
            lobes.mix * _reflected(lobes.m_first, lobes.f0),
            (1.0 - lobes.mix) * _reflected(lobes.m_second, lobes.f0),
        ], axis=-1)  # fmt: skip
        total = np.maximum(parts.sum(axis=-1, keepdims=True), 1e-12)
        return self.device.table((parts / total * self._rho[:, None])[None], linear=True)

    @cached_property
    def _rho(self) -> npt.NDArray[np.float64]:
        strength = self.pipeline.skin.specular.strength
        lobes = self._lobes
        first, second = (_reflected(m, lobes.f0) for m in (lobes.m_first, lobes.m_second))
        return np.clip(strength * (lobes.mix * first + (1.0 - lobes.mix) * second), 0.0, 1.0)

    @cached_property
    def directional_albedo(self) -> moderngl.Texture:
        """Row over cos theta in [0, 1]: what the specular lobes reflect, rho_dt(cos theta)."""
        return self.device.table(self._rho.reshape(1, -1, 1), linear=True)

    @cached_property
    def mean_directional_albedo(self) -> float:
        """Cosine-weighted mean of `directional_albedo`: for light that comes from everywhere."""
        return float(np.average(self._rho, weights=RHO_COSINES))

    @cached_property
    def view_table(self) -> moderngl.Texture3D:
        """The view transform over log2 of scene-linear red, green, blue."""
        values = view_table(self.pipeline.view.transform)
        texture = self.device.context.texture3d(
            (TABLE_SIZE,) * 3, 3, np.ascontiguousarray(values).tobytes(), dtype="f4"
        )
        texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
        texture.repeat_x = texture.repeat_y = texture.repeat_z = False
        return texture

    @cached_property
    def white(self) -> moderngl.Texture:
        """Visibility of a light that casts no shadow."""
        return self.device.table(np.ones((1, 1, 1)))

    def shot(
        self,
        camera: Camera,
        turn_deg: float,
        guard_px: int = 0,
        jitter_px: tuple[float, float] = (0.0, 0.0),
        sample: int = 0,
        footprint_px: float = 1.0,
    ) -> Shot:
        """One sample with the subject turned by `turn_deg` about +Y."""
        view_from_world = camera.view_from_world
        world_from_object = rotation_y(turn_deg)
        clip_from_view = camera.clip_from_view(guard_px, jitter_px)
        width, height = (side + 2 * guard_px for side in camera.size_px)
        scissor = _screen_bounds(
            self.asset.mesh.positions_mm,
            clip_from_view @ view_from_world @ world_from_object,
            (width, height),
        )
        toward = (view_from_world @ world_from_object)[2]
        nearest = -float((self.asset.mesh.positions_mm @ toward[:3]).max() + toward[3])
        return Shot(
            (width, height),
            scissor,
            view_from_world,
            world_from_object,
            clip_from_view,
            max(nearest, camera.near_mm),
            camera.far_mm,
            camera.distance_mm,
            sample,
            guard_px,
            jitter_px,
            footprint_px,
        )

    @property
    def dtype(self) -> str:
        """Of buffers that need not be exact."""
        return "f2" if self.pipeline.quality.precision == "half" else "f4"

    @property
    def scattered_samples(self) -> int:
        """How many samples of a pixel scatter their light."""
        quality = self.pipeline.quality
        once = quality.sampling == "contrast" or self.pipeline.diffusion.resolution == "half"
        return 1 if once else quality.supersampling**2

    @property
    def transmitting_lamps(self) -> list[Lamp]:
        """The lamps whose light may cross thin skin."""
        method = self.pipeline.skin.transmission.method
        if method == "none":
            return []
        lamps = [lamp for lamp in self.lamps if np.any(lamp.irradiance)]
        return [lamp for lamp in lamps if method == "baked" or lamp.settings.shadow]

    def data_map(self, name: str) -> moderngl.Texture:
        """`curvature` or `thickness_mm`, uploaded when a pass first asks; 0 where it is missing."""
        if name not in self._data_maps:
            self._data_maps[name] = upload_map(self.device, name, self.asset.maps.get(name))
        return self._data_maps[name]

    @property
    def baked_curvature_mm(self) -> float:
        """Standard deviation of the smoothing in the asset's curvature map; 0 if not stated."""
        notes = [stage.get("notes", {}) for stage in self.asset.info.get("stages", [])]
        return max((float(note.get("curvature_scale_mm") or 0.0) for note in notes), default=0.0)

    @cached_property
    def facet_mm(self) -> float:
        """Standard deviation of the smoothing that triangles do: normals that are linear in one
        have their curvature averaged over it, a box with a twelfth of its squared side.

        A mean over triangles, which are finer where there is detail: over the surface, a bust's
        wide shoulders spoke for its face. But not over crumbs: a few thousand somewhere inside say
        nothing of what is seen.
        """
        corners = self.asset.mesh.positions_mm[self.asset.mesh.faces].astype(np.float64)
        sides = corners - np.roll(corners, 1, axis=1)
        areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
        counts = areas > CRUMB * areas.mean() if len(areas) else areas > 0.0
        squared = np.einsum("fij,fij->fi", sides, sides).mean(axis=1)[counts]
        return math.sqrt(float(squared.mean()) / 12.0) if len(squared) else 0.0


@lru_cache(maxsize=64)
def _reflected(m: float, f0: float) -> npt.NDArray[np.float64]:
    """`rho_dt` at RHO_COSINES, once a process: most of what a renderer of a small picture costs."""
    found = rho_dt(RHO_COSINES, m, f0)
    found.flags.writeable = False
    return found


def profile_of(skin: SkinSettings) -> GaussianSum:
    """The diffusion profile that the settings describe, scaled.

    A scale of 0 is the narrowest profile that optics takes: far below any pixel.
    """
    profile = D_EON_SKIN
    if not isinstance(skin.profile, str):
        terms = sorted(skin.profile, key=lambda term: term.variance_mm2)
        profile = GaussianSum.normalized(
            tuple(term.variance_mm2 for term in terms), tuple(term.weight for term in terms)
        )
    narrowest = MIN_LENGTH_MM * 1.001 / float(np.sqrt(profile.variances_mm2[0]))
    return profile.scaled(max(skin.scale, narrowest)) if skin.scale != 1.0 else profile


def scattering_of(pipeline: Pipeline) -> GaussianSum:
    """The profile that the method spreads light by: the skin's, or the artistic kernel's."""
    if pipeline.diffusion.method != "separable_artistic":
        return profile_of(pipeline.skin)
    share = pipeline.diffusion.artistic.strength
    weights: dict[float, list[float]] = {}
    for sigmas, shares in zip(
        artistic_sigmas_mm(pipeline), (share, [1.0 - w for w in share]), strict=True
    ):
        for c in range(3):
            weights.setdefault(float(sigmas[c] ** 2), [0.0, 0.0, 0.0])[c] += shares[c]
    variances = sorted(weights)
    return GaussianSum.normalized(variances, [weights[v] for v in variances])


def artistic_sigmas_mm(pipeline: Pipeline) -> npt.NDArray[np.float64]:
    """(near and far, 3) standard deviations of the artistic kernel, scaled."""
    artistic = pipeline.diffusion.artistic
    sigmas = np.array([artistic.near_mm, artistic.far_mm]) * pipeline.skin.scale
    return np.maximum(sigmas, 10.0 * MIN_LENGTH_MM)


def _interleaved(asset: Asset) -> npt.NDArray[np.float32]:
    mesh = asset.mesh
    return np.hstack([mesh.positions_mm, mesh.normals, mesh.tangents, mesh.uv]).astype(np.float32)


def _padding(form: str) -> str:
    return f"{4 * int(form[0])}x"


def _screen_bounds(
    positions_mm: npt.NDArray[np.floating], clip_from_object: Matrix, size: tuple[int, int]
) -> tuple[int, int, int, int]:
    """(x, y, w, h) in bottom-up pixels that can show the mesh; everything when it surrounds us."""
    low, high = positions_mm.min(axis=0), positions_mm.max(axis=0)
    corners = np.array(
        [
            [x, y, z, 1.0]
            for x in (low[0], high[0])
            for y in (low[1], high[1])
            for z in (low[2], high[2])
        ]
    )
    clip = corners @ clip_from_object.T
    whole = (0, 0, *size)
    if (clip[:, 3] <= 1e-6).any():
        return whole
    pixel = (clip[:, :2] / clip[:, 3:] * 0.5 + 0.5) * size
    start = np.clip(np.floor(pixel.min(axis=0)) - 2, 0, size).astype(int)
    stop = np.clip(np.ceil(pixel.max(axis=0)) + 2, 0, size).astype(int)
    span = np.maximum(stop - start, 1)
    return int(start[0]), int(start[1]), int(span[0]), int(span[1])
