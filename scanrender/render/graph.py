"""The pass graph: given the buffers somebody asked for, it walks backwards and runs only those.

The only place that knows the order of passes. A pass declares what it reads and writes; a debug
dump is the same walk with more buffers asked for. Intermediates are allocated before their writer
and returned to a pool after their last reader, so that a turntable allocates nothing after its
first frame.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import moderngl

from scanrender.buffers import buffer_spec
from scanrender.render.device import Device

Size = tuple[int, int]


@dataclass(frozen=True)
class Buffer:
    """What a pass writes: RGBA32F, or R32F with `components=1`.

    `size` is (width, height) px, None for the picture with its guard band. `exact` is what half
    floats cannot hold: lengths in millimetres, sums over samples. A name with a leading underscore
    is private to its pass: it is never dumped and needs no entry in the catalogue.
    """

    name: str
    components: int = 4
    size: Size | None = None
    clear: float = 0.0
    exact: bool = False

    def __post_init__(self) -> None:
        if not self.name.startswith("_"):
            buffer_spec(self.name)


@dataclass(frozen=True)
class Pass:
    """One pass. `draw(shot, inputs, target)` draws into the bound, cleared framebuffer `target`.

    The last of `writes` are left out of it while nobody reads them. `in_picture` is a pass whose
    pixels no filter reads: it has no use for the guard band.
    """

    name: str
    reads: tuple[str, ...]
    writes: tuple[Buffer, ...]
    draw: Callable[[Any, Mapping[str, moderngl.Texture], moderngl.Framebuffer], None]
    depth_test: bool = False
    in_picture: bool = False


Check = Callable[[Pass, Any, Sequence[moderngl.Texture]], None]


class TexturePool:
    """Textures and framebuffers, kept for reuse."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._free: dict[tuple[Size, int, str], list[moderngl.Texture]] = {}
        self._depth: dict[tuple[Size, str], moderngl.Renderbuffer] = {}
        self._framebuffers: dict[tuple[int, ...], moderngl.Framebuffer] = {}

    def take(self, size: Size, components: int, dtype: str = "f4") -> moderngl.Texture:
        free = self._free.setdefault((size, components, dtype), [])
        if free:
            return free.pop()
        texture = self._device.context.texture(size, components, dtype=dtype)
        texture.repeat_x = texture.repeat_y = False
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        return texture

    def give_back(self, texture: moderngl.Texture) -> None:
        # The same order in each frame: framebuffers are made for sets of textures, and a pool that
        # hands them out by history would make new sets, and so framebuffers, without end.
        free = self._free[(texture.size, texture.components, texture.dtype)]
        free.append(texture)
        free.sort(key=lambda other: -other.glo)

    def depth(self, size: Size, use: str = "mesh") -> moderngl.Renderbuffer:
        """A depth buffer of this size: the one that meshes are drawn with, or one of its own."""
        if (size, use) not in self._depth:
            self._depth[size, use] = self._device.context.depth_renderbuffer(size)
        return self._depth[size, use]

    def framebuffer(
        self, textures: Sequence[moderngl.Texture], depth: moderngl.Renderbuffer | None = None
    ) -> moderngl.Framebuffer:
        key = (*(texture.glo for texture in textures), -1 if depth is None else depth.glo)
        if key not in self._framebuffers:
            self._framebuffers[key] = self._device.context.framebuffer(list(textures), depth)
        return self._framebuffers[key]


