"""Preparation at the extremes: a sound asset of the right size or one sentence, and nothing else.

Cleaning is drawn over shapes, units and places; the whole way from file to asset is gone once for
each kind of broken mesh.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from render.synthetic import AMBIENT, pipeline
from scan.scan_shapes import sphere, write_obj

from scanrender import images
from scanrender.asset import Asset
from scanrender.errors import ScanrenderError
from scanrender.measure.extreme_meshes import mesh
from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.scan.clean import clean
from scanrender.scan.prepare import prepare
from scanrender.scan.raw import RawMesh
from scanrender.settings.prep import BakeSettings, CleanSettings, PrepSettings, SimplifySettings
from scanrender.settings.scan import ScanSettings

Arrays = tuple[np.ndarray, np.ndarray]
TRIANGLE: Arrays = (np.array([[0.0, 0, 0], [100, 0, 0], [0, 100, 0]]), np.array([[0, 1, 2]]))


def ball(rows: int = 10) -> Arrays:
    positions, faces, _ = sphere(50.0, rows, 2 * rows)
    return positions, faces


def joined(*parts: Arrays) -> Arrays:
    starts = np.cumsum([0, *(len(p) for p, _ in parts)])
    faces = [f + start for (_, f), start in zip(parts, starts, strict=False)]
    return np.vstack([p for p, _ in parts]), np.vstack(faces)


def slivers() -> Arrays:
    """A ball, and triangles a million times as long as they are wide across it."""
    angle = np.linspace(0.0, np.pi, 12, endpoint=False)
    way = 50.0 * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    aside = way[:, [1, 0, 2]] * [-1e-6, 1e-6, 0.0]
    points = np.stack([-way, way, way + aside], axis=1).reshape(-1, 3)
    return joined(ball(), (points, np.arange(len(points)).reshape(-1, 3)))


def folded() -> Arrays:
    """Two faces on the same corners, turned away from each other, and their neighbours."""
    corners = np.array([[0.0, 0, 0], [100, 0, 0], [100, 100, 0], [0, 100, 0]])
    return corners, np.array([[0, 1, 2], [0, 2, 3], [0, 2, 1], [0, 3, 2]])


def zero_area() -> Arrays:
    positions, faces = ball()
    line = np.stack([np.arange(40), np.arange(40) + 1, np.arange(40)], axis=1)
    return positions, np.vstack([faces, line, np.repeat(np.arange(9)[:, None], 3, axis=1)])


def pieces(count: int = 300) -> Arrays:
    """Triangles in a ball, none of which touches another."""
    rng = np.random.default_rng(1)
    middle = rng.uniform(-48.0, 48.0, (count, 1, 3))
    corners = middle + rng.normal(size=(count, 3, 3)) * 0.7
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def torn() -> Arrays:
    """Every third face turned inside out."""
    positions, faces = ball()
    return positions, np.where(np.arange(len(faces))[:, None] % 3, faces, faces[:, ::-1])


def with_nan() -> Arrays:
    positions, faces = ball()
    return np.where(np.arange(len(positions))[:, None] % 17, positions, np.nan), faces


def inverted() -> Arrays:
    positions, faces = ball()
    return positions, faces[:, ::-1]


SHAPES = {
    "triangle": lambda: TRIANGLE,
    "ball": ball,
    "slivers": slivers,
    "folded": folded,
    "zero area": zero_area,
    "shells": lambda: joined(ball(), ball()),
    "pieces": pieces,
    "inverted": inverted,
    "torn": torn,
    "points": lambda: (np.ones((3, 3)), np.array([[0, 1, 2]])),
    "nan": with_nan,
}  # fmt: skip


def outcome(call: Callable[[], Any]) -> Any:
    """What `call` returns, or the refusal that it raises: one sentence, no traceback."""
    try:
        return call()
    except ScanrenderError as error:
        refusal = error
    assert refusal.what
    assert "\n" not in refusal.what
    assert "Traceback" not in str(refusal)
    return refusal


KEEPS_ALL = CleanSettings(floater_fraction=0.0, hole_mm=0.0, spike_sigma=100.0)


def corner_uv(kind: str, faces: np.ndarray) -> np.ndarray | None:
    if kind == "none":
        return None
    uv = np.random.default_rng(0).random((len(faces), 3, 2)).astype(np.float32)
    return {"inside": uv, "outside": uv * 40.0 - 17.0, "huge": uv * 1e30, "nan": uv * np.nan}[kind]


@given(
    # Vertices that are no numbers are dropped as a file is read.
    shape=st.sampled_from(sorted(set(SHAPES) - {"nan"})),
    exponent=st.integers(-6, 6),
    offset=st.sampled_from([0.0, 1.0, 1e3, 1e7]),
    way=st.tuples(*[st.sampled_from([-1.0, 0.0, 1.0])] * 3),
    uv=st.sampled_from(["none", "inside", "outside", "huge", "nan"]),
)
def test_cleaning_keeps_size_and_place_in_any_unit(shape, exponent, offset, way, uv):
    """The unit is stated, the offset is in the scan's own units: what comes out is in mm, around
    the origin, as large as what went in."""
    made, faces = SHAPES[shape]()
    unit = 10.0**exponent
    positions = made * unit + offset * np.array(way)
    raw = RawMesh(positions, faces, corner_uv(uv, faces))
    settings = ScanSettings(units=1.0 / unit, up="+y", front="+z")
    cleaned = outcome(lambda: clean(raw, settings, KEEPS_ALL))
    if isinstance(cleaned, ScanrenderError):
        # Of what has no area, or less of it than coordinates so far out can tell.
        assert shape == "points" or offset > 1e3 * unit, cleaned
        return
    surface = cleaned.surface
    found = surface.positions
    assert np.isfinite(found).all()
    assert surface.faces.max() < len(found)
    drawn = made[np.unique(faces)]
    size = np.nanmax(drawn, axis=0) - np.nanmin(drawn, axis=0)
    # What is left of the digits of a coordinate beside its offset.
    digits = 4.0 * np.spacing(offset) / unit + 1e-5 * size.max()
    np.testing.assert_allclose(np.ptp(found, axis=0), size, atol=digits)
    assert np.abs(found).max() < 2.0 * size.max()


SMALL = PrepSettings(
    simplify=SimplifySettings(triangles=400),
    bake=BakeSettings(albedo_px=64, normal_px=64, data_px=64, ao_rays=4, thickness_rays=2),
    report="short",
)


def holds(asset: Asset, size_mm: np.ndarray) -> None:
    """Finite, in range, and of the size that the scan has."""
    asset_mesh = asset.mesh
    for name in ("positions_mm", "normals", "tangents", "uv"):
        assert np.isfinite(getattr(asset_mesh, name)).all(), name
    np.testing.assert_allclose(np.linalg.norm(asset_mesh.normals, axis=1), 1.0, atol=1e-3)
    assert asset_mesh.uv.min() >= 0.0
    assert asset_mesh.uv.max() <= 1.0
    assert np.ptp(asset_mesh.positions_mm, axis=0) == pytest.approx(size_mm, rel=0.1, abs=2.0)
    for name, pixels in asset.maps.items():
        assert np.isfinite(pixels).all(), name
        if name in ("albedo", "ao", "skin"):
            assert pixels.min() >= 0.0, name
            assert pixels.max() <= 1.0 + 1e-6, name  # a float32 mean of ones


@pytest.mark.parametrize(
    ("shape", "as_is"),
    [("triangle", False), ("slivers", False), ("slivers", True), ("folded", False),
     ("shells", True), ("pieces", False), ("pieces", True), ("inverted", False), ("nan", False)],
)  # fmt: skip
def test_a_broken_mesh_becomes_an_asset_or_a_sentence(tmp_path: Path, shape: str, as_is: bool):
    positions, faces = SHAPES[shape]()
    uv = corner_uv("outside" if shape == "slivers" else "inside", faces)
    scan = write_obj(tmp_path / "scan.obj", positions, faces, None if as_is else uv)
    mm, out = ScanSettings(units="mm"), tmp_path / "asset"
    asset = outcome(lambda: prepare(scan, mm, SMALL, out, as_is=as_is))
    if isinstance(asset, ScanrenderError):
        assert shape in ("triangle", "folded", "pieces"), asset
        assert not out.exists()
        return
    size = np.sort(np.nanmax(positions, axis=0) - np.nanmin(positions, axis=0))
    holds(asset, size[np.argsort(np.argsort(np.ptp(asset.mesh.positions_mm, axis=0)))])


@pytest.mark.parametrize("kind", ["black", "white", "hdr", "nan"])
def test_any_texture_becomes_an_albedo(tmp_path: Path, kind: str):
    positions, faces, uv = sphere(100.0, 10, 20)
    pixels = np.random.default_rng(2).random((16, 16, 3)).astype(np.float32)
    texture = {
        "black": 0.0 * pixels,
        "white": np.ones_like(pixels),
        "hdr": 1e5 * pixels,
        "nan": np.where(pixels < 0.2, np.nan, pixels),
    }[kind].astype(np.float32)
    if kind in ("black", "white"):
        images.write_png8(tmp_path / "map.png", texture)
    else:
        images.write_image(tmp_path / "map.exr", texture)
    name = "map.png" if kind in ("black", "white") else "map.exr"
    (tmp_path / "m.mtl").write_text(f"newmtl skin\nmap_Kd {name}\n")
    scan = write_obj(tmp_path / "scan.obj", positions, faces, uv, "m.mtl")
    mm = ScanSettings(units="mm")
    asset = outcome(lambda: prepare(scan, mm, SMALL, tmp_path / "asset"))
    if isinstance(asset, ScanrenderError):
        assert kind in ("hdr", "nan"), asset
        assert name in f"{asset.what} {asset.where}"
        return
    holds(asset, np.array([200.0, 200.0, 200.0]))
    if kind in ("black", "white"):
        assert np.median(asset.maps["albedo"]) == pytest.approx(float(kind == "white"), abs=0.02)


MANY = 100_000


def test_a_hundred_thousand_pieces_are_cleaned():
    """Each is looked at, kept or dropped by its size and place; none is looked at by each other."""
    positions, faces = joined(ball(60), pieces(MANY))
    cleaned = clean(RawMesh(positions, faces), ScanSettings(units="mm"), CleanSettings())
    assert len(cleaned.surface.faces) == len(ball(60)[1])
    kept = clean(RawMesh(positions, faces), ScanSettings(units="mm"), KEEPS_ALL).surface
    assert len(kept.faces) == len(faces)


@pytest.mark.gl
def test_a_hundred_thousand_pieces_are_rendered(gl: Device):
    positions, faces = pieces(MANY)
    corners = positions[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    uv = np.random.default_rng(3).random((len(positions), 2))
    asset = Asset(mesh(positions, np.repeat(normals, 3, axis=0), uv, faces), {})
    lamp = {"type": "directional", "azimuth_deg": 50, "shadow_px": 256}
    settings = pipeline(
        camera={"width_px": 96, "height_px": 96}, lights=[lamp, AMBIENT], quality={"check": True}
    )
    renderer = Renderer(gl, asset, settings)
    beauty = renderer.render(renderer.view(0)).buffers["beauty"]
    assert np.isfinite(beauty).all()
    assert beauty.max() > 0.05
