"""The trade study: its points, what it keeps, its sentences; one small study from end to end."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from render.synthetic import sphere

from scanrender.asset import save_asset
from scanrender.errors import ConfigError
from scanrender.measure import knobs, trade
from scanrender.measure.knobs import KNOBS, METHOD, Knob, name_of, overrides, points, twins
from scanrender.measure.trade import pareto, run_trade
from scanrender.measure.trade_page import write_page
from scanrender.settings.loading import load_pipeline

SMALL = ("camera.width_px=24", "camera.height_px=24", "camera.aim=subject", "camera.height_mm=60")


def row(point: dict[str, Any], milliseconds: float, error: float) -> dict[str, Any]:
    return {
        "case": f"close: {name_of(point)}", "view": "close", "point": point,
        "frame_ms": milliseconds, "renderer": "none", "stamp": "s",
        "dE2000": {"mean": error, "p95": error, "maximum": error},
        "FLIP": {"mean": error}, "energy_ratio": [1.0, 1.0, 1.0],
        "truth": {"halving_dE2000": {"mean": 0.01}},
    }  # fmt: skip


def test_there_are_sixty_points_and_no_two_alike():
    found = points()
    assert len(found) >= 60
    assert len({name_of(point) for point in found}) == len(found)
    assert {point[METHOD] for point in found} == {"none", *knobs.SCREEN}


def test_every_point_is_a_pipeline():
    for point in points():
        settings = load_pipeline("trade", overrides(point)).model_dump()
        for key, value in point.items():
            section, name = key.split(".")
            assert settings[section][name] == value


def test_a_knob_joins_by_being_declared(monkeypatch: pytest.MonkeyPatch):
    before = len(points())
    depth = Knob("diffusion.edge_contrast", 3.0, (1.0, 10.0), ("gaussian_sum",))
    monkeypatch.setattr(knobs, "KNOBS", (*KNOBS, depth))
    assert len(points()) == before + 2


def test_twins_differ_in_one_knob_alone():
    rows = [row(point, 1.0, 1.0) for point in points()]
    samples = next(knob for knob in KNOBS if knob.key == "diffusion.samples")
    pairs = twins(rows, samples, 9)
    assert len(pairs) >= 15
    for usual, other in pairs:
        changed = {k for k in usual["point"] if usual["point"][k] != other["point"][k]}
        assert changed == {"diffusion.samples"}


def test_the_front_holds_what_nothing_beats():
    costs = ((3, 0.2), (1, 0.9), (2, 0.95), (4, 0.1))
    rows = [row(point, *cost) for point, cost in zip(points()[:4], costs, strict=True)]
    assert [r["frame_ms"] for r in pareto(rows)] == [1, 3, 4]


def test_the_page_says_what_a_knob_buys(tmp_path: Path):
    rows = []
    for point in points():
        slow = 2.0 if point.get("diffusion.samples") == 33 else 1.0
        rows.append(row(point, 100.0 * slow, 0.5 - 0.1 * slow))
    page, plot = write_page(tmp_path, rows, "scanrender trade trade head.obj")
    text = page.read_text()
    assert "`diffusion.samples` 33 instead of 17: close: 2.00 times the time, dE2000 -0.100" in text
    assert plot.stat().st_size > 5000


@pytest.mark.gl
def test_a_small_study_ends_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    asset = tmp_path / "ball"
    save_asset(sphere(20.0, (0.6, 0.4, 0.3), rings=24), asset)
    few = [point for point in points() if name_of(point) in ("none", "gaussian_sum", "disk")]
    monkeypatch.setattr(trade, "points", lambda: few)
    told: list[str] = []
    rows = run_trade("trade", asset, ("close",), tmp_path / "out", told.append, SMALL)
    # skin/natural has highlights: left in, they would be most of the error.
    assert all(r["energy_ratio"][0] == pytest.approx(1.0, abs=0.02) for r in rows)
    errors = {r["point"][METHOD]: r["dE2000"]["mean"] for r in rows}
    assert errors["disk"] < errors["none"]
    assert errors["gaussian_sum"] < errors["none"]
    again = run_trade("trade", asset, ("close",), tmp_path / "out", told.append, SMALL)
    assert "measured already" in told[-1]
    assert json.loads(json.dumps(again)) == json.loads(json.dumps(rows))


@pytest.mark.gl
def test_light_without_a_truth_is_refused(tmp_path: Path):
    asset = tmp_path / "ball"
    save_asset(sphere(20.0, rings=12), asset)
    sky = (*SMALL, "lights=[{type: environment, map: sky}]")
    with pytest.raises(ConfigError, match="environment"):
        run_trade("trade", asset, ("close",), tmp_path / "out", print, sky)
