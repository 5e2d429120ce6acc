"""`--check`: a fault is found in the pass that made it, and named with buffer, number and place."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from render.synthetic import AMBIENT, pipeline, sphere

from scanrender.asset import save_asset
from scanrender.buffers import CATALOGUE, buffer_spec
from scanrender.errors import StageError
from scanrender.render import frame as frame_module
from scanrender.render.check import check_beauty, faults
from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.render.graph import Pass
from scanrender.render.passes import all_passes

pytestmark = pytest.mark.gl

SIZE = 40
LAMP = {"type": "directional", "azimuth_deg": 140, "shadow_px": 32}
SETTINGS: dict[str, Any] = {
    "camera": {"width_px": SIZE, "height_px": SIZE, "height_mm": 90},
    "lights": [LAMP, AMBIENT],
    "quality": {"supersampling": 1, "check": True},
}
# Written on the way to a picture of these settings.
ON_THE_WAY = (
    "position", "normal_geometry", "normal_shading", "albedo", "skin", "ao", "depth_mm", "shadow_0",
    "visibility_0", "irradiance", "jacobian", "diffusion_input", "gaussian_0", "gaussian_5",
    "scattered", "specular", "transmission", "thickness_mm", "transmittance", "diffuse", "radiance",
)  # fmt: skip


def planted(name: str, value: float, column: int, row: int) -> Callable[[Any], list[Pass]]:
    """All passes, of which the one that writes `name` puts `value` at a place of the picture."""

    def passes(scene: Any) -> list[Pass]:
        return [_broken(step) if _writes(step, name) else step for step in all_passes(scene)]

    def _broken(step: Pass) -> Pass:
        index = [b.name for b in step.writes].index(name)

        def draw(shot: Any, inputs: Mapping[str, Any], target: Any) -> None:
            step.draw(shot, inputs, target)
            if index >= len(target.color_attachments):
                return  # nobody reads it: it is not written
            texture = target.color_attachments[index]
            guard = 0 if step.writes[index].size else shot.guard_px
            at = (column + guard, texture.height - 1 - guard - row, 1, 1)
            texture.write(np.full(texture.components, value, np.float32).tobytes(), viewport=at)

        return replace(step, draw=draw)

    return passes


def _writes(step: Pass, name: str) -> bool:
    return any(b.name == name for b in step.writes)


def render_with(gl: Device, passes: Callable[[Any], list[Pass]], **quality: Any) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(frame_module, "all_passes", passes)
        renderer = Renderer(gl, sphere(30.0, rings=12), pipeline(SETTINGS, quality=quality))
        renderer.render(renderer.view(2))


@given(
    name=st.sampled_from(ON_THE_WAY),
    value=st.sampled_from([np.nan, np.inf, -np.inf, -7.0]),
    column=st.integers(0, 31),
    row=st.integers(0, 31),
)
def test_the_first_offender_is_named_with_pass_buffer_count_and_place(
    gl: Device, name: str, value: float, column: int, row: int
):
    if value == -7.0 and buffer_spec(name).limits[0] == -np.inf:
        value = np.nan  # any finite number may stand there
    with pytest.raises(StageError) as caught:
        render_with(gl, planted(name, value, column, row))
    kind = "out-of-range" if value == -7.0 else "non-finite"
    assert f"wrote 1 {kind} pixel into {name}" in caught.value.what
    assert "frame 2, sample 0, " in caught.value.where
    assert f"first at column {column}, row {row} (R = {value:g})" in caught.value.where


def test_without_the_check_a_fault_shows_in_the_picture_only(gl: Device):
    with pytest.raises(StageError, match="non-finite pixels in beauty") as caught:
        render_with(gl, planted("irradiance", np.nan, 20, 20), check=False)
    assert "--check" in caught.value.fix
    render_with(gl, planted("transmittance", np.nan, 20, 20), check=False)  # nothing reads it


def test_a_fault_outside_the_picture_is_said_to_be_in_the_guard_band(gl: Device):
    with pytest.raises(StageError, match="irradiance") as caught:
        render_with(gl, planted("irradiance", np.inf, -1, 5))
    assert "column -1, row 5, in the guard band" in caught.value.where


@pytest.mark.parametrize("method", ["none", "gaussian_sum", "separable_artistic", "disk"])
@pytest.mark.parametrize("precision", ["full", "half"])
@pytest.mark.parametrize("sampling", ["everywhere", "contrast"])
def test_a_sound_scene_passes(gl: Device, method: str, precision: str, sampling: str):
    more = {"diffusion": {"method": method, "halo": "cbf_normalized", "limit": "lab"}}
    quality = {"precision": precision, "sampling": sampling, "supersampling": 2}
    settings = pipeline(SETTINGS, more, curvature={"modulation": "increase"}, quality=quality)
    renderer = Renderer(gl, sphere(30.0, (0.7, 0.5, 0.4), rings=12), settings)
    checked = renderer.render(renderer.view(1), renderer.buffer_names)
    plain = Renderer(
        gl, renderer.scene.asset, pipeline(settings.model_dump(), quality={"check": False})
    )
    np.testing.assert_array_equal(
        checked.buffers["beauty"], plain.render(plain.view(1)).buffers["beauty"]
    )


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e-3])
def test_the_picture_is_always_looked_at(value: float):
    beauty = np.zeros((4, 5, 4), np.float32)
    check_beauty(beauty)
    beauty[2, 1, 1] = value
    with pytest.raises(StageError, match=r"1 (non-finite|negative) pixel in beauty") as caught:
        check_beauty(beauty)
    assert caught.value.where == f"first at column 1, row 2 (G = {value:g})"


def test_a_mask_must_not_be_negative_and_rounding_is_no_fault():
    pixels = np.zeros((2, 2, 4), np.float32)
    pixels[0, 0] = 1.0005, 1.0, 1.0, 1.0
    assert not faults(pixels, (0.0, 1.0)).any()
    pixels[1, 1, 3] = -1e-9
    assert faults(pixels, (0.0, 1.0))[1, 1].tolist() == [False, False, False, True]


def test_every_buffer_says_what_it_can_hold():
    for name, spec in CATALOGUE.items():
        low, high = spec.limits
        assert low < high, name
        if spec.span is not None and np.isfinite(high):
            assert low <= spec.span[0] < spec.span[1] <= high, name


def test_check_on_the_command_line(cli, tmp_path: Path):
    save_asset(sphere(30.0, rings=8), tmp_path / "asset")
    sets = [w for s in ("camera.width_px=24", "camera.height_px=24", "quality.supersampling=1",
                        "turntable.frames=2") for w in ("--set", s)]  # fmt: skip
    broken = (
        "from scanrender.render import device\n"
        "sources = device._source\n"
        "device._source = lambda file: sources(file).replace(\n"
        "    'void main() {', 'void main() { specular = vec4(0.0); if (gl_FragCoord.x < 1e6) '\n"
        "    '{ specular.g = sqrt(-gl_FragCoord.x); return; }') if file == 'specular.frag'"
        " else sources(file)\n"
    )
    for command in (["render", "asset"], ["run", "turntable", "asset"]):
        done = cli(*command, *sets, "--check", "--out", "out", code=broken)
        assert done.returncode == 5, done.stderr
        assert "scanrender: pass specular wrote" in done.stderr
        assert "non-finite pixels into specular" in done.stderr
        assert "frame 0, sample 0, first at column" in done.stderr
    assert cli("render", "asset", *sets, "--check", "--out", "out").returncode == 0