class Graph:
    """All passes a scene could run. Raises ValueError when two passes write the same buffer."""

    def __init__(
        self, passes: Iterable[Pass], dtype: str = "f4", check: Check | None = None
    ) -> None:
        """`dtype` ("f4", "f2") is that of buffers which need not be exact; `check` is called after
        each pass with what it has written, and raises where that is wrong.
        """
        self._dtype, self._check = dtype, check
        self._writer: dict[str, Pass] = {}
        for step in passes:
            for buffer in step.writes:
                if buffer.name in self._writer:
                    other = self._writer[buffer.name].name
                    raise ValueError(f"{buffer.name} is written by {other} and by {step.name}")
                self._writer[buffer.name] = step

    @property
    def names(self) -> list[str]:
        """Every buffer that can be asked for."""
        return [name for name in self._writer if not name.startswith("_")]

    @property
    def writes(self) -> frozenset[str]:
        """Every buffer that some pass writes, private ones included."""
        return frozenset(self._writer)

    def kept(self, wanted: Collection[str]) -> list[str]:
        """What `wanted` needs that has a size of its own, and so is the same for every sample."""
        steps = self.order(wanted)
        return [b.name for step in steps for b in step.writes if b.size is not None]

    def fills_picture(self, name: str) -> bool:
        """Whether buffer `name` has the picture's size; a shadow map has its own."""
        return all(b.size is None for b in self._writer[name].writes if b.name == name)

    def order(self, wanted: Collection[str], given: Collection[str] = ()) -> list[Pass]:
        """The passes that `wanted` needs, each after those it reads from; `given` exist already.

        Raises ValueError for a buffer that no pass writes, or for a circle.
        """
        ordered: list[Pass] = []
        open_passes: list[Pass] = []

        def visit(name: str) -> None:
            if name in given:
                return
            if name not in self._writer:
                raise ValueError(f"no pass of this scene writes {name!r}")
            step = self._writer[name]
            if step in ordered:
                return
            if step in open_passes:
                raise ValueError(f"passes read each other in a circle at {step.name}")
            open_passes.append(step)
            for needed in step.reads:
                visit(needed)
            open_passes.pop()
            ordered.append(step)

        for name in sorted(wanted):
            visit(name)
        return ordered

    def run(
        self,
        device: Device,
        pool: TexturePool,
        shot: Any,
        wanted: Collection[str],
        given: Mapping[str, moderngl.Texture] | None = None,
        timings: dict[str, float] | None = None,
        where: moderngl.Renderbuffer | None = None,
    ) -> dict[str, moderngl.Texture]:
        """Draw and return the `wanted` textures; the caller gives them back to the pool.

        Passes without a depth test draw only where the depth buffer `where` holds 1, not 0: pixels
        are told apart ahead of the shaders, which need not know. The others stay 0.

        With `timings`, each pass is finished and its wall-clock seconds are added under its name
        (timer queries lie on software GL). `shot.size` is the picture's padded (width, height).
        """
        steps = self.order(wanted, given or {})
        last_use = {name: i for i, step in enumerate(steps) for name in step.reads}
        live: dict[str, moderngl.Texture] = dict(given or {})
        read = {*wanted, *last_use}
        for index, step in enumerate(steps):
            started = time.perf_counter()
            writes = step.writes if self._check else _read_by(step, read)
            for buffer in writes:
                dtype = "f4" if buffer.exact else self._dtype
                live[buffer.name] = pool.take(buffer.size or shot.size, buffer.components, dtype)
            self._draw(device, pool, shot, step, [live[b.name] for b in writes], live, where)
            device.let_go()
            if self._check is not None:
                self._check(step, shot, [live[b.name] for b in step.writes])
            if timings is not None:
                device.finish()
                timings[step.name] = timings.get(step.name, 0.0) + time.perf_counter() - started
            for name in [*step.reads, *(b.name for b in step.writes)]:
                done = last_use.get(name, -1) <= index and name not in wanted
                if done and name in live and name not in (given or {}):
                    pool.give_back(live.pop(name))
        return {name: live[name] for name in wanted}

    def _draw(
        self,
        device: Device,
        pool: TexturePool,
        shot: Any,
        step: Pass,
        textures: Sequence[moderngl.Texture],
        live: Mapping[str, moderngl.Texture],
        where: moderngl.Renderbuffer | None,
    ) -> None:
        own = pool.depth(textures[0].size) if step.depth_test else None
        target = pool.framebuffer(textures, own or where)
        target.depth_mask = step.depth_test
        target.use()
        everywhere(target)
        # One call clears every attachment and the depth. Only a shadow map has another value than
        # 0, and it is the single attachment of its pass.
        value = step.writes[0].clear
        target.clear(value, value, value, value, depth=1.0)
        context = device.context
        context.disable(moderngl.BLEND)
        if own or where:
            context.enable(moderngl.DEPTH_TEST)
        else:
            context.disable(moderngl.DEPTH_TEST)
        if not step.depth_test:
            target.scissor = shot.picture_scissor if step.in_picture else shot.scissor
        step.draw(shot, {name: live[name] for name in step.reads}, target)
        everywhere(target)


def _read_by(step: Pass, read: Collection[str]) -> tuple[Buffer, ...]:
    """What the pass has to write: up to the last buffer that is `read`."""
    used = [number for number, buffer in enumerate(step.writes) if buffer.name in read]
    return step.writes[: max(used) + 1]


def everywhere(target: moderngl.Framebuffer) -> None:
    """Lift the scissor (moderngl's stub does not know that it takes None)."""
    target.scissor = None  # type: ignore[assignment]
