"""Further samples where pixels differ: the same edges as samples everywhere, and no other light."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from render.synthetic import MATT, joined, pipeline, plane, render, sphere_mesh

from scanrender.asset import Asset
from scanrender.metrics import delta_e_2000_linear
from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.render.supersample import Supersampler

pytestmark = pytest.mark.gl

SUN = {"type": "directional", "azimuth_deg": 40, "elevation_deg": 20, "irradiance": 2.0,
       "shadow": False}  # fmt: skip
RED_AND_BLUE = np.float32([[[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]]).repeat(8, axis=1)
METHODS = ("none", "gaussian_sum", "separable_preintegrated", "disk")


def two_balls() -> Asset:
    """A pale ball before a dark one, 40 mm apart: light that crosses the step would show."""
    front, behind = sphere_mesh(6.0), sphere_mesh(20.0)
    front = replace(front, positions_mm=front.positions_mm + np.float32([4.0, 3.0, 40.0]))
    uv = [np.full_like(ball.uv, u) for ball, u in ((front, 0.25), (behind, 0.75))]
    meshes = [replace(ball, uv=at) for ball, at in zip((front, behind), uv, strict=True)]
    colours = np.float32([[[0.9, 0.7, 0.6], [0.05, 0.03, 0.02]]]).repeat(8, axis=1)
    return Asset(joined(meshes), {"albedo": colours})


def shot(sampling: str, side: int, method: str) -> Any:
    return pipeline(
        MATT,
        lights=[SUN, {"type": "ambient", "irradiance": 0.1}],
        diffusion={"method": method},
        quality={"sampling": sampling, "supersampling": side},
    )


def error(picture: dict[str, Any], right: dict[str, Any]) -> npt.NDArray[np.float64]:
    return delta_e_2000_linear(*(np.clip(made["beauty"], 0, 1) for made in (picture, right)))


@pytest.mark.parametrize("method", METHODS)
def test_edges_are_as_smooth_as_with_samples_everywhere(gl: Device, method: str):
    asset = two_balls()
    right = render(gl, asset, shot("everywhere", 8, method))
    one, every, some = (
        render(gl, asset, shot(*how, method))
        for how in (("everywhere", 1), ("everywhere", 2), ("contrast", 2))
    )
    off = {name: error(made, right) for name, made in zip("oes", (one, every, some), strict=True)}
    seen = right["alpha"][:, :, 0] > 0.0
    edge = seen & (off["o"] > 2.0)
    assert edge.sum() > 50, "else this scene has no edges to judge by"
    assert off["s"][edge].mean() < 0.5 * off["o"][edge].mean()
    assert off["s"][edge].mean() < 1.3 * off["e"][edge].mean()
    flat = seen & (off["o"] < 0.2)
    assert off["s"][flat].mean() < 0.2


@pytest.mark.parametrize("method", METHODS[1:])
def test_no_light_comes_over_a_silhouette(gl: Device, method: str):
    """A red ball before a blue one: where samples everywhere see no red, there is none."""
    asset = Asset(two_balls().mesh, {"albedo": RED_AND_BLUE})
    for side in (2, 4):
        some = render(gl, asset, shot("contrast", side, method))["beauty"]
        right = render(gl, asset, shot("everywhere", 8, method))["beauty"]
        seen = right.sum(axis=2) > 0.0
        for own, other in ((2, 0), (0, 2)):
            alone = seen & (right[..., other] < 1e-4 * right[..., own])
            assert alone.sum() > 80
            assert (some[..., other][alone] < 2e-3 * right[..., own].max()).all()


def test_a_flat_picture_has_one_sample_a_pixel(gl: Device, monkeypatch: pytest.MonkeyPatch):
    """And beauty is that sample's radiance, but for the rim."""
    counted: list[float] = []
    mark = Supersampler._mark

    def counting(self: Supersampler, radiance: Any, at: Any) -> Any:
        where = mark(self, radiance, at)
        target = self._device.context.framebuffer([], where)
        depth = np.frombuffer(target.read(components=1, attachment=-1, dtype="f4"), np.float32)
        counted.append(float(depth.mean()))
        return where

    monkeypatch.setattr(Supersampler, "_mark", counting)
    settings = pipeline(MATT, quality={"sampling": "contrast", "supersampling": 3})
    made = render(gl, plane(20.0, (0.5, 0.5, 0.5)), settings, "radiance")
    inside = made["alpha"][:, :, 0] == 1.0
    np.testing.assert_allclose(made["beauty"][inside], made["radiance"][inside], rtol=2e-3)
    assert 0.0 < counted[0] < 0.1


