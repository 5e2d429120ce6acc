"""Blurs that would reach past the subject stop there; normals of no length are no NaN."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from render.synthetic import AMBIENT, joined, pipeline, quad, render, sphere, sphere_mesh

from scanrender.asset import Asset
from scanrender.render.device import Device

pytestmark = pytest.mark.gl

RADIUS = 10.0
BALL = sphere(RADIUS, (0.7, 0.5, 0.4), rings=16)
CAMERA = {"camera": {"width_px": 48, "height_px": 48}, "quality": {"check": True}}
LAMP = {"type": "directional", "azimuth_deg": 110, "elevation_deg": 10, "shadow_px": 64}


def lit(blur_mm: float, **more: Any) -> Any:
    lights = [{**LAMP, "shadow_blur_mm": blur_mm}, AMBIENT]
    return pipeline(CAMERA, {"lights": lights}, more)


@pytest.mark.parametrize("blur_mm", [5.0, 10.0, 100.0])
def test_a_shadow_s_edge_is_no_wider_than_a_part_of_the_subject(gl: Device, blur_mm: float):
    """Taps spread wider than it would all miss it: three tenths of its radius and no more."""
    wall, board = quad((-10.0, -10.0), (10.0, 10.0)), quad((-4.0, -4.0), (4.0, 4.0), z=6.0)
    asset = Asset(joined([wall, board]), BALL.maps)
    radius = float(np.linalg.norm(asset.mesh.positions_mm, axis=1).max())
    seen = {}
    for radius_mm in (0.3 * radius, 0.5, blur_mm):
        lamp = {**LAMP, "azimuth_deg": -40, "shadow_blur_mm": radius_mm}
        shot = pipeline(CAMERA, lights=[lamp, AMBIENT])
        seen[radius_mm] = render(gl, asset, shot, "visibility_0")["visibility_0"]
    np.testing.assert_allclose(seen[blur_mm], seen[0.3 * radius], atol=1e-6)
    assert np.abs(seen[blur_mm] - seen[0.5]).max() > 0.1


@pytest.mark.parametrize("blur_mm", [3.0, 20.0])
def test_transmittance_is_averaged_over_a_part_of_the_subject(gl: Device, blur_mm: float):
    def through(radius_mm: float) -> np.ndarray:
        skin = {"skin": {"scale": 3.0, "transmission": {"blur_mm": radius_mm, "wrap": 0.3}}}
        return render(gl, BALL, lit(1.0, **skin), "transmittance")["transmittance"]

    made = through(blur_mm)
    assert made.max() > 1e-3
    np.testing.assert_allclose(made, through(0.3 * RADIUS), atol=1e-6)


@pytest.mark.parametrize("smooth_mm", [0.0, 5.0, 50.0])
def test_curvature_smoothed_past_the_subject_is_that_of_the_subject(gl: Device, smooth_mm: float):
    """Five of its radii: a mean over what is seen, no larger and no smaller than what is in it."""
    shot = pipeline(CAMERA, curvature={"modulation": "reduce", "smooth_mm": smooth_mm})
    made = render(gl, BALL, shot, "curvature", "depth_mm")
    seen = made["curvature"][made["depth_mm"] > 0.0]
    assert np.isfinite(seen).all()
    assert np.median(seen) == pytest.approx(1.0 / RADIUS, rel=0.1)
    assert seen.max() < 2.0 / RADIUS


@pytest.mark.parametrize("share", [0.02, 1.0])
@pytest.mark.parametrize("method", ["gaussian_sum", "separable_preintegrated", "disk"])
def test_normals_of_no_length_are_no_nan_and_stay_alone(gl: Device, method: str, share: float):
    mesh = sphere_mesh(RADIUS, 16)
    lost = np.random.default_rng(1).random(len(mesh.normals)) < share
    normals = np.where(lost[:, None], 0.0, mesh.normals).astype(np.float32)
    tangents = np.where(lost[:, None], 0.0, mesh.tangents).astype(np.float32)
    broken = Asset(replace(mesh, normals=normals, tangents=tangents), BALL.maps)
    shot = lit(1.0, diffusion={"method": method}, curvature={"modulation": "reduce"})
    made = render(gl, broken, shot, "normal_geometry", "depth_mm")
    seen = made["depth_mm"][:, :, 0] > 0.0
    length = np.linalg.norm(made["normal_geometry"][seen], axis=1)
    assert np.isfinite(made["beauty"]).all()
    np.testing.assert_allclose(length, 1.0, atol=1e-3)
    if share < 1.0:
        sound = render(gl, BALL, shot)["beauty"]
        off = np.abs(made["beauty"] - sound).max(axis=2)[seen]
        assert np.median(off) < 0.05 * sound.max()
