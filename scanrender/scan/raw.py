"""RawMesh: what a scan file says, before anything is changed.

Every reader (`read_obj`, `read_ply`, `read_gltf`, `read_simple`) returns one; only `ingest` calls
them. Positions keep the scan's own units and axes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.scan.pages import Page

FloatArray = npt.NDArray[np.floating[Any]]
IntArray = npt.NDArray[np.int64]

NO_PAGE = -1


@dataclass(frozen=True)
class RawMesh:
    """One scan, triangulated, as stored in its file.

    positions (n, 3) float64 in scan units; faces (m, 3) int64 into positions; corner_uv (m, 3, 2)
    float32 with glTF's origin (top left), or None; page (m,) int16, the index in `pages` that
    colours each face, NO_PAGE where none; pages, and normal_pages of the same length with None
    where the material has no normal map; colors (n, 3) float32 linear Rec.709, or None;
    notes: sentences about what the reader had to decide. `up_hint` is "+y" where the file format
    itself fixes the up axis (glTF), `mm_hint` millimetres per unit where it fixes the unit.
    """

    positions: npt.NDArray[np.float64]
    faces: IntArray
    corner_uv: npt.NDArray[np.float32] | None = None
    page: npt.NDArray[np.int16] | None = None
    pages: tuple[Page, ...] = ()
    normal_pages: tuple[Page | None, ...] = ()
    colors: npt.NDArray[np.float32] | None = None
    notes: tuple[str, ...] = ()
    up_hint: str | None = None
    mm_hint: float | None = None

    def in_order_of_use(self) -> RawMesh:
        """The same with its vertices numbered as the faces first name them, unused ones last: what
        lies side by side on the surface then mostly does in memory, too. The collapse of a scan
        that was subdivided takes three quarters of the time."""
        corners = self.faces.reshape(-1)
        place = np.arange(len(corners))
        first = np.full(len(self.positions), len(corners))
        first[corners[::-1]] = place[::-1]
        used = corners[first[corners] == place]
        source = np.concatenate([used, np.flatnonzero(first == len(corners))])
        number = np.arange(len(source))
        if (source == number).all():
            return self
        renumbered = np.empty_like(source)
        renumbered[source] = number
        return replace(
            self,
            positions=np.take(self.positions, source, axis=0),
            faces=np.take(renumbered, self.faces),
            colors=None if self.colors is None else np.take(self.colors, source, axis=0),
        )

    def without_geometry(self) -> RawMesh:
        """Its pages alone: the rest is a tenth of what a preparation holds at its end."""
        nothing = np.zeros((0, 3))
        return RawMesh(
            nothing, nothing.astype(np.int64), pages=self.pages, normal_pages=self.normal_pages
        )

    @property
    def color_source(self) -> str:
        """`texture`, `vertex` or `none`."""
        if self.pages and self.page is not None and bool((self.page != NO_PAGE).any()):
            return "texture"
        return "none" if self.colors is None else "vertex"
