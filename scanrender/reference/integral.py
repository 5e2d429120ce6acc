"""The surface integral of one Gaussian at many points, over samples of the whole surface.

sum over cells of area x mask x light x G(v, |x_p - x|), in float64, with no far field left out but
`tail`. Points are taken in blocks about as wide as the Gaussian, whose cells one search finds: a
dense matrix a block is several times faster than a list of neighbours a point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from scanrender.optics._math import Array
from scanrender.reference.parallel import each
from scanrender.reference.sheet import Labels
from scanrender.reference.surface_samples import Samples

_BLOCK_SIGMAS = 2.0
_DENSE_ENTRIES = 130_000  # of float64: 1 MiB stays in a core's cache between its three passes
_JOBS = 32


@dataclass(frozen=True)
class LobeSums:
    """Integrals of one Gaussian G at k points.

    ``total`` (k, 3) = integral of G mask light dA and ``mass`` (k,) = integral of G mask dA, over
    the whole surface; ``sheet_total`` and ``sheet_mass`` over the point's own sheet.
    """

    total: Array
    mass: Array
    sheet_total: Array
    sheet_mass: Array

    @classmethod
    def joined(cls, parts: list[LobeSums]) -> LobeSums:
        """Of consecutive points."""
        join = np.concatenate
        return cls(
            join([part.total for part in parts]),
            join([part.mass for part in parts]),
            join([part.sheet_total for part in parts]),
            join([part.sheet_mass for part in parts]),
        )

    def reordered(self, order: npt.NDArray[np.int64]) -> LobeSums:
        """Row i of the result is row order[i] of this."""
        parts = (self.total, self.mass, self.sheet_total, self.sheet_mass)
        return LobeSums(*(part[order] for part in parts))


def reach_mm(variance_mm2: float, tail: float) -> float:
    """Radius past which a Gaussian has ``tail`` of its energy on a plane."""
    return math.sqrt(2.0 * variance_mm2 * math.log(1.0 / tail))


def lobe_sums(
    position: Array,
    label: Labels,
    samples: Samples,
    sheet_of_face: Labels,
    variance_mm2: float,
    tail: float,
) -> LobeSums:
    """LobeSums at points (k, 3) mm of sheets ``label`` (k,), for a Gaussian of ``variance_mm2``.

    Light averaged into cells is light blurred by the cells: their spread is taken off the variance.
    """
    variance = max(variance_mm2 - samples.spread_mm2, 0.5 * variance_mm2)
    tree = cKDTree(samples.position, balanced_tree=False, compact_nodes=False)
    order, starts = _blocks(position, _BLOCK_SIGMAS * math.sqrt(variance))
    reach = reach_mm(variance, tail)
    # One row a cell, so that a block gathers memory once.
    sheet = sheet_of_face[samples.face]
    table = np.column_stack(
        [samples.position, samples.source, samples.mass, samples.seen, sheet.astype(np.float64)]
    )

    def work(job: int) -> LobeSums:
        edges = np.linspace(0, len(starts) - 1, jobs + 1).astype(np.int64)
        parts = []
        for block in range(edges[job], edges[job + 1]):
            mine = order[starts[block] : starts[block + 1]]
            parts.append(_block_sums(position[mine], label[mine]))
        return LobeSums.joined(parts) if parts else _block_sums(position[:0], label[:0])

    def _block_sums(at: Array, at_label: Labels) -> LobeSums:
        if len(at) == 0:
            return LobeSums(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)), np.zeros(0))
        middle = 0.5 * (at.min(axis=0) + at.max(axis=0))
        radius = float(np.sqrt(np.sum((at - middle) ** 2, axis=1).max()))
        near = np.asarray(tree.query_ball_point(middle, reach + radius), np.int64)
        near.sort()  # the tree's order is no contract, and sums depend on it in the last digits
        rows = table[near]
        values, seen, cell_sheet = rows[:, 3:7], rows[:, 7], rows[:, 8]
        labels = np.unique(at_label)
        weights = [np.where(cell_sheet == one, seen, 0.0)[:, None] for one in labels]
        # All cells first, then each sheet's own: one product, since the matrix is what is large.
        columns = np.concatenate([values, *(values * weight for weight in weights)], axis=1)
        columns *= 1.0 / (2.0 * math.pi * variance)
        cells = _one_side(rows[:, :3] - middle, variance, is_cell=True).T
        points = _one_side(at - middle, variance, is_cell=False)
        sums = np.empty((len(at), columns.shape[1]))
        step = max(1, _DENSE_ENTRIES // max(len(near), 1))
        for start in range(0, len(at), step):
            kernel = points[start : start + step] @ cells
            np.exp(kernel, out=kernel)
            sums[start : start + step] = kernel @ columns
        own = np.empty((len(at), 4))
        for number, one in enumerate(labels, 1):
            mine = at_label == one
            own[mine] = sums[mine, 4 * number : 4 * number + 4]
        return LobeSums(sums[:, :3], sums[:, 3], own[:, :3], own[:, 3])

    jobs = max(1, min(_JOBS, len(starts) - 1))
    found = LobeSums.joined(each(jobs, work))
    back = np.empty(len(order), np.int64)
    back[order] = np.arange(len(order))
    return found.reordered(back)


def _one_side(position: Array, variance: float, is_cell: bool) -> Array:
    """(k, 5) whose product of points and cells is -|p - c|^2 / 2v, for mm close to the origin."""
    scaled = position * (1.0 / math.sqrt(2.0 * variance))
    squared, ones = -np.sum(scaled * scaled, axis=1, keepdims=True), np.ones((len(scaled), 1))
    parts = [scaled, ones, squared] if is_cell else [2.0 * scaled, squared, ones]
    return np.concatenate(parts, axis=1)


def _blocks(position: Array, side_mm: float) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Order of points by the cube they lie in, and where each cube starts, with the end."""
    cube = np.floor(position / side_mm).astype(np.int64)
    order = np.lexsort((cube[:, 0], cube[:, 1], cube[:, 2]))
    cube = cube[order]
    steps = np.flatnonzero((cube[1:] != cube[:-1]).any(axis=1)) + 1
    return order, np.concatenate([[0], steps, [len(order)]]).astype(np.int64)
