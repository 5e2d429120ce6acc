"""What a night leaves, as tests of the report read it."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

PIPELINE = """
version: 1
camera: {width_px: 48, height_px: 60}
turntable: {frames: 5}
quality: {supersampling: 1}
lights: [{type: directional, shadow_px: 64}]
outputs: {buffers: [depth_mm, normal_shading, display], contact_frames: 2}
matrix:
  look: {natural: {}, oily: {extends: skin/oily}}
"""
BROKEN = "<img src=x onerror=alert(1)>"  # the stem of a scan's name, which a page must not believe


def run(folder: Path, *arguments: str, code: str = "") -> subprocess.CompletedProcess[str]:
    start = f"{code}\nfrom scanrender.cli.main import main\nmain()\n"
    return subprocess.run(
        [sys.executable, "-c", start, *arguments],
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, "NO_COLOR": "1"},
        timeout=300,
        check=False,
    )


def told(page: Path) -> dict[str, Any]:
    """The data of a page, as its scripts read it."""
    return held(page, "data")


def held(page: Path, name: str) -> dict[str, Any]:
    text = page.read_text(encoding="utf-8")
    found = re.search(rf'<script type="application/json" id="{name}">(.*?)</script>', text)
    assert found is not None
    data = json.loads(found[1])
    assert isinstance(data, dict)
    return data
