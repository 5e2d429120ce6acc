"""Where inside a pixel the supersamples lie: deterministic, the same for every pixel and frame."""

from __future__ import annotations

import numpy as np


def sample_offsets_px(side: int) -> list[tuple[float, float]]:
    """`side`^2 offsets (right, down) from the pixel's centre, in (-0.5, 0.5).

    A rotated grid: shear keeps near-vertical and near-horizontal edges from falling on the same
    row or column twice, and the points' mean is exactly the centre. One sample is the centre.
    """
    count = side * side
    index = np.arange(count)
    x = (index + 0.5) / count
    # Van der Corput by rows of `side`: each column of the stratified grid gets its own row.
    y = ((index % side) * side + index // side + 0.5) / count
    offsets = np.stack([x, y], axis=1) - 0.5
    return [(float(a), float(b)) for a, b in offsets - offsets.mean(axis=0)]
