"""The page of measured figures takes the tables that `scanrender bench` wrote."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MACHINE = {"cores": 2, "processor": "a processor", "system": "a system", "load": [0.5, 0.4, 0.3]}


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("bench_tables", ROOT / "tools/bench_tables.py")
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


def document(**row):
    return {"scanrender": "1.2.3", "machine": MACHINE, "rows": [{"case": "a", **row}]}


def test_tables_take_their_places_in_the_page(tool):
    page = (ROOT / "docs" / "preparation.md").read_text(encoding="utf-8")
    stages = {"unwrap": {"seconds": 8.0, "peak_mib": 900, "plain": "xatlas", "ratio": 2.5}}
    limits = {"seconds": ["<=", 60.0]}
    measured = document(meaning="a scan", seconds=61.0, stages=stages, limits=limits)
    filled = tool.with_blocks(page, tool.prep_blocks(measured))
    filled = tool.with_blocks(filled, tool.fidelity_blocks(document(front={"mean": 0.5})))
    assert "| unwrap | 8 | 900 |" in filled
    assert "Over its limit: a: seconds is 61, the limit is <= 60." in filled
    assert "| picture, front: dE2000 mean | 0.5 |" in filled
    assert "2 cores of a processor, load 0.5 at the end" in filled
    assert "Not measured yet" not in filled
    assert tool.with_blocks(filled, tool.prep_blocks(measured)) == filled, "again: the same page"


def test_a_page_without_marks_is_refused(tool):
    with pytest.raises(ValueError, match="no mark"):
        tool.with_blocks("# A page\n", {"cases": "x"})


def test_milliseconds_take_their_place_in_the_page(tool):
    page = (ROOT / "docs" / "rendering.md").read_text(encoding="utf-8")
    row = {"case": "close: gaussian_sum", "view": "close", "way": "gaussian_sum"}
    row |= {"frame_ms": 6001.2, "passes_ms": {}, "covered_mpx": 0.5, "renderer": "a driver"}
    row |= {"limits": {"frame_ms": ["<=", 6000.0]}}
    filled = tool.with_blocks(page, tool.render_blocks({**document(), "rows": [row]}))
    assert "| gaussian_sum | 6,001 |" in filled
    assert "Over its limit: close: gaussian_sum: frame_ms is 6001, the limit is <= 6000." in filled
    assert "GL: a driver." in filled


@pytest.mark.parametrize("name", ["plan", "truth", "published", "choice"])
def test_pages_of_the_trade_have_room_for_their_tables(tool, name):
    page, blocks = tool.BLOCKS[name]
    error = {"mean": 0.25, "p95": 1.1, "maximum": 7.0}
    row = {"p95": 1.25, "mean": 0.2, "asked_ms": 900, "planned_ms": 300, "share": 0.33, "plan_s": 9}
    row |= {"left_out": ["diffusion.samples=9"], "renderer": "a driver", "frame_ms": 450.0}
    row |= {"integral": "truth_mean", "dE2000": error, "FLIP": {"mean": 0.01}, "faster": 4.5}
    row |= {"energy_ratio": [1.0, 1.0, 1.0], "picked": "a way", "satisfies": True, "kept": False}
    row |= {"truth": {"seconds": 160.0, "halving_dE2000": {"mean": 0.03}}, "wish": 1.0}
    row |= {"predicted": 0.9, "measured": 1.5, "limits": {"frame_ms": ["<=", 400.0]}}
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    filled = tool.with_blocks(text, blocks(document(**row)))
    said = {
        "plan": "1 of 1 shots are over the tolerance: a (1.25).",
        "truth": "Over its limit: a: frame_ms is 450, the limit is <= 400.",
        "published": "| a | 450 | 4.50 | 0.250 | 1.100 |",
        "choice": "| a | a way | yes | 0.90 | 1.50 | no |",
    }
    assert said[name] in filled
