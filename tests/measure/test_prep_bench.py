"""The benchmark of the preparation: what it measures is measured, what it writes can be read."""

from __future__ import annotations

import csv
import json
import subprocess
import sys

import numpy as np
import pytest

from scanrender.errors import UsageError
from scanrender.measure.prep_bench import (
    CASES,
    Case,
    bench_prep,
    case_list,
    csv_text,
    missed_limits,
    table_text,
)
from scanrender.measure.prep_inputs import REAL_HEAD, dense_head_scan
from scanrender.measure.watch import Watch
from scanrender.scan.ingest import read_scan
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
    assert watch.usage.peak_child_mib > 140
    if watch.usage.peak_tree_mib is not None:
        assert watch.usage.peak_tree_mib > 140
    with Watch(0.05) as idle:
        subprocess.run([sys.executable, "-c", "import time; time.sleep(0.5)"], check=True)
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
    assert rows[0]["stages"]["unwrap"] > 0.0
    assert rows[0]["plain"]["fast_simplification_s"] > 0.0
    assert "no such scan" in rows[1]["failed"]
    stored = json.loads((tmp_path / "prep.json").read_text())
    assert stored["rows"] == json.loads(json.dumps(rows))
    with (tmp_path / "prep.csv").open(newline="") as stream:
        table = list(csv.DictReader(stream))
    assert float(table[0]["stages.unwrap"]) > 0.0
    assert table[1]["failed"]
    assert len(missed_limits(rows)) == 2
    assert "wall clock" in table_text(rows)
    assert any("ball: a ball" in words for words in said)


def test_every_case_has_settings_that_hold():
    for case in CASES.values():
        assert PrepSettings.model_validate(case.prep).simplify.triangles < 60_000
    assert [case.name for case in case_list("1m,chain")] == ["1m", "chain"]
    assert len(case_list("all")) == len(CASES)
    with pytest.raises(UsageError, match="no such case: '2m'"):
        case_list("2m")


def test_limits_are_kept_or_told():
    row = {"case": "a", "seconds": 5.0, "limit_s": 6.0, "peak_tree_mib": 10, "limit_mib": None}
    assert missed_limits([row]) == []
    assert missed_limits([{**row, "seconds": 7.0}]) == ["a: 7.0 s, the limit is 6 s"]
    assert table_text([{"case": "b", "failed": "x"}]) == "no case was completed"
    assert csv_text([row, {"case": "b", "failed": "x"}]).splitlines()[2].startswith("b,")


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
