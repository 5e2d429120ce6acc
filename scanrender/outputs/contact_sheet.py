"""A contact sheet: many labelled pictures on one calm page, undated: equal runs are equal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from scanrender.errors import UsageError
from scanrender.outputs.lettering import elided, wrapped, write
from scanrender.outputs.png import bytes_from_unit, write_bytes_png

Bytes = npt.NDArray[np.uint8]

MIN_SHEET, MAX_SHEET = 960, 2880  # px: a readable header; a page that mail and wiki still take
GROUND = (21, 22, 24)
RULE = (52, 54, 58)
INK = (236, 236, 234)
LABEL = (186, 188, 192)
FADED = (128, 130, 135)
SMALL, LINE = 0.9, 1.25  # a note's letters and lines, in those of the label


@dataclass(frozen=True)
class Tile:
    """One picture of the sheet: `pixels` (h, w, 3), display-encoded, float in [0, 1] or uint8.

    `note` stands under the label in smaller letters.
    """

    label: str
    pixels: npt.NDArray[Any]
    note: str = ""


@dataclass(frozen=True)
class _Grid:
    """Where things go, in px. `cell` is a column's width, `rows` are the rows' heights."""

    width: int
    columns: int
    margin: int
    gap: int
    cell: int
    rows: tuple[int, ...]
    words: int  # room under the pictures for label and note
    body: int

    def top(self, row: int) -> int:
        """From the first row's top to that of `row`."""
        return sum(self.rows[:row]) + row * (self.words + self.gap // 2)


def contact_sheet(
    path: Path | str,
    tiles: Sequence[Tile],
    *,
    columns: int,
    title: str,
    subtitle: str = "",
    footer: str = "",
) -> Path:
    """Write `tiles`, row by row in `columns`, under a header and above a footer, as PNG.

    Every picture is as wide as its column; the widest are shown at their own size if the page stays
    within 2880 px, small ones enlarged by whole factors where all are alike. The pictures of a row
    start at one height. `title` is the scan, `subtitle` the pipeline,
    `footer` what made it (renderer string, version). Raises UsageError without tiles or columns,
    OutputError when the file cannot be written.
    """
    return write_bytes_png(path, sheet_pixels(tiles, columns, title, subtitle, footer))


def sheet_pixels(
    tiles: Sequence[Tile], columns: int, title: str, subtitle: str, footer: str
) -> Bytes:
    """What `contact_sheet` writes, (H, W, 3) uint8."""
    if not tiles or columns < 1:
        raise UsageError("a contact sheet needs at least one tile and one column")
    grid = _layout(tiles, min(columns, len(tiles)))
    inner = grid.width - 2 * grid.margin
    body, big, medium, small = (round(grid.body * size) for size in (1.0, 2.1, 1.1, 0.92))
    header = round(body * 5.6 if subtitle else body * 4.0)
    notes = wrapped(footer, small, inner)
    foot = (round(body * 1.2) + round(body * 1.35) * len(notes)) if notes else 0
    height = 2 * grid.margin + header + grid.top(len(grid.rows)) + foot

    sheet = Image.new("RGB", (grid.width, height), GROUND)
    write(sheet, (grid.margin, grid.margin), elided(title, big, inner), INK, big)
    below = (grid.margin, grid.margin + round(body * 2.9))
    write(sheet, below, elided(subtitle, medium, inner), FADED, medium)
    for index, tile in enumerate(tiles):
        row, column = divmod(index, grid.columns)
        left = grid.margin + column * (grid.cell + grid.gap)
        top = grid.margin + header + grid.top(row)
        _place(sheet, tile, (left, top), grid)
    if notes:
        top = height - grid.margin - foot
        sheet.paste(RULE, (grid.margin, top, grid.width - grid.margin, top + max(1, body // 12)))
        for row, words in enumerate(notes):
            at = (grid.margin, top + round(body * 1.2) + row * round(body * 1.35))
            write(sheet, at, words, FADED, small)
    return np.array(sheet)


def _layout(tiles: Sequence[Tile], columns: int) -> _Grid:
    """Measures that follow the page width: margins 3 %, gaps 1 %, text 1/95 (at least 12 px)."""
    widest = max(tile.pixels.shape[1] for tile in tiles)
    gap_share = min(0.01, 0.12 / columns)
    wanted = columns * (widest + 1) / (0.94 - gap_share * (columns - 1))
    page = min(max(math.ceil(wanted), MIN_SHEET), MAX_SHEET)
    margin, gap = round(page * 0.03), int(page * gap_share)
    room = max(1, (page - 2 * margin - gap * (columns - 1)) // columns)
    # Whole multiples where there is room: pixels are shown as they are, not resampled by 1.02.
    cell_width = room // widest * widest or room
    width = max(MIN_SHEET, 2 * margin + columns * cell_width + gap * (columns - 1))
    body = max(12, round(width / 95))
    sizes = [_size(tile, cell_width) for tile in tiles]
    rows = tuple(
        max(height for _, height in sizes[start : start + columns])
        for start in range(0, len(tiles), columns)
    )
    lines = max(len(wrapped(tile.note, round(body * SMALL), cell_width)) for tile in tiles)
    words = round(body * (2.6 + LINE * lines))
    return _Grid(width, columns, margin, gap, cell_width, rows, words, body)


def _size(tile: Tile, width: int) -> tuple[int, int]:
    """(w, h) of a picture in a cell of this width: as wide as it, unless it is a tall sliver."""
    tall, wide = tile.pixels.shape[:2]
    scale = min(width / wide, 2.0 * width / tall)
    return max(1, round(wide * scale)), max(1, round(tall * scale))


def _place(sheet: Image.Image, tile: Tile, at: tuple[int, int], grid: _Grid) -> None:
    """Fit the tile to its column and write its words under it."""
    pixels = tile.pixels if tile.pixels.dtype == np.uint8 else bytes_from_unit(tile.pixels)
    picture = Image.fromarray(np.ascontiguousarray(pixels[:, :, :3]))
    size = _size(tile, grid.cell)
    if size != picture.size:
        picture = picture.resize(size, Image.Resampling.LANCZOS)
    left, top = at
    sheet.paste(picture, (left, top))
    below = top + size[1] + round(grid.body * 0.6)
    write(sheet, (left, below), elided(tile.label, grid.body, grid.cell), LABEL, grid.body)
    small = round(grid.body * SMALL)
    for line, words in enumerate(wrapped(tile.note, small, grid.cell)):
        at = (left, below + round(grid.body * (1.45 + LINE * line)))
        write(sheet, at, elided(words, small, grid.cell), FADED, small)
