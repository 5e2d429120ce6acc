"""The benchmark of the preparation: what it measures is measured, what it writes can be read."""

from __future__ import annotations

import csv
import json
import subprocess
import sys

import numpy as np
import pytest

from scanrender.errors import UsageError
from scanrender.measure import stage_costs
from scanrender.measure.limits import ATLAS, missed_limits
from scanrender.measure.prep_bench import CASES, Case, bench_prep, case_list, table_text
from scanrender.measure.prep_inputs import REAL_HEAD, dense_head_scan
from scanrender.measure.tables import case_table, csv_text, markdown, stage_table, text
from scanrender.measure.watch import Watch
from scanrender.scan.ingest import read_scan
from scanrender.scan.plain import CALLS
from scanrender.settings.prep import PrepSettings

BALL = """ply
format ascii 1.0
element vertex {vertices}
property float x
property float y
property float z
element face {faces}
property list uchar int vertex_indices
end_header
"""


def write_ball(path, scans):
    """A sphere of 100 mm, 24 x 48."""
    theta, phi = np.linspace(0.02, np.pi - 0.02, 24), 2.0 * np.pi * np.arange(48) / 48
    t, p = np.meshgrid(theta, phi, indexing="ij")
    points = 100.0 * np.stack([np.sin(t) * np.sin(p), np.cos(t), np.sin(t) * np.cos(p)], axis=-1)
    number = np.arange(24 * 48).reshape(24, 48)
    a, b = number[:-1], np.roll(number, -1, axis=1)[:-1]
    c, d = number[1:], np.roll(number, -1, axis=1)[1:]
    faces = np.concatenate([np.stack([a, c, d], -1), np.stack([a, d, b], -1)]).reshape(-1, 3)
    text = BALL.format(vertices=number.size, faces=len(faces))
    text += "".join("{} {} {}\n".format(*point) for point in points.reshape(-1, 3))
    text += "".join("3 {} {} {}\n".format(*face) for face in faces)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


SMALL = {
    "simplify": {"triangles": 500},
    "bake": {"albedo_px": 64, "normal_px": 64, "data_px": 32, "ao_rays": 4, "thickness_rays": 1},
}


def test_memory_of_children_counts():
    program = "import sys, time; block = bytearray(150_000_000); print(); time.sleep(1.0)"
    with Watch(0.05) as watch:
        subprocess.run([sys.executable, "-c", program], check=True, capture_output=True)
    assert watch.usage.seconds > 1.0
    # None where a test before this one had a larger child.
    assert watch.usage.peak_child_mib is None or watch.usage.peak_child_mib > 140
    if watch.usage.peak_tree_mib is not None:
        assert watch.usage.peak_tree_mib > 140
    with Watch(0.05) as idle:
        subprocess.run([sys.executable, "-c", "import time; time.sleep(0.5)"], check=True)
    assert idle.usage.peak_child_mib is None  # not that of the child before
    if idle.usage.peak_tree_mib is not None:
        assert idle.usage.peak_tree_mib < watch.usage.peak_tree_mib - 100


def test_a_bench_writes_rows_that_can_be_read(tmp_path):
    cases = [
        Case("ball", "a ball", "ball.ply", write_ball, SMALL, limit_s=1e-3),
        Case("none", "no such scan", "none.ply", lambda path, scans: path, SMALL),
    ]
    said = []
    rows = bench_prep(cases, tmp_path, tmp_path, said.append, plain=True)
    assert rows[0]["raw_triangles"] == 2208
    assert rows[0]["triangles"] <= 510
    assert rows[0]["lost"]["flipped_triangles"] == 0
    stages = rows[0]["stages"]
    assert set(CALLS) <= set(stages)
    for name in CALLS:
        cost = stages[name]
        assert "plain_failed" not in cost, cost
        assert cost["ratio"] == pytest.approx(
            cost["seconds"] / max(cost["plain_seconds"], 1e-3), rel=0.6, abs=0.02
        )
        assert cost["peak_mib"] > 0
        assert cost["plain_mib"] > 0
    # The rest is what is left of the whole when the last stage has ended.
    assert 0.0 < stages[stage_costs.REST]["seconds"] < rows[0]["seconds"]
    assert "no such scan" in rows[1]["failed"]
    stored = json.loads((tmp_path / "prep.json").read_text())
    assert stored["rows"] == json.loads(json.dumps(rows))
    with (tmp_path / "prep.csv").open(newline="") as stream:
        table = list(csv.DictReader(stream))
    assert float(table[0]["stages.unwrap.seconds"]) > 0.0
    assert float(table[0]["stages.simplify.plain_mib"]) > 0.0
    assert table[1]["failed"]
    assert len(missed_limits(rows)) == 2
    shown = table_text(rows)
    assert "wall clock" in shown
    assert CALLS["unwrap"][0] in shown
    assert any("ball: a ball" in words for words in said)


def test_a_plain_call_that_fails_is_told_and_has_no_ratio(tmp_path):
    costs = {"ingest": {"seconds": 1.0}, "report": {"seconds": 1.0}}
    said = []
    stage_costs.add_plain_calls(costs, tmp_path / "none.ply", tmp_path, said.append)
    assert "plain_failed" in costs["ingest"]
    assert "ratio" not in costs["ingest"]
    assert stage_table({"stages": costs})[1][3] == "failed"
    late = {"seconds": 1.0, "plain_failed": "too long", "plain_limit_s": 300.0}
    assert stage_table({"stages": {"clean": late}})[1][3] == "> 300"
    assert costs["report"] == {"seconds": 1.0}
    assert len(said) == 1


