"""Dense scans with a texture, texture coordinates of their own and a known truth.

`dense_head_scan` colours vertices; here the surface keeps the real head's texture coordinates, so
that `--as-is` can show it with all its geometry and all its colour: what a prepared asset is
compared with. The sensor's noise is added last, so that the surface without it is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender import images
from scanrender.errors import UsageError
from scanrender.files import atomic_path, make_folder
from scanrender.measure.prep_inputs import REAL_HEAD, REAL_HEAD_MM, RELIEF, rounded_split
from scanrender.phantom import Damage, make_head, scan_head, write_obj
from scanrender.phantom.noise import noise
from scanrender.scan.gutters import Gutters
from scanrender.scan.ingest import read_scan
from scanrender.scan.rasterize import rasterize
from scanrender.scan.raw import RawMesh
from scanrender.scan.topology import components, vertex_normals

Array = npt.NDArray[Any]

PAGE_PX = 4096
# Colour finer than the head's own 1024 px texture, (lattice spacing mm, standard deviation of the
# logarithm of the albedo): blotches, freckles, pores.
MOTTLE = ((9.0, 0.05), (2.5, 0.05), (0.9, 0.05))
# The ears of the real head in its own frame, in mm: |x| beyond the first number, y and z between.
HEAD_EARS = (66.0, (25.0, 95.0), (-16.0, 28.0))


@dataclass(frozen=True)
class Truth:
    """A scan file and what it was made from.

    positions_mm (n, 3) and faces (m, 3) of the undamaged surface; truth_from_raw (4, 4) takes the
    file's coordinates to it; ears (m,) marks its faces on the ears; components of the surface.
    """

    scan: Path
    positions_mm: Array
    faces: Array
    truth_from_raw: Array
    ears: npt.NDArray[np.bool_]
    components: int


def bust_scan(folder: Path, scans: Path, noise_mm: float, levels: int = 3) -> Truth:
    """The real head as in `dense_head_scan`, with its texture, and noise_mm of sensor noise.

    17,672 * 4^levels triangles, 388 mm high, in millimetres, as binary PLY with a PNG of PAGE_PX.
    Raises UsageError where there is no such scan.
    """
    source = scans / REAL_HEAD
    if not source.exists():
        raise UsageError(f"no such scan: {source}", fix="name the folder: --scans FOLDER")
    positions, faces, corner_uv, raw = _textured(read_scan(source))
    page = folder / "bust.png"
    if not page.exists():
        make_folder(folder)
        images.write_srgb_png(page, _page(positions, faces, corner_uv, raw))
    for _ in range(levels):
        positions, faces, _ = rounded_split(positions, faces, np.zeros((len(positions), 1)))
        corner_uv = _split_corners(corner_uv)
    normals = vertex_normals(positions, faces)
    for number, (spacing, deviation) in enumerate(RELIEF):
        positions = positions + (deviation * noise(positions, spacing, number))[:, None] * normals
    scan = folder / f"bust_{noise_mm:g}.ply"
    if not scan.exists():
        error = np.random.default_rng(7).normal(0.0, noise_mm, len(positions))
        _write_ply(scan, positions + error[:, None] * normals, faces, corner_uv, page.name)
    return Truth(
        scan,
        positions,
        faces,
        np.eye(4),
        _in_ears(positions[faces].mean(axis=1), *HEAD_EARS),
        components(faces, len(positions))[0],
    )


def phantom_bust(folder: Path, triangles: int, page_px: int = PAGE_PX) -> Truth:
    """Our own head with a scanner's noise, in its own frame, as OBJ with one texture.

    Its floaters are left out: that they are dropped is not a loss, and is tested elsewhere.
    """
    head = make_head(triangles)
    damage = Damage(floaters=0, spikes=0, tilt_deg=0.0, mm_per_unit=1.0, offset=(0.0, 0.0, 0.0))
    raw = scan_head(head, damage)
    scan = folder / "phantom" / f"phantom_{triangles}.obj"
    if not scan.exists():
        make_folder(scan.parent)
        write_obj(scan, raw, 1, page_px)
    middle = head.positions_mm[head.faces].mean(axis=1)
    reach = float(np.abs(middle[:, 0]).max())
    ears = np.abs(middle[:, 0]) > 0.85 * reach
    count = components(head.faces, len(head.positions_mm))[0]
    return Truth(
        scan, head.positions_mm, head.faces, np.linalg.inv(raw.raw_from_truth), ears, count
    )


def _textured(raw: RawMesh) -> tuple[Array, Array, Array, RawMesh]:
    """Welded positions in mm, faces, texture coordinates of the corners; faces without area go."""
    if raw.corner_uv is None or not raw.pages:
        raise UsageError("the real head has no texture", fix="fetch the scan again, whole")
    scale = REAL_HEAD_MM / float(np.ptp(raw.positions[np.unique(raw.faces)], axis=0)[1])
    unique, index = np.unique(raw.positions, axis=0, return_inverse=True)
    faces = index.reshape(-1)[raw.faces]
    solid = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return unique * scale, faces[solid], raw.corner_uv[solid], raw


def _page(positions: Array, faces: Array, corner_uv: Array, raw: RawMesh) -> Array:
    """(PAGE_PX, PAGE_PX, 3) linear: the scan's texture enlarged, with finer colour on it."""
    texels = rasterize(corner_uv.reshape(-1, 2), np.arange(3 * len(faces)).reshape(-1, 3), PAGE_PX)
    points = texels.interpolate(positions[faces])
    tone = sum(deviation * noise(points, spacing, 40) for spacing, deviation in MOTTLE)
    small = raw.pages[0]
    uv = np.stack([texels.index % PAGE_PX, texels.index // PAGE_PX], axis=1)
    color = small.sample((uv + 0.5) / PAGE_PX) * np.exp(tone)[:, None]
    return Gutters(texels.mask).fill(texels.scatter(np.clip(color, 0.0, 1.0)))


def _split_corners(corner_uv: Array) -> Array:
    """Texture coordinates (4 m, 3, 2) of the corners after `rounded_split`."""
    a, b, c = corner_uv.transpose(1, 0, 2)
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    split = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1)
    return np.asarray(split.reshape(-1, 3, 2))


def _in_ears(
    points: Array, aside: float, height: tuple[float, float], depth: tuple[float, float]
) -> npt.NDArray[np.bool_]:
    x, y, z = points.T
    inside = (np.abs(x) > aside) & (y > height[0]) & (y < height[1])
    return np.asarray(inside & (z > depth[0]) & (z < depth[1]))


def _write_ply(path: Path, positions: Array, faces: Array, corner_uv: Array, page: str) -> None:
    """Binary PLY with texture coordinates of corners, as MeshLab writes them: v runs up."""
    rows = np.empty(
        len(faces), [("n", "u1"), ("face", "<i4", 3), ("k", "u1"), ("uv", "<f4", (3, 2))]
    )
    rows["n"], rows["face"], rows["k"] = 3, faces, 6
    rows["uv"] = np.stack([corner_uv[:, :, 0], 1.0 - corner_uv[:, :, 1]], axis=2)
    header = ["ply", "format binary_little_endian 1.0", f"comment TextureFile {page}"]
    header += [f"element vertex {len(positions)}", *(f"property float {axis}" for axis in "xyz")]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    header += ["property list uchar float texcoord", "end_header"]
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        stream.write(("\n".join(header) + "\n").encode("ascii"))
        stream.write(positions.astype("<f4").tobytes())
        stream.write(rows.tobytes())
