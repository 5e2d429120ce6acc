"""Large raw scans to measure with: there is no freely licensed real one above a million triangles,
so a real head is subdivided and given pores, and our own phantom is made at any size.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender import images
from scanrender.errors import UsageError
from scanrender.files import make_folder
from scanrender.phantom import Damage, Head, make_head, scan_head, write_obj, write_ply
from scanrender.phantom.noise import noise
from scanrender.scan.ingest import read_scan
from scanrender.scan.raw import RawMesh
from scanrender.scan.topology import edges_of, vertex_normals

Array = npt.NDArray[Any]

REAL_HEAD = Path("lee_perry_smith") / "LeePerrySmith.obj"
REAL_HEAD_MM = 388.0  # bounding-box height, see the manifest of the scans
# Displacements of the subdivided head, (lattice spacing mm, standard deviation mm): creases, pores.
RELIEF = ((6.0, 0.05), (1.5, 0.02))


def phantom_scan(path: Path, triangles: int, seed: int = 0) -> Path:
    """Our own head with a scanner's faults, as binary PLY."""
    make_folder(path.parent)
    return write_ply(path, scan_head(make_head(triangles, seed), Damage(), seed))


def dense_head_scan(path: Path, scans: Path, levels: int = 3) -> Path:
    """The real head with each triangle cut into 4^levels, rounded, displaced, in millimetres, with
    its texture as vertex colours, as binary PLY. Raises UsageError where there is no such scan."""
    source = scans / REAL_HEAD
    if not source.exists():
        raise UsageError(f"no such scan: {source}", fix="name the folder: --scans FOLDER")
    raw = read_scan(source)
    scale = REAL_HEAD_MM / float(np.ptp(raw.positions[np.unique(raw.faces)], axis=0)[1])
    positions, faces, colors = _welded(raw, scale)
    for _ in range(levels):
        positions, faces, colors = rounded_split(positions, faces, colors)
    normals = vertex_normals(positions, faces)
    for number, (spacing, deviation) in enumerate(RELIEF):
        positions = positions + (deviation * noise(positions, spacing, number))[:, None] * normals
    make_folder(path.parent)
    label = np.zeros(len(positions), np.uint8)
    spacing_mm = float(
        np.linalg.norm(positions[faces[:, 0]] - positions[faces[:, 1]], axis=1).mean()
    )
    head = Head(positions, faces.astype(np.int32), colors.astype(np.float32), label, 0, spacing_mm)
    return write_ply(path, head)


def paged_scan(folder: Path, triangles: int, pages: int, page_px: int) -> Path:
    """The phantom as OBJ with `pages` textures of page_px: baked small, enlarged afterwards."""
    small = min(512, page_px)
    scan = write_obj(folder / "head.obj", scan_head(make_head(triangles), Damage()), pages, small)
    for page in sorted(folder.glob("*.png")):
        pixels = images.read_image(page)[:, :, :3]
        factor = page_px // small
        images.write_png8(page, pixels.repeat(factor, axis=0).repeat(factor, axis=1))
    return scan


def _welded(raw: RawMesh, scale: float) -> tuple[Array, Array, Array]:
    """Positions mm, faces, and linear colours at the vertices, from the texture of one corner."""
    unique, index = np.unique(raw.positions, axis=0, return_inverse=True)
    faces = index.reshape(-1)[raw.faces]
    solid = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    colors = np.full((len(unique), 3), 0.5, np.float32)
    if raw.corner_uv is not None and raw.pages:
        colors[faces.reshape(-1)] = raw.pages[0].sample(raw.corner_uv.reshape(-1, 2))
    return unique * scale, faces[solid], colors


def rounded_split(positions: Array, faces: Array, colors: Array) -> tuple[Array, Array, Array]:
    """Each triangle into four, then each vertex a quarter of the way to its neighbours' mean: the
    facets of the coarse mesh become curved."""
    edges = edges_of(faces)
    middle = len(positions) + edges.half.reshape(3, -1)  # of the edges 01, 12, 20
    a, b, c = faces.T
    ab, bc, ca = middle
    split = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
    positions = np.concatenate([positions, positions[edges.pairs].mean(axis=1)])
    colors = np.concatenate([colors, colors[edges.pairs].mean(axis=1)])
    fine = edges_of(split)
    inner = np.ones(len(positions), bool)
    inner[fine.pairs[fine.count == 1]] = False  # the open border stays where it is
    total, count = np.zeros_like(positions), np.zeros(len(positions))
    for here, there in (fine.pairs.T, fine.pairs.T[::-1]):
        for axis in range(3):
            total[:, axis] += np.bincount(here, positions[there, axis], len(positions))
        count += np.bincount(here, minlength=len(positions))
    shift = total / np.maximum(count, 1)[:, None] - positions
    return positions + 0.25 * inner[:, None] * shift, split, colors
