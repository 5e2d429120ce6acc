"""Camera + lights + plan -> a Frame: samples rendered, resolved, cropped, read back."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import partial

import moderngl
import numpy as np
import numpy.typing as npt

from scanrender.asset import Asset
from scanrender.buffers import CATALOGUE, Frame, buffer_spec
from scanrender.errors import ConfigError, StageError, UsageError
from scanrender.render.camera import Camera, bounding_radius_mm, frame_subject
from scanrender.render.check import check_beauty, check_pass
from scanrender.render.device import Device
from scanrender.render.graph import Graph, TexturePool
from scanrender.render.lamps import WIDEST_MAP_DEG
from scanrender.render.maps import unsound_texels
from scanrender.render.passes import all_passes
from scanrender.render.passes._scatter import largest_width_factor
from scanrender.render.plan import Decision, plan, with_taps_that_meet
from scanrender.render.scene import Scene, Shot, scattering_of
from scanrender.render.supersample import Supersampler
from scanrender.settings.pipeline import Pipeline

RESOLVED = ("beauty", "display")


@dataclass(frozen=True)
class View:
    """Where frame `index` of a turntable stands: how far the subject and the camera are turned."""

    index: int
    subject_deg: float
    camera_deg: float


class Renderer:
    """Renders frames of one asset. Keep one per process: it owns device textures."""

    scene: Scene
    pool: TexturePool

    def __init__(
        self, device: Device, asset: Asset, pipeline: Pipeline, like: Renderer | None = None
    ) -> None:
        """`like` is a renderer of the same asset, whose device memory serves this one too."""
        self.device = device
        device.let_go()  # the maps of the renderer before this one take as much as its own will
        _check_size(pipeline, device.most_px)
        self.asked = pipeline  # for another renderer of these frames: a plan of a plan is another
        self.pipeline, self.decisions = plan(pipeline, asset.maps)
        scattering = scattering_of(self.pipeline)
        self.pipeline = with_taps_that_meet(
            self.pipeline,
            float(scattering.radius_for(0.999).max()),
            bounding_radius_mm(asset.mesh.positions_mm),
            self.decisions,
        )
        shared = None if like is None else like.scene
        self.scene = Scene(device, asset, self.pipeline, shared, scattering)
        self.camera = self._camera() if like is None else like._camera_for(self.pipeline)
        self.scene.nearest_px_per_mm = self.camera.px_per_mm(self.camera.near_mm)
        check = check_pass if self.pipeline.quality.check else None
        self.graph = Graph(all_passes(self.scene), self.scene.dtype, check)
        self.pool = TexturePool(device) if like is None else like.pool
        self.supersampler = Supersampler(device, self.pool, self.scene, self.graph, check)
        self.decisions += _map_decisions(asset) if like is None else []
        self.decisions += _light_decisions(self.scene) + _curvature_decisions(self.scene)
        self.guard_px = self._guard_px()

    def show_window(self, shares: tuple[float, float, float, float]) -> None:
        """From now on render only (left, top, right, bottom) of the picture, as shares of it."""
        self.camera = self._camera().window(shares)
        self.guard_px = self._guard_px()

    @property
    def buffer_names(self) -> list[str]:
        """Every buffer that this scene can dump, in the catalogue's order."""
        order = {name: i for i, name in enumerate(CATALOGUE)}
        names = {*self.graph.names, "beauty"}
        return sorted(names, key=lambda n: (order.get(buffer_spec(n).name, _family(n, order)), n))

    def view(self, index: int) -> View:
        """Frame `index` of the turntable. Positive turns show the subject's own left first."""
        turntable = self.pipeline.turntable
        angle = turntable.start_deg + turntable.degrees * index / turntable.frames
        if turntable.mode == "subject":
            return View(index, -angle, 0.0)
        return View(index, 0.0, angle)

    def render(
        self,
        view: View,
        buffers: Collection[str] = (),
        timings: dict[str, float] | None = None,
    ) -> Frame:
        """One frame: `display` and `beauty` always, other `buffers` of the pixel-centre sample.

        Other buffers come from a sample of their own at the pixel's centre, since the mean of two
        positions across a silhouette is the position of nothing; so the picture is the same
        whatever is asked for beside it. Raises UsageError for a buffer that this scene does not
        make, StageError when the picture holds what is no light, or with `quality.check` when any
        pass has written what its buffer cannot hold.
        """
        self._check_names(buffers)
        try:
            return self._render(view, buffers, timings)
        except StageError as error:
            where = ", ".join(filter(None, (f"frame {view.index}", error.where)))
            raise StageError(error.what, where, error.fix) from error

    def _render(
        self, view: View, buffers: Collection[str], timings: dict[str, float] | None
    ) -> Frame:
        shot = self._shot(view)
        beauty = self.supersampler.beauty(partial(self._shot, view), timings)
        tonemapped = self.graph.run(
            self.device, self.pool, shot, {"display"}, {"beauty": beauty}, timings
        )
        display = self._read(tonemapped["display"], channels=3)
        pixels = {"beauty": self._read(beauty), "display": display}
        self.pool.give_back(beauty)
        self.pool.give_back(tonemapped["display"])
        pixels.update(self._dump(shot, [n for n in buffers if n not in RESOLVED], timings))
        alpha = np.ascontiguousarray(pixels["beauty"][:, :, 3])
        check_beauty(pixels["beauty"])
        cropped = {name: _channels(name, array) for name, array in pixels.items()}
        return Frame(cropped, alpha, self._info(view))

    def _dump(
        self, shot: Shot, names: Collection[str], timings: dict[str, float] | None
    ) -> dict[str, npt.NDArray[np.float32]]:
        if not names:
            return {}
        made = self.graph.run(self.device, self.pool, shot, set(names), None, timings)
        pixels = {}
        for name, texture in made.items():
            pixels[name] = self._read(texture, crop=self.graph.fills_picture(name))
            self.pool.give_back(texture)
        return pixels

    def _shot(
        self,
        view: View,
        jitter_px: tuple[float, float] = (0.0, 0.0),
        sample: int = 0,
        footprint_px: float = 1.0,
        halved: bool = False,
    ) -> Shot:
        """One sample of the picture, or of one of half its width and height."""
        camera, guard_px = self.camera.turned(view.camera_deg), self.guard_px
        if halved:
            camera, guard_px = camera.halved(), (guard_px + 1) // 2
        turn = view.subject_deg
        shot = self.scene.shot(camera, turn, guard_px, jitter_px, sample, footprint_px)
        return replace(shot, is_halved=halved)

    def _camera(self) -> Camera:
        return self._camera_of(self.pipeline)

    def _camera_of(self, pipeline: Pipeline) -> Camera:
        turntable = pipeline.turntable
        count = min(turntable.frames, 72)
        angles = turntable.start_deg + turntable.degrees * np.arange(count) / count
        return frame_subject(
            pipeline.camera, self.scene.asset.mesh.positions_mm, -np.asarray(angles)
        )

    def _camera_for(self, pipeline: Pipeline) -> Camera:
        """Where a renderer with these settings would stand: here, if they frame the same shot."""
        mine = self.pipeline
        same = (mine.camera, mine.turntable) == (pipeline.camera, pipeline.turntable)
        return self.camera if same else self._camera_of(pipeline)

    def _guard_px(self) -> int:
        """Pixels rendered beyond the picture, so that light diffuses in from outside it.

        R_99.9 of the widest channel at the nearest point; at most half the picture (DESIGN 6), and
        what the device holds.
        """
        if self.pipeline.diffusion.method == "none":
            return 0
        reach = self.camera.px_per_mm(self.camera.near_mm) * float(self.scene.reach_mm.max())
        reach *= largest_width_factor(self.scene)
        size = self.camera.size_px
        limit = min(min(size) // 2, (self.device.most_px - max(size)) // 2)
        if reach > limit:
            reason = (
                f"the profile reaches {math.ceil(reach)} px; the guard band stops at {limit} px"
            )
            self.decisions.append(Decision("guard band", reason))
        return min(math.ceil(reach), limit)

    def _read(
        self, texture: moderngl.Texture, crop: bool = True, channels: int | None = None
    ) -> npt.NDArray[np.float32]:
        """(h, w, c) float32 of the picture alone, top row first: the only flip there is.

        The guard band stays on the device: in a close view it is twice the picture.
        """
        guard = self.guard_px if crop else 0
        width, height = texture.width - 2 * guard, texture.height - 2 * guard
        raw = np.empty((height, width, channels or texture.components), np.float32)
        source = self.pool.framebuffer([texture])
        window = (guard, guard, width, height)
        source.read_into(raw, window, components=raw.shape[2], dtype="f4")
        return raw[::-1]

    def _check_names(self, names: Collection[str]) -> None:
        known = self.buffer_names
        for name in names:
            buffer_spec(name)
            if name not in known:
                raise UsageError(
                    f"this scene makes no buffer {name!r}",
                    fix=f"it makes: {', '.join(known)}",
                )

    def _info(self, view: View) -> dict[str, object]:
        return {
            "index": view.index,
            "subject_deg": view.subject_deg,
            "camera_deg": view.camera_deg,
            "camera_distance_mm": round(self.camera.distance_mm, 3),
            "px_per_mm": round(self.camera.px_per_mm(self.camera.distance_mm), 6),
            "guard_px": self.guard_px,
        }


def _check_size(pipeline: Pipeline, most_px: int) -> None:
    width, height = pipeline.camera.width_px, pipeline.camera.height_px
    if max(width, height) > most_px:
        raise ConfigError(
            f"a picture of {width} x {height} px is more than this GL holds: {most_px} a side",
            "camera.width_px, camera.height_px",
            "render it in parts (figure.crop), or on another device",
        )


def _map_decisions(asset: Asset) -> list[Decision]:
    """Texels that are no numbers are not drawn as they are."""
    counts = {name: unsound_texels(pixels) for name, pixels in asset.maps.items()}
    return [
        Decision(f"{count} texels of {name}", "they are no finite numbers: they take its mean")
        for name, count in counts.items()
        if count
    ]


def _light_decisions(scene: Scene) -> list[Decision]:
    """What a lamp's shadow map cannot hold."""
    return [
        Decision(
            f"part of the shadows of lamp {lamp.index}",
            f"it stands {lamp.distance_mm:.0f} mm from the centre, inside the subject's bounds; "
            f"its map sees {WIDEST_MAP_DEG:.0f} degrees, what lies beside it is lit unshadowed",
        )
        for lamp in scene.lamps
        if lamp.settings.shadow and not lamp.sees_all
    ]


def _curvature_decisions(scene: Scene) -> list[Decision]:
    asked, needed = scene.pipeline.curvature.smooth_mm, scene.baked_curvature_mm
    if scene.pipeline.curvature.modulation == "none" or asked >= needed:
        return []
    reason = f"{needed:.1f} mm instead of {asked:g}: finer, it is that of the scan's triangles"
    return [Decision("curvature.smooth_mm", reason)]


def _family(name: str, order: dict[str, int]) -> int:
    return order.get(f"{name.rsplit('_', 1)[0]}_0", len(order))


def _channels(name: str, array: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    spec = buffer_spec(name)
    count = 1 if spec.kind == "scalar" else 3
    values = array[:, :, :count]
    if not spec.premultiplied:
        return np.ascontiguousarray(values)
    mask = array[:, :, 3:]
    return np.divide(values, mask, out=np.zeros(values.shape, np.float32), where=mask > 0.0)
