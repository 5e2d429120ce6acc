"""What half floats cost, buffer by buffer: each alone is kept in 16 bits, all others in 32."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from scanrender.asset import Asset
from scanrender.metrics import delta_e_2000_linear
from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.render.graph import Buffer, Graph, Pass
from scanrender.render.passes import all_passes
from scanrender.render.supersample import Supersampler
from scanrender.settings.pipeline import Pipeline


@dataclass(frozen=True)
class HalfError:
    """A buffer (or all that the setting makes half), dE2000 of the picture, bytes saved a pixel.

    `is_half` says whether `quality.precision: half` keeps it in half floats. `delta_e` is (mean,
    95 %, largest) over the subject; not finite where the picture is not.
    """

    buffer: str
    is_half: bool
    delta_e: tuple[float, float, float]
    saved: int


def half_errors(
    device: Device, asset: Asset, pipeline: Pipeline, frame: int = 0
) -> list[HalfError]:
    """One row for each buffer on the way to the picture, one for all that are half together."""
    renderer = Renderer(device, asset, pipeline)
    full = renderer.render(renderer.view(frame))
    steps = renderer.graph.order({"radiance"})
    buffers = [b for step in steps for b in step.writes]
    rows = []
    for buffer in buffers:
        made = _picture(renderer, {buffer.name}, frame)
        error = _apart(full.buffers["beauty"], made, full.alpha)
        rows.append(HalfError(buffer.name, not buffer.exact, error, 2 * buffer.components))
    chosen = [b for b in buffers if not b.exact]
    made = _picture(renderer, {b.name for b in chosen}, frame)
    error = _apart(full.buffers["beauty"], made, full.alpha)
    rows.append(HalfError("all of them", True, error, sum(2 * b.components for b in chosen)))
    return rows


def _picture(renderer: Renderer, halves: set[str], frame: int) -> npt.NDArray[np.float32] | None:
    """The picture with these buffers in half floats; None where it is no picture any more."""
    passes = [_with_halves(step, halves) for step in all_passes(renderer.scene)]
    graph = Graph(passes, "f2")
    maker = Supersampler(renderer.device, renderer.pool, renderer.scene, graph)
    view = renderer.view(frame)

    texture = maker.beauty(partial(renderer._shot, view), None)
    pixels = renderer._read(texture, channels=3)
    renderer.pool.give_back(texture)
    return pixels if np.isfinite(pixels).all() else None


def _with_halves(step: Pass, halves: set[str]) -> Pass:
    writes: Sequence[Buffer] = [replace(b, exact=b.name not in halves) for b in step.writes]
    return replace(step, writes=tuple(writes))


def _apart(
    full: npt.NDArray[np.float32],
    half: npt.NDArray[np.float32] | None,
    alpha: npt.NDArray[np.float32],
) -> tuple[float, float, float]:
    if half is None:
        return (float("inf"),) * 3
    off = delta_e_2000_linear(half, full)[alpha > 0.0]
    return float(off.mean()), float(np.quantile(off, 0.95)), float(off.max())
