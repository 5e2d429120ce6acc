"""Tangent frames as MikkTSpace makes them, from which baked normals and their readers agree.

Mikkelsen: Simulation of Wrinkled Surfaces Revisited, 2008, and mikktspace.c: per face the direction
of growing u; per corner projected onto the vertex normal's plane and weighted by the corner angle;
summed over corners that share position, texture coordinate and handedness.

UV origin is glTF's top left, and +Y of a normal map is *up in the image*: the bitangent runs toward
decreasing v, bitangent = w * cross(normal, tangent).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.scan.topology import cross, unique_rows, unit

Array = npt.NDArray[Any]


def corner_tangents(positions: Array, faces: Array, normals: Array, corner_uv: Array) -> Array:
    """Tangents (m, 3, 4) float64 with the bitangent's sign in w.

    positions (n, 3), faces (m, 3), normals (n, 3) unit, corner_uv (m, 3, 2). Faces without area in
    UV get an arbitrary tangent perpendicular to the normal, and w = 1.
    """
    along_u, sign = _face_tangents(positions, faces, corner_uv)
    flat = faces.reshape(-1)
    normal = normals[flat].astype(np.float64)
    tangent = unit(_project(np.repeat(along_u, 3, axis=0), normal))
    weight = _projected_angles(positions, faces, normals).reshape(-1)
    # Corners with the same place, coordinate and handedness share one tangent.
    uv = np.nan_to_num(corner_uv.reshape(-1, 2).astype(np.float64))
    _, group = unique_rows(flat, *uv.T, np.repeat(sign, 3))
    summed = np.stack([np.bincount(group, weight * tangent[:, axis]) for axis in range(3)], axis=1)[
        group
    ]
    result = unit(_project(summed, normal))
    lost = np.linalg.norm(result, axis=1) < 0.5
    if lost.any():
        result[lost] = any_perpendicular(normal[lost])
    handed = np.repeat(np.where(sign == 0, 1, sign), 3)
    return np.concatenate([result, handed[:, None]], axis=1).reshape(-1, 3, 4)


def vertex_tangents(positions: Array, faces: Array, normals: Array, uv: Array) -> Array:
    """Tangents (n, 4) float32 for vertices that are already split at seams: uv (n, 2)."""
    corners = corner_tangents(positions, faces, normals, uv[faces])
    result = np.zeros((len(positions), 4), np.float32)
    result[:, :3] = any_perpendicular(normals.astype(np.float64))
    result[:, 3] = 1.0
    result[faces.reshape(-1)] = corners.reshape(-1, 4)
    return result


def any_perpendicular(normals: Array) -> Array:
    """One unit vector (k, 3) perpendicular to each normal."""
    helper = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    return unit(np.cross(normals, helper))


def to_tangent_space(vector: Array, normal: Array, tangent: Array) -> Array:
    """Coordinates of `vector` (k, 3) in interpolated frames: normal (k, 3), tangent (k, 4).

    The frames are not orthonormal after interpolation; a renderer computes
    x * tangent + y * w * cross(normal, tangent) + z * normal, so this inverts exactly that.
    """
    t, w = tangent[:, :3], tangent[:, 3:4]
    third = cross(normal, t)
    b = third * w
    first = cross(b, normal)
    determinant = np.einsum("ij,ij->i", t, first)
    flat = np.abs(determinant) <= 1e-12
    safe = np.where(flat, 1.0, determinant)
    parts = (first, third, cross(t, b))
    local = np.stack([np.einsum("ij,ij->i", vector, part) / safe for part in parts], axis=1)
    local[flat] = (0.0, 0.0, 1.0)
    return unit(local, fallback=(0.0, 0.0, 1.0))


def from_tangent_space(local: Array, normal: Array, tangent: Array) -> Array:
    """The inverse of `to_tangent_space`, unit vectors (k, 3)."""
    t = tangent[:, :3]
    b = np.cross(normal, t) * tangent[:, 3:4]
    return unit(local[:, :1] * t + local[:, 1:2] * b + local[:, 2:] * normal)


def _face_tangents(positions: Array, faces: Array, corner_uv: Array) -> tuple[Array, Array]:
    """Direction of growing u (m, 3), and the handedness: +1, -1, or 0 without area in UV."""
    a, b, c = (positions[faces[:, i]].astype(np.float64) for i in range(3))
    uv = np.nan_to_num(corner_uv.astype(np.float64))
    u1, u2 = uv[:, 1, 0] - uv[:, 0, 0], uv[:, 2, 0] - uv[:, 0, 0]
    # v runs down in the image; its negative runs up, as mikktspace and +Y expect.
    v1, v2 = uv[:, 0, 1] - uv[:, 1, 1], uv[:, 0, 1] - uv[:, 2, 1]
    area = u1 * v2 - u2 * v1
    sign = np.sign(np.where(np.abs(area) > 1e-20, area, 0.0))
    tangent = (v2[:, None] * (b - a) - v1[:, None] * (c - a)) * sign[:, None]
    return unit(tangent), sign


def _project(vectors: Array, normal: Array) -> Array:
    return np.asarray(vectors - np.einsum("ij,ij->i", vectors, normal)[:, None] * normal)


def _projected_angles(positions: Array, faces: Array, normals: Array) -> Array:
    """(m, 3) corner angles between edges projected onto the vertex normal's plane."""
    angles = np.zeros(faces.shape)
    for i in range(3):
        here = faces[:, i]
        normal = normals[here].astype(np.float64)
        u = unit(_project(positions[faces[:, (i + 1) % 3]] - positions[here], normal))
        v = unit(_project(positions[faces[:, (i + 2) % 3]] - positions[here], normal))
        angles[:, i] = np.arccos(np.clip(np.einsum("ij,ij->i", u, v), -1.0, 1.0))
    return angles
