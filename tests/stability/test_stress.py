"""`scanrender stress` finds what is broken, makes it simple, and writes it down."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scanrender.errors import ConfigError, UsageError
from scanrender.measure import stress
from scanrender.measure.extreme_meshes import SHAPES, asset_of, maps_of
from scanrender.measure.extremes import AXES, SUBJECT, case_of, random_case
from scanrender.measure.invariants import INVARIANTS, Finding, Refusal, examine
from scanrender.render import device as device_module
from scanrender.render.device import Device

pytestmark = pytest.mark.gl

# Of the scenes that `stress` draws: a tenth of a second each.
SCENES = range(3000, 3016)


@pytest.mark.parametrize("number", SCENES)
def test_a_random_scene_keeps_what_any_picture_must(gl: Device, number: int):
    for examined in stress.examine_scene(gl, random_case(number), number):
        outcome = examined.outcome
        if isinstance(outcome, Finding):
            assert outcome.holds, (stress.in_words(outcome), examined.case.axes)


@pytest.mark.parametrize("name", ["fov_deg", "distance", "size_mm", "lamp", "irradiance", "maps"])
def test_the_ends_of_an_axis_are_sound(gl: Device, name: str):
    values = (AXES.get(name) or SUBJECT[name]).walk
    for value in values if name in ("lamp", "maps") else (values[0], values[-1]):
        outcome = examine(gl, case_of({name: value}), "sound")
        assert isinstance(outcome, Refusal) or (outcome and outcome.holds), (value, outcome)


@pytest.mark.parametrize("shape", SHAPES)
def test_shapes_are_assets_that_are_sound(gl: Device, shape: str):
    asset = asset_of(shape, 200.0, "noisy")
    assert np.abs(asset.mesh.positions_mm).max() <= 100.1
    for invariant in ("sound", "furnace"):
        outcome = examine(gl, case_of({"shape": shape, "maps": "noisy"}), invariant)
        assert outcome is None or (isinstance(outcome, Finding) and outcome.holds), outcome


def test_cases_are_the_same_each_time():
    for number in range(20):
        one, two = random_case(number), random_case(number)
        assert (one.axes, one.settings) == (two.axes, two.settings)
    for name, pixels in maps_of("nan").items():
        np.testing.assert_array_equal(pixels, maps_of("nan")[name])


# What `stress` found once, each with the one thing it broke.
FOUND: list[tuple[str, dict[str, Any]]] = [
    # Curvature that widens the transmittance of what is thin: more than all light came through.
    ("sound", {"maps": "nan", "modulation": "increase", "forward": True, "transmission": "baked",
               "size_mm": 0.1112}),
    # A lamp a millimetre from the centre, turned: less than that by a rounding, and refused.
    ("rotation", {"lamp": {"type": "point", "position_mm": [60.0] * 3, "radius_mm": 30.0},
                  "size_mm": 0.03231}),
    # Four taps, none of them in the middle, of kernels wider than the subject: 0.987.
    ("resolution", {"irradiance": 1.562e7, "scale": 2.26, "samples": 4, "size_mm": 0.1625}),
    # A shadow map of 2 mm texels was asked for skin of 0.1 and 0.6 mm: 2.09 and 1.27.
    ("mirror", {"bias_mm": 0.1, "ambient": 0.0, "wrap": 1.0}),
    ("mirror", {"azimuth_deg": -154.1082, "scale": 28.55, "wrap": 0.3,
                "colour": [0.0001, 1.0, 10000.0]}),
    # Light that scatters once has one sample's taps, and a spiral has a hand: 1.09.
    ("mirror", {"fov_deg": 128.8686, "resolution": "half", "size_mm": 2.169}),
    # Eight taps of an average as wide as a finger: 1.32.
    ("mirror", {"profile": 48.52, "wrap": 1.0, "blur_mm": 20.0}),
    # Kernels wider than the subject, whose taps beside its outline lay too far apart: 0.79, 0.97.
    ("resolution", {"distance": 0.3056, "samples": 4, "size_mm": 0.000868}),
    ("resolution", {"profile": 28.08, "samples": 64, "size_mm": 0.5484,
                    "lamp": {"type": "point", "position_mm": [0.0, 1.0, 0.0]}}),
    # One sample's 64 taps of the disk were all that scattered, and wind one way: 0.883.
    ("mirror", {"fov_deg": 90.029, "method": "disk", "normalize": "none", "resolution": "half",
                "size_mm": 78.69}),
    # A plain sum of the disk, whose taps met a subject smaller than the profile by chance: 13, 1.8.
    ("mirror", {"method": "disk", "normalize": "none", "size_mm": 0.001748}),
    ("resolution", {"method": "disk", "normalize": "none", "mask": "none", "size_mm": 0.04674}),
    ("mirror", {"method": "disk", "normalize": "none", "size_mm": 4.0}),
    # Texels as wide as a pixel and a sixth of one high: rows of samples sheared alike, 0.82, 0.96.
    ("mirror", {"maps": "nan", "shape": "box"}),
    ("mirror", {"maps": "noisy", "shape": "box"}),
    # Each of 64 samples was read finer than the way to the next, as one alone has to be: 0.57.
    ("mirror", {"maps": "noisy", "shape": "uv_outside"}),
    # Mip levels from the differences of two pixels, under a wide lens: 0.62.
    ("mirror", {"fov_deg": 135.7901, "azimuth_deg": 76.8828, "shape": "uv_outside", "maps": "hdr"}),
    # A lamp near the skin, and T(d) averaged four times as far as light scatters: 1.51.
    ("mirror", {"blur_mm": 20.0, "irradiance": 824100.0, "profile": 28.71,
                "lamp": {"type": "point", "azimuth_deg": -100.0, "distance_mm": 130.0,
                         "radius_mm": 5.0}}),
    ("mirror", {"blur_mm": 20.0, "irradiance": 824100.0, "profile": 28.71, "strength": 10.0,
                "lamp": {"type": "point", "azimuth_deg": -100.0, "distance_mm": 130.0,
                         "radius_mm": 5.0}}),
    # A guide of so much contrast that it told roundings apart: 1.1 with 1e6.
    ("mirror", {"edge_contrast": 1e4, "halo": "cbf_normalized", "resolution": "half",
                "size_mm": 0.1984}),
]  # fmt: skip


@pytest.mark.parametrize(("invariant", "axes"), FOUND)
def test_what_was_found_stays_cured(gl: Device, invariant: str, axes: dict[str, Any]):
    outcome = examine(gl, case_of(axes), invariant)
    assert isinstance(outcome, Finding)
    assert outcome.holds, stress.in_words(outcome)


# A fault for the tests to find: light through ambient occlusion is no number.
FAULT = (
    "float open = texelFetch(ao, here, 0).r;",
    "float open = texelFetch(ao, here, 0).r; if (open < 0.999) open = sqrt(-1.0 - open);",
)


def test_what_is_broken_is_found_shrunk_and_written(gl: Device, tmp_path: Path, monkeypatch):
    source = device_module._source
    monkeypatch.setattr(device_module, "_source", lambda file: source(file).replace(*FAULT))
    broken = Device(gl.context)
    case = case_of({"fov_deg": 40.0, "f0": 0.5, "maps": "noisy", "jitter": True})
    found = examine(broken, case, "sound")
    assert isinstance(found, Finding)
    assert not found.holds
    assert "pass irradiance wrote" in found.sentence
    simplest, finding = stress.shrink(broken, case, "sound")
    assert dict(simplest.axes) == {"maps": "noisy"}
    file = stress.save_case(tmp_path / "case.yaml", simplest, finding)
    again, invariant = stress.load_case(file)
    assert (again.axes, again.settings, invariant) == (simplest.axes, simplest.settings, "sound")
    assert not examine(broken, again, invariant).holds
    monkeypatch.undo()
    assert examine(gl, again, invariant).holds


@pytest.mark.parametrize(
    ("invariant", "axes"),
    [
        # What reflects all light has none that scatters: 0 of 0.
        ("furnace", {"f0": 1.0, "strength": 10.0}),
        # The background is exposed as the picture is, and has no light that could be divided.
        ("intensity", {"irradiance": 180800.0, "sampling": "contrast", "supersampling": 2}),
        # Thin skin of a coarse shadow map's texels: 16 samples were too few, 64 were not.
        ("mirror", {"wrap": 1.0}),
    ],
)
def test_an_invariant_does_not_take_its_own_way_of_looking_for_a_fault(gl: Device, invariant, axes):
    outcome = examine(gl, case_of(axes), invariant)
    assert isinstance(outcome, Finding)
    assert outcome.holds, outcome


def test_every_invariant_applies_to_the_plain_scene(gl: Device):
    for name in INVARIANTS:
        outcome = examine(gl, case_of({}), name)
        assert isinstance(outcome, Finding), name
        assert outcome.holds, outcome


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("axes: {}", ConfigError),
        ("[", ConfigError),
        ("axes: {joy: 1}\ninvariant: sound", ConfigError),
        ("axes: {}\ninvariant: joy", ConfigError),
        (None, UsageError),
    ],
)
def test_a_file_that_is_no_case_is_said_to_be_none(tmp_path: Path, text: str | None, error):
    file = tmp_path / "case.yaml"
    if text is not None:
        file.write_text(text)
    with pytest.raises(error):
        stress.load_case(file)


def test_the_command(cli, tmp_path: Path):
    done = cli("stress", "--axes", "f0", "--minutes", "0.02", "--out", "out", "--json")
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["broken"] == []
    assert summary["scenes"] > 0
    page = (tmp_path / "out" / "stability.md").read_text()
    for word in ("| `f0` | 0 to 1 | all |", "| furnace |", "## Random scenes", "## Half floats"):
        assert word in page


def test_a_case_that_is_out_of_bounds_by_now_is_refused(cli, tmp_path: Path):
    file = tmp_path / "scene.yaml"
    file.write_text(
        "{axes: {edge_contrast: 1000000.0, halo: cbf_normalized}, invariant: mirror}",
        encoding="utf-8",
    )
    assert "refused: diffusion: " in cli("stress", "--again", file).stdout


def test_the_command_fails_where_something_is_broken_and_examines_it_again(cli, tmp_path: Path):
    code = (
        "from scanrender.render import device\n"
        "source = device._source\n"
        f"device._source = lambda file: source(file).replace(*{FAULT!r})\n"
    )
    done = cli(
        "stress", "--axes", "none", "--seed", 5, "--minutes", 0.001, "--out", "out", code=code
    )
    assert done.returncode == 5, done.stderr
    assert "invariants are broken" in done.stderr
    assert "pass irradiance wrote" in (tmp_path / "out" / "stability.md").read_text()
    case = next((tmp_path / "out").glob("scene_*_sound.yaml"))
    assert cli("stress", "--again", case, code=code).returncode == 5
    again = cli("stress", "--again", case)
    assert again.returncode == 0
    assert again.stdout.startswith("sound: 0, bound 0")


def test_large_pictures_are_walked_in_long_runs_alone(gl: Device, monkeypatch):
    monkeypatch.setattr(stress, "walk", lambda device, name: [])
    monkeypatch.setattr(stress.time, "perf_counter", lambda: float("inf"))
    assert "frame_px" not in stress.run_stress(gl, 1.0).walks
    assert "frame_px" in stress.run_stress(gl, 20.0).walks
    assert "frame_px" in stress.run_stress(gl, 0.0, axes=["frame_px"]).walks
    assert AXES["frame_px"].walk == ([7680, 4320],)
    assert not any("frame_px" in random_case(number).axes for number in range(300))


def test_axes_that_are_none_are_refused(gl: Device):
    with pytest.raises(UsageError, match="no axis is walked that is called joy"):
        stress.run_stress(gl, 0.0, axes=["joy"])
