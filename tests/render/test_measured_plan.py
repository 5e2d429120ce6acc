"""A plan leaves out what would not show, keeps what would, and says by how much."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from render.synthetic import joined, pipeline, slab, sphere, sphere_mesh

from scanrender.asset import Asset
from scanrender.measure.random_shots import random_shot
from scanrender.metrics import delta_e_2000_linear, linear_from_srgb
from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.render.measured_plan import MeasuredPlan, measure_plan
from scanrender.render.trials import trials
from scanrender.settings.pipeline import Pipeline

SHOT: dict[str, Any] = {
    "camera": {"width_px": 160, "height_px": 160, "elevation_deg": 0, "height_mm": 60.0},
    "turntable": {"frames": 8},
    "quality": {"supersampling": 1},
    "diffusion": {"mask": "none"},
}
FRONT = {"type": "directional", "azimuth_deg": 0, "elevation_deg": 20, "irradiance": 2.0,
         "follows": "camera"}  # fmt: skip
BEHIND = {**FRONT, "azimuth_deg": 180}
SKIN = (0.6, 0.4, 0.3)


def planned(gl: Device, asset: Asset, tolerance: float = 1.0, **shot: Any) -> MeasuredPlan:
    renderer = Renderer(gl, asset, pipeline(SHOT, shot))
    return measure_plan(renderer, range(8), tolerance)


def left_out(plan: MeasuredPlan) -> set[str]:
    return {finding.what for finding in plan.findings if finding.is_left_out}


def test_a_shadow_is_kept_where_it_falls(gl: Device):
    alone = sphere(20.0, SKIN)
    small = sphere_mesh(5.0, centre=(0.0, 12.0, 25.0))
    with_caster = Asset(joined([sphere_mesh(20.0), small]), alone.maps)
    lamp = {**FRONT, "elevation_deg": 50}
    assert "lights.0.shadow" in left_out(planned(gl, alone, lights=[lamp]))
    kept = planned(gl, with_caster, lights=[lamp])
    assert "lights.0.shadow" not in left_out(kept)
    finding = next(f for f in kept.findings if f.what == "lights.0.shadow")
    assert finding.difference.delta_e > 1.0
    assert "would show" in finding.sentence


@pytest.mark.parametrize(("thickness_mm", "lamp", "glows"), [
    (1.5, BEHIND, True), (25.0, BEHIND, False), (1.5, FRONT, False),
])  # fmt: skip
def test_light_through_skin_is_kept_where_skin_is_thin_and_lit_from_behind(
    gl: Device, thickness_mm: float, lamp: dict[str, Any], glows: bool
):
    lights = [lamp, {"type": "ambient", "irradiance": 0.3}]
    plan = planned(
        gl, slab(15.0, thickness_mm), lights=lights, turntable={"mode": "camera", "degrees": 0.0}
    )
    assert ("transmission" in left_out(plan)) != glows


def test_scattering_is_kept_from_near_and_left_out_from_afar(gl: Device):
    lamp = {**FRONT, "azimuth_deg": 70, "shadow": False}
    near = planned(gl, sphere(8.0, SKIN), lights=[lamp], camera={"height_mm": 20.0})
    far = planned(gl, sphere(8.0, SKIN), lights=[lamp], camera={"height_mm": 4000.0})
    assert near.pipeline.diffusion.method != "none"
    assert far.pipeline.diffusion.method == "none"


def test_what_was_asked_for_is_not_touched(gl: Device):
    renderer = Renderer(gl, sphere(20.0, SKIN), pipeline(SHOT, lights=[FRONT]))
    before = renderer.pipeline, renderer.render(renderer.view(3)).buffers["beauty"]
    measure_plan(renderer, range(8), 5.0)
    assert renderer.pipeline == before[0]
    np.testing.assert_array_equal(renderer.render(renderer.view(3)).buffers["beauty"], before[1])


def test_a_tolerance_of_next_to_nothing_keeps_what_can_be_seen(gl: Device):
    lamp = {**FRONT, "azimuth_deg": 70}
    plan = planned(gl, sphere(8.0, SKIN), 0.01, lights=[lamp], camera={"height_mm": 20.0},
                   quality={"supersampling": 2})  # fmt: skip
    assert not left_out(plan) & {"diffusion.method", "quality.sampling", "specular"}


@given(number=st.integers(1000, 9999))
@example(number=1001)  # a shadow that falls between frames a quarter of a turn apart
@settings(max_examples=3, deadline=None)
def test_planned_frames_stay_within_the_tolerance(gl: Device, number: int):
    """`scanrender bench plan` does this on heads, at a picture's size, for the documentation."""
    balls = [sphere_mesh(60.0), sphere_mesh(15.0, centre=(10.0, 20.0, 65.0))]
    asset = Asset(joined(balls), {"albedo": np.float32([[SKIN]])})
    asked = Renderer(gl, asset, random_shot(number, 128))
    plan = measure_plan(asked, range(24), 1.0)
    after = Renderer(gl, asset, plan.pipeline, asked)
    pictures = [r.render(r.view(9)) for r in (asked, after)]
    heat = delta_e_2000_linear(*(linear_from_srgb(p.buffers["display"]) for p in pictures))
    seen = pictures[0].alpha > 0.0
    assert not seen.any() or np.quantile(heat[seen], 0.95) <= 1.0


EVERY = random_shot(0, 480)


@pytest.mark.parametrize("method", ["none", "gaussian_sum", "separable_preintegrated", "disk"])
def test_each_trial_changes_the_settings_it_names_and_nothing_else(method: str):
    shot = EVERY.model_copy(
        update={"diffusion": EVERY.diffusion.model_copy(update={"method": method})}
    )
    names = [trial.what for trial in trials(shot)]
    assert len(names) == len(set(names))
    for trial in trials(shot):
        for value, change in trial.options:
            candidate = change(shot)
            if candidate is None:
                continue
            assert change(candidate) is None, f"{trial.what} {value}: done twice"
            assert len(_differences(shot, candidate)) == 1, trial.what
            Pipeline.model_validate(candidate.model_dump())
    if method == "none":
        assert not any(
            change(shot) for t in trials(shot) for _, change in t.options if "diffusion" in t.what
        )


def _differences(first: Any, second: Any, path: str = "") -> list[str]:
    if isinstance(first, dict):
        return [d for key in first for d in _differences(first[key], second[key], f"{path}.{key}")]
    if isinstance(first, (list, tuple)):
        assert len(first) == len(second)
        pairs = enumerate(zip(first, second, strict=True))
        return [d for i, (a, b) in pairs for d in _differences(a, b, f"{path}.{i}")]
    if hasattr(first, "model_dump"):
        return _differences(first.model_dump(), second.model_dump(), path)
    return [] if first == second else [path]
