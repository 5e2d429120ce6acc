"""A pixel's samples to its mean: all of them everywhere, or further ones only where they show."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import moderngl

from scanrender.render.device import Device, bind
from scanrender.render.graph import Graph, TexturePool, everywhere
from scanrender.render.passes import all_passes, reproject
from scanrender.render.samples import sample_offsets_px
from scanrender.render.scene import Scene, Shot

Timings = dict[str, float] | None
ShotAt = Callable[[tuple[float, float], int], Shot]
# Range of the root of light in 3 x 3 pixels above which a pixel gets its further samples.
THRESHOLD = 0.04


class Supersampler:
    """Renders `beauty` of one scene: radiance, resolved (RGB premultiplied by coverage)."""

    def __init__(self, device: Device, pool: TexturePool, scene: Scene, graph: Graph) -> None:
        self._device, self._pool, self._scene, self._graph = device, pool, scene, graph
        quality = scene.pipeline.quality
        self._offsets = sample_offsets_px(quality.supersampling)
        self._by_contrast = quality.sampling == "contrast" and len(self._offsets) > 1
        if self._by_contrast:
            self._further = _further_graph(scene)

    def beauty(self, shot_at: ShotAt, timings: Timings) -> moderngl.Texture:
        """The picture's mean over samples; the caller gives it back to the pool."""
        if self._by_contrast:
            return self._where_contrast(shot_at, timings)
        beauty, kept = None, self._graph.kept({"radiance"})
        given: dict[str, moderngl.Texture] = {}
        for number, offset in enumerate(self._offsets):
            shot, wanted = shot_at(offset, number), {"radiance", *(kept if number == 0 else [])}
            made = self._graph.run(self._device, self._pool, shot, wanted, given, timings)
            given = given or {name: made[name] for name in kept}
            beauty = beauty or self._empty(shot)
            self._add(made["radiance"], beauty, shot, 1.0 / len(self._offsets))
            self._pool.give_back(made["radiance"])
        self._give_back(given)
        assert beauty is not None
        return beauty

    def _where_contrast(self, shot_at: ShotAt, timings: Timings) -> moderngl.Texture:
        centre = shot_at((0.0, 0.0), 0)
        kept = self._graph.kept({"radiance"})
        shared = [name for name in reproject.GIVEN if name in self._graph.writes]
        wanted = {"radiance", *kept, *shared}
        made = self._graph.run(self._device, self._pool, centre, wanted, None, timings)
        beauty = self._empty(centre)
        self._add(made["radiance"], beauty, centre, 1.0)
        where = self._mark(made["radiance"], centre)
        offsets = [offset for offset in self._offsets if offset != (0.0, 0.0)]
        share = 1.0 / (1 + len(offsets))
        self._add(made["radiance"], beauty, centre, share, where, replaces=True)
        self._pool.give_back(made["radiance"])
        given = {name: made[name] for name in kept}
        given |= {reproject.GIVEN[name]: made[name] for name in shared}
        for number, offset in enumerate(offsets, 1):
            shot = shot_at(offset, number)
            more = self._further.run(
                self._device, self._pool, shot, {"radiance"}, given, timings, where
            )
            self._add(more["radiance"], beauty, shot, share, where)
            self._pool.give_back(more["radiance"])
        self._give_back(given)
        return beauty

    def _give_back(self, given: Mapping[str, moderngl.Texture]) -> None:
        for texture in given.values():
            self._pool.give_back(texture)

    def _empty(self, shot: Shot) -> moderngl.Texture:
        beauty = self._pool.take(shot.size, 4)
        self._pool.framebuffer([beauty]).clear()
        return beauty

    def _add(
        self,
        radiance: moderngl.Texture,
        beauty: moderngl.Texture,
        shot: Shot,
        weight: float,
        where: moderngl.Renderbuffer | None = None,
        replaces: bool = False,
    ) -> None:
        """Add weighted radiance to `beauty`, or put it in its place; `where` as in Graph.run."""
        context, program = self._device.context, self._device.program("resolve")
        target = self._pool.framebuffer([beauty], where)
        target.depth_mask = False
        target.use()
        _switch(context, moderngl.DEPTH_TEST, where is not None)
        _switch(context, moderngl.BLEND, not replaces)
        context.blend_func = moderngl.ONE, moderngl.ONE
        target.scissor = shot.scissor  # beyond it radiance is 0
        bind(program, {"radiance": radiance, "weight": weight})
        self._device.fill(program)
        everywhere(target)

    def _mark(self, radiance: moderngl.Texture, shot: Shot) -> moderngl.Renderbuffer:
        """Depth 1 where further samples would show."""
        context, program = self._device.context, self._device.program("contrast")
        where = self._pool.depth(shot.size, "where")
        unseen = self._pool.take(shot.size, 1)
        target = self._pool.framebuffer([unseen], where)
        target.depth_mask = True
        target.use()
        context.enable(moderngl.DEPTH_TEST)
        context.depth_func = "1"
        view = self._scene.pipeline.view
        bind(
            program,
            {
                "radiance": radiance,
                "background": view.background,
                "exposure": 2.0**view.exposure_ev,
                "threshold": THRESHOLD,
                "guard_px": shot.guard_px,
            },
        )
        self._device.fill(program)
        context.depth_func = "<"
        self._pool.give_back(unseen)
        return where


def _further_graph(scene: Scene) -> Graph:
    """The passes of a further sample: what scatters is taken from the pixel's centre."""
    own = [step for step in all_passes(scene) if all(b.name != "scattered" for b in step.writes)]
    scatters = scene.pipeline.diffusion.method != "none"
    return Graph([*own, *(reproject.passes(scene) if scatters else [])], scene.dtype)


def _switch(context: moderngl.Context, flag: int, on: bool) -> None:
    (context.enable if on else context.disable)(flag)
