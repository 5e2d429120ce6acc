"""What `bench fidelity` measures is there, and what is broken on purpose is found."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from scanrender.asset import Asset, Mesh, load_asset
from scanrender.errors import DeviceError, UsageError
from scanrender.images import read_image
from scanrender.measure import fidelity, seams
from scanrender.measure.bust import bust_scan, phantom_bust
from scanrender.measure.compare_views import compare_views, picture_error
from scanrender.measure.fidelity import FidelityCase, bench_fidelity, fidelity_text, shape_losses
from scanrender.measure.limits import missed_limits
from scanrender.measure.prep_inputs import REAL_HEAD
from scanrender.measure.seams import seam_edges, seam_visibility
from scanrender.metrics import summarize
from scanrender.scan.ingest import read_scan
from scanrender.scan.rasterize import rasterize

BAKE = {"albedo_px": 256, "normal_px": 256, "data_px": 128, "ao_rays": 4, "thickness_rays": 1}
TRIANGLES = 2500


@cache
def make_phantom(folder: Path, scans: Path):
    return phantom_bust(folder, 8000, 256)


CASE = FidelityCase("tiny", "a tiny phantom", make_phantom, "raw", TRIANGLES, BAKE, 72, 1)


@pytest.fixture(scope="module")
def bench(tmp_path_factory, gl):
    """(row, asset, folder of the bench): one whole run of a tiny case, with one close-up."""
    out = tmp_path_factory.mktemp("fidelity")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(seams, "AZIMUTHS_DEG", (90.0,))
        (row,) = bench_fidelity([CASE], out, out, lambda words: None)
        yield row, load_asset(out / "assets" / "fidelity_tiny"), out


@pytest.mark.gl
def test_a_row_holds_all_that_is_promised(bench):
    row, _, out = bench
    assert "failed" not in row
    assert row["triangles"] <= 1.02 * TRIANGLES
    assert 0.0 < row["distance_raw_mm"]["mean"] < 1.0
    assert row["components_changed"] == 0
    assert row["front"]["count"] > 500
    told = missed_limits([row])
    assert not [sentence for sentence in told if "not measured" in sentence]
    # 3000 triangles and 96 pixels are too few for limits that are meant for 50 k: they are told.
    assert any("distance_raw_mm" in sentence for sentence in told)
    assert "picture, front" in fidelity_text([row])
    pictures = out / "pictures" / "tiny"
    for name in ("front_asset", "front_as_is", "front_de2000", "profile_de2000", "seams_090_where"):
        assert (pictures / f"{name}.png").exists()
    red = read_image(pictures / "seams_090_where.png")[:, :, 0] == 1.0
    assert red.any(), "the seams are marked"


@pytest.mark.gl
def test_the_same_asset_twice_has_no_error_and_no_seams(bench, tmp_path):
    _, asset, out = bench
    folder = out / "assets" / "fidelity_tiny"
    views = compare_views(folder, folder, tmp_path, 64, 1)
    assert views["front"]["maximum"] == 0.0
    seen = seam_visibility(asset, asset, tmp_path, 72)
    assert seen["contrast"] == pytest.approx(1.0)
    assert seen["de2000_seam"] == 0.0


@pytest.mark.gl
def test_a_seam_that_shows_is_found(bench, tmp_path):
    """Without gutters, filters reach beyond the charts, where nothing was baked."""
    _, asset, _ = bench
    albedo = asset.maps["albedo"]
    covered = rasterize(asset.mesh.uv, asset.mesh.faces, len(albedo)).mask
    bare = Asset(asset.mesh, {**asset.maps, "albedo": albedo * covered[:, :, None]}, asset.info)
    seen = seam_visibility(asset, bare, tmp_path, 144)
    assert seen["seam_px"] > 50
    assert seen["contrast"] > 1.05
    assert seen["de2000_seam"] > 2.0 * seen["de2000_near"]


def test_lost_ears_and_pieces_are_found(bench):
    _, asset, out = bench
    truth = make_phantom(out / "inputs", out)
    whole = shape_losses(asset, truth)
    assert whole["ears_mm"]["max"] < 4.0
    mesh = asset.mesh
    middle = mesh.positions_mm[mesh.faces].mean(axis=1)
    ear = middle[:, 0] > 0.8 * middle[:, 0].max()
    assert 0 < ear.sum() < 0.3 * len(ear)
    deaf = Asset(replace(mesh, faces=mesh.faces[~ear]), asset.maps, asset.info)
    assert shape_losses(deaf, truth)["ears_mm"]["max"] > whole["ears_mm"]["max"] + 3.0
    far = Mesh(
        np.concatenate([mesh.positions_mm, mesh.positions_mm[:3] + 50.0]),
        *(np.concatenate([x, x[:3]]) for x in (mesh.normals, mesh.tangents, mesh.uv)),
        np.concatenate([mesh.faces, len(mesh.positions_mm) + np.arange(3, dtype=np.uint32)[None]]),
    )
    assert shape_losses(Asset(far, {}, asset.info), truth)["components_changed"] == 1


def test_seam_edges_are_cut_in_the_atlas_and_whole_on_the_surface():
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    split = np.concatenate([corners, corners[[0, 2]]])  # the diagonal 0-2 exists twice
    faces = np.array([[0, 1, 2], [4, 5, 3]], np.uint32)
    blank = np.zeros((6, 4), np.float32)
    lines = seam_edges(Mesh(split, blank[:, :3], blank, blank[:, :2], faces))
    assert len(lines) == 2, "once from each side"
    for line in lines:
        assert {tuple(end) for end in line} == {(0.0, 0.0, 0.0), (1.0, 1.0, 0.0)}
    joined = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
    mesh = Mesh(corners, blank[:4, :3], blank[:4], blank[:4, :2], joined)
    assert len(seam_edges(mesh)) == 0


def test_without_a_device_the_shape_is_measured_and_pictures_are_missed(
    bench, tmp_path, monkeypatch
):
    _, asset, out = bench
    truth = make_phantom(out / "inputs", out)

    def no_pictures(*_):
        raise DeviceError("no usable OpenGL")

    monkeypatch.setattr(fidelity, "_pictures", no_pictures)
    monkeypatch.setattr(fidelity, "prepare", lambda *_, **__: asset)
    said = []
    blind = replace(CASE, name="blind", make=lambda folder, scans: truth)
    (row,) = bench_fidelity([blind], tmp_path, tmp_path, said.append)
    assert row["distance_truth_mm"]["mean"] > 0.0
    told = missed_limits([row])
    assert "blind: front.mean was not measured" in told
    assert "blind: seams.contrast was not measured" in told
    assert any("no usable OpenGL" in words for words in said)


def test_a_bust_keeps_its_texture_coordinates_and_its_truth(tmp_path, monkeypatch):
    """A tetrahedron with a texture stands for the real head."""
    monkeypatch.setattr("scanrender.measure.bust.PAGE_PX", 64)
    source = tmp_path / REAL_HEAD
    source.parent.mkdir(parents=True)
    source.write_text(
        "mtllib head.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
        "vt 0.1 0.1\nvt 0.4 0.1\nvt 0.1 0.4\nvt 0.9 0.9\nusemtl skin\n"
        "f 1/1 3/3 2/2\nf 1/1 2/2 4/4\nf 2/2 3/3 4/4\nf 1/1 4/4 3/3\n"
    )
    (source.parent / "head.mtl").write_text("newmtl skin\nmap_Kd head.png\n")
    from scanrender.images import write_png8

    ramp = np.linspace(0.2, 0.8, 16)
    write_png8(source.parent / "head.png", np.stack(np.meshgrid(ramp, ramp) * 2, axis=-1)[:, :, :3])
    truth = bust_scan(tmp_path / "inputs", tmp_path, 0.1, levels=3)
    raw = read_scan(truth.scan)
    assert len(raw.faces) == 4 * 64 == len(truth.faces)
    assert np.ptp(truth.positions_mm[:, 1]) > 100.0
    error = np.linalg.norm(raw.positions - truth.positions_mm, axis=1)
    assert error.std() < 0.15
    assert 0.05 < np.sqrt((error**2).mean()) < 0.15
    assert raw.corner_uv.min() == pytest.approx(0.1, abs=1e-6)
    assert raw.color_source == "texture"
    assert truth.components == 1
    with pytest.raises(UsageError, match="no such scan"):
        bust_scan(tmp_path / "x", tmp_path / "nowhere", 0.0)


def test_unknown_cases_are_refused():
    with pytest.raises(UsageError, match="no such case"):
        fidelity.fidelity_list("noise_9")
    assert len(fidelity.fidelity_list("all")) == 5


@pytest.mark.gl
def test_a_changed_picture_is_measured(bench, gl):
    _, asset, _ = bench
    from scanrender.measure.compare_views import renderer_like, view_settings
    from scanrender.render.frame import View

    settings = view_settings(64, 1)
    first = renderer_like(asset, settings)
    darker = {**asset.maps, "albedo": 0.7 * asset.maps["albedo"]}
    second = renderer_like(Asset(asset.mesh, darker, asset.info), settings, first)
    frames = [renderer.render(View(0, 0.0, 0.0)) for renderer in (first, second)]
    assert summarize(*picture_error(*frames)).mean > 3.0
