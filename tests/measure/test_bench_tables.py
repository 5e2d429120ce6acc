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