def test_a_stages_peak_is_that_of_its_own_time():
    watch = Watch(0.1)
    watch.samples = [(10.0, 1024), (10.5, 4096), (11.5, 2048), (12.5, 9216)]
    stages = [
        {"name": "a", "at": 0.0, "seconds": 1.0, "peak_memory_mib": 77},
        {"name": "b", "at": 1.0, "seconds": 1.0, "peak_memory_mib": 78},
        {"name": "c", "at": 2.0, "seconds": 0.1, "peak_memory_mib": 79},
    ]
    costs = stage_costs.stage_costs(stages, watch, 10.0, 3.0)
    assert [costs[name]["peak_mib"] for name in "ab"] == [4, 2]
    assert costs["c"]["peak_mib"] == 79  # nothing was sampled: what the kernel kept
    assert costs[stage_costs.REST] == {"seconds": pytest.approx(0.9), "peak_mib": 9}


def test_every_case_has_settings_that_hold():
    for case in CASES.values():
        assert PrepSettings.model_validate(case.prep).simplify.triangles < 60_000
    assert [case.name for case in case_list("1m,chain")] == ["1m", "chain"]
    assert len(case_list("all")) == len(CASES)
    with pytest.raises(UsageError, match="no such case: '2m'"):
        case_list("2m")


def test_limits_are_kept_or_told():
    row = {"case": "a", "seconds": 5.0, "peak_tree_mib": None, "lost": {"charts": 41}}
    row["limits"] = {"seconds": ("<=", 6.0), "peak_tree_mib": ("<=", 10.0)}
    assert missed_limits([row]) == []
    assert missed_limits([{**row, "seconds": 7.0}]) == ["a: seconds is 7, the limit is <= 6"]
    assert missed_limits([{**row, "peak_tree_mib": 11}])
    assert missed_limits([{**row, "seconds": float("nan")}])
    assert missed_limits([{**row, "seconds": None}]) == ["a: seconds was not measured"]
    good = {
        "charts": 60, "atlas_use": 0.65, "overlap": 0.0, "flipped_triangles": 0,
        "stretch": {"within_1_5": 0.95},
    }  # fmt: skip
    row = {"case": "a", "lost": good, "stages": {"unwrap": {"seconds": 15.0}}, "limits": ATLAS}
    assert missed_limits([row]) == []
    for key, value in (("charts", 61), ("atlas_use", 0.64), ("overlap", 1e-6)):
        assert len(missed_limits([{**row, "lost": {**good, key: value}}])) == 1
    assert len(missed_limits([{**row, "lost": {}}])) == 5


def test_tables_show_limits_ratios_and_what_the_plain_call_is():
    assert table_text([{"case": "b", "failed": "x"}]) == "no case was completed"
    row = {"case": "a", "seconds": 5.0, "limits": {"seconds": ("<=", 6.0)}}
    row["stages"] = {
        "unwrap": {"seconds": 8.0, "peak_mib": 1200, "plain": "xatlas", "plain_seconds": 4.0,
                   "plain_mib": 100, "ratio": 2.0},
        "report": {"seconds": 1.0, "peak_mib": None},
    }  # fmt: skip
    assert csv_text([row, {"case": "b", "failed": "x"}]).splitlines()[2].startswith("b,")
    cases = case_table([row], (("case", "case"), ("seconds", "s"), ("none", "nothing")))
    assert cases == [["case", "a"], ["s", "5"], ["  limit", "<= 6"]]
    stages = stage_table(row)
    assert stages[1] == ["unwrap", "8", "1,200", "4", "100", "2", "xatlas"]
    assert stages[2] == ["report", "1", "", "", "", "", ""]
    assert len({line.count("|") for line in markdown(stages).splitlines()}) == 1
    assert text(stages).splitlines()[0].split()[0] == "stage"
    bare = {"stages": {"report": {"seconds": 1.0, "peak_mib": 7}}}
    assert stage_table(bare) == [["stage", "s", "peak MiB"], ["report", "1", "7"]]


def test_a_coarse_real_head_is_cut_and_rounded(tmp_path):
    ball = tmp_path / REAL_HEAD
    write_ball(tmp_path / "ball.ply", tmp_path)
    raw = read_scan(tmp_path / "ball.ply")
    ball.parent.mkdir(parents=True)
    lines = ["v {} {} {}".format(*point) for point in raw.positions]
    lines += ["f {} {} {}".format(*face) for face in raw.faces + 1]
    ball.write_text("\n".join(lines) + "\n")
    dense = read_scan(dense_head_scan(tmp_path / "dense.ply", tmp_path, levels=2))
    assert len(dense.faces) == 16 * len(raw.faces)
    assert np.ptp(dense.positions, axis=0)[1] == pytest.approx(388.0, rel=0.01)
    radius = np.linalg.norm(dense.positions - dense.positions.mean(axis=0), axis=1)
    assert radius.std() / radius.mean() < 0.01
    with pytest.raises(UsageError, match="no such scan"):
        dense_head_scan(tmp_path / "x.ply", tmp_path / "nowhere")
