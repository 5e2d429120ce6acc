"""Where a seam would be seen first: the face of a scan that looks along +Z.

Not a face detector: the part above the neck (`facing.head_part`) that looks forward. On anything
that is no head it is merely the front, and a cut there is as good as anywhere else.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.scan.facing import head_part, spread_samples
from scanrender.scan.segment import pieces_of, smoothed_face_normals
from scanrender.scan.topology import face_areas, face_centres, face_pairs

Array = npt.NDArray[Any]

FORWARD = 0.25  # least z of the smoothed normal: cheeks to a little before the ears
DEPTH = 0.35  # of the head's depth from its back: leaves out the backs of ears and the nape
SMALLEST_SHARE = 0.01  # of the surface's area: less is not worth keeping whole
SMOOTHING_SWEEPS = 40
SLICES = 32  # of the head's height, for its profile
HOLE_SHARE = 0.15  # islands within the face (nostrils, lids, below the lip) up to this belong to it


def face_region(positions: Array, faces: Array) -> npt.NDArray[np.bool_]:
    """(m,) one connected region of faces, or none: positions (n, 3) mm, +Y up, the face to +Z."""
    none = np.zeros(len(faces), bool)
    points, _ = spread_samples(positions, faces)
    head = points[head_part(points[:, [2, 0, 1]])]
    if len(head) < 100:
        return none
    floor = chin_mm(head)
    back, front = np.quantile(head[:, 2], [0.01, 0.99])
    first, second, _ = face_pairs(faces)
    normal = smoothed_face_normals(positions, faces, SMOOTHING_SWEEPS)
    centre = face_centres(positions, faces)
    found = (normal[:, 2] > FORWARD) & (centre[:, 1] > floor)
    found &= centre[:, 2] > back + DEPTH * (front - back)
    if not found.any():
        return none
    area = face_areas(positions, faces)
    piece = pieces_of(found, first, second)
    size = np.bincount(piece[found], area[found], minlength=len(faces))
    found = piece == int(size.argmax())
    # Islands within: the complement's pieces but for the large ones.
    rest = pieces_of(found, first, second)
    size_of_face = float(area[found].sum())
    size = np.bincount(rest[~found], area[~found], minlength=len(faces))
    found |= size[rest] < HOLE_SHARE * size_of_face
    whole = area[found].sum() > SMALLEST_SHARE * area.sum()
    return np.asarray(found) if whole else none


def chin_mm(head: Array) -> float:
    """Height above which the profile of head (k, 3) stands out from that of the neck: half way.

    The neck's front lies behind the face; a chart over both would stretch across the corner.
    """
    height = head[:, 1]
    edges = np.linspace(height.min(), height.max(), SLICES + 1)
    slices = np.clip(np.searchsorted(edges, height) - 1, 0, SLICES - 1)
    rows = [head[slices == row, 2] for row in range(SLICES)]
    profile = np.array([np.quantile(row, 0.98) if len(row) else -np.inf for row in rows])
    neck, face = profile[0], float(np.median(profile[SLICES // 4 : 3 * SLICES // 4]))
    out = np.flatnonzero(profile > neck + 0.5 * (face - neck))
    return float(edges[out[0]]) if len(out) and face > neck else float(edges[0])
