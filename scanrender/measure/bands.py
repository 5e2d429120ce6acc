"""Where a picture's errors gather: around depth steps, and around the borders of skin."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage

Mask = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.floating]

STEP_MM = 5.0  # a depth step between neighbouring pixels


def step_band(depth_mm: Floats, inside: Mask, reach_px: float) -> Mask:
    """(h, w) pixels of the subject within `reach_px` of a step of depth, its outline included."""
    deep = ndimage.maximum_filter(np.where(inside, depth_mm, -np.inf), 3)
    shallow = ndimage.minimum_filter(np.where(inside, depth_mm, np.inf), 3)
    step = inside & (deep - shallow > STEP_MM)
    if not step.any():
        return np.asarray(step)
    return np.asarray((ndimage.distance_transform_edt(~step) <= reach_px) & inside)


def border_band(part: Mask, inside: Mask, reach_px: int) -> Mask:
    """(h, w) pixels of the subject within `reach_px` of the border of `part`, on either side."""
    grown = ndimage.binary_dilation(part, iterations=reach_px)
    core = ndimage.binary_erosion(part, iterations=reach_px, border_value=1)
    return np.asarray(grown & ~core & inside)
