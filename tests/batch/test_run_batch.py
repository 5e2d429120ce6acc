"""One bad scan never stops the others, and nothing unfinished passes for finished."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from render.synthetic import pipeline, sphere

from scanrender.asset import save_asset
from scanrender.batch import job as batch_job
from scanrender.batch import run as batch_run
from scanrender.batch import state
from scanrender.batch.job import Result, run_job
from scanrender.batch.jobs import Job, single_job
from scanrender.batch.memory import render_mib
from scanrender.batch.record import Record, load_record
from scanrender.batch.run import run_batch
from scanrender.batch.state import Records
from scanrender.errors import BatchError, OutputError, ScanError, StageError, UsageError
from scanrender.files import TEMPORARY_PREFIX, check_writable

TINY = pipeline(
    stages=["render"],
    camera={"width_px": 32, "height_px": 32},
    turntable={"frames": 3},
    quality={"supersampling": 1},
    lights=[{"type": "directional", "shadow_px": 64}],
)


def silent(stage: str, fraction: float) -> None:
    assert 0.0 <= fraction <= 1.0


@pytest.fixture(scope="module")
def asset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("asset") / "ball"
    return save_asset(sphere(20.0, (0.6, 0.3, 0.2), rings=10), folder)


def files_in(folder: Path) -> set[str]:
    """Results; the record and the log beside them are another matter."""
    names = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    return {name for name in names if name.split("/")[-1] not in ("record.json", "log.txt")}


# --- several scans -------------------------------------------------------------------------------


def fake_jobs(monkeypatch: pytest.MonkeyPatch, failing: dict[str, Exception]) -> list[Path]:
    folders = []

    def do(job: Job, progress, verify: bool) -> Result:
        folders.append(job.folder)
        if job.scan.name in failing:
            raise failing[job.scan.name]
        return Result(job.scan.stem, job.folder)

    monkeypatch.setattr(batch_job, "do_job", do)
    return folders


SCANS = [Path("a.obj"), Path("b.obj"), Path("c.obj")]


@pytest.mark.parametrize("error", [ScanError("no faces"), RuntimeError("our bug"), ValueError()])
def test_the_others_complete(monkeypatch: pytest.MonkeyPatch, error: Exception):
    folders = fake_jobs(monkeypatch, {"b.obj": error})
    said: list[str] = []
    batch = run_batch(SCANS, TINY, Path("out"), silent, said.append)
    assert [result.name for result in batch.results] == ["a", "c"]
    assert [failure.job.scan.name for failure in batch.failures] == ["b.obj"]
    assert folders == [Path("out/a"), Path("out/b"), Path("out/c")]
    with pytest.raises(BatchError, match="1 of 3") as caught:
        batch.raise_if_failed()
    assert caught.value.exit_code == 8
    assert "b.obj" in str(caught.value.where)
    assert len(said) == 4, "a line a scan, and one for what failed"


def test_of_a_matrix_jobs_are_counted(monkeypatch: pytest.MonkeyPatch):
    fake_jobs(monkeypatch, {"b.obj": ScanError("no faces")})
    looks = {"look": {"natural": {}, "oily": {"skin": {"scale": 0.5}}}}
    several = TINY.model_copy(update={"matrix": looks})
    batch = run_batch(SCANS, several, Path("out"), silent, lambda line: None)
    with pytest.raises(BatchError, match="2 of 6 jobs") as caught:
        batch.raise_if_failed()
    assert "b.obj oily" in str(caught.value.where)


def test_a_scan_that_cannot_begin_any_more_is_in_the_summary(
    monkeypatch: pytest.MonkeyPatch, asset: Path, tmp_path: Path
):
    other = save_asset(sphere(20.0, (0.6, 0.3, 0.2), rings=10), tmp_path / "other")
    run_batch([asset, other], TINY, tmp_path / "out", silent, print).raise_if_failed()

    def records_of(job: Job) -> Records:
        if job.scan == other:
            raise ScanError("it is gone")
        return state.records_of(job)

    monkeypatch.setattr(batch_run, "records_of", records_of)
    batch = run_batch([asset, other], TINY, tmp_path / "out", silent, print)
    assert [result.cached for result in batch.results] == [True]
    summary = json.loads((tmp_path / "out" / "batch.json").read_text())
    assert [job["status"] for job in summary["jobs"]] == ["failed", "cached"]


def test_memory_of_frames_is_known_from_the_last_ones(asset: Path, tmp_path: Path):
    run_job(asset, TINY, tmp_path, silent)
    record = load_record(tmp_path)
    measured = record.stages["frames"].notes["peak_mib"]
    assert measured > 50  # a Python with its libraries has more than that
    same = single_job(asset, TINY, tmp_path)
    larger = pipeline(TINY.model_dump(mode="json"), camera={"width_px": 64, "height_px": 32})
    assert measured < render_mib(same, record) < 1.5 * measured
    guess = render_mib(same, Record(tmp_path))
    assert render_mib(single_job(asset, larger, tmp_path), record) >= guess > 500


def test_one_scan_fails_with_its_own_error_and_writes_straight_into_out(
    monkeypatch: pytest.MonkeyPatch,
):
    folders = fake_jobs(monkeypatch, {"a.obj": StageError("died")})
    batch = run_batch(SCANS[:1], TINY, Path("out"), silent, print)
    assert folders == [Path("out")]
    with pytest.raises(StageError, match="died"):
        batch.raise_if_failed()


def test_a_bug_in_a_single_job_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch):
    fake_jobs(monkeypatch, {"a.obj": RuntimeError("our bug")})
    with pytest.raises(RuntimeError):
        run_batch(SCANS[:1], TINY, Path("out"), silent, print)


def test_an_interruption_stops_the_batch(monkeypatch: pytest.MonkeyPatch):
    folders = fake_jobs(monkeypatch, {"b.obj": KeyboardInterrupt()})  # type: ignore[dict-item]
    with pytest.raises(KeyboardInterrupt):
        run_batch(SCANS, TINY, Path("out"), silent, print)
    assert len(folders) == 2


def test_the_same_scan_twice_is_a_usage_error(monkeypatch: pytest.MonkeyPatch):
    folders = fake_jobs(monkeypatch, {})
    with pytest.raises(UsageError, match="twice"):
        run_batch([Path("a.obj"), Path("x/../a.obj")], TINY, Path("out"), silent, print)
    assert folders == []


def test_nothing_failed_is_no_error(monkeypatch: pytest.MonkeyPatch):
    fake_jobs(monkeypatch, {})
    run_batch(SCANS, TINY, Path("out"), silent, print).raise_if_failed()


# --- one job -------------------------------------------------------------------------------------


@pytest.mark.gl
def test_a_whole_turn_writes_what_outputs_asks_for(asset: Path, tmp_path: Path):
    result = run_job(asset, TINY, tmp_path, silent)
    assert files_in(tmp_path) == {
        "turntable.mp4", "contact_sheet.png", "pipeline.yaml", "manifest.json",
    }  # fmt: skip
    assert set(result.files) == files_in(tmp_path)


@pytest.mark.gl
def test_the_manifest_says_what_made_the_result(asset: Path, tmp_path: Path):
    settings = pipeline(TINY.model_dump(mode="json"), outputs={"video": False}, skin={"scale": 0})
    run_job(asset, settings, tmp_path, silent)
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert manifest["versions"]["scanrender"] == manifest["scanrender"]
    assert {"numpy", "moderngl"} <= set(manifest["versions"])
    assert manifest["gl"]["renderer"]
    assert manifest["gl"]["view"]["ocio_config"].startswith("ocio://")
    assert manifest["platform"]["python"]
    assert manifest["settings"] == settings.model_dump(mode="json")
    assert {"upload", "render", "write"} <= set(manifest["seconds"])
    assert manifest["not_run"], "what the plan left out, and why"
    entries = {entry["path"]: entry for entry in manifest["files"]}
    assert set(entries) == files_in(tmp_path) - {"manifest.json"}
    assert all(len(entry["sha256"]) == 64 for entry in entries.values())
    assert all(entry["bytes"] == (tmp_path / name).stat().st_size
               for name, entry in entries.items())  # fmt: skip


@pytest.mark.gl
def test_a_part_of_the_turn_is_these_frames_and_no_more(asset: Path, tmp_path: Path):
    settings = pipeline(TINY.model_dump(mode="json"), outputs={"buffers": ["albedo"]})
    run_job(asset, settings, tmp_path, silent, frames=[1, 2])
    assert files_in(tmp_path) == {
        "frames/frame_0001.png", "frames/frame_0002.png", "pipeline.yaml", "manifest.json",
    }  # fmt: skip


@pytest.mark.gl
def test_frames_do_not_depend_on_which_others_are_made(asset: Path, tmp_path: Path):
    settings = pipeline(TINY.model_dump(mode="json"), outputs={"frames": True, "video": False})
    run_job(asset, settings, tmp_path / "whole", silent)
    run_job(asset, settings, tmp_path / "part", silent, frames=[2])
    name = "frames/frame_0002.png"
    assert (tmp_path / "whole" / name).read_bytes() == (tmp_path / "part" / name).read_bytes()


@pytest.mark.gl
def test_buffers_are_dumped_for_their_frames_with_pictures(asset: Path, tmp_path: Path):
    settings = pipeline(
        TINY.model_dump(mode="json"),
        outputs={"video": False, "contact_sheet": False, "buffers": ["all"], "buffer_frames": [1]},
    )
    run_job(asset, settings, tmp_path, silent)
    names = files_in(tmp_path)
    assert "buffers/frame_0001.exr" in names
    assert {"buffers/frame_0001/albedo.png", "buffers/frame_0001/gaussian_5.png"} <= names
    assert not [name for name in names if "frame_0000" in name or "frame_0002" in name]


@pytest.mark.gl
def test_a_second_run_that_fails_leaves_no_manifest_to_vouch_for_it(
    asset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    run_job(asset, TINY, tmp_path, silent)
    assert (tmp_path / "manifest.json").is_file()

    def stop(stage: str, fraction: float) -> None:
        if stage == "render":
            raise StageError("the machine went away")

    other = pipeline(TINY.model_dump(mode="json"), skin={"scale": 0})
    with pytest.raises(StageError):
        run_job(asset, other, tmp_path, stop)
    assert not (tmp_path / "manifest.json").exists()
    assert not (tmp_path / "turntable.mp4").exists(), "it shows other settings"
    assert not [name for name in files_in(tmp_path) if TEMPORARY_PREFIX in name]


@pytest.mark.gl
def test_what_was_interrupted_leaves_nothing_half_written(asset: Path, tmp_path: Path):
    def stop(stage: str, fraction: float) -> None:
        if fraction > 0.5:
            raise KeyboardInterrupt

    settings = pipeline(TINY.model_dump(mode="json"), outputs={"frames": True})
    with pytest.raises(KeyboardInterrupt):
        run_job(asset, settings, tmp_path, stop)
    assert files_in(tmp_path) == {"frames/frame_0000.png", "frames/frame_0001.png"}


def test_a_place_that_cannot_be_written_is_said_before_the_work(tmp_path: Path):
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "deeper"):
        with pytest.raises(OutputError):
            check_writable(folder)
    check_writable(tmp_path / "new" / "deep")
    assert files_in(tmp_path) == {"file"}


@pytest.mark.gl
def test_a_job_does_not_replace_a_folder_of_something_else(tmp_path: Path):
    (tmp_path / "asset").mkdir()
    (tmp_path / "asset" / "mine.txt").write_text("mine")
    settings = pipeline(TINY.model_dump(mode="json"), stages=["prep"])
    with pytest.raises(OutputError, match="not an asset"):
        run_job(tmp_path / "scan.obj", settings, tmp_path, silent)
    assert files_in(tmp_path) == {"asset/mine.txt"}


@pytest.mark.gl
def test_an_asset_given_as_a_scan_is_not_prepared_again(asset: Path, tmp_path: Path):
    """Nine figures of one head need one preparation."""
    settings = pipeline(TINY.model_dump(mode="json"), stages=["prep", "render"])
    result = run_job(asset, settings, tmp_path, silent)
    assert "prep" not in result.stages
    assert any("prepared asset" in reason for reason in result.decisions)
    assert not (tmp_path / "asset").exists()
    with pytest.raises(UsageError, match="prepared asset already"):
        run_job(asset, pipeline(stages=["prep"]), tmp_path / "other", silent)
    assert not (tmp_path / "other").exists()
