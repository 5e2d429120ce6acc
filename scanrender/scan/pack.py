"""Place charts in a square atlas as large as they fit, turned freely, never mirrored.

Bitmaps on a coarse grid, each chart where it touches most of what is placed already; all positions
of one chart are tested at once by correlation (FFT). The scale is searched: the largest tried at
which everything still fits. In the spirit of Levy, Petitjean, Ray, Maillot: Least Squares Conformal
Maps for Automatic Texture Atlas Generation, SIGGRAPH 2002, section 4, which slides horizons instead
and cannot fill the holes that it leaves.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import fft, ndimage

from scanrender.scan.parallel import run
from scanrender.scan.rasterize import covered

Array = npt.NDArray[Any]

COARSE, FINE = 128, 320  # cells along the atlas; a fine grid wastes less and takes longer
# Shares of the atlas to fill, two side by side in processes of their own: most heads stop between.
USES = ((0.66, 0.685), (0.705, 0.725), (0.75, 0.78), (0.82, 0.86), (0.9, 0.94))
# What fills less is searched on the coarse grid, then at these multiples of the scale found there.
COARSE_STEP, COARSE_TRIALS = 1.0 / 1.03, 60
FINE_FACTORS = (1.015, 1.03)
SUBCELLS = 4  # charts are drawn this much finer than the grid, so that padding is not rounded up
REACH = 1.0 / 60.0  # of the side; nearer than this is touching
MAX_CHARTS = 400  # beyond this the search takes too long, and shelves do no worse


@dataclass(frozen=True)
class Placed:
    """matrix (c, 2, 2) and offset (c, 2): uv = matrix @ (mm) + offset; scale: atlas side per mm."""

    matrix: Array
    offset: Array
    scale: float


def pack_charts(chart: Array, corner_uv: Array, padding: float) -> Array:
    """Packed corner_uv (m, 3, 2) in [0, 1] of chart (m,) and corner_uv in mm.

    padding: least gap between charts as a share of the atlas side. Raises ValueError when nothing
    fits, or when there are too many charts for this way of packing.
    """
    count = int(chart.max()) + 1
    if count > MAX_CHARTS:
        raise ValueError(f"{count} charts are too many")
    upright = _upright(chart, corner_uv, count)
    placed = _largest(chart, upright, padding)
    turned = np.einsum("mij,mcj->mci", placed.matrix[chart], upright)
    packed = turned * placed.scale + placed.offset[chart][:, None]
    if packed.min() < -1e-9 or packed.max() > 1.0 + 1e-9:
        raise ValueError("a chart was placed outside the atlas")
    return np.asarray(np.clip(packed, 0.0, 1.0))


def _upright(chart: Array, corner_uv: Array, count: int) -> Array:
    """Charts turned so that their bounding rectangle is the smallest, with a corner at 0."""
    result = corner_uv.copy()
    order = np.argsort(chart, kind="stable")
    bounds = np.searchsorted(chart[order], np.arange(count + 1))
    for number in range(count):
        faces = order[bounds[number] : bounds[number + 1]]
        points = corner_uv[faces].reshape(-1, 2)
        angle = _smallest_rectangle(points)
        c, s = np.cos(angle), np.sin(angle)
        turned = points @ np.array([[c, s], [-s, c]])
        result[faces] = (turned - turned.min(axis=0)).reshape(-1, 3, 2)
    return result


def _smallest_rectangle(points: Array) -> float:
    """The turn in radians after which the points' bounding rectangle has the smallest area."""
    angles = np.linspace(0.0, 0.5 * np.pi, 46)[:-1]
    sparse = points[:: max(1, len(points) // 3000)]
    along = sparse @ np.stack([np.cos(angles), -np.sin(angles)])
    across = sparse @ np.stack([np.sin(angles), np.cos(angles)])
    return float(angles[np.argmin(np.ptp(along, axis=0) * np.ptp(across, axis=0))])


def _largest(chart: Array, upright: Array, padding: float) -> Placed:
    """The charts placed at the largest scale tried that fits."""
    e1, e2 = upright[:, 1] - upright[:, 0], upright[:, 2] - upright[:, 0]
    area = 0.5 * np.abs(e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0]).sum()
    extent = float(upright.max())
    largest = min(np.sqrt(0.95 / area), 0.999 / extent)

    def tried(scales: Iterable[float]) -> list[Placed | None]:
        return run([lambda s=s: _place(chart, upright, s, padding, FINE) for s in scales])  # type: ignore[misc]

    best: Placed | None = None
    for uses in USES:
        low, high = tried(min(np.sqrt(use / area), largest) for use in uses)
        best = high or low or best
        if high is None or high.scale == largest:
            break
    if best is not None:
        return best
    scale = min(np.sqrt(USES[0][0] / area), largest)
    for _ in range(COARSE_TRIALS):
        scale *= COARSE_STEP
        best = _place(chart, upright, scale, padding, COARSE)
        if best is not None:
            low, high = tried(scale * factor for factor in FINE_FACTORS)
            return high or low or best
    raise ValueError("the charts do not fit into the atlas")


def _place(chart: Array, upright: Array, scale: float, padding: float, cells: int) -> Placed | None:
    """Every chart at this scale in a grid of `cells`, or None when one does not fit."""
    count = int(chart.max()) + 1
    solid, grown, margin = _bitmaps(chart, upright, scale, padding, cells)
    side = cells + 2 * margin
    border = np.ones((side, side), np.float32)
    border[margin:-margin, margin:-margin] = 0.0
    taken = border.copy()
    matrix, offset = np.zeros((count, 2, 2)), np.zeros((count, 2))
    reach = max(1, round(REACH * cells))
    sizes = np.array([max(bitmap.shape) for bitmap in solid])
    for number in np.argsort(-sizes, kind="stable"):
        near = ndimage.uniform_filter(taken, 2 * reach + 1, mode="constant", cval=1.0)
        spot = _best_spot(taken, near, solid[number], grown[number], cells, margin)
        if spot is None:
            return None
        turn, row, column = spot
        bitmap = np.rot90(solid[number], turn)
        rows, columns = bitmap.shape
        top, left = row + margin, column + margin
        window = taken[top : top + rows, left : left + columns]
        np.maximum(window, bitmap, out=window)
        matrix[number], shift = _turn(turn, solid[number].shape)
        offset[number] = (shift + np.array([column, row])) / cells
    return Placed(matrix, offset, scale)


def _turn(turn: int, shape: tuple[int, ...]) -> tuple[Array, Array]:
    """np.rot90(bitmap, turn) as a map of (x, y) in cells, for a bitmap of `shape` before it."""
    rows, columns = shape
    table = {
        0: ([[1, 0], [0, 1]], [0, 0]),
        1: ([[0, 1], [-1, 0]], [0, columns]),
        2: ([[-1, 0], [0, -1]], [columns, rows]),
        3: ([[0, -1], [1, 0]], [rows, 0]),
    }
    matrix, shift = table[turn]
    return np.array(matrix, float), np.array(shift, float)


def _best_spot(
    taken: Array, near: Array, solid: Array, grown: Array, cells: int, margin: int
) -> tuple[int, int, int] | None:
    """(quarter turns, row, column) of the solid bitmap's corner where it touches most."""
    side = fft.next_fast_len(len(taken), real=True)
    layers = np.stack([taken > 0.5, near]).astype(np.float32)
    spectra = _spectrum(layers, side)
    best, found = -np.inf, None
    for turn in range(2):
        outer = np.rot90(grown, turn)
        shape = np.rot90(solid, turn).shape
        if max(shape) > cells:
            continue
        spectrum = _spectrum(outer, side)
        # Correlation with a bitmap; convolution with it is correlation with it turned by 180
        # degrees, shifted by its size: one transform serves two turns.
        for half, product in ((0, np.conj(spectrum)), (2, spectrum)):
            top, left = (0, 0) if half == 0 else (outer.shape[0] - 1, outer.shape[1] - 1)
            window = (
                slice(top, top + cells - shape[0] + 1),
                slice(left, left + cells - shape[1] + 1),
            )
            clash, touch = _correlated(spectra * product, side, window)
            score = np.where(clash < 0.5, touch, -np.inf)
            at = int(np.argmax(score))
            if score.flat[at] > best:
                best = float(score.flat[at])
                row, column = np.unravel_index(at, score.shape)
                found = (turn + half, int(row), int(column))
    return found


def _spectrum(layers: Array, side: int) -> Array:
    """fft.rfft2 of layers (…, rows, columns) with zeros up to `side`, whose rows are left out."""
    return np.asarray(fft.fft(fft.rfft(layers, side, axis=-1), side, axis=-2))


def _correlated(product: Array, side: int, window: tuple[slice, slice]) -> Array:
    """That window of fft.irfft2 of each layer, the other rows left out; scaled once, at the end, as
    it does: the best of many spots alike is that of the last bit, and hangs on the rounding."""
    rows, columns = window
    some = fft.ifft(product, axis=1, norm="forward")[:, rows]
    layers = fft.irfft(some, side, axis=2, norm="forward")[:, :, columns]
    return np.asarray(layers * np.float32(1.0 / side**2))


def _bitmaps(
    chart: Array, upright: Array, scale: float, padding: float, cells: int
) -> tuple[list[Array], list[Array], int]:
    """Per chart the cells that it covers, and those within `padding` of it, larger by `margin`
    cells on each side."""
    fine = cells * SUBCELLS
    # Half a subcell for what the sampling at subcell centres misses, on both charts of a pair.
    reach = padding * fine + 1.5
    margin = int(np.ceil(reach / SUBCELLS)) + 1
    solid, grown = [], []
    order = np.argsort(chart, kind="stable")
    bounds = np.searchsorted(chart[order], np.arange(int(chart.max()) + 2))
    for number in range(int(chart.max()) + 1):
        corners = upright[order[bounds[number] : bounds[number + 1]]].reshape(-1, 2) * scale
        size = np.maximum(np.ceil(corners.max(axis=0) * cells - 1e-9), 1).astype(int)
        drawn = _drawn(corners, size[::-1], fine)
        solid.append(_coarse(drawn))
        grown.append(_coarse(_within(np.pad(drawn, margin * SUBCELLS), reach)))
    return solid, grown, margin


def _within(bitmap: npt.NDArray[np.bool_], reach: float) -> npt.NDArray[np.bool_]:
    """Cells whose centre is at most `reach` from that of a set one: a disc is drawn around each,
    row by row, which takes a tenth of the time of measuring the distance."""
    runs, near, width = bitmap.copy(), bitmap.copy(), 0
    for away in range(int(reach), -1, -1):
        while width < int(np.sqrt(reach * reach - away * away)):
            width += 1
            runs[:, width:] |= bitmap[:, :-width]
            runs[:, :-width] |= bitmap[:, width:]
        near[away:] |= runs[: len(runs) - away]
        near[: len(runs) - away] |= runs[away:]
    return near


def _drawn(corners: Array, shape: Array, fine: int) -> npt.NDArray[np.bool_]:
    """Subcells whose centre a triangle covers, and those that hold a corner; rows go up."""
    rows, columns = shape * SUBCELLS
    canvas = int(max(rows, columns))
    faces = np.arange(len(corners)).reshape(-1, 3)
    drawn = np.zeros(canvas * canvas, bool)
    drawn[covered(corners * (fine / canvas), faces, canvas)] = True
    # Slivers between the centres leave no mark but at their corners.
    at = np.clip((corners * fine).astype(np.int64), 0, canvas - 1)
    drawn[at[:, 1] * canvas + at[:, 0]] = True
    return drawn.reshape(canvas, canvas)[:rows, :columns]


def _coarse(bitmap: npt.NDArray[np.bool_]) -> npt.NDArray[np.float32]:
    rows, columns = bitmap.shape[0] // SUBCELLS, bitmap.shape[1] // SUBCELLS
    blocks = bitmap.reshape(rows, SUBCELLS, columns, SUBCELLS)
    return np.asarray(blocks.any(axis=(1, 3)), np.float32)
