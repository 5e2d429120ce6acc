"""Stages say that they run, so that whoever waits names the right one and stops it in time."""

from __future__ import annotations

import pytest
from scan_shapes import sphere, write_obj

from scanrender.scan import pipeline
from scanrender.scan.journal import Journal
from scanrender.scan.prepare import prepare
from scanrender.settings.prep import PrepSettings
from scanrender.settings.scan import ScanSettings

TINY = {
    "report": "short",
    "simplify": {"lods": [700]},
    "bake": {"albedo_px": 32, "normal_px": 32, "data_px": 32, "maps": ["albedo"]},
}


@pytest.fixture
def scan(tmp_path):
    positions, faces, uv = sphere(100.0, 20, 40)
    return write_obj(tmp_path / "a.obj", positions, faces, uv)


def test_the_stage_that_still_runs_is_announced_again():
    said = []
    journal = Journal(lambda *event: said.append(event))
    slow = journal.stage("unwrap")
    slow.__enter__()
    with journal.stage("raw surface"):
        pass
    with journal.stage("of no known share"):
        pass
    slow.__exit__(None, None, None)
    assert [name for name, _ in said] == [
        "unwrap",
        "raw surface",
        "unwrap",
        "of no known share",
        "unwrap",
    ]
    shares = [share for _, share in said]
    assert shares == sorted(shares)
    assert [stage["name"] for stage in journal.stages] == [
        "raw surface",
        "of no known share",
        "unwrap",
    ]


def test_the_stage_that_failed_is_the_last_one_announced():
    said = []
    journal = Journal(lambda name, _: said.append(name))
    failing = journal.stage("unwrap")
    failing.__enter__()
    with journal.stage("distance"):
        assert not failing.__exit__(ValueError, ValueError("native"), None)
    with journal.stage("project"):
        pass
    assert said == ["unwrap", "distance", "unwrap"]


@pytest.mark.parametrize(
    ("function", "stage"),
    [
        ("make_high", "raw surface"),
        ("shape_values", "occlusion, thickness"),
        ("surface_distance", "distance"),
        ("make_lods", "levels of detail"),
    ],
)
def test_a_failure_beside_the_main_line_has_its_own_stage(function, stage, scan, monkeypatch):
    def fail(*_, **__):
        raise RuntimeError("a library says no")

    monkeypatch.setattr(pipeline, function, fail)
    said = []
    settings = PrepSettings.model_validate(TINY)
    with pytest.raises(RuntimeError):
        pipeline.prepare_here(
            scan,
            ScanSettings(units="mm"),
            settings,
            as_is=True,
            progress=lambda name, _: said.append(name),
        )
    assert said[-1] == stage


def test_a_level_of_detail_that_takes_too_long_costs_only_itself(scan, tmp_path, monkeypatch):
    slow = tmp_path / "slow"
    slow.mkdir()
    (slow / "fast_simplification.py").write_text("import time; time.sleep(60.0)")
    monkeypatch.setenv("PYTHONPATH", str(slow))
    settings = PrepSettings.model_validate({**TINY, "timeout_s": 1.0})
    asset = prepare(scan, ScanSettings(units="mm"), settings, tmp_path / "asset", as_is=True)
    assert not asset.lods
    said = [text for text in asset.info["warnings"] if text.startswith("no level of detail")]
    assert said == [
        "no level of detail of any size: the stage 'lods' took longer than 1 s and was stopped"
    ]
