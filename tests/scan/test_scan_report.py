"""What is reported of a preparation is true, and the phantom's preparation is good."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scan_shapes import grid, sphere, write_obj

from scanrender import images
from scanrender.asset import PREP_REPORT, PREP_SHEET, PREP_VIEWS, Mesh, load_asset
from scanrender.batch.prep_report import draw_prep_sheet
from scanrender.outputs.contact_sheet import Tile
from scanrender.outputs.prep_sheet import tiles
from scanrender.phantom import LABELS, make_head, write_ply
from scanrender.scan.high import Low
from scanrender.scan.prepare import prepare
from scanrender.scan.rays import Target
from scanrender.scan.report import atlas_report, density_spread
from scanrender.scan.unwrap import Unwrapped
from scanrender.settings.prep import PrepSettings
from scanrender.settings.scan import ScanSettings

MM = ScanSettings(units="mm", up="+y", front="+z")


def sheet_low(uv_of_xy):
    """A flat 40 mm square as a prepared mesh, with texture coordinates uv_of_xy(x, y) in [0, 1]."""
    positions, faces = grid(lambda x, y: 0.0 * x)
    uv = np.stack(uv_of_xy(*(positions[:, :2].T / 40.0 + 0.5)), axis=1)
    up = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (len(positions), 1))
    mesh = Mesh(positions.astype(np.float32), up, np.zeros((len(up), 4), np.float32),
                uv.astype(np.float32), faces.astype(np.uint32))  # fmt: skip
    chart = np.zeros(len(faces), np.int64)
    unwrapped = Unwrapped(np.arange(len(positions)), faces, uv, chart, {"charts": 1, "flipped": 0})
    return Low(positions, faces, up.astype(float), unwrapped, mesh)


def test_density_is_linear_texels_per_millimetre():
    even = density_spread(sheet_low(lambda x, y: (x, y)), 800)
    assert even["median_px_per_mm"] == pytest.approx(20.0, rel=1e-3)
    assert even["within_1_5"] == 1.0
    # u = x^2: density sqrt(2x), by texels of median x = sqrt(1/2); 1.5 times that is beyond the
    # end, and a factor 1.5 below it lies at x = sqrt(1/2) / 2.25, under which are 9.9 % of texels.
    uneven = density_spread(sheet_low(lambda x, y: (x * x, y)), 800)
    assert uneven["within_1_5"] == pytest.approx(1.0 - 0.5 / 2.25**2, abs=0.01)


def test_atlas_use_and_overlap_are_measured():
    half = atlas_report(sheet_low(lambda x, y: (0.5 * x, y)), 512)
    assert half["atlas_use"] == pytest.approx(0.5, abs=1e-5)
    assert half["overlap"] == 0.0
    # Folded over in the middle: everything lies twice.
    folded = atlas_report(sheet_low(lambda x, y: (np.abs(x - 0.5), y)), 512)
    assert folded["overlap"] > 0.95


@pytest.fixture(scope="module")
def prepared(tmp_path_factory):
    """The undamaged phantom, prepared: its truth, its asset."""
    folder = tmp_path_factory.mktemp("phantom")
    head = make_head(60_000)
    scan = write_ply(folder / "head.ply", head)
    settings = PrepSettings.model_validate(
        {
            "simplify": {"triangles": 20_000},
            "bake": {"albedo_px": 1024, "normal_px": 512, "data_px": 512, "ao_rays": 16},
        }
    )
    return head, prepare(scan, MM, settings, folder / "asset"), folder / "asset"


def test_the_phantoms_atlas_is_good(prepared):
    lost = prepared[1].info["lost"]
    assert lost["charts"] <= 60
    assert lost["flipped_triangles"] == 0
    assert lost["overlap"] < 1e-3
    assert lost["stretch"]["within_1_5"] >= 0.95
    assert lost["atlas_use"] > 0.58  # the padding of 4 px weighs four times more than at 4096


def test_the_phantoms_colours_are_kept(prepared):
    assert prepared[1].info["lost"]["color_de2000"]["mean"] < 1.0
    assert prepared[1].info["lost"]["symmetric_mm"]["mean"] < 0.05
    assert prepared[1].info["lost"]["symmetric_mm"]["p99"] < 0.2


def test_the_skin_map_agrees_with_the_phantoms_labels(prepared):
    head, asset, _ = prepared
    back = np.linalg.inv(np.array(asset.info["raw_from_asset"]))
    points = head.positions_mm @ back[:3, :3].T + back[:3, 3]
    near = Target(asset.mesh.positions_mm, asset.mesh.faces.astype(np.int64)).nearest(points)
    uv = np.einsum("kc,kcd->kd", near.bary, asset.mesh.uv[asset.mesh.faces[near.face]])
    side = asset.maps["skin"].shape[0]
    column, row = np.clip((uv * side).astype(int), 0, side - 1).T
    found = asset.maps["skin"][row, column, 0] > 0.5
    truth = np.isin(np.array(LABELS)[head.label], ["skin", "lips"])
    assert (found & truth).sum() / (found | truth).sum() >= 0.93
    assert (~found & ~truth).sum() / (~found | ~truth).sum() >= 0.9
    # Large areas do not hide the small ones.
    share = {name: found[head.label == k].mean() for k, name in enumerate(LABELS)}
    assert share["lips"] > 0.95
    assert share["hair"] < 0.1
    assert share["brow"] < 0.25
    assert share["eye"] < 0.35


def test_the_report_holds_health_before_and_losses_after(prepared):
    report = json.loads((prepared[2] / PREP_REPORT).read_text())
    assert report["health"]["triangles"] == len(prepared[0].faces)
    assert report["health"]["components"] == 1
    assert report["lost"]["color_de2000"]["mean"] > 0.0
    assert all(stage["seconds"] >= 0.0 for stage in report["stages"])


def test_the_sheet_shows_raw_and_prepared(prepared):
    folder = prepared[2]
    with np.load(folder / PREP_VIEWS) as stored:
        views = {name: stored[name] for name in stored.files}
    report = json.loads((folder / PREP_REPORT).read_text())
    shown = {tile.label: tile for tile in tiles(views, report)}
    assert {"raw shape, front", "triangles", "charts", "map: albedo", "map: skin"} <= set(shown)
    raw, prepared_ = (luminance(shown[label]) for label in list(shown)[:2])
    assert raw.std() > 0.1, "otherwise the picture is empty"
    assert np.abs(raw - prepared_).mean() < 0.01
    sheet = draw_prep_sheet(folder)
    assert sheet == folder / PREP_SHEET
    assert images.read_image(sheet).shape[1] > 1000
    assert not (folder / PREP_VIEWS).exists()
    assert draw_prep_sheet(folder) is None
    assert len(load_asset(folder, maps=()).mesh.faces) > 0


def luminance(tile: Tile):
    return tile.pixels @ [0.2126, 0.7152, 0.0722]


def test_a_short_report_and_fewer_maps(tmp_path):
    positions, faces, uv = sphere(100.0, 12, 24)
    scan = write_obj(tmp_path / "a.obj", positions, faces, uv)
    settings = PrepSettings.model_validate(
        {
            "report": "short",
            "bake": {"albedo_px": 64, "normal_px": 64, "maps": ["albedo", "normal_ts"]},
        }
    )
    asset = prepare(scan, MM, settings, tmp_path / "out")
    assert set(asset.maps) == {"albedo", "normal_ts"}
    assert asset.info["health"] is None
    assert not (tmp_path / "out" / PREP_VIEWS).exists()
    assert asset.info["lost"]["symmetric_mm"]["max"] < 1e-3
