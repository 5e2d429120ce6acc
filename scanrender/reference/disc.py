"""The surface integral of one narrow Gaussian: quadrature on the surface around each point.

A Gaussian narrower than any affordable sampling of the whole surface still reaches only its own
neighbourhood. Nodes of a product rule on the tangent plane, Gauss-Laguerre in r^2 / 2v and even in
angle, are projected along the normal onto the mesh; there light is evaluated afresh, shadow rays
included. As the Gaussian narrows, the sum becomes the light at the point itself.

Limits: only the first surface below the tangent plane counts, so what lies behind thin skin is
missing (widths here are far below any skin's thickness), and surface steeper than 87 degrees.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from scanrender.optics._math import Array
from scanrender.reference.integral import LobeSums
from scanrender.reference.lighting import frame
from scanrender.reference.parallel import each
from scanrender.reference.points import PictureCamera, Points
from scanrender.reference.sheet import Labels
from scanrender.reference.surface import Surface
from scanrender.reference.surface_samples import Field

_CHUNK_NODES = 100_000
_STEEPEST_COSINE = 0.05
# Rays start this high above the tangent plane, in standard deviations: higher finds other parts.
_HEIGHT_SIGMAS = 3.0
# Turns consecutive points by fractions that fill the circle evenly (plastic number).
_TURN = 0.7548776662466927


def disc_sums(
    surface: Surface,
    field: Field,
    points: Points,
    label: Labels,
    sheet_of_face: Labels,
    camera: PictureCamera | None,
    variance_mm2: float,
    nodes: int,
) -> LobeSums:
    """LobeSums at points of sheets ``label`` (k,), with about ``nodes`` nodes at each."""
    offsets, weights = disc_rule(nodes)
    step = max(1, _CHUNK_NODES // len(weights))
    starts = range(0, len(points), step)

    def work(job: int) -> LobeSums:
        which = np.arange(starts[job], min(starts[job] + step, len(points)))
        return _sums(which)

    def _sums(which: np.ndarray[tuple[int, ...], np.dtype[np.int64]]) -> LobeSums:
        some = points.chosen(which)
        sigma, count = math.sqrt(variance_mm2), len(weights)
        middle = surface.positions_at(some.face, some.bary)
        normal = surface.face_normals[some.face]
        across, along = frame(normal)
        turn = 2.0 * math.pi * np.mod(which * _TURN, 1.0)
        c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
        x, y = offsets[:, 0] * c - offsets[:, 1] * s, offsets[:, 0] * s + offsets[:, 1] * c
        aside = x[..., None] * across[:, None] + y[..., None] * along[:, None]
        height = _HEIGHT_SIGMAS * sigma * normal[:, None]
        start = (middle[:, None] + sigma * aside + height).reshape(-1, 3)
        down = np.repeat(-normal, count, axis=0)
        face, bary = surface.caster.first_hit(start, down, 2.0 * _HEIGHT_SIGMAS * sigma)
        hit = np.flatnonzero(face >= 0)
        face, bary, owner = face[hit], bary[hit], hit // count
        at = surface.positions_at(face, bary)
        z = np.einsum("ki,ki->k", at - middle[owner], normal[owner])
        cosine = np.einsum("ki,ki->k", surface.face_normals[face], normal[owner])
        # G(|x - p|) dA over the plane's G(r2) d^2r2: exact on a plane, whatever rays round to.
        share = np.exp(-0.5 * z * z / variance_mm2) / np.maximum(cosine, _STEEPEST_COSINE)
        share *= weights[hit % count] * (cosine > _STEEPEST_COSINE)
        light, mask = field(face, bary)
        share *= mask
        own = share * (sheet_of_face[face] == label[which][owner])
        if camera is not None:
            to_eye = camera.to_eye(at)
            own *= np.einsum("ki,ki->k", surface.face_normals[face], to_eye) > 0.0
        return LobeSums(
            _summed(owner, share[:, None] * light, len(some)),
            _summed(owner, share[:, None], len(some))[:, 0],
            _summed(owner, own[:, None] * light, len(some)),
            _summed(owner, own[:, None], len(some))[:, 0],
        )

    if len(points) == 0:
        return LobeSums(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)), np.zeros(0))
    return LobeSums.joined(each(len(starts), work))


@lru_cache(maxsize=8)
def disc_rule(nodes: int) -> tuple[Array, Array]:
    """Offsets (n, 2) in standard deviations and weights (n,), summing to 1, of a plane Gaussian.

    r^2 / 2v of a plane Gaussian is exponential: Gauss-Laguerre radii, at least three angles each.
    """
    radii = 1 if nodes < 4 else 2 if nodes < 10 else 3 if nodes < 30 else 4 if nodes < 100 else 5
    u, w = np.polynomial.laguerre.laggauss(radii)
    offsets, weights = [], []
    for ring in range(radii):
        angles = max(3, round(nodes * (0.5 * w[ring] + 0.5 / radii))) if nodes > 1 else 1
        phi = 2.0 * math.pi * (np.arange(angles) + 0.5 * (ring % 2)) / angles
        r = math.sqrt(2.0 * u[ring]) if nodes > 1 else 0.0
        offsets.append(r * np.stack([np.cos(phi), np.sin(phi)], axis=1))
        weights.append(np.full(angles, w[ring] / angles))
    total = np.concatenate(weights)
    return np.concatenate(offsets), total / total.sum()


def _summed(
    owner: np.ndarray[tuple[int, ...], np.dtype[np.int64]], rows: Array, count: int
) -> Array:
    """(count, c): rows (j, c) added to their owners (j,)."""
    sums = [np.bincount(owner, column, count) for column in rows.T]
    return np.stack(sums, axis=1)
