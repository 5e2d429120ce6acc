"""Every real scan at hand in one night, and one that is broken: nine are done, it is explained."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from batch.browser import Browser, all_of, needs_browser, one, open_page, open_scan, requests, wait
from batch.night import run, told

from scanrender.outputs.exr import read_exr

SCANS = Path(__file__).parents[2].parent / "shared" / "scans"
NAMES = (
    "lee_perry_smith/LeePerrySmith.obj", "james_3dmd/james.obj", "fran_cyberware/fran_cut.obj",
    "venus_bust/bust.glb", "roman_bust/bust.glb", "meshroom_object/texturedMesh.obj",
    "dense_head_draco/head.glb", "igea/igea.ply", "lucy/lucy.ply",
)  # fmt: skip
PIPELINE = """
version: 1
extends: turntable
prep:
  report: short
  simplify: {triangles: 6000}
  bake: {albedo_px: 256, normal_px: 256, data_px: 128, ao_rays: 16, thickness_rays: 4}
camera: {width_px: 120, height_px: 160}
turntable: {frames: 4}
quality: {supersampling: 1}
outputs: {buffers: [depth_mm, albedo, irradiance], contact_frames: 4}
"""
pytestmark = [
    pytest.mark.gl,
    pytest.mark.skipif(not SCANS.is_dir(), reason="no folder ../shared/scans"),
]


@pytest.fixture(scope="module")
def ten(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run that met a file of which half is missing."""
    folder = tmp_path_factory.mktemp("ten")
    (folder / "p.yaml").write_text(PIPELINE)
    whole = (SCANS / NAMES[-1]).read_bytes()
    (folder / "upload.ply").write_bytes(whole[: len(whole) // 2])
    scans = [str(SCANS / name) for name in NAMES]
    words = ("--jobs", "2", "--out", "out", "--progress", "json")
    done = run(folder, "run", "p.yaml", *scans, "upload.ply", *words)
    assert done.returncode == 8, done.stderr
    return folder / "out"


def test_nine_are_done_and_one_is_explained(ten: Path):
    summary = json.loads((ten / "batch.json").read_text())
    assert summary["counts"] == {"jobs": 10, "failed": 1, "complete": 9}
    failed, *done = summary["jobs"]
    assert failed["name"] == "upload"
    assert failed["error"]["exit_code"] == 4
    assert "upload.ply" in failed["error"]["what"] + str(failed["error"]["where"])
    assert failed["error"]["fix"]
    assert not (ten / "upload" / "manifest.json").exists()
    for job in done:
        folder = ten / job["folder"]
        assert {"manifest.json", "turntable.mp4", "contact_sheet.png"} <= set(job["files"])
        assert job["prep"]["counts"]["prepared"]["triangles"] > 1000
        depth = read_exr(folder / "buffers" / "frame_0000.exr")["depth_mm"]
        assert (depth > 0).mean() > 0.05, f"{job['name']} shows nothing"


@needs_browser
def test_the_report_shows_each(ten: Path, browser: Browser):
    page = ten / "report.html"
    labels = [job["label"] for job in told(page)["jobs"] if job["status"] == "done"]
    requests(browser)
    open_page(browser, page)
    assert browser.title.startswith("1 failed")
    assert "upload" in one(browser, ".failure").text
    assert len(all_of(browser, ".cards > li")) == len(labels) == 9
    for label in labels:
        open_scan(browser, label)
        shown: Any = wait(browser, lambda: all_of(browser, ".stage img"))
        assert shown[0].size["width"] > 0
        open_page(browser, page)
    assert [entry["message"] for entry in browser.get_log("browser")] == []
