"""Before a shot: what of it changes the picture by less than the tolerance is left out.

Each trial of `trials.py` is rendered and compared with the shot as it was asked for, so that what
is left out together is judged together. Trials in millimetres are made on small pictures of several
frames; trials in pixels on windows of the picture itself, where it is busiest or scatters most. In
the end whole frames are compared, and changes are taken back while they differ too much.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.buffers import Frame
from scanrender.metrics import delta_e_2000_linear, linear_from_srgb
from scanrender.render.frame import Renderer
from scanrender.render.trials import Trial, changed, trials
from scanrender.settings.pipeline import Pipeline

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Place = tuple[int, tuple[float, float]]  # frame, (across, down) as shares of the picture
SMALL_PX = 256
# A twelfth of a turn apart: with a quarter, a shadow that falls between two of them was missed.
VIEWS = 12
TILE_PX = 12
WINDOW_PX = 256
# Of the tolerance, for whole frames: other frames than those looked at differ by more than these.
MARGIN = 0.8
LEAST_COVERED = 0.25  # of a tile: with less it speaks for the rim alone


@dataclass(frozen=True)
class Difference:
    """How far a picture is from the one that was asked for, in dE2000 of the display.

    `delta_e` is the larger of the 95 % quantile over the subject and the mean of the worst tile: an
    ear may glow or not, and be less than 5 % of the picture. `worst_at` is that tile's middle
    (across, down), as shares of the picture.
    """

    delta_e: float
    frame: int
    heat: Floats
    alpha: npt.NDArray[np.float32]
    worst_at: tuple[float, float]


@dataclass(frozen=True)
class Finding:
    """One trial: `value` instead of what was asked for, and what it changes at the most."""

    what: str
    value: str
    is_left_out: bool
    difference: Difference
    tolerance: float

    @property
    def sentence(self) -> str:
        """`none is enough: dE2000 0.12 at most, 1 is tolerated`."""
        found = f"dE2000 {self.difference.delta_e:.3f}"
        if self.is_left_out:
            return f"{self.value} is enough: {found} at most, {self.tolerance:g} is tolerated"
        where = f"in frame {self.difference.frame}"
        return f"{self.value} would show: {found} {where}, {self.tolerance:g} is tolerated"


@dataclass
class MeasuredPlan:
    """The shot's settings, what was found, and milliseconds of a frame before and after."""

    pipeline: Pipeline
    findings: list[Finding] = field(default_factory=list)
    final: Difference | None = None
    asked_ms: float = 0.0
    planned_ms: float = 0.0
    seconds: float = 0.0


def measure_plan(
    renderer: Renderer,
    frames: Sequence[int],
    tolerance: float,
    say: Callable[[str], None] = lambda _: None,
) -> MeasuredPlan:
    """Try every trial on `frames` of the shot that `renderer` has; it is left as it was.

    tolerance: dE2000, for the 95 % quantile and for any tile's mean. Raises StageError as a frame
    does.
    """
    started = time.perf_counter()
    probe = _Probe(renderer, _spread(frames))
    plan = MeasuredPlan(renderer.pipeline)
    taken: list[_Taken] = []
    for trial in trials(renderer.pipeline):
        for number, (value, change) in enumerate(trial.options):
            candidate = change(plan.pipeline)
            if candidate is None:
                continue
            difference = probe.difference(trial, candidate, tolerance)
            fits = difference.delta_e <= tolerance
            finding = Finding(trial.what, value, fits, difference, tolerance)
            plan.findings.append(finding)
            say(f"{trial.what}: {finding.sentence}")
            if fits:
                plan.pipeline = candidate
                taken.append(_Taken(trial, number, difference.delta_e))
                break
    _confirm(plan, probe, taken, tolerance, say)
    plan.asked_ms, plan.planned_ms = probe.milliseconds(plan.pipeline)
    plan.seconds = time.perf_counter() - started
    return plan


@dataclass(frozen=True)
class _Taken:
    trial: Trial
    option: int
    delta_e: float

    @property
    def dearer(self) -> _Taken | None:
        more = self.option + 1
        is_there = more < len(self.trial.options)
        return _Taken(self.trial, more, self.delta_e) if is_there else None


