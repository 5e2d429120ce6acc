"""`bench render` times whole frames and their passes, and reports what they cover."""

from __future__ import annotations

import pytest

from scanrender.asset import save_asset
from scanrender.errors import UsageError
from scanrender.measure import render_bench
from scanrender.measure.chosen import chosen
from scanrender.measure.limits import missed_limits
from tests.render.synthetic import sphere

SMALL = ("camera.width_px=96", "camera.height_px=54", "lights.0.shadow_px=64")


def of(rows, view, way):
    return next(row for row in rows if (row["view"], row["way"]) == (view, way))


@pytest.fixture(scope="module")
def rows(tmp_path_factory, gl):
    folder = tmp_path_factory.mktemp("render_bench")
    asset = save_asset(sphere(90.0), folder / "asset")
    said: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        chosen = ("no diffusion", "gaussian_sum", "separable_preintegrated")
        patch.setattr(
            render_bench, "WAYS", [way for way in render_bench.WAYS if way.name in chosen]
        )
        rows = render_bench.bench_render(
            ["close", "far", "empty"], folder, said.append, asset, 1, SMALL
        )
    assert len(said) == len(rows) == 9
    assert (folder / "render.json").exists()
    return rows


@pytest.mark.gl
def test_each_way_runs_the_passes_that_it_needs_and_no_others(rows):
    assert "diffuse_horizontal" not in of(rows, "close", "no diffusion")["passes_ms"]
    assert "diffuse_horizontal" in of(rows, "close", "separable_preintegrated")["passes_ms"]
    for row in rows:
        assert row["frame_ms"] > 0.0
        assert all(ms >= 0.0 for ms in row["passes_ms"].values())


@pytest.mark.gl
def test_far_covers_a_36th_of_close_and_empty_nothing(rows):
    close, far, empty = (
        of(rows, view, "gaussian_sum")["covered_mpx"] for view in ("close", "far", "empty")
    )
    # The near one is cropped by the picture's border or not; each scale is its own share of it.
    assert 20.0 < close / far < 50.0
    assert empty == 0.0


@pytest.mark.gl
def test_limits_are_told_of_the_close_view_alone(rows):
    for row in rows:
        limited = row["view"] == "close" and row["way"] != "no diffusion"
        assert bool(row["limits"]) == limited
    slow = {**of(rows, "close", "gaussian_sum"), "frame_ms": 6001.0}
    assert missed_limits([slow]) == ["close: gaussian_sum: frame_ms is 6001, the limit is <= 6000"]


@pytest.mark.gl
def test_tables_have_a_column_a_view_and_leave_gaps(rows):
    frames, passes = render_bench.render_tables(rows[:-1])
    assert frames[0] == ["frame, ms", "close", "far", "empty"]
    assert frames[-1][0] == "separable_preintegrated"
    assert frames[-1][-1] == ""
    assert passes[0][1:] == ["close", "far"]
    assert "gbuffer" in render_bench.render_text(rows)


def test_an_unknown_case_is_refused():
    assert chosen("all", render_bench.VIEWS) == list(render_bench.VIEWS)
    assert chosen(" far, close,", render_bench.VIEWS) == ["far", "close"]
    with pytest.raises(UsageError, match="no such case"):
        chosen("close,nearest", render_bench.VIEWS)
