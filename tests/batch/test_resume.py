"""What is complete is not done again, what is not is; and nobody can tell afterwards."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest
from batch.jobs import OTHER_LIGHT, Counted, contents, flip_a_bit, silent, tiny, write_ball

from scanrender.batch import job as batch_job
from scanrender.batch.job import run_job
from scanrender.batch.jobs import single_job
from scanrender.batch.record import RECORD_NAME
from scanrender.batch.state import Trust, look, records_of
from scanrender.batch.upkeep import verify_jobs

pytestmark = pytest.mark.gl


def test_a_finished_job_is_not_touched(work: Path, counted: Counted):
    before = {path: path.stat().st_mtime_ns for path in work.rglob("*") if path.is_file()}
    result = run_job(work / "ball.obj", tiny(), work / "out", silent)
    assert result.cached
    assert counted.since() == (0, [])
    after = {path: path.stat().st_mtime_ns for path in work.rglob("*") if path.is_file()}
    changed = {path.name for path in before if before[path] != after.get(path)}
    assert set(after) == set(before)
    assert changed <= {RECORD_NAME}, "the copy's inodes are noted, nothing else"
    manifest = json.loads((work / "out" / "manifest.json").read_text())
    assert set(result.files) >= {"asset/", "turntable.mp4", "manifest.json"}
    assert {entry["path"] for entry in manifest["files"]} >= {"asset/mesh.glb", "turntable.mp4"}


def test_a_copied_folder_is_believed_by_its_content_once(work: Path, monkeypatch):
    run_job(work / "ball.obj", tiny(), work / "out", silent)
    from scanrender.batch import record

    def refuse(path: Path, part: int | None = None) -> None:
        raise AssertionError(f"{path} was read again")

    monkeypatch.setattr(record, "read_entry", refuse)
    assert run_job(work / "ball.obj", tiny(), work / "out", silent).cached


def test_another_light_renders_without_preparing(work: Path, counted: Counted):
    before = contents(work / "out")
    run_job(work / "ball.obj", tiny(lights=OTHER_LIGHT), work / "out", silent)
    assert counted.since() == (0, [0, 1, 2, 3])
    after = contents(work / "out")
    assert {n for n in before if before[n] != after[n] and n.startswith("asset/")} == set()
    assert before["turntable.mp4"] != after["turntable.mp4"]
    run_job(work / "ball.obj", tiny(), work / "out", silent)
    assert contents(work / "out") == before


@pytest.mark.parametrize(
    ("changes", "prepared", "rendered"),
    [
        ({"description": "words"}, 0, []),
        ({"turntable": {"fps": 12}}, 0, []),  # frames are kept: the video is made of them
        ({"outputs": {"contact_frames": 2}}, 0, []),
        ({"outputs": {"buffers": ["albedo", "position"]}}, 0, [1]),
        ({"outputs": {"buffer_frames": [1, 3]}}, 0, [3]),
        ({"prep": {"memory_mib": 4000}}, 0, []),
        ({"skin": {"scale": 0.5}}, 0, [0, 1, 2, 3]),
        # Another preparation of the same maps: frames are keyed by what is in them.
        ({"prep": {"timeout_s": 800}}, 1, []),
        ({"prep": {"simplify": {"triangles": 140}}}, 1, [0, 1, 2, 3]),
    ],
    ids=str,
)
def test_only_what_reads_a_setting_is_done_again(
    work: Path, counted: Counted, changes: dict[str, Any], prepared: int, rendered: list[int]
):
    settings = tiny(**changes)
    run_job(work / "ball.obj", settings, work / "out", silent)
    assert counted.since() == (prepared, rendered)
    assert run_job(work / "ball.obj", settings, work / "out", silent).cached


@pytest.mark.parametrize("name", ["frames/frame_0002.png", "buffers/frame_0001/albedo.png"])
def test_a_file_that_is_gone_is_made_again_alone(work: Path, counted: Counted, name: str):
    before = contents(work / "out")
    (work / "out" / name).unlink()
    run_job(work / "ball.obj", tiny(), work / "out", silent)
    assert counted.since() == (0, [2] if name.startswith("frames") else [1])
    assert contents(work / "out") == before


def test_without_kept_frames_a_lost_video_renders_them_again(asset: Path, tmp_path: Path, counted):
    settings = tiny(outputs={"frames": False, "buffers": []})
    run_job(asset, settings, tmp_path, silent)
    before = contents(tmp_path)
    assert not (tmp_path / ".frames").exists()
    counted.since()
    (tmp_path / "turntable.mp4").unlink()
    run_job(asset, settings, tmp_path, silent)
    assert counted.since() == (0, [0, 1, 2, 3])
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("name", "prepared", "rendered"),
    [
        ("frames/frame_0001.png", 0, [1]),
        ("turntable.mp4", 0, []),
        ("buffers/frame_0001.exr", 0, [1]),
        ("asset/albedo.png", 1, []),
    ],
)
def test_a_flipped_bit_is_found_by_verify_and_made_again_alone(
    work: Path, counted: Counted, name: str, prepared: int, rendered: list[int]
):
    before = contents(work / "out")
    run_job(work / "ball.obj", tiny(), work / "out", silent)
    flip_a_bit(work / "out" / name)
    assert run_job(work / "ball.obj", tiny(), work / "out", silent).cached, "nobody has looked"
    batch_job.do_job(single_job(work / "ball.obj", tiny(), work / "out"), silent, verify=True)
    assert counted.since() == (prepared, rendered)
    assert contents(work / "out") == before


@pytest.mark.parametrize(
    ("name", "stage"),
    [("asset/ao.exr", "prep"), ("buffers/frame_0001.exr", "buffers"), ("turntable.mp4", "video")],
)
def test_what_verify_forgets_stays_forgotten(work: Path, name: str, stage: str):
    """Also when the record is written in between: what is left of a stage is not the stage."""
    flip_a_bit(work / "out" / name)
    _, damaged = verify_jobs(work / "out")
    assert damaged == [str(work / "out" / name)]
    job = single_job(work / "ball.obj", tiny(), work / "out")
    for _ in range(2):
        records = records_of(job)
        assert stage in look(job, records, Trust()).reasons
        records.job.changed = True
        records.save()


def test_what_a_stage_reads_is_looked_at(work: Path, counted: Counted):
    """A damaged map is found before it is shown, a damaged frame before it is in the video."""
    run_job(work / "ball.obj", tiny(), work / "out", silent)
    before = contents(work / "out")
    flip_a_bit(work / "out" / "asset" / "albedo.png")
    (work / "out" / "frames" / "frame_0000.png").unlink()
    run_job(work / "ball.obj", tiny(), work / "out", silent)
    assert counted.since() == (1, [0])
    flip_a_bit(work / "out" / "frames" / "frame_0003.png")
    (work / "out" / "turntable.mp4").unlink()
    run_job(work / "ball.obj", tiny(), work / "out", silent)
    assert counted.since() == (0, [3])
    assert contents(work / "out") == before


def test_another_scan_and_a_changed_one_are_prepared(work: Path, counted: Counted):
    write_ball(work / "ball.obj", radius=90.0)
    run_job(work / "ball.obj", tiny(), work / "out", silent)
    assert counted.since()[0] == 1
    write_ball(work / "other.obj", radius=90.0)
    run_job(work / "other.obj", tiny(), work / "out", silent)
    assert counted.since() == (1, []), "the same shape: its frames are there"


def test_a_scan_that_is_only_touched_is_not_prepared(work: Path, counted: Counted):
    os.utime(work / "ball.obj")
    assert run_job(work / "ball.obj", tiny(), work / "out", silent).cached
    assert counted.since() == (0, [])


def test_an_image_that_comes_is_prepared_and_its_frames_are_rendered(work: Path, counted: Counted):
    from PIL import Image

    Image.new("RGB", (8, 8), (255, 0, 0)).save(work / "photo.png")
    run_job(work / "ball.obj", tiny(), work / "out", silent)
    assert counted.since() == (1, [0, 1, 2, 3])
    manifest = json.loads((work / "out" / "manifest.json").read_text())
    assert len(manifest["source"]["beside"]["photo.png"]) == 64
    Image.new("RGB", (8, 8), (0, 0, 255)).save(work / "photo.png")
    run_job(work / "ball.obj", tiny(), work / "out", silent)
    assert counted.since() == (1, [0, 1, 2, 3])
    assert run_job(work / "ball.obj", tiny(), work / "out", silent).cached
