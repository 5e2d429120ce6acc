"""A pixel's samples to its mean: all of them everywhere, or further ones only where they show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import moderngl

from scanrender.render.device import Device, bind
from scanrender.render.graph import Check, Graph, TexturePool, everywhere
from scanrender.render.passes import all_passes, reproject
from scanrender.render.samples import sample_offsets_px
from scanrender.render.scene import Scene, Shot

Timings = dict[str, float] | None
CENTRE = (0.0, 0.0)
# Range of the root of light in 3 x 3 pixels above which a pixel gets its further samples.
THRESHOLD = 0.04


class ShotAt(Protocol):
    """Makes the shot of one sample of a frame."""

    def __call__(
        self,
        jitter_px: tuple[float, float] = ...,
        sample: int = ...,
        footprint_px: float = ...,
        halved: bool = ...,
    ) -> Shot: ...


class Supersampler:
    """Renders `beauty` of one scene: radiance, resolved (RGB premultiplied by coverage)."""

    def __init__(
        self,
        device: Device,
        pool: TexturePool,
        scene: Scene,
        graph: Graph,
        check: Check | None = None,
    ) -> None:
        """`check` as in Graph."""
        self._device, self._pool, self._scene, self._graph = device, pool, scene, graph
        quality, diffusion = scene.pipeline.quality, scene.pipeline.diffusion
        offsets = sample_offsets_px(quality.supersampling)
        self._by_contrast = quality.sampling == "contrast" and len(offsets) > 1
        if self._by_contrast:
            offsets = [CENTRE, *(offset for offset in offsets if offset != CENTRE)]
        self._offsets = offsets
        self._halved = diffusion.resolution == "half" and diffusion.method != "none"
        self._further = _further_graph(scene, check)
        # Shadow maps have a size of their own, and are the same for every sample.
        self._kept = graph.kept({"radiance"})
        self._shared = [name for name in reproject.GIVEN if name in graph.writes]

    def beauty(self, shot_at: ShotAt, timings: Timings) -> moderngl.Texture:
        """The picture's mean over samples; the caller gives it back to the pool."""
        given = self._scattered(shot_at(halved=True), timings) if self._halved else {}
        if len(self._offsets) == 1:
            # Its radiance is the mean already; covered pixels are covered whole.
            radiance, given = self._sample(shot_at(self._offsets[0]), 0, given, timings, None)
            self._give_back(given)
            return radiance
        share, where = 1.0 / len(self._offsets), None
        beauty: moderngl.Texture | None = None
        for number, offset in enumerate(self._offsets):
            alone = number == 0 and self._by_contrast
            side = 1.0 if alone else 1.0 / self._scene.pipeline.quality.supersampling
            shot = shot_at(offset, number, side)
            radiance, given = self._sample(shot, number, given, timings, where)
            beauty = beauty or self._empty(shot)
            if alone:
                self._add(radiance, beauty, shot, 1.0)
                where = self._mark(radiance, shot)
            self._add(radiance, beauty, shot, share, where, replaces=alone)
            self._pool.give_back(radiance)
        self._give_back(given)
        assert beauty is not None
        return beauty

    def _sample(
        self,
        shot: Shot,
        number: int,
        given: dict[str, moderngl.Texture],
        timings: Timings,
        where: moderngl.Renderbuffer | None,
    ) -> tuple[moderngl.Texture, dict[str, moderngl.Texture]]:
        """Radiance of one sample, and what the samples after it are given."""
        shares = self._by_contrast or self._halved
        graph = self._further if self._halved or (shares and number > 0) else self._graph
        if given:
            made = graph.run(self._device, self._pool, shot, {"radiance"}, given, timings, where)
            return made["radiance"], given
        shared = self._shared if shares else []
        wanted = {"radiance", *self._kept, *shared}
        made = graph.run(self._device, self._pool, shot, wanted, None, timings)
        return made["radiance"], self._to_give(made, shared)

    def _give_back(self, given: Mapping[str, moderngl.Texture]) -> None:
        for texture in given.values():
            self._pool.give_back(texture)

    def _scattered(self, shot: Shot, timings: Timings) -> dict[str, moderngl.Texture]:
        """What every sample is given, from a picture of half the size."""
        wanted = {*self._kept, *self._shared}
        made = self._graph.run(self._device, self._pool, shot, wanted, None, timings)
        return self._to_give(made, self._shared)

    def _to_give(
        self, made: Mapping[str, moderngl.Texture], shared: Sequence[str]
    ) -> dict[str, moderngl.Texture]:
        given = {name: made[name] for name in self._kept}
        return given | {reproject.GIVEN[name]: made[name] for name in shared}

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


def _further_graph(scene: Scene, check: Check | None) -> Graph:
    """The passes of a further sample: what scatters is taken from the pixel's centre."""
    own = [step for step in all_passes(scene) if all(b.name != "scattered" for b in step.writes)]
    scatters = scene.pipeline.diffusion.method != "none"
    return Graph([*own, *(reproject.passes(scene) if scatters else [])], scene.dtype, check)


def _switch(context: moderngl.Context, flag: int, on: bool) -> None:
    (context.enable if on else context.disable)(flag)
