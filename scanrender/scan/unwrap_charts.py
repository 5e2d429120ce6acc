"""First rung of the unwrap ladder: our own charts, flattened by SLIM, packed as bitmaps.

xatlas alone makes thousands of charts on noisy skin (4143 on a 50 k head); few, compact charts
keep seams rare and mip levels clean. The face is one of them as long as it flattens. A piece
that is not a disk, flips, overlaps itself, or stretches too much is cut in two, and again, down to
single triangles, which always work: hence no flips. Where only a corner of a piece lies over
another, that corner alone becomes a piece. Runs in a child process only.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.scan.face_region import face_region
from scanrender.scan.flatten import (
    distortion,
    flattenings,
    is_flattenable,
    isometric_triangle,
    signed_areas,
)
from scanrender.scan.pack import pack_charts
from scanrender.scan.parallel import run, workers
from scanrender.scan.rasterize import overlap_share
from scanrender.scan.raw import NO_PAGE
from scanrender.scan.repair import split_vertices
from scanrender.scan.segment import edge_components, segment, split_in_two
from scanrender.scan.surface import Surface
from scanrender.scan.untangle import simple_part
from scanrender.scan.unwrap_box import possible_padding

Array = npt.NDArray[Any]

PIECES = 36
MAX_DISTORTION = 1.25
# The mean over a face counts what nobody sees, bags behind its lids and lips; a seam all would see.
FACE_DISTORTION = 1.45
STRAY_SHARE = 0.2  # of a side's largest part: less is not a chart of its own
MAX_OVERLAP = 0.002  # of a piece; less is taken away face by face
OVERLAP_TEST_PX = 256


def unwrap_by_charts(
    arrays: dict[str, Any], params: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """positions (n, 3), faces (m, 3), padding as a share of the atlas side -> chart (m,), corner_uv
    (m, 3, 2) in mm, and, where our packer manages, packed (m, 3, 2) in [0, 1], y up. The report
    has the padding that there is room for."""
    positions, faces = arrays["positions"], arrays["faces"]
    pieces = min(int(params.get("pieces", PIECES)), max(1, len(faces) // 40))
    region = face_region(positions, faces)
    label = segment(positions, faces, pieces, region)
    waiting = [np.flatnonzero(label == piece) for piece in range(int(label.max()) + 1)]
    waiting.sort(key=len, reverse=True)  # the face takes longest: it begins first
    shares = min(workers(), len(waiting))
    parts = run([_flattened(positions, faces, region, waiting[i::shares]) for i in range(shares)])
    chart = np.full(len(faces), -1, np.int64)
    corner_uv = np.zeros((len(faces), 3, 2))
    done = 0
    for part in parts:
        for chosen, flat in part:
            chart[chosen], corner_uv[chosen] = done, flat
            done += 1
    result = {"chart": chart, "corner_uv": corner_uv}
    padding = possible_padding(float(params["padding"]), done)
    report: dict[str, Any] = {"charts": done, "cuts": done - len(waiting), "padding": padding}
    try:
        result["packed"] = pack_charts(chart, corner_uv, padding)
    except ValueError as error:
        report["not_packed"] = str(error)
    return result, report


def _flattened(
    positions: Array, faces: Array, region: Array, waiting: list[Array]
) -> Callable[[], list[tuple[Array, Array]]]:
    """A job: the faces and corner UV of each piece, cut as often as it takes."""

    def job() -> list[tuple[Array, Array]]:
        left, done = list(reversed(waiting)), []
        while left:
            chosen = left.pop()
            limit = FACE_DISTORTION if region[chosen].mean() > 0.5 else MAX_DISTORTION
            flat = _flat(positions, faces[chosen], limit)
            if flat is None:
                left += _halves(positions, faces, chosen)
                continue
            kept, corner_uv = flat
            done.append((chosen[kept], corner_uv[kept]))
            left += _connected(faces, chosen[~kept])
        return done

    return job


def _halves(positions: Array, faces: Array, chosen: Array) -> list[Array]:
    half = split_in_two(positions, faces[chosen])
    # What a side's larger part left behind across the cut goes to the other side.
    for side in (0, 1):
        rows = np.flatnonzero(half == side)
        label = edge_components(faces[chosen[rows]])
        size = np.bincount(label)
        half[rows[size[label] < STRAY_SHARE * size.max()]] = 1 - side
    return [part for side in (0, 1) for part in _connected(faces, chosen[half == side])]


def _connected(faces: Array, chosen: Array) -> list[Array]:
    if not len(chosen):
        return []
    label = edge_components(faces[chosen])
    return [chosen[label == number] for number in range(int(label.max()) + 1)]


def _flat(
    positions: Array, faces: Array, most_distortion: float
) -> tuple[npt.NDArray[np.bool_], Array] | None:
    """One piece flattened: which of its faces (m,) stay, and corner UV (m, 3, 2); those that do not
    stay would overlap the others. None when the piece must be cut in two."""
    if len(faces) == 1:
        return np.ones(1, bool), isometric_triangle(positions[faces[0]])[None]
    page = np.full(len(faces), NO_PAGE, np.int16)
    piece = split_vertices(Surface(positions, faces, None, page, None)).compact()
    if not is_flattenable(piece.faces):
        return None
    best: tuple[npt.NDArray[np.bool_], Array] | None = None
    fewest = len(faces)
    for uv in flattenings(piece.positions, piece.faces):
        if _is_poor(piece, uv, most_distortion):
            continue
        kept = simple_part(uv, piece.faces)
        if kept is None:
            continue
        taken = int((~kept).sum())
        if taken < fewest:
            best, fewest = (kept, np.asarray(uv[piece.faces])), taken
        if not fewest:
            break
    return best


def _is_poor(piece: Surface, uv: Array, most_distortion: float) -> bool:
    """Flipped, too stretched, or lying over itself by more than a corner."""
    if not np.isfinite(uv).all() or (signed_areas(uv, piece.faces) <= 0).any():
        return True
    count = len(piece.faces)
    if count > 8 and distortion(piece.positions, piece.faces, uv) > most_distortion:
        return True
    low = uv.min(axis=0)
    scaled = (uv - low) / max(float((uv.max(axis=0) - low).max()), 1e-300)
    return count > 2 and overlap_share(scaled, piece.faces, OVERLAP_TEST_PX) > MAX_OVERLAP
