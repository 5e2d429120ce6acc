"""run over many scans, its dry run, run again from a manifest, and the cache commands."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from batch.killing import KILL
from cli.test_commands import SHOW_MODULES, files_in, write_ball
from render.synthetic import sphere

from scanrender.asset import save_asset

PIPELINE = """
version: 1
scan: {units: mm}
prep:
  simplify: {triangles: 150}
  report: short
  bake: {albedo_px: 32, normal_px: 32, data_px: 16, ao_rays: 4, thickness_rays: 1}
camera: {width_px: 32, height_px: 32}
turntable: {frames: 3}
quality: {supersampling: 1}
lights: [{type: directional, shadow_px: 64}]
outputs: {frames: true}
"""
MATRIX = """
extends: plain.yaml
outputs: {video: false, contact_sheet: false}
matrix:
  look: {natural: {}, oily: {extends: skin/oily}}
  light: {key: {lights.0.irradiance: 2.0}, dim: {lights.0.irradiance: 0.5}}
"""
# What a run that has nothing to do must not load, since loading it takes longer than the rest.
SLOW = {"moderngl", "av", "scipy", "trimesh", "PIL", "rich"}

pytestmark = pytest.mark.gl


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "plain.yaml").write_text(PIPELINE)
    (tmp_path / "matrix.yaml").write_text(MATRIX)
    return tmp_path


@pytest.fixture
def assets(folder: Path) -> Path:
    for name in ("anna", "bert"):
        save_asset(sphere(20.0, (0.6, 0.3, 0.2), rings=10), folder / "heads" / name)
    return folder / "heads"


def results(folder: Path) -> dict[str, str]:
    telling = ("manifest.json", "batch.json", "asset.json", "prep_report.json", "report.html")
    names = {name for name in files_in(folder) if name.split("/")[-1] not in telling}
    names = {name for name in names if not name.startswith(".report/")}
    return {name: KILL.digest(folder / name) for name in sorted(names)}


def test_a_matrix_of_a_raw_scan_is_prepared_once(cli, folder: Path):
    write_ball(folder / "ball.obj")
    words = ["run", "matrix.yaml", "ball.obj", "--out", "out", "--progress", "none"]
    dry = cli(*words, "--dry-run")
    assert "4 jobs into out: 0 complete, 4 to do (1 preparations, 12 frames" in dry.stdout
    assert "time: unknown: no earlier run in this folder" in dry.stdout
    done = cli(*words, "--jobs", "2")
    assert done.returncode == 0, done.stderr
    variants = {"natural-key", "natural-dim", "oily-key", "oily-dim"}
    assert {p.parent.name for p in (folder / "out").glob("*/manifest.json")} == variants
    assert [p.parent.name for p in (folder / "out").rglob("asset.json")] == ["asset"]
    pictures = {(folder / "out" / v / "frames/frame_0000.png").read_bytes() for v in variants}
    assert len(pictures) == 4
    batch = json.loads((folder / "out" / "batch.json").read_text())
    assert batch["counts"] == {"jobs": 4, "failed": 0, "complete": 4}
    assert sum("prep" in job["seconds"] for job in batch["jobs"]) == 1
    before = {p: p.stat().st_mtime_ns for p in (folder / "out").rglob("*")}
    again = cli(*words, "--jobs", "2", code=SHOW_MODULES)
    assert "0 done, 4 complete before, 0 failed" in again.stdout
    assert {p: p.stat().st_mtime_ns for p in (folder / "out").rglob("*")} == before
    loaded = {name.split(".")[0] for name in again.stderr.split()}
    assert "pydantic" in loaded, "otherwise the list of modules was not shown"
    assert loaded & SLOW == set()
    dry = cli(*words, "--dry-run", "--set", "turntable.frames=6", "--json")
    said = json.loads(dry.stdout)
    assert (said["to_prepare"], said["to_render"]) == (0, 24)
    assert said["seconds"] > 0
    assert said["measured_on"] == 4


def test_a_matrix_over_preparation_keeps_an_asset_for_each(cli, folder: Path):
    write_ball(folder / "ball.obj")
    (folder / "m.yaml").write_text(
        "extends: plain.yaml\noutputs: {video: false}\nmatrix:\n"
        "  size: {few: {prep.simplify.triangles: 120}, more: {prep.simplify.triangles: 200}}\n"
        "  light: {key: {}, dim: {lights.0.irradiance: 0.5}}\n"
    )
    done = cli("run", "m.yaml", "ball.obj", "--out", "out", "--progress", "none")
    assert done.returncode == 0, done.stderr
    assert {p.parent.name for p in (folder / "out").rglob("asset.json")} == {
        "asset-few-key", "asset-more-key",
    }  # fmt: skip
    again = cli("run", "m.yaml", "ball.obj", "--out", "out")
    assert "0 done, 4 complete before" in again.stdout


def test_a_finished_run_needs_neither_gl_nor_a_place_to_write(cli, assets: Path, folder: Path):
    words = ["run", "plain.yaml", "heads/anna", "--out", "out", "--progress", "none"]
    assert cli(*words).returncode == 0
    before = {p: p.stat().st_mtime_ns for p in (folder / "out").rglob("*")}
    done = cli(*words, code=SHOW_MODULES)
    assert "nothing to do: it is complete" in done.stdout
    assert {name.split(".")[0] for name in done.stderr.split()} & SLOW == set()
    assert {p: p.stat().st_mtime_ns for p in (folder / "out").rglob("*")} == before
    assert json.loads(cli(*words, "--json").stdout)[0]["status"] == "cached"


def test_a_batch_is_run_again_from_its_manifest(cli, assets: Path, folder: Path):
    done = cli("run", "matrix.yaml", "heads", "--out", "out", "--progress", "none")
    assert done.returncode == 0, done.stderr
    again = cli("run", "--from-manifest", "out/batch.json", "--out", "again", "--progress", "none")
    assert again.returncode == 0, again.stderr
    assert results(folder / "again") == results(folder / "out")
    assert len(results(folder / "out")) == 2 * 4 * (3 + 1)
    for words in (["plain.yaml"], ["--set", "skin.scale=1"], ["--frames", "1"]):
        assert cli("run", *words, "--from-manifest", "out/batch.json").returncode == 2
    (folder / "x.json").write_text("[]")
    assert cli("run", "--from-manifest", "x.json").returncode == 3
    assert cli("run", "--from-manifest", "y.json").returncode == 2


def test_a_scan_is_run_again_from_its_manifest_if_it_is_the_same(cli, folder: Path):
    write_ball(folder / "ball.obj")
    words = ["run", "plain.yaml", "ball.obj", "--out", "out", "--frames", "1-2"]
    assert cli(*words, "--set", "skin.scale=0.5").returncode == 0
    again = cli("run", "--from-manifest", "out/manifest.json", "--out", "again")
    assert again.returncode == 0, again.stderr
    assert results(folder / "again") == results(folder / "out")
    assert {n for n in files_in(folder / "again") if n.startswith("frames")} == {
        "frames/frame_0001.png", "frames/frame_0002.png",
    }  # fmt: skip
    with (folder / "ball.obj").open("a") as file:
        file.write("# another\n")
    done = cli("run", "--from-manifest", "out/manifest.json", "--out", "third")
    assert done.returncode == 2
    assert "not the one of the manifest" in done.stderr


def test_failures_come_first_and_are_in_the_summary(cli, assets: Path, folder: Path):
    (folder / "zz.obj").write_text("v 0 0 0\n")
    done = cli("run", "plain.yaml", "heads", "zz.obj", "--out", "out", "--progress", "json")
    assert done.returncode == 8
    lines = done.stdout.splitlines()
    assert lines[0].startswith("failed: zz: zz.obj has no faces")
    assert "2 done, 0 complete before, 1 failed" in lines[-1]
    batch = json.loads((folder / "out" / "batch.json").read_text())
    assert [job["status"] for job in batch["jobs"]] == ["failed", "done", "done"]
    assert batch["jobs"][0]["error"]["fix"]
    assert batch["jobs"][0]["error"]["exit_code"] == 4
    assert "no faces" in (folder / "out" / "zz" / "log.txt").read_text()
    assert "complete" in (folder / "out" / "anna" / "log.txt").read_text()
    events = [json.loads(line) for line in done.stderr.splitlines() if line.startswith("{")]
    assert events[-1]["ended"] == events[-1]["total"] == 3
    assert events[-1]["failed"] == 1
    assert {event["scan"] for event in events} == {"anna", "bert", "zz"}


@pytest.mark.parametrize(("words", "guarded"), [([], False), (["--timeout", "600"], True)])
def test_one_scan_that_may_hang_has_a_worker(cli, assets: Path, folder: Path, words, guarded: bool):
    said = "from scanrender.batch.pool import Pool\n"
    said += "own = Pool._start\nPool._start = lambda pool: print('a worker') or own(pool)\n"
    arguments = ["run", "plain.yaml", "heads/anna", "--out", "out", "--progress", "none", *words]
    done = cli(*arguments, code=said)
    assert done.returncode == 0, done.stderr
    assert ("a worker" in done.stdout) == guarded
    assert (folder / "out" / "manifest.json").exists()


def test_cache_says_what_is_there_and_what_is_not(cli, assets: Path, folder: Path):
    words = ["plain.yaml", "heads", "--out", "out"]
    assert cli("run", *words, "--progress", "none").returncode == 0
    listed = cli("cache", "list", "out").stdout
    assert "out/anna: complete: frames (3 files" in listed
    assert "2 folders" in listed
    assert cli("cache", "why", *words).stdout.count("complete, nothing would be done") == 2
    why = cli("cache", "why", *words, "--set", "skin.scale=0.5").stdout
    assert "frames: settings.skin.scale: 1.0 is now 0.5" in why
    assert "video: its frames change" in why
    assert "12 files are what was written" in cli("cache", "verify", "out").stdout

    frame = folder / "out" / "anna" / "frames" / "frame_0001.png"
    whole, stat = frame.read_bytes(), frame.stat()
    with frame.open("r+b") as file:
        file.seek(100)
        file.write(bytes([whole[100] ^ 1]))
    os.utime(frame, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert "2 complete before" in cli("run", *words).stdout, "nobody has looked"
    found = cli("cache", "verify", "out")
    assert found.returncode == 5
    assert "damaged: out/anna/frames/frame_0001.png" in found.stdout
    assert "1 of 12 files" in found.stderr
    why = json.loads(cli("cache", "why", *words, "--json").stdout)
    assert [list(row["reasons"]) for row in why] == [["frames"], []]
    assert "1 done, 1 complete before" in cli("run", *words).stdout
    assert frame.read_bytes() == whole
    assert cli("cache", "verify", "out").returncode == 0


def test_prune_removes_what_unfinished_runs_left_and_nothing_else(cli, assets: Path, folder: Path):
    from scanrender.files import atomic_path

    words = ["run", "plain.yaml", "heads/anna", "--out", "out", "--progress", "none"]
    assert cli(*words).returncode == 0
    before = results(folder / "out")
    dead = cli("--version", code="import os; print(os.getpid())").stdout.split()[0]
    with atomic_path(folder / "out" / "frames" / "x.png") as alive:
        alive.write_bytes(b"half")
        left = alive.with_name(alive.name.replace(f"-{os.getpid()}-", f"-{dead}-"))
        left.write_bytes(b"half")
        frames = folder / "out" / ".frames"
        frames.mkdir()
        (frames / "frame_0000.png").write_bytes(b"waits")
        said = cli("cache", "prune", "out", "--dry-run").stdout
        assert "2 leftovers" in said
        assert left.exists()
        assert "2 leftovers" in cli("cache", "prune", "out").stdout
        assert not left.exists()
        assert not frames.exists()
        assert alive.exists(), "its process is at work"
    (folder / "out" / "frames" / "x.png").unlink()
    assert results(folder / "out") == before
    assert "nothing to do" in cli(*words).stdout
