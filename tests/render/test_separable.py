"""The separable kernels on screen: exact sums, edges along rows and columns, and their cross."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render.edges import lit_edge
from render.synthetic import MATT, pipeline, plane, render, sphere

from scanrender.optics.profiles.gaussians import D_EON_SKIN, GaussianSum
from scanrender.render.device import Device, device
from scanrender.render.frame import Renderer
from scanrender.render.passes.separable import kernel_taps, taps_for
from scanrender.render.scene import Scene

pytestmark = pytest.mark.gl

PREINTEGRATED, ARTISTIC = "separable_preintegrated", "separable_artistic"
METHODS = (PREINTEGRATED, ARTISTIC)
HALOS = ("none", "depth", "cbf", "cbf_normalized", "measure")


def scene(**diffusion: Any) -> Scene:
    return Scene(device(), plane(10.0), pipeline(MATT, diffusion=diffusion))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("samples", [3, 4, 7, 17, 254, 255])
def test_kernels_sum_to_one(gl: Device, method: str, samples: int):
    taps = kernel_taps(scene(method=method, samples=samples), samples)
    assert len(taps.offsets_mm) == samples
    np.testing.assert_allclose(np.float32(taps.weights).sum(axis=0), 1.0, atol=1e-6)
    assert (taps.cell_mm > 0).all()
    # A tap that is moved by its whole cell still does not pass its neighbour.
    assert (np.diff(taps.offsets_mm) >= taps.cell_mm[1:] + taps.cell_mm[:-1] - 1e-12).all()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("vertical", [True, False])
def test_an_edge_along_rows_or_columns_is_the_profile_s_own(
    gl: Device, method: str, vertical: bool
):
    """The rank-1 kernel is exact there, for enough taps; its truth is its own line marginal."""
    errors = []
    for samples in (7, 17, 51, 151):
        diffusion = {"method": method, "samples": samples}
        errors.append(lit_edge(gl, vertical=vertical, diffusion=diffusion).error)
    assert errors[0] < 0.35
    assert errors[1] < 0.06
    assert errors[2] < 0.01
    assert errors[3] < 0.004


@pytest.mark.parametrize("halo", HALOS)
@pytest.mark.parametrize("fill", [0.9, 0.2])
def test_in_every_halo_mode_and_far_away(gl: Device, halo: str, fill: float):
    diffusion = {"method": PREINTEGRATED, "samples": 101, "halo": halo}
    assert lit_edge(gl, diffusion=diffusion, camera={"fill": fill}).error < 0.01


@pytest.mark.parametrize("camera", [{"focal_mm": 40}, {"focal_mm": 800}, {"height_px": 320}])
def test_kernel_size_is_in_millimetres(gl: Device, camera: dict[str, Any]):
    diffusion = {"method": PREINTEGRATED, "samples": 101}
    assert lit_edge(gl, diffusion=diffusion, camera=camera).error < 0.01


@pytest.mark.parametrize("degrees", [30, 60])
def test_measure_knows_no_tilt(gl: Device, degrees: float, capsys: pytest.CaptureFixture[str]):
    """It lays the taps along the surface."""
    diffusion = {"method": PREINTEGRATED, "samples": 101}
    errors = {
        halo: lit_edge(gl, tilt_deg=degrees, diffusion={**diffusion, "halo": halo}).error
        for halo in HALOS
    }
    with capsys.disabled():
        print(f"\nseparable, edge on a plane at {degrees} deg: {errors}")
    assert errors["measure"] < 0.01


def test_artistic_spreads_by_its_own_gaussians(gl: Device):
    artistic = {"near_mm": [0.4, 0.2, 0.1], "far_mm": [1.5, 0.8, 0.1], "strength": [0.25, 1, 0]}
    edge = lit_edge(
        gl, diffusion={"method": ARTISTIC, "samples": 151, "artistic": artistic, "halo": "none"}
    )
    assert edge.error < 0.005  # its truth is the profile below
    made = Scene(gl, plane(10.0), pipeline(MATT, diffusion={
        "method": ARTISTIC, "artistic": artistic})).scattering  # fmt: skip
    x = np.linspace(-3, 3, 13)
    expected = GaussianSum(
        (0.01, 0.04, 0.16, 0.64, 2.25),
        ((0, 0, 1), (0, 1, 0), (0.25, 0, 0), (0, 0, 0), (0.75, 0, 0)),
    )
    np.testing.assert_allclose(made.line_cdf(x), expected.line_cdf(x), atol=1e-12)


def test_the_default_artistic_kernel_is_close_to_skin():
    made = Scene(device(), plane(10.0), pipeline(MATT, diffusion={"method": ARTISTIC})).scattering
    x = np.linspace(-8, 8, 400)
    error = np.abs(made.line_cdf(x) - D_EON_SKIN.line_cdf(x)).max(axis=0)
    assert (error < [0.015, 0.006, 0.003]).all()


def test_a_point_of_light_becomes_a_cross(gl: Device):
    """The rank-1 finding: on the axes too much light, on the diagonals too little."""
    size = 201
    texture = np.zeros((size, size, 3), np.float32)
    texture[size // 2 - 1 : size // 2 + 2, size // 2 - 1 : size // 2 + 2] = 1.0
    asset = plane(10.0)
    asset.maps["albedo"] = texture
    ratios = {}
    for method in ("gaussian_sum", PREINTEGRATED):
        settings = pipeline(MATT, diffusion={"method": method, "samples": 101, "halo": "none"},
                            camera={"width_px": 201, "height_px": 201})  # fmt: skip
        light = render(gl, asset, settings, "diffuse")["diffuse"][:, :, 0]
        along = light[100, 100 + 24]
        diagonal = light[100 + 17, 100 + 17]  # as far away
        ratios[method] = along / diagonal
    assert ratios["gaussian_sum"] == pytest.approx(1.0, abs=0.1)
    assert ratios[PREINTEGRATED] > 1.3


def test_taps_follow_the_footprint():
    assert taps_for(255, 0.1) == 9
    assert taps_for(255, 30.0) == 61
    assert taps_for(7, 1000.0) == 7


def test_it_runs_two_passes_and_no_level(gl: Device):
    renderer = Renderer(gl, sphere(10.0), pipeline(MATT, diffusion={"method": PREINTEGRATED}))
    names = [step.name for step in renderer.graph.order({"radiance"})]
    assert [n for n in names if n in ("diffuse_horizontal", "scattered")] == [
        "diffuse_horizontal",
        "scattered",
    ]
    assert not [n for n in names if n.startswith(("gaussian", "horizontal", "lab", "edge"))]


@pytest.mark.parametrize("method", ["gaussian_sum", *METHODS])
def test_diffuse_is_scattered_light_times_the_rest_of_the_albedo(gl: Device, method: str):
    settings = pipeline(MATT, skin={"texturing": "mixed"}, diffusion={"method": method})
    made = render(gl, sphere(10.0, (0.5, 0.25, 0.1)), settings, "diffuse", "scattered", "albedo")
    inside = made["alpha"][:, :, 0] == 1
    expected = made["scattered"] * np.sqrt(made["albedo"])
    np.testing.assert_allclose(made["diffuse"][inside], expected[inside], rtol=2e-3)
