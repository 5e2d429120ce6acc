"""Files read back by another library hold what was written."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from scanrender.phantom import Damage, Head, RawScan, scan_head, write_obj, write_ply, write_truth
from scanrender.phantom.damage import srgb_u8_from_linear
from scanrender.phantom.head import albedo_of_truth
from scanrender.phantom.unwrap import unwrap


def test_ply_read_back(raw: RawScan, tmp_path: Path) -> None:
    path = write_ply(tmp_path / "raw.ply", raw)
    mesh = trimesh.load(path, process=False)
    assert mesh.vertices.shape == raw.positions.shape
    assert np.array_equal(mesh.faces, raw.faces)
    assert np.allclose(mesh.vertices, raw.positions, atol=1e-5)
    assert np.array_equal(np.asarray(mesh.visual.vertex_colors)[:, :3], raw.colours_srgb_u8)
    assert [p.name for p in tmp_path.iterdir()] == ["raw.ply"]


def test_ply_far_from_the_origin_keeps_its_detail(head: Head, tmp_path: Path) -> None:
    damage = dataclasses.replace(Damage.none(), offset=(4.5e8, 5.2e9, 0.0))
    raw = scan_head(head, damage)
    mesh = trimesh.load(write_ply(tmp_path / "far.ply", raw), process=False)
    assert np.allclose(mesh.vertices - raw.raw_from_truth[:3, 3], head.positions_mm, atol=1e-5)


def test_obj_read_back(raw: RawScan, tmp_path: Path) -> None:
    path = write_obj(tmp_path / "scan.obj", raw, pages=1, page_px=512)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["scan.mtl", "scan.obj", "scan_0.png"]
    mesh = trimesh.load(path, process=False, maintain_order=True)
    assert len(mesh.faces) == len(raw.faces)
    uv = np.asarray(mesh.visual.uv)
    assert uv.min() >= 0.0
    assert uv.max() <= 1.0
    assert mesh.visual.material.image.size == (512, 512)


def test_texture_agrees_with_the_vertices(head: Head, tmp_path: Path) -> None:
    """Looking up each vertex in the page gives its albedo: neither flipped nor shifted."""
    path = write_obj(tmp_path / "clean.obj", head, page_px=1024)
    mesh = trimesh.load(path, process=False, maintain_order=True)
    page = np.asarray(Image.open(tmp_path / "clean_0.png")).astype(int)
    uv = np.asarray(mesh.visual.uv)
    column = np.clip((uv[:, 0] * 1024).astype(int), 0, 1023)
    row = np.clip(((1.0 - uv[:, 1]) * 1024).astype(int), 0, 1023)
    linear = albedo_of_truth(np.asarray(mesh.vertices), head.spacing_mm, head.seed)
    apart = np.abs(page[row, column] - srgb_u8_from_linear(linear).astype(int)).max(axis=1)
    assert np.median(apart) < 14
    assert np.percentile(apart, 90) < 60


def test_several_pages(head: Head, tmp_path: Path) -> None:
    write_obj(tmp_path, head, pages=3, page_px=256)
    names = sorted(p.name for p in tmp_path.iterdir())
    assert names == ["scan.mtl", "scan.obj", "scan_0.png", "scan_1.png", "scan_2.png"]
    text = (tmp_path / "scan.obj").read_text()
    assert text.count("usemtl") == 3


def test_atlas_has_no_mirrored_charts_and_keeps_scale(head: Head) -> None:
    atlas = unwrap(head.positions_mm, head.faces, 1, 512)
    a, b, c = (atlas.texels[atlas.corner[:, k]] for k in range(3))
    # y points down in texels, so a face seen from outside runs clockwise there.
    signed = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert (signed < 0.0).mean() > 0.97
    assert 0.5 < atlas.mm_per_texel < 3.0


def test_truth_folder(head: Head, raw: RawScan, tmp_path: Path) -> None:
    folder = write_truth(tmp_path / "truth", head, raw)
    document = json.loads((folder / "truth.json").read_text())
    assert document["units"] == "mm"
    assert document["triangles"] == len(head.faces)
    assert np.allclose(document["raw_from_truth"], raw.raw_from_truth)
    arrays = np.load(folder / "truth.npz")
    assert np.array_equal(arrays["albedo_linear"], head.albedo_linear)
    assert np.array_equal(arrays["label"], head.label)
    mesh = trimesh.load(folder / "clean.ply", process=False)
    assert np.allclose(mesh.vertices, head.positions_mm, atol=1e-4)