def _confirm(
    plan: MeasuredPlan,
    probe: _Probe,
    taken: list[_Taken],
    tolerance: float,
    say: Callable[[str], None],
) -> None:
    """Compare whole frames; while they differ too much, make a change a lesser one: the one with
    which the largest difference was found."""
    while taken:
        plan.final = probe.whole(plan.pipeline, MARGIN * tolerance)
        if plan.final.delta_e <= MARGIN * tolerance:
            return
        last = taken.pop(max(range(len(taken)), key=lambda k: taken[k].delta_e))
        value = last.trial.options[last.option][0]
        finding = Finding(last.trial.what, value, False, plan.final, tolerance)
        plan.findings = [f for f in plan.findings if (f.what, f.value) != (finding.what, value)]
        plan.findings.append(finding)
        say(f"{finding.what}: {finding.sentence}")
        plan.pipeline = _with(probe.renderer.pipeline, taken)
        while (dearer := last.dearer) is not None:
            last = dearer
            value, change = last.trial.options[last.option]
            candidate = change(plan.pipeline)
            if candidate is not None:
                taken.append(last)
                plan.findings.append(Finding(last.trial.what, value, True, plan.final, tolerance))
                plan.pipeline = candidate
                break


def _with(pipeline: Pipeline, taken: Sequence[_Taken]) -> Pipeline:
    for each in taken:
        pipeline = each.trial.options[each.option][1](pipeline) or pipeline
    return pipeline


