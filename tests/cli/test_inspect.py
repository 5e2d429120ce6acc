"""What `scanrender inspect` prints: one screen that says what is wrong and what was decided."""

from __future__ import annotations

import os
import sys

import numpy as np
import pytest

from scanrender import images
from scanrender.cli.inspect import lines
from scanrender.scan.inspect import inspect_scan

TETRAHEDRON = "v 0 0 0\nv 0 100 300\nv 200 0 300\nv 0 200 0\n"


def test_one_screen_names_defects_and_decisions(tmp_path):
    images.write_png8(tmp_path / "skin.png", np.random.default_rng(0).random((8, 16, 3)))
    (tmp_path / "m.mtl").write_text("newmtl a\nmap_Kd skin.png\n")
    (tmp_path / "a.obj").write_text(
        f"mtllib lost.mtl m.mtl\n{TETRAHEDRON}v 0 0 0\nvt 0 0\nusemtl a\n"
        "f 1/1 2/1 3/1\nf 5/1 3/1 4/1\nf 1/1 4/1 2/1\nf 1/1 2/1 4/1\nf 1/1 1/1 2/1\n"
    )
    shown = lines(inspect_scan(tmp_path / "a.obj"))
    assert len(shown) < 24
    assert max(map(len, shown)) < 160
    text = "\n".join(shown)
    assert shown[0] == "a.obj: 5 triangles"
    for part in (
        "3 boundary edges", "1 faces without an area", "1 faces that are there twice",
        "5, at 4 places that are used", "skin.png 16 x 8", "lost.mtl m.mtl is missing",
        "mm (medium): read as mm",
    ):  # fmt: skip
        assert part in text, text


def test_a_closed_scan_is_said_to_be_watertight(tmp_path):
    (tmp_path / "a.obj").write_text(TETRAHEDRON + "f 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n")
    text = "\n".join(lines(inspect_scan(tmp_path / "a.obj")))
    assert "surface   watertight" in text
    assert "colour    none" in text


@pytest.mark.skipif(sys.platform != "linux", reason="names of any bytes")
def test_a_name_that_is_no_text_is_printed_all_the_same(cli, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONIOENCODING", "utf-8:strict")
    name = os.fsdecode(b"kopf\xff.obj")
    (tmp_path / name).write_text(TETRAHEDRON + "f 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n")
    done = cli("inspect", name)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("kopf\\udcff.obj: 4 triangles")
