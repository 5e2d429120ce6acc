"""A mirrored scene gives the mirrored picture: at the pixel's centre, and of few samples too."""

from __future__ import annotations

import numpy as np
import pytest

from scanrender.measure.extremes import case_of
from scanrender.measure.invariants import Finding, mirrored
from scanrender.render.device import Device
from scanrender.render.samples import sample_offsets_px


@pytest.mark.parametrize("side", [2, 3, 4, 7, 16])
def test_samples_lie_along_no_diagonal(side: int):
    """Four samples had a correlation of 0.8: an edge along their diagonal met two of them."""
    x, y = np.array(sample_offsets_px(side)).T
    assert abs(np.corrcoef(x, y)[0, 1]) < 1e-12
    assert np.var(x) == pytest.approx(1.0 / 12.0, rel=0.07)
    assert np.var(y) == pytest.approx(1.0 / 12.0, rel=0.07)


@pytest.mark.gl
@pytest.mark.parametrize("maps", ["plain", "noisy", "black"])
@pytest.mark.parametrize("method", ["none", "gaussian_sum", "separable_preintegrated"])
def test_a_mirrored_scene_gives_the_mirrored_picture(gl: Device, maps: str, method: str):
    found = mirrored(gl, case_of({"maps": maps, "method": method}))
    assert isinstance(found, Finding)
    assert found.holds, found
