"""A figure shows one shot several ways and says in numbers what each way changes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from render.synthetic import MATT, merged, sphere

from scanrender.asset import save_asset
from scanrender.batch.job import run_job
from scanrender.buffers import Frame
from scanrender.errors import ConfigError
from scanrender.images import read_image
from scanrender.measure.figure_numbers import HARD_SPACE, NEEDS, NUMBERS, in_words, measure
from scanrender.resources import shipped_pipelines
from scanrender.settings.figure import FigureSettings
from scanrender.settings.loading import load_pipeline
from scanrender.settings.pipeline import Pipeline
from scanrender.settings.validation import panel_pipelines

FIGURES = [name for name in shipped_pipelines() if name.startswith("figures/")]


def figure(**panels: object) -> Pipeline:
    data = merged(
        MATT,
        {
            "stages": ["render"],
            "camera": {"width_px": 48, "height_px": 48},
            "lights": [{"type": "directional", "azimuth_deg": 80, "shadow": False}],
            "figure": {
                "numbers": list(NUMBERS),
                "panels": [{"label": label, **panel} for label, panel in panels.items()],  # type: ignore[dict-item]
            },
        },
    )
    return Pipeline.model_validate(data)


def test_panels_differ_from_the_pipeline_by_what_they_set():
    pipeline = figure(first={}, second={"set": {"lights.0.irradiance": 3.0, "skin.scale": 2}})
    first, second = panel_pipelines(pipeline, "test")
    assert first == pipeline.model_copy(update={"figure": FigureSettings()})
    assert (second.lights[0].irradiance, second.skin.scale) == (3.0, 2.0)
    assert first.lights[0].irradiance != 3.0


def test_a_slip_in_a_panel_names_the_panel(tmp_path: Path):
    file = tmp_path / "figure.yaml"
    file.write_text(
        "version: 1\nfigure: {panels: [{label: a}, {label: b, set: {diffusion.metod: none}}]}\n"
    )
    with pytest.raises(ConfigError) as caught:
        load_pipeline(file)
    assert "diffusion.metod" in caught.value.what
    assert "figure.panels.1" in str(caught.value.where)
    assert "method" in str(caught.value.fix)


def test_the_nine_figures_are_shipped():
    assert [f"figures/fig{number}" for number in range(1, 10)] == FIGURES


@pytest.mark.gl
def test_a_figure_is_a_picture_and_its_numbers(tmp_path: Path):
    asset = save_asset(sphere(20.0, (0.6, 0.3, 0.2), rings=24), tmp_path / "ball")
    pipeline = figure(
        plain={"set": {"diffusion.method": "none"}},
        soft={},
        guide={"show": "depth_mm"},
        apart={"difference": 8},
        eighth={"crop": [0.25, 0.25, 0.75, 0.5]},
    )
    result = run_job(asset, pipeline, tmp_path / "out", lambda stage, fraction: None)
    assert {"figure.png", "figure.json"} <= set(result.files)
    assert not (tmp_path / "out" / "turntable.mp4").exists()
    picture = read_image(tmp_path / "out" / "figure.png")
    assert picture.std() > 0.05
    panels = json.loads((tmp_path / "out" / "figure.json").read_text())["panels"]
    assert [panel["label"] for panel in panels] == ["plain", "soft", "guide", "apart", "eighth"]
    plain, soft, guide, apart, eighth = panels
    assert plain["delta_e"]["max"] == 0.0
    assert soft["delta_e"]["mean"] > 0.05
    assert soft["high_frequency"] < plain["high_frequency"]
    assert soft["energy_ratio"] == pytest.approx([1.0] * 3, abs=0.1)
    assert guide["mean"] > 20.0  # mm
    assert all(panel["black_pixels"] >= 0 for panel in (plain, soft, eighth))
    assert set(guide) & set(NUMBERS) == {"mean", "high_frequency"}  # not of a picture unseen
    assert apart["delta_e"] == soft["delta_e"]
    assert 0.0 < eighth["delta_e"]["mean"] != soft["delta_e"]["mean"]  # of what it shows


def frame(**buffers: np.ndarray) -> Frame:
    one = next(iter(buffers.values()))
    return Frame(
        {"beauty": np.ones((*one.shape[:2], 3), np.float32), **buffers},
        np.ones(one.shape[:2], np.float32),
    )


def test_black_pixels_are_counted_inside_the_subject_only():
    beauty = np.full((16, 16, 3), 0.5, np.float32)
    beauty[8, 8] = 0.0
    beauty[4, 4] = np.nan
    beauty[0, 0] = 0.0  # at the border of the subject
    assert NUMBERS["black_pixels"](frame(beauty=beauty), frame(beauty=beauty), "beauty") == 2


def test_contrast_at_the_borders_of_skin_and_away_from_them():
    diffuse = np.zeros((64, 64, 3), np.float32)
    diffuse[:, 32:] = 1.0
    skin = (np.arange(64) < 32).astype(np.float32) * np.ones((64, 1), np.float32)
    sharp = NUMBERS["border_contrast"](frame(diffuse=diffuse, skin=skin), None, "diffuse")
    assert sharp["at_borders"] > 0.1
    assert sharp["elsewhere"] == pytest.approx(0.0, abs=1e-6)


def test_a_leak_is_what_diffusion_moved_at_depth_steps():
    depth = np.full((48, 48), 500.0, np.float32)
    depth[:, 24:] = 540.0
    lit = np.zeros((48, 48, 3), np.float32)
    lit[:, 24:] = 1.0
    leaking = lit.copy()
    leaking[:, 20:24] += 0.25
    first = frame(diffuse=lit, depth_mm=depth)
    leak = NUMBERS["silhouette_leak"]
    assert leak(first, first, "diffuse") == 0.0
    assert leak(frame(diffuse=leaking, depth_mm=depth), first, "diffuse") > 0.1
    flat = frame(diffuse=leaking, depth_mm=np.full((48, 48), 500.0, np.float32))
    assert leak(flat, first, "diffuse") == 0.0


def test_every_number_works_on_what_it_says_it_needs():
    shape = (24, 24)
    for name in NUMBERS:
        buffers = {"display": np.random.default_rng(0).random((*shape, 3)).astype(np.float32)}
        for needed in NEEDS.get(name, ()):
            buffers[needed] = np.ones((*shape, 3), np.float32)
        if "depth_mm" in buffers:
            buffers["depth_mm"] = np.ones(shape, np.float32)
        one = frame(**buffers)
        shown = "depth_mm" if name == "mean" else "display"
        one.buffers.setdefault(shown, np.ones(shape, np.float32))  # type: ignore[attr-defined]
        values = measure(one, one, shown, [name])
        assert name in values
        assert isinstance(in_words(values), str)


def test_numbers_are_said_in_a_line():
    values = {
        "black_pixels": 0,
        "delta_e": {"mean": 0.204, "p95": 1.5, "max": 9.0},
        "energy_ratio": [0.9988, 1.0, 1.0],
        "silhouette_leak": 0.0172,
        "transmitted": 0.01,
    }
    words = in_words(values).replace(HARD_SPACE, " ").split(" · ")
    assert words == [
        "0 black pixels",
        "dE2000 0.20, 95 % 1.50",
        "energy 0.999 / 1.000 / 1.000",
        "leak 1.72 %",
        "through skin 1.00 %",
    ]
    assert in_words(values).count(" ") == len(words) - 1  # lines break between numbers only
    same = {"delta_e": {"mean": 0.0, "p95": 0.0, "max": 0.0}, "energy_ratio": [1.0, 1.0, 1.0]}
    assert in_words(same) == ""


def test_light_through_skin_is_a_share_of_the_picture():
    light = np.full((16, 16, 3), 0.5, np.float32)
    through = np.zeros_like(light)
    through[:, :4] = 0.1
    shown = frame(beauty=light, transmission=through)
    assert NUMBERS["transmitted"](shown, shown, "display") == pytest.approx(0.05)
    assert NUMBERS["transmitted"](frame(beauty=light), shown, "display") == 0.0


@pytest.mark.parametrize(
    ("panel", "complaint"),
    [
        ({"crop": [0.5, 0.0, 0.4, 1.0]}, "left < right"),
        ({"range": [1.0, 1.0]}, "smaller"),
        ({"difference": 4, "show": "lab"}, "display"),
    ],
)
def test_panels_that_make_no_sense_are_refused(panel: dict[str, object], complaint: str):
    with pytest.raises(ValueError, match=complaint):
        figure(one=panel)
