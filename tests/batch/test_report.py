"""The morning report, made by runs in processes of their own: what the page is given."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from batch.night import BROKEN, held, run, told

pytestmark = pytest.mark.gl


def test_failures_come_first_with_what_to_do(page: Path):
    jobs = told(page)["jobs"]
    assert [job["status"] for job in jobs] == ["failed"] * 2 + ["done"] * 4
    for job in jobs[:2]:
        assert job["error"]["exit_code"] == 4
        assert job["error"]["what"]
        assert job["error"]["fix"]
    assert jobs[2]["lost"]["symmetric_mm"]["p99"] == 0.072
    assert {"render", "write"} <= set(jobs[2]["seconds"])


def test_the_page_names_nothing_of_the_network(page: Path):
    text = page.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
    assert not re.search(r"https?://|@import|<link[^>]+stylesheet", text)


def test_downloads_are_there(page: Path):
    from urllib.parse import unquote

    files = [file for job in told(page)["jobs"] for file in job["downloads"]]
    assert {"turntable.mp4", "contact_sheet.png", "manifest.json", "frame_0000.exr"} <= {
        file["name"] for file in files
    }
    for file in files:
        if not file["href"].startswith("file:"):
            assert (page.parent / unquote(file["href"])).stat().st_size == file["bytes"]


def test_it_is_made_again_from_the_folder_alone(night: Path, page: Path, tmp_path: Path):
    moved = tmp_path / "moved"
    shutil.copytree(night / "out", moved)
    (moved / "report.html").unlink()
    loads = "import sys, atexit; atexit.register(lambda: print('moderngl' in sys.modules))"
    again = run(tmp_path, "report", "moved", code=loads)
    assert again.returncode == 0, again.stderr
    assert again.stdout.split() == ["moved/report.html", "False"]
    new, old = told(moved / "report.html"), told(page)
    assert {**new, "title": old["title"]} == old


def test_a_picture_is_read_again_only_when_it_changed(night: Path, tmp_path: Path):
    moved = tmp_path / "moved"
    shutil.copytree(night / "out", moved)
    before = {path.name: path.stat().st_mtime_ns for path in (moved / ".report").iterdir()}
    assert len(before) == 4
    video = moved / "anna" / "oily" / "turntable.mp4"
    video.write_bytes(b"damaged")
    assert run(tmp_path, "report", "moved").returncode == 0
    after = {path.name: path.stat().st_mtime_ns for path in (moved / ".report").iterdir()}
    assert len(after) == 4
    assert len(set(before.items()) & set(after.items())) == 3
    jobs = {job["label"]: job["id"] for job in told(moved / "report.html")["jobs"]}
    pixels = held(moved / "report.html", f"pixels-{jobs['anna oily']}")
    assert "cannot read video" in pixels["unread"][0]
    assert pixels["page"], "the contact sheet stands in"


def test_a_folder_that_nothing_ran_in_is_told(tmp_path: Path):
    (tmp_path / "empty").mkdir()
    done = run(tmp_path, "report", "empty")
    assert done.returncode == 3
    assert "does not tell what was done" in done.stderr
    assert not (tmp_path / "empty" / "report.html").exists()


def test_a_run_with_nothing_to_do_leaves_the_page_alone(night: Path, tmp_path: Path):
    words = ("run", "p.yaml", "anna", "--set", "matrix={}", "--out", str(tmp_path / "one"))
    words = (*words, "--progress", "none")
    assert run(night, *words).returncode == 0
    page = tmp_path / "one" / "report.html"
    assert [job["label"] for job in told(page)["jobs"]] == ["anna"]
    made = page.stat().st_mtime_ns
    again = run(night, *words)
    assert again.returncode == 0
    assert "report:" not in again.stderr
    assert page.stat().st_mtime_ns == made


def test_one_scan_that_failed_has_a_page(night: Path, tmp_path: Path):
    out = tmp_path / "out"
    scan = f"{BROKEN}.ply"
    done = run(night, "run", "turntable", scan, "--out", str(out), "--progress", "none")
    assert done.returncode == 4
    assert told(out / "report.html")["jobs"][0]["status"] == "failed"
