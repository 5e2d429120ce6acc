"""A tiny job, and what tests of resumption ask of its folder."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from batch.killing import KILL
from render.synthetic import pipeline, sphere_mesh

from scanrender.batch.record import RECORD_NAME
from scanrender.render.frame import Renderer
from scanrender.scan import prepare as preparation
from scanrender.settings.pipeline import Pipeline

TINY = {
    "stages": ["prep", "render"],
    "scan": {"units": "mm"},
    "prep": {
        "simplify": {"triangles": 150}, "report": "short",
        "bake": {"albedo_px": 32, "normal_px": 32, "data_px": 16, "ao_rays": 4,
                 "thickness_rays": 1},
    },
    "camera": {"width_px": 32, "height_px": 32},
    "turntable": {"frames": 4},
    "quality": {"supersampling": 1},
    "lights": [{"type": "directional", "shadow_px": 64}],
    "outputs": {"frames": True, "buffers": ["albedo"], "buffer_frames": [1]},
}  # fmt: skip
OTHER_LIGHT = [{"type": "directional", "shadow_px": 64, "azimuth_deg": 80}]


def tiny(**changes: Any) -> Pipeline:
    return pipeline(TINY, **changes)


def silent(stage: str, fraction: float) -> None:
    pass


def write_ball(path: Path, radius: float = 100.0, head: str = "") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    ball = sphere_mesh(radius, 8)
    lines = [head] if head else []
    lines += [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in ball.positions_mm]
    lines += [f"vt {u:.5f} {v:.5f}" for u, v in ball.uv]
    lines += [f"f {a}/{a} {b}/{b} {c}/{c}" for a, b, c in ball.faces + 1]
    path.write_text("\n".join(lines) + "\n")
    return path


class Counted:
    """How often a scan was prepared, and which frames were rendered."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.prepared, self.rendered = 0, []
        prepare, render = preparation.prepare, Renderer.render

        def counted_prepare(*arguments, **keywords):
            self.prepared += 1
            return prepare(*arguments, **keywords)

        def counted_render(renderer, view, *arguments, **keywords):
            self.rendered.append(view.index)
            return render(renderer, view, *arguments, **keywords)

        monkeypatch.setattr(preparation, "prepare", counted_prepare)
        monkeypatch.setattr(Renderer, "render", counted_render)

    def since(self) -> tuple[int, list[int]]:
        found = self.prepared, self.rendered
        self.prepared, self.rendered = 0, []
        return found


def contents(folder: Path) -> dict[str, str]:
    """Everything but what tells times."""
    telling = {RECORD_NAME, "log.txt", "manifest.json", "asset.json", "prep_report.json"}
    files = [path for path in folder.rglob("*") if path.is_file() and path.name not in telling]
    return {path.relative_to(folder).as_posix(): KILL.digest(path) for path in sorted(files)}


def flip_a_bit(path: Path) -> None:
    """As a bad disk does: size, time and inode stay."""
    stat = path.stat()
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    with path.open("r+b") as file:
        file.write(data)
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
