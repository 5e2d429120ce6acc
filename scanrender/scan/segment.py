"""Cut a surface into few compact pieces that flatten well.

k-means on (centroid, scaled normal) of faces, after Lloyd 1982 and in the spirit of Cohen-Steiner,
Alliez, Desbrun: Variational Shape Approximation, SIGGRAPH 2004; with normals smoothed over the
surface first, so that scanner noise does not fray the borders.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse import csgraph

from scanrender.scan.topology import (
    area_normals,
    face_areas,
    face_centres,
    face_pairs,
    lengths,
    unit,
)

Array = npt.NDArray[Any]

# On a head of 200 000 mm^2 this makes a right angle count as much as 35 mm of distance.
NORMAL_SCALE = 0.055
SMOOTHING_SWEEPS = 30
SMALLEST_SHARE = 0.004
STRAIGHTENING_SWEEPS = 4


def segment(
    positions: Array, faces: Array, pieces: int, whole: Array | None = None, seed: int = 0
) -> Array:
    """A piece number (m,) for each face; every piece is connected through edges.

    `whole` (m,) marks faces that shall be one piece, without a cut through them.
    """
    from scipy.cluster.vq import kmeans2

    first, second, _ = face_pairs(faces)
    count = len(faces)
    area = face_areas(positions, faces)
    whole = np.zeros(count, bool) if whole is None else whole
    smooth = smoothed_face_normals(positions, faces, SMOOTHING_SWEEPS)
    scale = NORMAL_SCALE * float(np.sqrt(area.sum()))
    centroid = face_centres(positions, faces)
    features = np.concatenate([centroid, smooth * scale], axis=1)
    # Faces of uneven size are weighted by area through resampling; labels follow the centres.
    rng = np.random.default_rng(seed)
    share = np.where(whole, 0.0, area)
    if share.sum() <= 0.0:
        return pieces_of(whole, first, second)
    drawn = rng.choice(count, min(20_000, 4 * count), p=share / share.sum())
    centers, _ = kmeans2(features[drawn], min(pieces, count), minit="++", iter=20, rng=rng)
    label = _nearest(features, centers)
    label[whole] = len(centers)
    for _ in range(STRAIGHTENING_SWEEPS):
        label = np.where(whole, label, _majority(label, first, second, count))
    return merge_small(pieces_of(label, first, second), first, second, positions, faces)


def split_in_two(positions: Array, faces: Array) -> Array:
    """Halves (m,) 0 or 1 of one piece, across its longest direction; both are non-empty."""
    centroid = face_centres(positions, faces)
    offset = centroid - centroid.mean(axis=0)
    _, _, axes = np.linalg.svd(offset, full_matrices=False)
    along = offset @ axes[0]
    half = np.asarray(along > np.median(along), np.int64)
    first, second, _ = face_pairs(faces)
    # A jagged border crosses itself when it is laid flat.
    straight = half
    for _ in range(STRAIGHTENING_SWEEPS):
        straight = _majority(straight, first, second, len(faces))
    for label in (straight, half):
        if 0 < label.sum() < len(faces):
            return label
    return np.asarray(np.arange(len(faces)) >= len(faces) // 2, np.int64)


def edge_components(faces: Array) -> Array:
    """The edge-connected component (m,) of each face."""
    first, second, _ = face_pairs(faces)
    _, label = csgraph.connected_components(symmetric(first, second, len(faces)), directed=False)
    return np.asarray(label)


def merge_small(label: Array, first: Array, second: Array, positions: Array, faces: Array) -> Array:
    """Give pieces below a share of the area to the neighbour with the longest common border."""
    area = face_areas(positions, faces)
    for _ in range(6):
        count = int(label.max()) + 1
        size = np.bincount(label, area, minlength=count)
        a, b = label[first], label[second]
        border = a != b
        touching = sparse.coo_matrix(
            (np.ones(border.sum()), (a[border], b[border])), shape=(count, count)
        ).tocsr()
        touching = touching + touching.T
        target = np.arange(count)
        small = np.flatnonzero(size < SMALLEST_SHARE * area.sum())
        for piece in small[np.argsort(size[small], kind="stable")]:
            row = touching[piece]
            # Only into a piece that is not itself moving, so that no two swap places.
            fixed = [(v, -k) for k, v in zip(row.indices, row.data, strict=True) if target[k] == k]
            if fixed:
                target[piece] = -max(fixed)[1]
        if (target == np.arange(count)).all():
            break
        _, label = np.unique(target[label], return_inverse=True)
        label = label.reshape(-1)
    return np.asarray(label)


def smoothed_face_normals(positions: Array, faces: Array, sweeps: int) -> Array:
    """(m, 3) unit normals averaged with the neighbours', by area, `sweeps` times over."""
    first, second, _ = face_pairs(faces)
    normal = area_normals(positions, faces)
    area = 0.5 * lengths(normal)
    adjacency = symmetric(first, second, len(faces))
    weight = sparse.diags(area + 1e-12) @ adjacency
    blend = sparse.diags(1.0 / np.maximum(np.asarray(adjacency.sum(axis=1)).ravel(), 1.0))
    smooth = unit(normal)
    for _ in range(sweeps):
        smooth = unit(smooth * area[:, None] + blend @ (weight.T @ smooth))
    return smooth


def pieces_of(label: Array, first: Array, second: Array) -> Array:
    """(m,) piece numbers of the faces, where only neighbours with the same label are connected."""
    same = label[first] == label[second]
    graph = symmetric(first[same], second[same], len(label))
    return np.asarray(csgraph.connected_components(graph, directed=False)[1], np.int64)


def symmetric(first: Array, second: Array, count: int) -> Any:
    half = sparse.coo_matrix((np.ones(len(first)), (first, second)), shape=(count, count))
    return (half + half.T).tocsr()


def _nearest(features: Array, centers: Array) -> Array:
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(centers).query(features)[1], np.int64)


def _majority(label: Array, first: Array, second: Array, count: int) -> Array:
    """A face of whose (at most three) neighbours two agree joins them: straighter borders."""
    here = np.concatenate([first, second])
    order = np.argsort(here, kind="stable")
    here, there = here[order], label[np.concatenate([second, first])[order]]
    around = np.full((count, 3), -1, np.int64)
    around[here, np.arange(len(here)) - np.searchsorted(here, here)] = there
    a, b, c = around.T
    agreed = np.where((a == b) | (a == c), a, np.where(b == c, b, -1))
    return np.asarray(np.where(agreed >= 0, agreed, label))