class _Probe:
    """Pictures of the shot as it was asked for, and of candidates beside them."""

    def __init__(self, renderer: Renderer, frames: Sequence[int]) -> None:
        self.renderer, self.frames = renderer, frames
        small = self._like(_small(renderer.pipeline))
        self._asked = [small.render(small.view(index)) for index in frames]
        busy = [_busiest_tile(frame) for frame in self._asked]
        number = int(np.argmax([spread for spread, _ in busy]))
        self._places = [(frames[number], busy[number][1])]
        self._windows: list[Frame] = []
        self._wholes: dict[int, Frame] = {}

    def difference(self, trial: Trial, candidate: Pipeline, tolerance: float) -> Difference:
        """The largest difference; what comes after one beyond the tolerance is not looked at."""
        if trial.per_pixel:
            return self._at_scale(candidate, tolerance)
        renderer = self._like(_small(candidate))
        worst: Difference | None = None
        for index, asked in zip(self.frames, self._asked, strict=True):
            found = _difference(renderer.render(renderer.view(index)), asked, index, TILE_PX)
            worst = found if worst is None or found.delta_e > worst.delta_e else worst
            if worst.delta_e > tolerance:
                break
        assert worst is not None
        if trial.what == "diffusion.method":
            self._places.append((worst.frame, worst.worst_at))
        return worst

    def whole(self, candidate: Pipeline, tolerance: float) -> Difference:
        """Whole frames of both, by the 95 % alone: their parts are judged by then. The busiest,
        and two that stand a third of the frames further each."""
        renderer = self._like(candidate)
        worst: Difference | None = None
        first, count = self.frames.index(self._places[0][0]), len(self.frames)
        for index in dict.fromkeys(self.frames[(first + count * k // 3) % count] for k in range(3)):
            if index not in self._wholes:
                self._wholes[index] = self.renderer.render(self.renderer.view(index))
            mine = renderer.render(renderer.view(index))
            found = _difference(mine, self._wholes[index], index, max(mine.alpha.shape))
            worst = found if worst is None or found.delta_e > worst.delta_e else worst
            if worst.delta_e > tolerance:
                break
        assert worst is not None
        return worst

    def milliseconds(self, candidate: Pipeline) -> tuple[float, float]:
        """Of a whole frame as asked for, and of the candidate's: both compiled by now."""
        index = self._places[0][0]
        return _milliseconds(self.renderer, index), _milliseconds(self._like(candidate), index)

    def _at_scale(self, candidate: Pipeline, tolerance: float) -> Difference:
        worst: Difference | None = None
        for number, place in enumerate(self._places):
            if number == len(self._windows):
                self._windows.append(self._in_window(self.renderer.pipeline, place))
            seen, asked = self._in_window(candidate, place), self._windows[number]
            found = _difference(seen, asked, place[0], WINDOW_PX)
            worst = found if worst is None or found.delta_e > worst.delta_e else worst
            if worst.delta_e > tolerance:
                break
        assert worst is not None
        return worst

    def _in_window(self, pipeline: Pipeline, place: Place) -> Frame:
        index, middle = place
        renderer = self._like(pipeline)
        renderer.show_window(_window_around(middle, renderer.camera.size_px))
        return renderer.render(renderer.view(index))

    def _like(self, pipeline: Pipeline) -> Renderer:
        return Renderer(self.renderer.device, self.renderer.scene.asset, pipeline, self.renderer)


def _small(pipeline: Pipeline) -> Pipeline:
    """The shot at SMALL_PX, with one sample a pixel."""
    camera = pipeline.camera
    scale = min(1.0, SMALL_PX / max(camera.width_px, camera.height_px))
    size = {
        "width_px": max(1, round(camera.width_px * scale)),
        "height_px": max(1, round(camera.height_px * scale)),
    }
    small = pipeline.model_copy(update={"camera": camera.model_copy(update=size)})
    return changed(small, "quality", "supersampling", 1)


def _spread(frames: Sequence[int]) -> list[int]:
    count = min(VIEWS, len(frames))
    return [frames[len(frames) * k // count] for k in range(count)]


def _milliseconds(renderer: Renderer, index: int) -> float:
    started = time.perf_counter()
    renderer.render(renderer.view(index))
    return 1e3 * (time.perf_counter() - started)


def _difference(mine: Frame, asked: Frame, index: int, tile_px: int) -> Difference:
    shown = [linear_from_srgb(frame.buffers["display"]) for frame in (mine, asked)]
    heat = delta_e_2000_linear(shown[0], shown[1])
    covered = np.maximum(mine.alpha, asked.alpha) > 0.0
    if not covered.any():
        return Difference(0.0, index, heat, asked.alpha, (0.5, 0.5))
    tiles, share = _tile_means(heat, covered, tile_px)
    tiles[share < LEAST_COVERED] = 0.0
    worst = max(float(np.quantile(heat[covered], 0.95)), float(tiles.max()))
    return Difference(worst, index, heat, asked.alpha, _middle(tiles, tile_px, heat.shape))


def _middle(tiles: Floats, tile_px: int, shape: tuple[int, ...]) -> tuple[float, float]:
    """(across, down) of the largest tile's middle, as shares of the picture."""
    row, column = np.unravel_index(int(tiles.argmax()), tiles.shape)
    return (float(column) + 0.5) * tile_px / shape[1], (float(row) + 0.5) * tile_px / shape[0]


def _tile_means(values: Floats, mask: Mask, tile_px: int) -> tuple[Floats, Floats]:
    """Means of `values` over the masked pixels of each tile, and the share of it they fill."""
    rows, columns = (np.arange(0, side, tile_px) for side in values.shape)

    def sums(array: npt.NDArray[Any]) -> Floats:
        return np.asarray(np.add.reduceat(np.add.reduceat(array, rows, 0), columns, 1), np.float64)

    count = sums(mask.astype(np.float64))
    return sums(np.where(mask, values, 0.0)) / np.maximum(count, 1.0), count / tile_px**2


def _busiest_tile(frame: Frame) -> tuple[float, tuple[float, float]]:
    """Variance of the display's green in the tile where it varies most, and the tile's middle
    (across, down) as shares of the picture."""
    green = frame.buffers["display"][:, :, 1].astype(np.float64)
    mask = np.ones(green.shape, bool)
    mean, _ = _tile_means(green, mask, TILE_PX)
    square, share = _tile_means(green**2, mask, TILE_PX)
    variance = np.where(share > 0.5, square - mean**2, 0.0)
    return float(variance.max()), _middle(variance, TILE_PX, green.shape)


def _window_around(
    middle: tuple[float, float], size_px: tuple[int, int]
) -> tuple[float, float, float, float]:
    """(left, top, right, bottom) of WINDOW_PX pixels around a point, inside the picture."""
    half = [min(0.5, 0.5 * WINDOW_PX / side) for side in size_px]
    at = [min(max(m, h), 1.0 - h) for m, h in zip(middle, half, strict=True)]
    return at[0] - half[0], at[1] - half[1], at[0] + half[0], at[1] + half[1]
