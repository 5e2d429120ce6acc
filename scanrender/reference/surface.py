"""The prepared surface in float64: geometry, normals and maps at any point of any triangle.

Normals, maps and their lookups follow `gbuffer.frag` and `mesh.vert`, without mipmaps: the truth
integrates over the detail that a mip level averages.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from scanrender.asset import Asset, Mesh
from scanrender.optics._math import Array
from scanrender.reference.rays import Caster, Faces


@dataclass(frozen=True)
class Geometry:
    """k points of the surface: position (k, 3) mm, unit normals (k, 3), uv (k, 2).

    ``geometric`` is the interpolated normal, ``shading`` has the normal map. ``lifted`` (k, 3) is
    where shadow rays start: the point moved onto the smooth surface that the normals describe.
    """

    position: Array
    geometric: Array
    shading: Array
    lifted: Array
    uv: Array


class Surface:
    """An asset's mesh and maps. Arrays are float64, in object space and mm."""

    def __init__(self, mesh: Mesh, maps: Mapping[str, Array] | None = None) -> None:
        self.positions = np.asarray(mesh.positions_mm, np.float64)
        self.normals = np.asarray(mesh.normals, np.float64)
        self.tangents = np.asarray(mesh.tangents, np.float64)
        self.uv = np.asarray(mesh.uv, np.float64)
        self.faces: Faces = np.asarray(mesh.faces, np.int64)
        self.maps = {} if maps is None else dict(maps)
        self.caster = Caster(self.positions, self.faces)

    @classmethod
    def of(cls, asset: Asset) -> Surface:
        """The surface of an asset; maps that it lacks are neutral."""
        wanted = ("albedo", "normal_ts", "ao", "skin")
        return cls(asset.mesh, {n: np.asarray(asset.maps[n]) for n in wanted if n in asset.maps})

    @cached_property
    def radius_mm(self) -> float:
        """Of the sphere around the origin that holds the surface."""
        return float(np.linalg.norm(self.positions, axis=1).max(initial=1e-3))

    @cached_property
    def face_normals(self) -> Array:
        """(m, 3) area vectors over their length; zero for a face without area."""
        a, b, c = (self.positions[self.faces[:, i]] for i in range(3))
        return unit(np.cross(b - a, c - a))

    @cached_property
    def face_areas(self) -> Array:
        """(m,) mm^2."""
        a, b, c = (self.positions[self.faces[:, i]] for i in range(3))
        return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))

    def positions_at(self, face: Faces, bary: Array) -> Array:
        """(k, 3) mm at barycentric coordinates (k, 3) of faces (k,)."""
        return self._mix(self.positions, face, bary)

    def normals_at(self, face: Faces, bary: Array) -> Array:
        """(k, 3) unit geometry normals, interpolated as the renderer does."""
        return unit(self._mix(self.normals, face, bary))

    def geometry(self, face: Faces, bary: Array) -> Geometry:
        """Everything that shading needs at barycentric coordinates (k, 3) of faces (k,)."""
        corners = self.faces[face]
        normal = self._mix(self.normals, face, bary)
        tangent = self._mix(self.tangents, face, bary)
        uv = self._mix(self.uv, face, bary)
        position = self._mix(self.positions, face, bary)
        geometric = unit(normal)
        shading = geometric
        if "normal_ts" in self.maps:
            t = self.lookup("normal_ts", uv)
            # MikkTSpace: interpolated vectors as they are, not re-orthogonalised (gbuffer.frag).
            bitangent = tangent[:, 3:] * np.cross(normal, tangent[:, :3])
            turned = t[:, :1] * tangent[:, :3] + t[:, 1:2] * bitangent + t[:, 2:] * normal
            lost = np.sum(turned * turned, axis=1, keepdims=True) <= 1e-12
            shading = np.where(lost, geometric, unit(turned))
        # Hanika, "Hacking the Shadow Terminator", Ray Tracing Gems II (2021), ch. 4: without it
        # coarse facets stand in their own shadow where the smooth normals still face the light.
        away = position[:, None] - self.positions[corners]
        n = self.normals[corners]
        below = np.minimum(np.einsum("kij,kij->ki", away, n), 0.0)
        lifted = position - np.einsum("ki,ki,kij->kj", bary, below, n)
        return Geometry(position, geometric, shading, lifted, uv)

    def lookup(self, name: str, uv: Array) -> Array:
        """(k, channels) of a map at uv (k, 2): bilinear, clamped, row 0 at v = 0 (glTF)."""
        pixels = self.maps[name]
        height, width = pixels.shape[:2]
        x = np.clip(uv[:, 0] * width - 0.5, 0.0, width - 1.0)
        y = np.clip(uv[:, 1] * height - 0.5, 0.0, height - 1.0)
        left, top = x.astype(np.int64), y.astype(np.int64)
        right, low = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
        fx, fy = (x - left)[:, None], (y - top)[:, None]
        above = pixels[top, left] * (1.0 - fx) + pixels[top, right] * fx
        under = pixels[low, left] * (1.0 - fx) + pixels[low, right] * fx
        return np.asarray(above * (1.0 - fy) + under * fy, np.float64)

    def _mix(self, values: Array, face: Faces, bary: Array) -> Array:
        a, b, c = (values[self.faces[face, i]] * bary[:, i : i + 1] for i in range(3))
        return np.asarray(a + b + c)


def unit(vectors: Array) -> Array:
    """Vectors (..., 3) over their length; zero stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, 1e-300))
