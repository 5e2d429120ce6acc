"""Near over far to 1:5e7, what cannot be drawn, subjects smaller than a pixel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from render.synthetic import (
    AMBIENT,
    MATT,
    flat_map,
    joined,
    pipeline,
    quad,
    render,
    sphere,
    sphere_mesh,
)

from scanrender.asset import Asset, load_asset, save_asset
from scanrender.errors import ConfigError, ScanError
from scanrender.render.device import Device
from scanrender.render.frame import Renderer

pytestmark = pytest.mark.gl

NONE = {"diffusion": {"method": "none"}}
TWO_TONE = {"albedo": np.array([[(0.0,) * 3, (1.0,) * 3]], np.float32)}


def sheets(gap_mm: float) -> Asset:
    """A bright sheet and, behind it, a dark one; drawn back to front and front to back."""
    h = 100.0
    dark = quad((-h, -h), (h, h), z=-100.0 - gap_mm, u=(0.25, 0.25), v=(0.5, 0.5))
    bright = quad((-h, -h), (h, h), z=-100.0, u=(0.75, 0.75), v=(0.5, 0.5))
    return Asset(joined([bright, dark]), TWO_TONE)


@pytest.mark.parametrize("height_mm", [100.0, 1.0, 0.1, 1e-2, 1e-3])
@pytest.mark.parametrize("gap_mm", [0.01, 0.5, 10.0])
def test_what_lies_behind_stays_behind(gl: Device, height_mm: float, gap_mm: float):
    """From within, far over near is 5e7; 24 bits of the depth's reciprocal lost half a millimetre
    at 5e5, and the back of the head was in front of the face."""
    for asset in (sheets(gap_mm), reversed_faces(sheets(gap_mm))):
        settings = pipeline(MATT, NONE, camera={"height_mm": height_mm}, quality={"check": True})
        made = render(gl, asset, settings, "albedo", "depth_mm")
        assert made["alpha"].min() == 1.0
        assert made["albedo"].min() > 0.99
        assert np.ptp(made["depth_mm"]) < 1e-3 * made["depth_mm"].max()


def reversed_faces(asset: Asset) -> Asset:
    return Asset(replace(asset.mesh, faces=asset.mesh.faces[::-1]), asset.maps)


def test_a_lamp_in_the_middle_of_something_huge_still_casts_shadows(gl: Device):
    """A point lamp a millimetre from the centre: its map's far plane is 1e7 times the near one."""
    ball = sphere_mesh(1e5, 32)
    faces = np.ascontiguousarray(ball.faces[:, ::-1])
    inverted = replace(ball, faces=faces, normals=-ball.normals)
    screen = quad((-100.0, -100.0), (100.0, 100.0), z=-300.0)
    lamp = {"type": "point", "position_mm": [0.0, 0.0, -1.0], "shadow_px": 256}
    camera = {"height_mm": 300.0, "elevation_deg": 0}
    for order in ([inverted, screen], [screen, inverted]):
        asset = Asset(joined(order), {"albedo": flat_map(1.0, 1.0, 1.0)})
        shot = pipeline(MATT, NONE, camera=camera, lights=[lamp], quality={"check": True})
        lit = render(gl, asset, shot, "visibility_0", "depth_mm")
        seen = lit["visibility_0"][lit["depth_mm"] > 0]
        assert np.median(seen) == 1.0, "the screen is the first that the light meets"


@given(
    size_mm=st.sampled_from([1e-4, 1e-2, 1.0]),
    projection=st.sampled_from(["orthographic", "perspective"]),
    height_mm=st.sampled_from([10.0, 260.0, 1e5]),
)
def test_a_subject_smaller_than_a_pixel_is_sound(gl: Device, size_mm, projection, height_mm):
    """Triangles thinner than the rasteriser's grid were drawn behind a camera near them."""
    settings = pipeline(
        camera={"width_px": 37, "height_px": 91, "projection": projection, "height_mm": height_mm},
        quality={"supersampling": 1, "check": True},
    )
    render(gl, sphere(size_mm, (0.7, 0.5, 0.4), rings=14), settings)


@given(scale=st.floats(-4.0, 4.0).map(lambda e: 10.0**e))
def test_curvature_has_no_unit_of_its_own(gl: Device, scale: float):
    """A pixel below a micrometre had none: a determinant was compared with 1e-12."""
    radius = 50.0 * scale
    made = render(gl, sphere(radius, rings=48), pipeline(MATT, NONE), "curvature_raw")
    seen = made["curvature_raw"][made["alpha"] == 1.0]
    assert np.median(seen) == pytest.approx(min(1.0 / radius, 2.0), rel=0.02)


def test_an_unseen_fine_mesh_changes_no_curvature(gl: Device):
    settings = pipeline(MATT, lights=[{"type": "directional", "azimuth_deg": 60}, AMBIENT],
                        curvature={"modulation": "reduce", "smooth_mm": 4.0})  # fmt: skip
    outer, inner = sphere_mesh(40.0, 24), sphere_mesh(2.0, 120)
    alone = Asset(outer, {"albedo": flat_map(0.7, 0.5, 0.4)})
    both = Asset(joined([outer, inner]), alone.maps)
    one, two = (render(gl, asset, settings, "curvature") for asset in (alone, both))
    np.testing.assert_allclose(one["curvature"], two["curvature"], atol=1e-4)
    np.testing.assert_allclose(one["beauty"], two["beauty"], atol=2e-3)


@pytest.mark.parametrize("name", ["positions_mm", "normals", "tangents", "uv"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_vertex_that_is_no_number_is_refused(gl: Device, tmp_path, name: str, value: float):
    ball = sphere(30.0, rings=8)
    broken = getattr(ball.mesh, name).copy()
    broken[7, 1] = value
    asset = Asset(replace(ball.mesh, **{name: broken}), ball.maps)
    with pytest.raises(ScanError, match=f"1 vertices have {name} that are not finite"):
        Renderer(gl, asset, pipeline(MATT))
    if name != "positions_mm":  # its bounds are part of the file
        with pytest.raises(ScanError, match="not finite"):
            load_asset(save_asset(asset, tmp_path / "asset"))


def test_meshes_that_are_none_are_refused(gl: Device):
    ball = sphere(30.0, rings=8)
    for faces, what in (
        (np.zeros((0, 3), np.uint32), "the mesh is empty"),
        (np.array([[0, 1, 9999]], np.uint32), "a face names vertex 9999 of"),
    ):
        with pytest.raises(ScanError, match=what):
            Renderer(gl, Asset(replace(ball.mesh, faces=faces), ball.maps), pipeline(MATT))


def test_a_picture_as_wide_as_gl_allows_has_no_guard_band_and_a_wider_one_is_refused(gl: Device):
    widest = gl.most_px
    for width, height in ((widest, 2), (2, widest)):
        settings = pipeline(MATT, camera={"width_px": width, "height_px": height, "height_mm": 9.0},
                            diffusion={"samples": 3})  # fmt: skip
        renderer = Renderer(gl, sphere(30.0, rings=8), settings)
        assert renderer.guard_px == 0
        beauty = renderer.render(renderer.view(0)).buffers["beauty"]
        assert beauty.shape == (height, width, 3)
    small = replace_limit(gl, 64)
    with pytest.raises(ConfigError, match=r"96 x 96 px is more than this GL holds: 64"):
        Renderer(small, sphere(30.0, rings=8), pipeline(MATT))


def replace_limit(gl: Device, most_px: int) -> Device:
    small = Device(gl.context)
    small.most_px = most_px
    return small
