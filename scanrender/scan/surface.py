"""Surface: the working mesh of the preparation, with the colour attributes of the raw scan.

Every cleaning step takes one and returns one, so that a texel can always be traced to the texture
coordinates it came from, even after faces were flipped, dropped or added.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.scan.raw import NO_PAGE, RawMesh
from scanrender.scan.topology import used_vertices

Points = npt.NDArray[np.float64]
Faces = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Surface:
    """positions (n, 3) float64; faces (m, 3) int64; corner_uv (m, 3, 2) float32 or None; page (m,)
    int16, NO_PAGE where a face has no texture; colors (n, 3) float32 linear or None."""

    positions: Points
    faces: Faces
    corner_uv: npt.NDArray[np.float32] | None
    page: npt.NDArray[np.int16]
    colors: npt.NDArray[np.float32] | None

    def keep_faces(self, kept: npt.NDArray[Any]) -> Surface:
        """Only the faces in `kept` (a mask or indices); vertices stay. Where a mask keeps all, the
        same surface: what is known of its faces stays known (`topology.edges_of`)."""
        if kept.dtype == bool and kept.all():
            return self
        return replace(
            self,
            faces=self.faces[kept],
            corner_uv=None if self.corner_uv is None else self.corner_uv[kept],
            page=self.page[kept],
        )

    def flip_faces(self, flipped: Mask) -> Surface:
        """Reverse the winding of the faces in the mask (m,)."""
        faces, corner_uv = self.faces.copy(), self.corner_uv
        faces[flipped] = faces[flipped][:, ::-1]
        if corner_uv is not None:
            corner_uv = corner_uv.copy()
            corner_uv[flipped] = corner_uv[flipped][:, ::-1]
        return replace(self, faces=faces, corner_uv=corner_uv)

    def renumber(self, vertex_of_corner: Faces, source: npt.NDArray[np.int64]) -> Surface:
        """New faces (m, 3) on vertices copied from `source` (indices into the present ones)."""
        return replace(
            self,
            positions=self.positions[source],
            faces=vertex_of_corner,
            colors=None if self.colors is None else self.colors[source],
        )

    def compact(self) -> Surface:
        """Without unreferenced vertices."""
        used = used_vertices(self.faces, len(self.positions))
        if used.all():
            return self
        new_index = np.cumsum(used) - 1
        return self.renumber(new_index[self.faces], np.flatnonzero(used))

    def add_faces(self, faces: Faces, positions: Points | None = None) -> Surface:
        """Append uncoloured faces (hole fillings) and the new vertices they use."""
        extra = np.zeros((0, 3)) if positions is None else positions
        colors = self.colors
        if colors is not None and len(extra):
            # A new vertex takes the mean colour of the faces it closes.
            added = np.zeros((len(extra), 3), np.float32)
            weight = np.zeros((len(extra), 1), np.float32)
            for corner in range(3):
                new = faces[:, corner] >= len(self.positions)
                for other in ((corner + 1) % 3, (corner + 2) % 3):
                    old = new & (faces[:, other] < len(self.positions))
                    slot = faces[old, corner] - len(self.positions)
                    np.add.at(added, slot, colors[faces[old, other]])
                    np.add.at(weight, slot, 1.0)
            colors = np.concatenate([colors, added / np.maximum(weight, 1.0)])
        corner_uv = self.corner_uv
        if corner_uv is not None:
            blank = np.full((len(faces), 3, 2), np.nan, np.float32)
            corner_uv = np.concatenate([corner_uv, blank])
        return replace(
            self,
            positions=np.concatenate([self.positions, extra]),
            faces=np.concatenate([self.faces, faces]),
            corner_uv=corner_uv,
            page=np.concatenate([self.page, np.full(len(faces), NO_PAGE, np.int16)]),
            colors=colors,
        )


def surface_from_raw(raw: RawMesh) -> Surface:
    """The same mesh as a Surface, in scan units."""
    page = raw.page if raw.page is not None else np.full(len(raw.faces), NO_PAGE, np.int16)
    return Surface(raw.positions, raw.faces, raw.corner_uv, page, raw.colors)
