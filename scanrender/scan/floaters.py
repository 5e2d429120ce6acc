"""Remove the loose crumbs that reconstruction leaves in the air."""

from __future__ import annotations

import numpy as np

from scanrender.scan.surface import Surface
from scanrender.scan.topology import components, face_areas


def drop_floaters(surface: Surface, fraction: float) -> Surface:
    """Without pieces whose area is a smaller share than `fraction` of the largest piece's."""
    count, piece = components(surface.faces, len(surface.positions))
    if count < 2:
        return surface
    area = np.bincount(piece, face_areas(surface.positions, surface.faces), minlength=count)
    return surface.keep_faces((area >= fraction * area.max())[piece])
