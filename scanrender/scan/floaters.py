"""Remove the loose crumbs that reconstruction leaves in the air, and nothing of the subject.

A piece is judged by its size and by how far it is from the subject, which is whatever is too large
to be a crumb: a torn-off ear tip, glasses or a card of lashes lie close and are kept although they
are small; a lump of background may be larger than those and goes.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from scanrender.scan.surface import Surface
from scanrender.scan.topology import components, face_areas

NEAR_SHARE = 0.1  # of the fraction is enough for a piece within the distance
FAR_SHARE = 3.0  # times the fraction is what a piece needs beyond FAR times the distance
FAR = 10.0


def drop_floaters(surface: Surface, fraction: float, distance: float | None = None) -> Surface:
    """Without pieces whose area is a smaller share than `fraction` of the largest piece's.

    With a `distance` (in the unit of positions) pieces nearer than it to the subject need only
    NEAR_SHARE of that size, and those beyond FAR times it FAR_SHARE of that size. The subject is
    every piece of FAR_SHARE times the fraction: those are never dropped.
    """
    count, piece = components(surface.faces, len(surface.positions))
    if count < 2:
        return surface
    area = np.bincount(piece, face_areas(surface.positions, surface.faces), minlength=count)
    share = area / max(float(area.max()), 1e-300)
    needed = np.full(count, fraction)
    doubtful = (share >= NEAR_SHARE * fraction) & (share < FAR_SHARE * fraction)
    if distance is not None and doubtful.any():
        subject = share >= min(FAR_SHARE * fraction, 1.0)
        gap = _gaps(surface, piece, subject, np.flatnonzero(doubtful))
        needed[doubtful] *= np.where(
            gap <= distance, NEAR_SHARE, np.where(gap > FAR * distance, FAR_SHARE, 1.0)
        )
    return surface.keep_faces((share >= needed)[piece])


def _gaps(
    surface: Surface,
    piece: npt.NDArray[np.int64],
    subject: npt.NDArray[np.bool_],
    doubtful: npt.NDArray[np.int64],
) -> npt.NDArray[np.float64]:
    """(k,) the least distance of each doubtful piece from the subject, by vertices and the middles
    of faces."""
    from scipy.spatial import cKDTree

    centre = surface.positions[surface.faces].mean(axis=1)
    of_subject = subject[piece]
    tree = cKDTree(
        np.concatenate(
            [surface.positions[np.unique(surface.faces[of_subject])], centre[of_subject]]
        )
    )
    place = np.full(len(subject), -1)
    place[doubtful] = np.arange(len(doubtful))
    mine = np.flatnonzero(place[piece] >= 0)
    points = np.concatenate([surface.positions[surface.faces[mine]].reshape(-1, 3), centre[mine]])
    owner = np.concatenate([np.repeat(place[piece[mine]], 3), place[piece[mine]]])
    gap = np.full(len(doubtful), np.inf)
    np.minimum.at(gap, owner, tree.query(points)[0])
    return gap
