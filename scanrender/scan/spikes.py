"""Pull single vertices that shot out of the surface back among their neighbours."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.scan.surface import Surface
from scanrender.scan.topology import edge_lengths, edges_of, lengths

# A clean, evenly bent surface deviates by next to nothing: this share of the edge length keeps
# rounding and curvature there from counting as spikes.
EDGE_SHARE = 0.06


def flatten_spikes(surface: Surface, sigma: float) -> tuple[Surface, int]:
    """Move each spike to its neighbours' mean; returns the surface and the number moved.

    A spike is further from its neighbours' mean than `sigma` times its neighbours' own deviation
    and than the local edge length. Boundary vertices are left alone: their mean is one-sided.
    """
    edges = edges_of(surface.faces)
    count = len(surface.positions)
    half = edges.matrix(np.ones(len(edges.pairs)), count)

    def summed(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Of each vertex's neighbours; the whole matrix, to and fro, would take as long to make."""
        return np.asarray(half @ values + half.T @ values)

    degree = np.maximum(np.bincount(edges.pairs.reshape(-1), minlength=count), 1.0)
    mean = summed(surface.positions) / degree[:, None]
    deviation = lengths(surface.positions - mean)
    around = summed(deviation) / degree
    # A spike lifts its neighbours' deviation by 1/degree of its own: take that share away again.
    inherited = summed(deviation / degree) / degree
    length = edge_lengths(surface.positions, edges.pairs)
    typical = float(np.median(length)) if len(length) else 0.0
    local = np.maximum(around - inherited, 0.0) + EDGE_SHARE * typical
    spike = (deviation > sigma * local) & (degree >= 3)
    spike[edges.pairs[edges.count != 2].reshape(-1)] = False
    if not spike.any():
        return surface, 0
    positions = surface.positions.copy()
    positions[spike] = mean[spike]
    return replace(surface, positions=positions), int(spike.sum())
