"""Where inside a pixel the supersamples lie: deterministic, the same for every pixel and frame."""

from __future__ import annotations

import numpy as np


def sample_offsets_px(side: int) -> list[tuple[float, float]]:
    """`side`^2 offsets (right, down) from the pixel's centre, in (-0.5, 0.5).

    A rotated grid: shear keeps near-vertical and near-horizontal edges from falling on the same
    row or column twice, and the points' mean is exactly the centre. One sample is the centre.

    Rows are sheared one way and columns the other. Sheared alike, the points lie along a diagonal
    (four of them with a correlation of 0.8): edges along it are sampled as by two, and a mirrored
    scene has another picture.
    """
    row, column = np.divmod(np.arange(side * side), side)
    x = (column + (row + 0.5) / side) / side
    y = (row + (side - column - 0.5) / side) / side
    offsets = np.stack([x, y], axis=1) - 0.5
    return [(float(a), float(b)) for a, b in offsets - offsets.mean(axis=0)]
