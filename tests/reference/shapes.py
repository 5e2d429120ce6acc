"""Meshes whose integrals are known: planes, slabs, spheres, and a bumpy sheet."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from scanrender.asset import Mesh
from scanrender.reference.points import Points
from scanrender.reference.surface import Surface

Array = npt.NDArray[np.float64]


def mesh_of(positions: Array, normals: Array, faces: npt.NDArray[np.int64]) -> Mesh:
    side = np.where(np.abs(normals[:, [1]]) > 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    across = np.cross(side, normals)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return Mesh(
        np.asarray(positions, np.float32),
        np.asarray(normals, np.float32),
        np.hstack([across, np.ones((len(normals), 1))]).astype(np.float32),
        np.full((len(positions), 2), 0.5, np.float32),
        faces.astype(np.uint32),
    )


def sheet_mesh(half_mm: float, cells: int, height: Callable[[Array, Array], Array]) -> Mesh:
    """A square sheet z = height(x, y) that faces +Z, `cells` a side."""
    line = np.linspace(-half_mm, half_mm, cells + 1)
    x, y = (axis.ravel() for axis in np.meshgrid(line, line))
    step = 1e-4
    slope_x = (height(x + step, y) - height(x - step, y)) / (2 * step)
    slope_y = (height(x, y + step) - height(x, y - step)) / (2 * step)
    normals = np.stack([-slope_x, -slope_y, np.ones_like(x)], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    row, column = (axis.ravel() for axis in np.mgrid[:cells, :cells])
    a = row * (cells + 1) + column
    b, c, d = a + 1, a + cells + 2, a + cells + 1
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return mesh_of(np.stack([x, y, height(x, y)], axis=1), normals, faces)


def plane_mesh(half_mm: float, cells: int, z_mm: float = 0.0) -> Mesh:
    return sheet_mesh(half_mm, cells, lambda x, y: np.full_like(x, z_mm))


def both(first: Mesh, second: Mesh) -> Mesh:
    parts = [
        np.concatenate([getattr(first, name), getattr(second, name)])
        for name in ("positions_mm", "normals", "tangents", "uv")
    ]
    faces = np.concatenate([first.faces, second.faces + np.uint32(len(first.positions_mm))])
    return Mesh(*parts, faces)


def turned_over(mesh: Mesh) -> Mesh:
    """The same surface that faces the other way."""
    return Mesh(mesh.positions_mm, -mesh.normals, mesh.tangents, mesh.uv, mesh.faces[:, ::-1])


def sphere_mesh(radius_mm: float, halvings: int = 5) -> Mesh:
    """An icosahedron, each face divided into 4^halvings, pushed out to the sphere."""
    g = 0.5 * (1.0 + 5.0**0.5)
    corners = np.array(
        [[-1, g, 0], [1, g, 0], [-1, -g, 0], [1, -g, 0], [0, -1, g], [0, 1, g],
         [0, -1, -g], [0, 1, -g], [g, 0, -1], [g, 0, 1], [-g, 0, -1], [-g, 0, 1]]
    )  # fmt: skip
    faces = np.array(
        [[0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9], [5, 11, 4],
         [11, 10, 2], [10, 7, 6], [7, 1, 8], [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8],
         [3, 8, 9], [4, 9, 5], [2, 4, 11], [6, 2, 10], [8, 6, 7], [9, 8, 1]]
    )  # fmt: skip
    triangles = corners[faces] / np.linalg.norm(corners[0])
    for _ in range(halvings):
        a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
        middles = [a + b, b + c, c + a]
        ab, bc, ca = (m / np.linalg.norm(m, axis=1, keepdims=True) for m in middles)
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
    unit, index = np.unique(np.round(triangles.reshape(-1, 3), 9), axis=0, return_inverse=True)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    # Out by half of what facets fall short of the sphere, so that their area is right.
    area = 0.5 * np.linalg.norm(
        np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
    )
    grown = radius_mm * np.sqrt(4.0 * np.pi / area.sum())
    return mesh_of(grown * unit, unit, index.reshape(-1, 3))


def points_near(surface: Surface, wanted_mm: npt.ArrayLike) -> Points:
    """Middles of the faces nearest to positions (k, 3)."""
    middles = surface.positions[surface.faces].mean(axis=1)
    away = np.linalg.norm(np.asarray(wanted_mm)[:, None] - middles, axis=2)
    return points_on(away.argmin(axis=1))


def points_on(faces: npt.NDArray[np.int64]) -> Points:
    count = len(faces)
    bary = np.full((count, 3), 1.0 / 3.0)
    return Points(faces.astype(np.int64), bary, np.zeros(count, bool), np.arange(count))


def white(face: npt.NDArray[np.int64], bary: Array) -> tuple[Array, Array]:
    """E = 1 everywhere, all of it skin."""
    return np.ones((len(face), 3)), np.ones(len(face))
