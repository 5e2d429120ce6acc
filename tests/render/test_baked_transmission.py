"""Transmission by the asset's thickness map: T(d) itself, and light that must get to the back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render.synthetic import MATT, flat_map, joined, pipeline, quad, render, slab

from scanrender.asset import Asset
from scanrender.optics.profiles.gaussians import D_EON_SKIN
from scanrender.reference.analytic import slab_transmittance
from scanrender.render.device import Device
from scanrender.render.frame import Renderer

pytestmark = pytest.mark.gl

BEHIND = {"type": "directional", "azimuth_deg": 180, "elevation_deg": 0, "irradiance": 1.0,
          "shadow_px": 256}  # fmt: skip
MIDDLE = np.s_[44:52, 44:52]
BAKED = {"transmission": {"method": "baked"}}


def sheets(thickness_mm: float, claimed_mm: float | None = None, *more: Any) -> Asset:
    """A slab with its thickness map (or one that claims otherwise), and what else stands about."""
    asset = slab(20.0, thickness_mm)
    claimed = flat_map(thickness_mm if claimed_mm is None else claimed_mm)
    return Asset(joined([asset.mesh, *more]), {**asset.maps, "thickness_mm": claimed})


@pytest.mark.parametrize("thickness", [0.0, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 30.0])
@pytest.mark.parametrize("shadow", [True, False])
def test_it_is_the_closed_form(gl: Device, thickness: float, shadow: bool):
    """T(0) = 1 in each channel; T(d) within 1e-3."""
    settings = pipeline(MATT, skin=BAKED, lights=[{**BEHIND, "shadow": shadow}])
    asset = sheets(max(thickness, 0.05), thickness)
    made = render(gl, asset, settings, "transmittance", "thickness_mm", "transmission")
    np.testing.assert_allclose(made["thickness_mm"][MIDDLE], thickness, rtol=1e-3)
    found = made["transmittance"][MIDDLE].mean(axis=(0, 1))
    np.testing.assert_allclose(found, slab_transmittance(thickness, D_EON_SKIN), atol=1e-3)
    np.testing.assert_allclose(
        made["transmission"][MIDDLE], made["transmittance"][MIDDLE], rtol=1e-6
    )


@pytest.mark.parametrize("azimuth", [180, 150, 120])
def test_a_turned_light_gives_its_cosine(gl: Device, azimuth: float):
    settings = pipeline(MATT, skin=BAKED, lights=[{**BEHIND, "azimuth_deg": azimuth}])
    made = render(gl, sheets(2.0), settings, "transmission")
    cosine = -np.cos(np.deg2rad(azimuth))
    truth = cosine * slab_transmittance(2.0, D_EON_SKIN)
    np.testing.assert_allclose(made["transmission"][48, 48], truth, atol=1e-3)


def test_both_sources_agree_on_a_slab(gl: Device):
    by_map = render(gl, sheets(3.0), pipeline(MATT, skin=BAKED, lights=[BEHIND]), "transmission")
    by_shadow = render(gl, sheets(3.0), pipeline(MATT, skin={
        "transmission": {"method": "shadow_map", "blur_mm": 0.0}}, lights=[BEHIND]),
        "transmission")  # fmt: skip
    np.testing.assert_allclose(
        by_map["transmission"][MIDDLE], by_shadow["transmission"][MIDDLE], atol=2e-3
    )


def test_what_stands_behind_keeps_the_light_away(gl: Device):
    """A hand behind an ear: the map knows nothing of it, the shadow map does."""
    hand = quad((-60, -60), (60, 60), z=-40, facing=-1.0)
    lit = [BEHIND]
    made = render(gl, sheets(2.0, None, hand), pipeline(MATT, skin=BAKED, lights=lit),
                  "transmission", "position")  # fmt: skip
    assert made["transmission"][MIDDLE].max() == 0.0
    careless = [{**BEHIND, "shadow": False}]
    made = render(gl, sheets(2.0, None, hand), pipeline(MATT, skin=BAKED, lights=careless),
                  "transmission")  # fmt: skip
    assert made["transmission"][MIDDLE][:, :, 0].min() > 0.1


def test_nothing_crosses_toward_the_light(gl: Device):
    front = {**BEHIND, "azimuth_deg": 0}
    made = render(gl, sheets(0.5), pipeline(MATT, skin=BAKED, lights=[front]), "transmission")
    assert made["transmission"].max() == 0.0


@pytest.mark.parametrize(
    ("maps", "lights", "reason"),
    [
        ({}, [BEHIND], "no thickness map"),
        ({"thickness_mm": flat_map(1.0)}, [{"type": "ambient"}], "no lamp"),
    ],
)
def test_what_cannot_be_is_not_run_and_said(gl: Device, maps: Any, lights: Any, reason: str):
    asset = slab(20.0, 1.0)
    settings = pipeline(MATT, skin=BAKED, lights=lights)
    renderer = Renderer(gl, Asset(asset.mesh, {**asset.maps, **maps}), settings)
    assert any(reason in decision.reason for decision in renderer.decisions)
    names = [step.name for step in renderer.graph.order({"radiance"})]
    assert "transmission" not in names
    assert "baked" not in names
