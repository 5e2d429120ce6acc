"""Fill what lies between charts from the nearest chart texel, so that no filter reads black."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

FINE_PX = 2048  # maps from this size on look for their neighbours at half the resolution


class Gutters:
    """For one coverage mask (h, w): where each empty texel finds its value."""

    def __init__(self, covered: npt.NDArray[np.bool_]) -> None:
        self.covered = covered
        self._empty: Any = None
        if covered.all() or not covered.any():
            return
        self._empty = np.flatnonzero(~covered)
        even = min(covered.shape) >= FINE_PX and not any(side % 2 for side in covered.shape)
        self._source = _nearest_halved(covered) if even else _nearest(covered)
        self._source = self._source.reshape(-1)[self._empty]

    def fill(self, image: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        """The same (h, w, c) array, filled: of a large map a copy is mostly fresh memory."""
        if self._empty is not None:
            flat = image.reshape(-1, image.shape[2])
            flat[self._empty] = np.take(flat, self._source, axis=0)
        return image


def _nearest(covered: npt.NDArray[np.bool_]) -> npt.NDArray[np.int32]:
    """(h, w) flat index of the nearest covered texel."""
    from scipy import ndimage

    row, column = ndimage.distance_transform_edt(
        ~covered, return_distances=False, return_indices=True
    )
    return np.asarray(row * np.int32(covered.shape[1]) + column, np.int32)


def _nearest_halved(covered: npt.NDArray[np.bool_]) -> npt.NDArray[np.int32]:
    """The same to within two texels, in a quarter of the time: found among blocks of 2 x 2."""
    height, width = covered.shape
    corners = [covered[i::2, j::2] for i in (0, 1) for j in (0, 1)]
    number = np.arange(height * width, dtype=np.int32).reshape(height, width)
    inside = [number[i::2, j::2] for i in (0, 1) for j in (0, 1)]
    one_of = np.select(corners, inside, default=-1)
    source = one_of.reshape(-1)[_nearest(one_of >= 0)]
    return source.repeat(2, axis=0).repeat(2, axis=1)
