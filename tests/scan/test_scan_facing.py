"""Where a head looks and how large it is, from its shape: our phantoms and real scans."""

from __future__ import annotations

import numpy as np
import pytest
from scan_shapes import SCANS, sphere

from scanrender.phantom.damage import Damage, scan_head
from scanrender.phantom.head import make_head
from scanrender.scan.clean import clean
from scanrender.scan.facing import find_facing, spread_samples
from scanrender.scan.frame import find_frame
from scanrender.scan.ingest import read_scan
from scanrender.scan.inspect import inspect_scan
from scanrender.scan.raw import RawMesh
from scanrender.settings.prep import CleanSettings
from scanrender.settings.scan import ScanSettings


@pytest.fixture(scope="module", params=[0, 1, 2])
def phantom(request):
    """A damaged, tilted head in inches, +Y up and facing +Z but for the tilt of 7 degrees."""
    scan = scan_head(make_head(12_000, request.param), Damage(), request.param)
    return RawMesh(scan.positions, scan.faces.astype(np.int64)), scan.raw_from_truth


def turned(raw, matrix):
    return RawMesh(raw.positions @ np.asarray(matrix, float).T, raw.faces)


def test_phantoms_are_recognised_with_their_unit_and_both_axes(phantom):
    raw, _ = phantom
    frame = clean(raw, ScanSettings(), CleanSettings()).frame
    assert frame.axes["up"] == "+y"
    assert (frame.axes["front"], frame.axes["front_turn_deg"]) == ("+z", 0.0)
    assert frame.axes["front_confidence"] in ("medium", "high")
    assert frame.mm_per_unit == pytest.approx(25.4)
    assert not frame.warnings


@pytest.mark.parametrize("degrees", [90, 180, -60])
def test_the_face_is_turned_to_the_front_from_wherever_it_looked(phantom, degrees):
    raw, raw_from_truth = phantom
    angle = np.radians(degrees)
    about_up = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    frame = clean(turned(raw, about_up), ScanSettings(), CleanSettings()).frame
    forward = np.asarray(about_up) @ raw_from_truth[:3, 2]
    forward /= np.linalg.norm(forward)
    # What is left is the phantom's own tilt, and at most the turn that is not worth taking out.
    assert (frame.rotation @ forward)[2] > np.cos(np.radians(17.0))
    assert np.linalg.det(frame.rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(frame.rotation @ [0, 1, 0], [0, 1, 0], atol=1e-12)


def test_a_head_lying_with_its_crown_along_z_stands_up(phantom):
    """Z up, face toward -y, as Blender exports: the cut through the neck tells."""
    raw, _ = phantom
    frame = clean(
        turned(raw, [[1, 0, 0], [0, 0, -1], [0, 1, 0]]), ScanSettings(), CleanSettings()
    ).frame
    assert (frame.axes["up"], frame.axes["up_confidence"]) == ("+z", "high")
    assert frame.axes["front"] == "-y"


def test_a_ball_has_no_face_and_says_so():
    positions, faces, _ = sphere(150.0)
    points, normals = spread_samples(positions, faces)
    assert find_facing(points, normals) is None
    frame = find_frame(RawMesh(positions, faces), positions, faces, ScanSettings())
    assert frame.axes["front_confidence"] == "low"
    assert any("scan.front" in warning for warning in frame.warnings)


def test_what_is_stated_is_not_doubted(phantom):
    raw, _ = phantom
    settings = ScanSettings(units="cm", up="-x", front="+y")
    frame = clean(raw, settings, CleanSettings()).frame
    assert frame.mm_per_unit == 10.0
    np.testing.assert_allclose(frame.rotation @ [-1, 0, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(frame.rotation @ [0, 1, 0], [0, 0, 1], atol=1e-12)
    assert frame.axes["front_confidence"] == "stated"


@pytest.mark.parametrize(
    ("name", "front", "turn", "mm_per_unit", "tolerance"),
    [
        # Seen on pictures; the manifest's millimetres for Lee Perry-Smith are 48.8 a unit.
        ("lee_perry_smith/LeePerrySmith.obj", "+z", 0, 48.8, 0.05),
        ("james_3dmd/james.obj", "+z", 0, 1.0, 0.0),
        ("fran_cyberware/fran_cut.obj", "+x", 36, 1000.0, 0.0),
        ("roman_bust/bust.glb", "+z", 0, 1000.0, 0.0),
    ],
)
def test_real_heads_face_forward(name, front, turn, mm_per_unit, tolerance):
    path = SCANS / name
    if not path.exists():
        pytest.skip(f"the real scan {name} is not on this machine")
    health = inspect_scan(path)
    assert health["axes"]["up"] == "+y"
    assert health["axes"]["front"] == front
    assert health["axes"]["front_turn_deg"] == pytest.approx(turn, abs=5)
    assert health["units"]["mm_per_unit"] == pytest.approx(mm_per_unit, rel=tolerance or 1e-9)
    assert health["axes"]["front_confidence"] in ("medium", "high")
    scale_is_a_guess = any("the scale is a guess" in warning for warning in health["warnings"])
    assert scale_is_a_guess == (health["units"]["confidence"] == "low")


@pytest.mark.skipif(not (SCANS / "igea").exists(), reason="needs ../shared/scans/igea")
def test_a_bun_of_hair_is_not_taken_for_a_nose():
    """It stands out further than the nose does, and its lower edge even more, in one slice."""
    cleaned = clean(read_scan(SCANS / "igea" / "igea.ply"), ScanSettings(up="+y"), CleanSettings())
    assert cleaned.frame.axes["front"] == "+z"
    points, normals = spread_samples(cleaned.surface.positions, cleaned.surface.faces)
    points, normals = points[:, [2, 0, 1]], normals[:, [2, 0, 1]]
    for degrees in range(0, 360, 45):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        found = find_facing(points @ turn, normals @ turn)
        # It may not know. It must not be wrong.
        if found is not None:
            off = (np.degrees(found.yaw) - degrees + 180.0) % 360.0 - 180.0
            assert abs(off) < 15.0


@pytest.mark.parametrize("flat", [0, 1, 2])
def test_a_flat_sheet_is_not_taken_for_a_bust_cut_off_at_its_base(flat):
    """Its whole border lies at both ends of the axis across it: that says nothing about up."""
    corners = np.insert([[0.0, 0.0], [200.0, 0.0], [200.0, 300.0], [0.0, 300.0]], flat, 7.0, axis=1)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    axes = find_frame(RawMesh(corners, faces), corners, faces, ScanSettings()).axes
    assert axes["up_confidence"] != "high"
