"""Every example runs, small, as its reader would run it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from scanrender.images import read_image
from scanrender.settings.loading import load_pipeline

EXAMPLES = Path(__file__).parents[1] / "examples"
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


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.yaml")), ids=lambda path: path.name)
def test_pipeline(path: Path):
    pipeline = load_pipeline(path)
    assert pipeline.description
    text = path.read_text(encoding="utf-8")
    assert f"scanrender run examples/{path.name}" in text, "it says how to run it"
