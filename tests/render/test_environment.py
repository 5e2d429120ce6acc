"""Environment lights in the picture: furnace, a sun of one texel, turning, occlusion, bad files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenImageIO as oiio  # noqa: N813
import pytest
from render.synthetic import (
    AMBIENT,
    MATT,
    flat_map,
    merged,
    pipeline,
    plane,
    render,
    sphere,
    turned,
)

from scanrender.asset import Asset
from scanrender.errors import ConfigError
from scanrender.optics.environment import directions, solid_angles
from scanrender.render.device import Device
from scanrender.render.environment import built_in_sky, environment_picture
from scanrender.render.frame import Renderer
from scanrender.settings.light import BUILT_IN_SKIES, EnvironmentLight

pytestmark = pytest.mark.gl

GLOSSY = {"skin": {"specular": {"strength": 1.0, "roughness": [0.4, 0.25], "second_lobe": 0.4,
                                "f0": 0.04}}}  # fmt: skip
NAMES = ("irradiance", "specular", "normal_geometry")


def written(path: Path, pixels: npt.ArrayLike) -> str:
    image = np.ascontiguousarray(pixels, dtype=np.float32)
    buffer = oiio.ImageBuf(image)
    assert buffer.write(str(path)), buffer.geterror()
    return str(path)


def sun(path: Path, direction: npt.ArrayLike, rows: int = 128) -> tuple[str, npt.NDArray[Any]]:
    """One texel that gives irradiance 1 (units of pi); and where exactly it stands."""
    toward = directions(rows, 2 * rows)
    row, column = np.unravel_index(np.argmax(toward @ np.asarray(direction)), toward.shape[:2])
    picture = np.zeros((rows, 2 * rows, 3))
    picture[row, column] = np.pi / solid_angles(rows, 2 * rows)[row]
    return written(path, picture), toward[row, column]


def inside(made: dict[str, npt.NDArray[np.float32]]) -> npt.NDArray[np.bool_]:
    return made["alpha"][:, :, 0] == 1


def test_constant_surroundings_are_ambient_light(gl: Device, tmp_path: Path):
    picture = written(tmp_path / "grey.exr", np.full((16, 32, 3), 0.8))
    base = merged(MATT, GLOSSY)
    light = {"type": "environment", "map": picture}
    around = render(gl, sphere(10.0), pipeline(base, lights=[light]), *NAMES)
    ambient = render(gl, sphere(10.0), pipeline(base, lights=[{**AMBIENT, "irradiance": 0.8}]),
                     *NAMES)  # fmt: skip
    for name in ("irradiance", "specular", "beauty"):
        np.testing.assert_allclose(around[name], ambient[name], rtol=3e-3, atol=1e-5)


@pytest.mark.parametrize("angles", [(30, 20), (-100, 60), (0, -85), (179, 0)])
def test_a_sun_of_one_texel_is_a_directional_light(gl: Device, tmp_path: Path, angles):
    a, e = np.deg2rad(angles)
    wanted = [np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)]
    picture, toward = sun(tmp_path / "sun.exr", wanted)
    base = merged(MATT, GLOSSY)
    around = render(gl, sphere(10.0), pipeline(base, lights=[
        {"type": "environment", "map": picture}]), *NAMES)  # fmt: skip
    lamp = {"type": "directional", "shadow": False, "irradiance": 1.0,
            "azimuth_deg": float(np.rad2deg(np.arctan2(toward[0], toward[2]))),
            "elevation_deg": float(np.rad2deg(np.arcsin(toward[1])))}  # fmt: skip
    direct = render(gl, sphere(10.0), pipeline(base, lights=[lamp]), *NAMES)
    difference = np.abs(around["irradiance"] - direct["irradiance"])[inside(direct)]
    assert difference.max() < 0.02
    assert difference.mean() < 0.004


def test_a_highlight_of_the_sun_is_where_the_lamps_is(gl: Device, tmp_path: Path):
    """Split sum takes the lobe as seen head-on: exact there, too round at grazing angles."""
    picture, toward = sun(tmp_path / "sun.exr", [0.5, 0.2, 0.84], rows=256)
    base = merged(MATT, {"skin": {"specular": {"strength": 1.0, "roughness": [0.3, 0.3]}}})
    around = render(gl, sphere(10.0), pipeline(base, lights=[
        {"type": "environment", "map": picture}], camera={"focal_mm": 2000}), *NAMES)  # fmt: skip
    lamp = {"type": "directional", "shadow": False, "irradiance": 1.0,
            "azimuth_deg": float(np.rad2deg(np.arctan2(toward[0], toward[2]))),
            "elevation_deg": float(np.rad2deg(np.arcsin(toward[1])))}  # fmt: skip
    direct = render(gl, sphere(10.0), pipeline(base, lights=[lamp], camera={"focal_mm": 2000}),
                    *NAMES)  # fmt: skip
    found, true = (made["specular"][:, :, 1] for made in (around, direct))
    rows, columns = np.mgrid[: found.shape[0], : found.shape[1]]
    for axis in (rows, columns):
        assert np.average(axis, weights=found) == pytest.approx(
            np.average(axis, weights=true), abs=3
        )
    assert found.sum() == pytest.approx(true.sum(), rel=0.15)
    assert found.max() == pytest.approx(true.max(), rel=0.25)


def test_turning_the_surroundings_is_turning_the_light(gl: Device, tmp_path: Path):
    picture, _ = sun(tmp_path / "sun.exr", [0, 0, 1.0])
    lit = {}
    for rotation in (0.0, 90.0, -90.0, 360.0):
        light = {"type": "environment", "map": picture, "rotation_deg": rotation}
        made = render(gl, sphere(10.0), pipeline(MATT, lights=[light]), "irradiance")["irradiance"]
        lit[rotation] = float(made[:, 56:, 0].mean() - made[:, :40, 0].mean())
    assert lit[90.0] > 0.2, "toward the subject's own left, which is on the right"
    assert lit[-90.0] < -0.2
    assert abs(lit[0.0]) < 0.02
    assert lit[360.0] == pytest.approx(lit[0.0], abs=1e-3)


def test_surroundings_follow_what_they_are_fixed_to(gl: Device):
    def made(mode: str, follows: str, index: int):
        settings = pipeline(MATT, lights=[{"type": "environment", "follows": follows}],
                            turntable={"mode": mode, "frames": 5})  # fmt: skip
        return render(gl, sphere(10.0), settings, "irradiance", index=index)["irradiance"]

    start = made("subject", "world", 0)
    np.testing.assert_allclose(made("subject", "world", 2), start, atol=0.01)
    turned = made("camera", "world", 2)
    assert np.abs(turned - start).max() > 0.2
    np.testing.assert_allclose(made("subject", "subject", 2), turned, atol=0.01)


def test_there_is_no_seam_behind_and_no_hole_above(gl: Device):
    for camera in ({"azimuth_deg": 180}, {"elevation_deg": 89}):
        made = render(gl, sphere(10.0, rings=64), pipeline(merged(MATT, GLOSSY), camera=camera,
                      lights=[{"type": "environment", "map": "dome"}]), *NAMES)  # fmt: skip
        light = made["irradiance"][30:66, 30:66, 1]
        steps = [np.abs(np.diff(light, axis=axis)).max() for axis in (0, 1)]
        assert max(steps) < 0.03, camera


@pytest.mark.parametrize(("tilt", "hides_mirror"), [(0.0, False), (65.0, True)])
def test_occlusion_dims_light_and_hides_low_reflections_first(
    gl: Device, tilt: float, hides_mirror: bool
):
    asset = turned(plane(10.0), tilt, "y")
    seen = {}
    for open_share in (1.0, 0.5, 0.0):
        dimmed = Asset(asset.mesh, {**asset.maps, "ao": flat_map(open_share)})
        made = render(gl, dimmed, pipeline(merged(MATT, GLOSSY), lights=[
            {"type": "environment", "map": "dome"}]), *NAMES)  # fmt: skip
        seen[open_share] = made["irradiance"][48, 48, 1], made["specular"][48, 48, 1]
    assert seen[0.5][0] == pytest.approx(0.5 * seen[1.0][0], rel=1e-3)
    assert seen[0.0] == (0.0, 0.0)
    assert (seen[0.5][1] < 0.6 * seen[1.0][1]) == hides_mirror


@pytest.mark.parametrize("name", BUILT_IN_SKIES)
def test_our_skies_light_the_front_with_one(gl: Device, name: str):
    picture = built_in_sky(name)
    assert picture.shape == (256, 512, 3)
    assert np.isfinite(picture).all()
    assert picture.min() >= 0
    made = render(gl, plane(10.0), pipeline(MATT, lights=[{"type": "environment", "map": name}]),
                  "irradiance")  # fmt: skip
    assert made["irradiance"][48, 48, 1] == pytest.approx(1.0, abs=5e-3)


def test_intensity_and_colour_multiply_the_picture():
    plain = environment_picture(EnvironmentLight())
    tinted = environment_picture(EnvironmentLight(intensity=2.0, colour=(1.0, 0.5, 0.0)))
    np.testing.assert_allclose(tinted, plain * [2.0, 1.0, 0.0])


def test_black_surroundings_do_not_run(gl: Device):
    renderer = Renderer(gl, plane(), pipeline(MATT, lights=[
        AMBIENT, {"type": "environment", "intensity": 0.0}]))  # fmt: skip
    assert not renderer.scene.environments
    assert "lights.1" in [d.what for d in renderer.decisions]


def test_half_floats_suns_and_holes_in_a_picture_are_survived(gl: Device, tmp_path: Path):
    pixels = np.full((8, 16, 3), 0.5)
    pixels[2, 3], pixels[4, 4], pixels[5, 5] = np.inf, np.nan, -3.0
    light = {"type": "environment", "map": written(tmp_path / "holes.exr", pixels)}
    made = render(gl, sphere(10.0), pipeline(merged(MATT, GLOSSY), lights=[light]), *NAMES)
    assert made["irradiance"].max() > 1.0
    assert (made["beauty"] >= 0).all()


def test_a_radiance_picture_is_read_too(tmp_path: Path):
    path = written(tmp_path / "grey.hdr", np.full((8, 16, 3), 2.0))
    np.testing.assert_allclose(environment_picture(EnvironmentLight(map=path)), 2.0, rtol=0.01)


@pytest.mark.parametrize(("name", "shape"), [("square.exr", (8, 8, 3)), ("late.png", (8, 16, 3))])
def test_a_picture_that_is_no_environment_is_refused(tmp_path: Path, name: str, shape):
    path = written(tmp_path / name, np.zeros(shape))
    with pytest.raises(ConfigError, match=name) as caught:
        environment_picture(EnvironmentLight(map=path))
    assert "twice as wide" in str(caught.value.fix)


def test_what_is_no_picture_is_refused(tmp_path: Path):
    (tmp_path / "note.exr").write_text("not a picture")
    with pytest.raises(ConfigError):
        environment_picture(EnvironmentLight(map=str(tmp_path / "note.exr")))
