"""Drop the few vertices that lie absurdly far out, before anything is measured by the scan's size:
one wrong number would decide its unit, and what lies at the same place.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.scan.surface import Surface
from scanrender.scan.topology import extent

Array = npt.NDArray[Any]

FAR = 100.0  # times the size of the bulk
_TAIL = 0.01  # of the vertices at either end of each axis are not of the bulk
_SAMPLE = 20_000
_FEW_VERTICES = 0.001  # or one triangle's
_FEW_FACES = 0.05


def bulk_extent(points: Array) -> tuple[Array, Array]:
    """As `extent`, of all but the outermost points (n, k), by a sample of them."""
    columns = points[:: max(1, len(points) // _SAMPLE)].T
    last = columns.shape[1] - 1
    tail = int(_TAIL * (last + 1))
    ordered = np.partition(columns, (tail, last - tail), axis=1)
    return ordered[:, tail], ordered[:, last - tail]


def drop_outliers(surface: Surface) -> Surface:
    """Without the faces at vertices further from the bulk than FAR times its size.

    Only few and scattered ones: what hangs together out there, or has many faces, may be a part of
    the subject, or the room around it.
    """
    low, high = bulk_extent(surface.positions)
    reach = FAR * float((high - low).max())
    low, high = low - reach, high + reach
    least, most = extent(surface.positions)
    if reach <= 0.0 or ((least >= low) & (most <= high)).all():
        return surface
    far = np.asarray(((surface.positions < low) | (surface.positions > high)).any(axis=1))
    of_face = far[surface.faces]
    gone, apart = np.asarray(of_face.any(axis=1)), of_face.all(axis=1)
    places = len(np.unique(surface.positions[far], axis=0))
    scattered = 2 * int(apart.sum()) < places  # a surface has as many faces as vertices, or more
    few = far.sum() <= max(3.0, _FEW_VERTICES * len(far)) and gone.mean() <= _FEW_FACES
    return surface.keep_faces(~gone).compact() if few and scattered else surface
