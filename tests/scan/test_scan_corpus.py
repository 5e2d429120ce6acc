"""Every file of ../shared/scans that is small enough, read; a few tricky ones, prepared.

The whole sweep, each file through `scanrender prep` in its own process: `sweep.py` beside this.
"""

from __future__ import annotations

import numpy as np
import pytest
from scan_shapes import SCANS
from sweep import TINY, all_scans, prepare_one

from scanrender.errors import ScanError
from scanrender.scan.ingest import read_scan
from scanrender.scan.inspect import inspect_scan

CORPUS = SCANS / "corpus_trimesh"
# What cannot be a scan, and a word of the sentence that says why.
REFUSED = {
    "empty.obj": "no vertices",
    "empty.ply": "no vertices",
    "empty.stl": "no vertices",
    "empty_nodes.glb": "no triangles",
    "face_in_group_name.obj": "no faces",
    "points_ascii.ply": "point cloud",
    "points_ascii_with_lists.ply": "point cloud",
    "points_bin.ply": "point cloud",
    "points_emptyascii.ply": "point cloud",
    "points_emptyface.ply": "point cloud",
}

pytestmark = pytest.mark.skipif(
    not CORPUS.is_dir(), reason=f"the real scans are not on this machine ({SCANS})"
)


def test_every_small_file_is_inspected_or_refused_in_one_sentence():
    refused = {}
    small = [path for path in all_scans() if path.stat().st_size < 40_000]
    assert len(small) > 40
    for path in small:
        try:
            health = inspect_scan(path)
        except ScanError as error:
            refused[path.name] = error.what
        else:
            assert health["triangles"] > 0
            assert np.isfinite(health["size_mm"]).all()
            assert health["units"]["reason"]
            assert health["axes"]["front_reason"]
    assert refused.keys() == REFUSED.keys()
    for name, word in REFUSED.items():
        assert word in refused[name]
        assert "\n" not in refused[name]


@pytest.mark.parametrize(
    ("name", "triangles", "source"),
    [
        ("fuze.obj", 1000, "texture"),  # MTL with tabs and a blank in the image's name
        ("fuze.ply", 1000, "texture"),  # texture coordinates per face, beside vertex colours
        ("fuze_ascii.ply", 1000, "texture"),
        ("noimg.obj", 1000, "none"),  # a material that no MTL describes
        ("rabbit.obj", 1252, "texture"),  # a material with a colour and no image
        ("nancolor.obj", 12, "vertex"),
        ("reference.obj", 1610, "vertex"),
        ("negative_indices.obj", 12, "none"),
        ("cube_compressed.obj", 12, "none"),
        ("mode5.gltf", 2786, "texture"),  # triangle strips
        ("no_indices_3storybuilding.glb", 72, "none"),
        ("rgb_cube_with_primitives.gltf", 12, "texture"),  # three materials, no image
        ("comments.off", 12, "vertex"),  # colours per face
        ("whitespace.off", 12, "vertex"),  # "OFF8 6 12"
        ("cube_blender_uv.ply", 12, "none"),  # quads
        ("two_objects_mixed_case_names.stl", 24, "none"),
        ("20mm-xyz-cube.stl", 260, "none"),
    ],
)
def test_what_the_odd_files_hold(name, triangles, source):
    raw = read_scan(CORPUS / name)
    assert len(raw.faces) == triangles
    assert raw.color_source == source


@pytest.mark.parametrize(
    "name",
    ["corpus_trimesh/fuze_ascii.ply"],
)
def test_tricky_files_become_assets(name):
    assert TINY["prep.bake.albedo_px"] <= 128
    row = prepare_one(SCANS / name)
    assert row.outcome == "asset", row.text


def test_what_is_not_a_scan_ends_with_exit_code_4():
    row = prepare_one(CORPUS / "points_bin.ply")
    assert (row.outcome, row.text[:3]) == ("refused", "[4]")
