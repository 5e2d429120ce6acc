"""`quality.max_delta_e`, `quality.budget_ms`, `quality.preset`: the cheapest way that will do.

The error against truth that a recipe is predicted to have is that of the nearest recipe, known from
the trade study (docs/trade), and what it differs from that one in this very shot, measured on a
frame: a bound, by the triangle's inequality. Times are measured on this machine.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from scanrender.asset import Asset
from scanrender.buffers import Frame
from scanrender.metrics import delta_e_2000_linear
from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.settings.pipeline import Pipeline

Say = Callable[[str], None]

_SEPARABLE = {"method": "separable_preintegrated", "samples": 9, "halo": "measure"}
_GAUSSIANS = {"method": "gaussian_sum", "samples": 9, "halo": "measure"}
_ONE = {"supersampling": 1}
_SOME = {"supersampling": 2, "sampling": "contrast"}
_ALL = {"supersampling": 2, "sampling": "everywhere"}


@dataclass(frozen=True)
class Recipe:
    """One way to render: settings of `diffusion` and `quality`."""

    name: str
    diffusion: Mapping[str, Any]
    quality: Mapping[str, Any]

    def applied(self, pipeline: Pipeline) -> Pipeline:
        """The pipeline rendered this way; its look (profile, limit, curvature) is left alone."""
        diffusion = pipeline.diffusion.model_copy(update=dict(self.diffusion))
        quality = pipeline.quality.model_copy(update=dict(self.quality))
        return pipeline.model_copy(update={"diffusion": diffusion, "quality": quality})


# From the cheapest to the nearest to truth, as the trade study found them.
RECIPES = (
    Recipe("no diffusion, one sample a pixel", {"method": "none"}, _ONE),
    Recipe("separable_preintegrated, one sample a pixel", _SEPARABLE, _ONE),
    Recipe("gaussian_sum, one sample a pixel", _GAUSSIANS, _ONE),
    Recipe("separable_preintegrated, samples by contrast", _SEPARABLE, _SOME),
    Recipe("separable_preintegrated, four samples everywhere", _SEPARABLE, _ALL),
    Recipe("gaussian_sum, four samples everywhere", {**_GAUSSIANS, "samples": 17}, _ALL),
)
NEAREST = RECIPES[-1]
# px/mm at the point looked at -> dE2000 to truth, mean over the skin, of the nearest recipe: the
# larger of the heads of docs/trade. A test holds these to the tables there.
NEAREST_DELTA_E = {0.254: 0.4526, 0.761: 0.2325, 1.522: 0.1837}
# What another head, light or view may add to that, as a share. `scanrender bench choice` on nine
# others: 36 of 36 bounds kept; at worst 1.15 times what was predicted (docs/trade/promises.md).
UNLIKE = 1.15
# What a preset may add to the error of the nearest recipe, whatever that is in this view.
PRESETS = {"draft": 0.35, "standard": 0.2, "reference": 0.0}
TIMED_FRAMES = 3


@dataclass(frozen=True)
class Choice:
    """A recipe, what is predicted of it, and whether it satisfies what was asked for."""

    recipe: Recipe
    pipeline: Pipeline
    delta_e: float
    frame_ms: float
    satisfies: bool


def nearest_delta_e(px_per_mm: float) -> float:
    """dE2000 to truth to be expected of the nearest recipe at this scale."""
    scales = np.log(list(NEAREST_DELTA_E))
    found = np.interp(np.log(max(px_per_mm, 1e-9)), scales, list(NEAREST_DELTA_E.values()))
    return UNLIKE * float(found)


def choose(
    device: Device, asset: Asset, pipeline: Pipeline, frames: Sequence[int], say: Say
) -> Choice | None:
    """The recipe for what `quality` asks for, or None where it asks for nothing."""
    quality = pipeline.quality
    bench = _Bench(device, asset, pipeline, frames)
    if quality.budget_ms is not None:
        return _within_budget(bench, quality.budget_ms, say)
    if quality.preset is not None:
        return _within_error(bench, bench.delta_e(NEAREST) + PRESETS[quality.preset], say)
    return None if quality.max_delta_e is None else _within_error(bench, quality.max_delta_e, say)


def _within_error(bench: _Bench, bound: float, say: Say) -> Choice:
    """The first recipe, from the cheapest, that is near enough."""
    for recipe in RECIPES:
        delta_e = bench.delta_e(recipe)
        say(f"{recipe.name}: predicted dE2000 {delta_e:.2f}")
        if delta_e <= bound or recipe is NEAREST:
            return bench.choice(recipe, delta_e <= bound)
    raise AssertionError("the nearest recipe ends the loop")


def _within_budget(bench: _Bench, budget_ms: float, say: Say) -> Choice:
    """The nearest recipe whose frames keep the budget: found by halves, then by one step each."""
    cheapest, dearest = 0, len(RECIPES) - 1
    while cheapest < dearest:
        middle = (cheapest + dearest + 1) // 2
        spent = bench.milliseconds(RECIPES[middle], 1)
        say(f"{RECIPES[middle].name}: {spent:.0f} ms")
        cheapest, dearest = (middle, dearest) if spent <= budget_ms else (cheapest, middle - 1)
    choice = bench.choice(RECIPES[cheapest], True)
    while choice.frame_ms > budget_ms and cheapest > 0:
        cheapest -= 1
        choice = bench.choice(RECIPES[cheapest], True)
    return replace(choice, satisfies=choice.frame_ms <= budget_ms)


class _Bench:
    """Renders recipes of one shot, to compare and to time them."""

    def __init__(
        self, device: Device, asset: Asset, pipeline: Pipeline, frames: Sequence[int]
    ) -> None:
        self._device, self._asset, self._pipeline = device, asset, pipeline
        count = min(TIMED_FRAMES, len(frames))
        self._frames = [frames[len(frames) * k // count] for k in range(count)]
        self._renderers: dict[str, Renderer] = {}
        self._nearest: Frame | None = None

    def renderer(self, recipe: Recipe) -> Renderer:
        if recipe.name not in self._renderers:
            like = next(iter(self._renderers.values()), None)
            made = Renderer(self._device, self._asset, recipe.applied(self._pipeline), like)
            self._renderers[recipe.name] = made
        return self._renderers[recipe.name]

    def delta_e(self, recipe: Recipe) -> float:
        """Predicted mean dE2000 to truth."""
        if self._nearest is None:
            self._nearest = self._frame(NEAREST)
        camera = self.renderer(NEAREST).camera
        known = nearest_delta_e(camera.px_per_mm(camera.distance_mm))
        if recipe is NEAREST:
            return known
        return known + _mean_difference(self._frame(recipe), self._nearest)

    def milliseconds(self, recipe: Recipe, count: int = TIMED_FRAMES) -> float:
        """Median over a few frames of the turn, after one that compiles."""
        renderer = self.renderer(recipe)
        renderer.render(renderer.view(self._frames[0]))
        spent = []
        for index in self._frames[:count]:
            started = time.perf_counter()
            renderer.render(renderer.view(index))
            spent.append(1e3 * (time.perf_counter() - started))
        return statistics.median(spent)

    def choice(self, recipe: Recipe, satisfies: bool) -> Choice:
        delta_e, spent = self.delta_e(recipe), self.milliseconds(recipe)
        return Choice(recipe, recipe.applied(self._pipeline), delta_e, spent, satisfies)

    def _frame(self, recipe: Recipe) -> Frame:
        renderer = self.renderer(recipe)
        return renderer.render(renderer.view(self._frames[0]))


def _mean_difference(mine: Frame, nearest: Frame) -> float:
    inside = np.minimum(mine.alpha, nearest.alpha) == 1.0
    if not inside.any():
        return 0.0
    shown = [np.clip(frame.buffers["beauty"][inside], 0.0, 1.0) for frame in (mine, nearest)]
    return float(delta_e_2000_linear(shown[0], shown[1]).mean())
