"""Every example runs, small, as its reader would run it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from cli.test_commands import write_ball

from scanrender.images import read_image
from scanrender.settings.loading import load_pipeline

EXAMPLES = Path(__file__).parents[1] / "examples"
PIPELINES = [p for p in sorted(EXAMPLES.glob("*.yaml")) if not p.name.endswith(".openjd.yaml")]
SCRIPTS = {
    "render_sphere.py": (["--size", "64"], ["plain.png", "skin.png"]),
    "one_frame.py": (
        ["--size", "64", "--map-size", "64", "--triangles", "2000"],
        ["frame.png", "frame.exr", "asset/mesh.glb", "asset/albedo.png"],
    ),
}


def run(name: str, out: Path) -> subprocess.CompletedProcess[str]:
    arguments, _ = SCRIPTS[name]
    return subprocess.run(
        [sys.executable, str(EXAMPLES / name), "--out", str(out), *arguments],
        capture_output=True,
        text=True,
        cwd=out.parent,
        env={**os.environ, "PYTHONWARNINGS": "error::DeprecationWarning:__main__"},
        timeout=300,
        check=False,
    )


def test_every_script_is_run_here():
    assert {path.name for path in EXAMPLES.glob("*.py")} == set(SCRIPTS)


@pytest.mark.gl
@pytest.mark.parametrize("name", SCRIPTS)
def test_script(name: str, tmp_path: Path):
    done = run(name, tmp_path / "out")
    assert done.returncode == 0, done.stderr
    for file in SCRIPTS[name][1]:
        assert (tmp_path / "out" / file).stat().st_size > 0
    picture = next(file for file in SCRIPTS[name][1] if file.endswith(".png"))
    pixels = read_image(tmp_path / "out" / picture)
    assert pixels.shape[:2] == (64, 64)
    assert pixels.max() > pixels.min() + 0.1, "something lit on a background"
    if name == "render_sphere.py":
        reach = [float(re.findall(r"[\d.]+", line)[-1]) for line in done.stdout.splitlines()]
        red, green, blue = reach
        assert red > green >= blue >= 0.0, "red light scatters furthest"
        assert 1.0 < red < 6.0


@pytest.mark.parametrize("path", PIPELINES, ids=lambda path: path.name)
def test_pipeline(path: Path):
    pipeline = load_pipeline(path)
    assert pipeline.description
    text = path.read_text(encoding="utf-8")
    assert f"scanrender run examples/{path.name}" in text, "it says how to run it"


@pytest.mark.gl
def test_the_farm_s_template_runs_a_range_and_the_video_is_made_of_it(tmp_path: Path):
    """As Open Job Description's own command checks and runs it: one range, then the last step."""
    template = EXAMPLES / "turntable.openjd.yaml"
    scan, out = write_ball(tmp_path / "head.obj"), tmp_path / "out"
    (tmp_path / "small.yaml").write_text(
        "version: 1\nscan: {units: mm}\ncamera: {width_px: 32, height_px: 32}\n"
        "prep: {report: short, simplify: {triangles: 150}, bake: {albedo_px: 32, normal_px: 32,"
        " data_px: 16, ao_rays: 4, thickness_rays: 1}}\n"
        "quality: {supersampling: 1}\nlights: [{type: directional, shadow_px: 64}]\n"
    )
    # The program that is on the machine's PATH is this very code.
    (tmp_path / "bin").mkdir()
    program = tmp_path / "bin" / "scanrender"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m scanrender "$@"\n')
    program.chmod(0o755)
    paths = f"{program.parent}{os.pathsep}{os.environ['PATH']}"

    def openjd(*words: str) -> str:
        done = subprocess.run(
            [sys.executable, "-c", "import openjd.cli; openjd.cli.main()", *words],
            capture_output=True, text=True, check=False, cwd=tmp_path,
            env={**os.environ, "PATH": paths, "PYTHONPATH": str(EXAMPLES.parent)},
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    assert "passes validation" in openjd("check", str(template))
    values = [word for value in (f"Pipeline={tmp_path / 'small.yaml'}", f"Scan={scan}",
                                 f"OutDir={out}") for word in ("-p", value)]  # fmt: skip
    one = ("--step", "Render", "--task-param", "Frames=24-47", "--run-dependencies")
    assert "openjd_progress: 100.0" in openjd("run", str(template), *values, *one)
    frames = {path.name for path in (out / "parts" / "24-47" / "frames").iterdir()}
    assert frames == {f"frame_{index:04d}.png" for index in range(24, 48)}
    rest = openjd("run", str(template), *values, "--step", "Assemble")
    assert "openjd_progress: 100.0" in rest
    assert (out / "turntable.mp4").is_file()
    log = (out / "log.txt").read_text(encoding="utf-8")
    assert "24 frames of parts/ were taken over" in log