@pytest.mark.parametrize("side", [1, 2, 3])
def test_frames_repeat_bit_by_bit_and_hold_the_mean_coverage(gl: Device, side: int):
    renderer = Renderer(gl, two_balls(), shot("contrast", side, "gaussian_sum"))
    first, second = (renderer.render(renderer.view(0)) for _ in range(2))
    np.testing.assert_array_equal(first.buffers["beauty"], second.buffers["beauty"])
    every = render(gl, two_balls(), shot("everywhere", 8, "gaussian_sum"))
    assert first.alpha.mean() == pytest.approx(every["alpha"].mean(), rel=0.01)
    assert len(np.unique(np.round(first.alpha, 5))) == (
        2 if side == 1 else side * side + 2 - side % 2
    )


def test_other_buffers_stay_those_of_the_pixels_centre(gl: Device):
    names = ("scattered", "position", "diffuse", "weight_sum")
    some, one = (
        render(gl, two_balls(), shot(*how, "separable_preintegrated"), *names)
        for how in (("contrast", 2), ("everywhere", 1))
    )
    for name in names:
        np.testing.assert_array_equal(some[name], one[name])


# --- light scattered in a smaller picture --------------------------------------------------------


@pytest.mark.parametrize("size", [(96, 96), (97, 95), (63, 128)])
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_half_the_resolution_lies_over_the_picture(
    gl: Device, size: tuple[int, int], projection: str
):
    """Light that changes slowly is the same, wherever the middle of an odd picture is."""
    lamp = {**SUN, "azimuth_deg": 20, "elevation_deg": 30}
    width, height = size
    settings = {
        "lights": [lamp, {"type": "ambient", "irradiance": 0.5}],
        "camera": {"width_px": width, "height_px": height, "projection": projection},
        "diffusion": {"method": "gaussian_sum"},
    }
    ball = Asset(sphere_mesh(60.0), {"albedo": np.float32([[[0.5, 0.5, 0.5]]])})
    full, half = (
        render(gl, ball, pipeline(MATT, settings, diffusion={"resolution": r}), "normal_geometry")
        for r in ("full", "half")
    )
    inside = (full["alpha"][:, :, 0] == 1.0) & (full["normal_geometry"][:, :, 2] > 0.5)
    ratio = half["beauty"][inside, 0] / full["beauty"][inside, 0]
    assert np.abs(ratio - 1.0).mean() < 0.006
    # Half a pixel too far to the right would be 0.027 to 0.044 between left and right.
    rows, columns = np.nonzero(inside)
    for above in (rows < height / 2, columns < width / 2):
        assert ratio[above].mean() == pytest.approx(ratio[~above].mean(), abs=0.005)


@pytest.mark.parametrize("sampling", ["everywhere", "contrast"])
def test_half_the_resolution_keeps_silhouettes_and_its_light(gl: Device, sampling: str):
    asset = Asset(two_balls().mesh, {"albedo": RED_AND_BLUE})
    settings = shot(sampling, 2, "separable_preintegrated")
    settings = settings.model_copy(
        update={"diffusion": settings.diffusion.model_copy(update={"resolution": "half"})}
    )
    some = render(gl, asset, settings)
    right = render(gl, asset, shot("everywhere", 8, "separable_preintegrated"))
    seen = right["beauty"].sum(axis=2) > 0.0
    for own, other in ((2, 0), (0, 2)):
        alone = seen & (right["beauty"][..., other] < 1e-4 * right["beauty"][..., own])
        crossed = some["beauty"][..., other][alone] / right["beauty"][..., own].max()
        # Where no centre of the smaller picture lies on its surface, a pixel asks the other one.
        assert (crossed > 4e-3).mean() < 0.01
        assert crossed.max() < 0.03
    assert some["beauty"].sum() == pytest.approx(right["beauty"].sum(), rel=0.02)
