"""High and Low: the cleaned raw surface and the prepared one, with what several stages need."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.asset import Mesh
from scanrender.scan.curvature import surface_curvature
from scanrender.scan.diffuse import cotangent_laplacian, smooth_normals
from scanrender.scan.rays import Target
from scanrender.scan.surface import Surface
from scanrender.scan.topology import face_areas, vertex_normals
from scanrender.scan.unwrap import Unwrapped
from scanrender.settings.prep import BakeSettings

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class High:
    """The cleaned raw surface; normals (n, 3) smoothed to what a texel holds; curvature (n,) 1/mm
    or None; curvature_scale_mm over which it was smoothed."""

    surface: Surface
    target: Target
    normals: Array
    curvature: Array | None
    curvature_scale_mm: float | None


@dataclass(frozen=True)
class Low:
    """The prepared mesh twice: welded (positions, faces, normals), and split along seams (mesh);
    cage (n,) mm at the welded vertices, for the projection, where it is measured already."""

    positions: Array
    faces: Array
    normals: Array
    unwrapped: Unwrapped
    mesh: Mesh
    cage: Array | None = None

    def texel_mm(self, size: int) -> float:
        """Typical side of a texel on the surface, for a map of `size`."""
        uv = self.mesh.uv.astype(np.float64)[self.mesh.faces]
        e1, e2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
        share = 0.5 * np.abs(e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0]).sum()
        area = face_areas(self.positions, self.faces).sum()
        return float(np.sqrt(area / max(share, 1e-12)) / size)


def make_high(surface: Surface, bake: BakeSettings) -> High:
    """Everything about the raw surface that does not depend on the prepared one."""
    positions, faces = surface.positions, surface.faces
    target = Target(positions, faces)
    normals = vertex_normals(positions, faces)
    curvature = scale = laplacian = None
    if "curvature" in bake.maps:
        laplacian = cotangent_laplacian(positions, faces)
        least = bake.curvature_smooth_mm
        curvature, scale = surface_curvature(positions, faces, least, laplacian)
    smooth = smooth_normals(positions, faces, normals, bake.footprint_mm, laplacian)
    return High(surface, target, smooth.astype(np.float32), curvature, scale)
