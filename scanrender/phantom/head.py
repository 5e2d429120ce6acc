"""The undamaged truth: a head as mesh, albedo and labels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanrender.phantom.albedo import LABELS, albedo_at
from scanrender.phantom.masks import masks_at
from scanrender.phantom.mesh import build_surface, vertex_normals
from scanrender.phantom.noise import Array
from scanrender.phantom.relief import relief_mm
from scanrender.phantom.shape import make_shape, template_from_truth, truth_from_template

__all__ = ["LABELS", "Head", "albedo_of_truth", "make_head"]

_CHUNK = 131_072


@dataclass(frozen=True)
class Head:
    """The truth frame: mm, right handed, +Y up, face toward +Z, origin mid-head.

    positions_mm (n, 3) float64; faces (m, 3) int32, counter-clockwise from outside;
    albedo_linear (n, 3) float32, linear Rec.709; label (n,) uint8, an index into LABELS;
    seed and spacing_mm (mean edge) are what the detail was made from.
    """

    positions_mm: Array
    faces: NDArray[np.int32]
    albedo_linear: NDArray[np.float32]
    label: NDArray[np.uint8]
    seed: int
    spacing_mm: float


def make_head(triangles: int = 400_000, seed: int = 0) -> Head:
    """A head of about `triangles` (within a few per cent); the same arguments, the same bytes."""
    surface = build_surface(triangles)
    shape = make_shape(seed)
    template = surface.positions
    positions = np.empty_like(template)
    albedo = np.empty(template.shape, dtype=np.float32)
    label = np.empty(len(template), dtype=np.uint8)
    relief = np.empty(len(template))
    spacing_mm = _mean_edge_mm(template, surface.faces)
    for start in range(0, len(template), _CHUNK):
        part = slice(start, start + _CHUNK)
        t = template[part]
        masks = masks_at(t, seed)
        albedo[part], label[part] = albedo_at(t, masks, spacing_mm, seed)
        relief[part] = relief_mm(t, masks, spacing_mm, seed)
        positions[part] = truth_from_template(t, shape)
    positions += relief[:, None] * vertex_normals(positions, surface.faces)
    return Head(positions, surface.faces, albedo, label, seed, spacing_mm)


def albedo_of_truth(positions_mm: Array, spacing_mm: float, seed: int) -> NDArray[np.float32]:
    """Albedo (n, 3), linear Rec.709, at truth points: what a texture finer than the mesh shows."""
    shape = make_shape(seed)
    albedo = np.empty(positions_mm.shape, dtype=np.float32)
    for start in range(0, len(positions_mm), _CHUNK):
        part = slice(start, start + _CHUNK)
        t = template_from_truth(positions_mm[part], shape)
        albedo[part], _ = albedo_at(t, masks_at(t, seed), spacing_mm, seed)
    return albedo


def _mean_edge_mm(positions: Array, faces: NDArray[np.int32]) -> float:
    a, b = positions[faces[:, 0]], positions[faces[:, 1]]
    return float(np.linalg.norm(a - b, axis=1).mean())
