"""A frame with everything that makes files difficult, small enough to read in a debugger."""

from __future__ import annotations

import numpy as np
import pytest

from scanrender.buffers import Frame, buffer_spec
from scanrender.images import srgb_from_linear

HEIGHT, WIDTH = 34, 47  # odd and unequal, so that swapped axes and padding show


@pytest.fixture
def frame() -> Frame:
    """A lit ball in view space (mm), one shadow map of another size, and non-finite pixels."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    across, up = (x - WIDTH / 2) / 14, (HEIGHT / 2 - y) / 14
    inside = across**2 + up**2 < 1
    normal = np.stack([across, up, np.sqrt(np.maximum(1 - across**2 - up**2, 0))], axis=2)
    normal *= inside[:, :, None]
    lit = np.clip(normal @ np.array([0.5, 0.5, 0.7], np.float32), 0, 1)[:, :, None]
    beauty = lit * np.array([0.8, 0.5, 0.4], np.float32)
    curvature = (0.05 * across)[:, :, None].copy()
    curvature[3, 4] = np.nan
    curvature[5, 6] = np.inf
    curvature[7, 8] = -np.inf
    buffers = {
        "normal_geometry": normal,
        "beauty": beauty,
        "position": normal * 90 - np.array([0, 0, 600], np.float32),
        "curvature": curvature,
        "kernel_px": np.full((HEIGHT, WIDTH, 3), (40, 12, 8)),
        "shadow_0": np.linspace(400, 900, 64 * 64).reshape(64, 64, 1),
        "display": srgb_from_linear(beauty),
    }
    for name, pixels in buffers.items():
        assert pixels.shape[2] == len(buffer_spec(name).channels)
    return Frame(
        {name: np.ascontiguousarray(pixels, np.float32) for name, pixels in buffers.items()},
        inside.astype(np.float32),
    )
