"""Fill what lies between charts from the nearest chart texel, so that no filter reads black."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage


class Gutters:
    """For one coverage mask (h, w): where each empty texel finds its value."""

    def __init__(self, covered: npt.NDArray[np.bool_]) -> None:
        self.covered = covered
        self._index: Any = None
        if not covered.all() and covered.any():
            self._index = ndimage.distance_transform_edt(
                ~covered, return_distances=False, return_indices=True
            )

    def fill(self, image: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        """A filled copy of (h, w, c)."""
        if self._index is None:
            return np.asarray(image, np.float32)
        return np.asarray(image[self._index[0], self._index[1]], np.float32)
