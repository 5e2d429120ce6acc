"""Any buffer as a picture that explains itself: title, meaning, legend with range and unit.

    scalar   a colour table over a range: diverging (blue, white, red) when the range is symmetric
             about 0, else viridis
    vector   (v + 1) / 2 for unit vectors, else each channel over its own range; X Y Z -> R G B
    colour   scene-linear: sRGB-encoded, darkened by a stated factor if it exceeds 1;
             display: as it is; data in three channels (px, ratios): linear over a stated range

The range is `BufferSpec.span`, or the 0.5 and 99.5 percentiles of the subject, so that a single
outlier does not hide the rest; what lies outside is counted in the legend. For a sequence that must
not flicker, pass a spec with a fixed span (`dataclasses.replace(spec, span=...)`). Values that are
not finite are magenta and counted; where alpha is 0 there is a grey checker.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from scanrender.buffers import LINEAR, BufferSpec
from scanrender.images import srgb_from_linear
from scanrender.outputs.colourmaps import (
    MAGENTA,
    diverging_table,
    plain_number,
    sequential_table,
    tick_labels,
)
from scanrender.outputs.lettering import elided, measure, wrapped, write
from scanrender.outputs.png import bytes_from_unit, write_bytes_png

Bytes = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.floating]
Mask = npt.NDArray[np.bool_]
Range = tuple[float, float]

MIN_WIDTH = 480  # px: below this a legend has no room; smaller pictures are enlarged
MAX_ENLARGED_HEIGHT = 2048  # px: how far a narrow picture may grow to reach that width

PANEL = (24, 25, 28)
INK = (236, 236, 234)
FADED = (158, 160, 164)
CHECKER = ((64, 64, 66), (73, 73, 75))


@dataclass(frozen=True)
class Bar:
    """One colour bar of the legend: `table` (256, 3) display bytes from `low` to `high`."""

    label: str
    table: Bytes
    low: float
    high: float


@dataclass(frozen=True)
class Shown:
    """A buffer as display bytes (h, w, 3), with the bars and remarks that explain it."""

    picture: Bytes
    bars: tuple[Bar, ...]
    remarks: tuple[str, ...]


def false_colour_png(
    path: Path | str, spec: BufferSpec, pixels: Floats, alpha: Floats | None = None
) -> Path:
    """Write `pixels` (h, w, c) of buffer `spec` as an explained picture.

    `alpha` (h, w) is the coverage; None means that all of the picture counts. Raises OutputError
    when the file cannot be written, ValueError when shapes do not fit.
    """
    return write_bytes_png(path, false_colour(spec, pixels, alpha))


def false_colour(spec: BufferSpec, pixels: Floats, alpha: Floats | None = None) -> Bytes:
    """What `false_colour_png` writes: (H, W, 3) uint8, picture above legend, W >= 480."""
    shown, finite, covered = _explained(spec, pixels, alpha)
    picture = shown.picture
    picture[~finite] = MAGENTA
    height, width = picture.shape[:2]
    grow = max(1, min(-(-MIN_WIDTH // width), MAX_ENLARGED_HEIGHT // height))
    picture = picture.repeat(grow, axis=0).repeat(grow, axis=1)
    if alpha is not None:
        empty = (finite & ~covered).repeat(grow, axis=0).repeat(grow, axis=1)
        picture[empty] = _checker(*picture.shape[:2])[empty]
    bad = int(finite.size - np.count_nonzero(finite))
    return _with_legend(picture, spec, shown.bars, list(shown.remarks), bad)


def explained(spec: BufferSpec, pixels: Floats, alpha: Floats | None = None) -> Shown:
    """What `false_colour` draws, in parts: for pages that write the legend themselves."""
    shown, finite, covered = _explained(spec, pixels, alpha)
    shown.picture[~finite] = MAGENTA
    if alpha is not None:
        empty = finite & ~covered
        shown.picture[empty] = _checker(*empty.shape)[empty]
    bad = int(finite.size - np.count_nonzero(finite))
    remarks = (*shown.remarks, *([f"{bad} px not finite (NaN or Inf)"] if bad else []))
    return replace(shown, remarks=tuple(filter(None, remarks)))


def _explained(spec: BufferSpec, pixels: Floats, alpha: Floats | None) -> tuple[Shown, Mask, Mask]:
    """Picture and legend, and where it is finite, and covered."""
    if pixels.ndim == 2:
        pixels = pixels[:, :, None]
    if pixels.shape[2] != len(spec.channels):
        raise ValueError(f"{spec.name} of shape {pixels.shape} is not a {spec.kind}")
    if alpha is not None and alpha.shape != pixels.shape[:2]:
        raise ValueError(f"alpha {alpha.shape} does not fit {spec.name} {pixels.shape}")
    finite: Mask = np.asarray(np.isfinite(pixels).all(axis=2))
    covered: Mask = np.ones(finite.shape, bool) if alpha is None else np.asarray(alpha > 0)
    subject = finite & covered
    values = np.nan_to_num(pixels, nan=0.0, posinf=0.0, neginf=0.0)
    shown = _SHOW[spec.kind](spec, values, subject)
    if not subject.any():
        shown = replace(shown, remarks=("no surface in this picture",))
    return shown, finite, covered


def with_common_range(spec: BufferSpec, pictures: Sequence[tuple[Floats, Floats]]) -> BufferSpec:
    """`spec` with one range for several (pixels, alpha) of its buffer, so that they compare.

    A fixed range and the vectors' stay as they are. Scene-linear light runs from black to its 99.5
    percentile, however dark that is.
    """
    if spec.span or spec.kind == "vector":
        return spec
    seen = np.concatenate([
        pixels[(alpha > 0) & np.isfinite(pixels.reshape(*alpha.shape, -1)).all(axis=2)].ravel()
        for pixels, alpha in pictures
    ])  # fmt: skip
    low, high = _percentiles(seen)
    if spec.kind == "colour" and (spec.space == LINEAR or low > 0.0):
        low = 0.0
    return replace(spec, span=(low, max(high, low + 1e-6)))


def _show_scalar(spec: BufferSpec, values: Floats, subject: Mask) -> Shown:
    low, high = spec.span or _percentiles(values[:, :, 0][subject])
    table = diverging_table() if low == -high else sequential_table()
    levels = bytes_from_unit(_unit_from_range(values[:, :, 0], low, high))
    remarks = (_data_range(values[subject]), _share_outside(values[subject], low, high))
    return Shown(table[levels], (Bar("", table, low, high),), remarks)


def _show_vector(spec: BufferSpec, values: Floats, subject: Mask) -> Shown:
    channels = []
    bars = []
    for axis, name in enumerate("XYZ"):
        low, high = spec.span or _percentiles(values[:, :, axis][subject])
        channels.append(_unit_from_range(values[:, :, axis], low, high))
        # From grey, not from black: pure blue is unreadable on a dark panel.
        table = np.full((256, 3), 56, np.uint8)
        table[:, axis] = np.linspace(56, 255, 256)
        bars.append(Bar(f"{name} {('red', 'green', 'blue')[axis]}", table, low, high))
    picture = bytes_from_unit(np.stack(channels, axis=2))
    remark = "X Y Z shown as R G B" + ("" if spec.span else ", each over its own range")
    return Shown(picture, tuple(bars), (remark,))


def _show_colour(spec: BufferSpec, values: Floats, subject: Mask) -> Shown:
    seen = values[subject]
    ramp = np.linspace(0.0, 1.0, 256)[:, None].repeat(3, axis=1)
    if spec.space == LINEAR:
        bright = float(np.percentile(seen, 99.5)) if seen.size else 0.0
        white = spec.span[1] if spec.span else max(1.0, bright)
        picture = bytes_from_unit(srgb_from_linear(np.clip(values, 0.0, white) / white))
        bar = Bar("", bytes_from_unit(srgb_from_linear(ramp)), 0.0, white)
        exposure = "exposure x1" if white == 1.0 else f"exposure x{1.0 / white:.3g}, auto-scaled"
        remarks = (f"sRGB-encoded, {exposure}", _data_range(seen), _share_outside(seen, 0.0, white))
        return Shown(picture, (bar,), remarks)
    low, high = spec.span or _percentiles(seen)
    if not spec.span and low > 0.0:
        low = 0.0  # radii and ratios are read against zero
    picture = bytes_from_unit(_unit_from_range(values, low, high))
    bar = Bar("", bytes_from_unit(ramp), low, high)
    linear = "shown as it is" if (low, high) == (0.0, 1.0) else "R G B, linear over the range"
    return Shown(picture, (bar,), (linear, _data_range(seen), _share_outside(seen, low, high)))


_SHOW = {"scalar": _show_scalar, "vector": _show_vector, "colour": _show_colour}


def _percentiles(values: Floats) -> Range:
    """The 0.5 and 99.5 percentiles, widened where they coincide; (0, 1) of nothing."""
    if not values.size:
        return 0.0, 1.0
    low, high = (float(edge) for edge in np.percentile(values, (0.5, 99.5)))
    if high - low > 1e-6 * max(abs(low), abs(high)):
        return low, high
    margin = max(abs(low) * 0.01, 1e-3)
    return low - margin, high + margin


def _unit_from_range(values: Floats, low: float, high: float) -> npt.NDArray[np.float32]:
    """`values` clipped to [low, high] and mapped to [0, 1], as float32."""
    clipped = np.clip(values, low, high).astype(np.float64)
    unit: npt.NDArray[np.float32] = ((clipped - low) / (high - low)).astype(np.float32)
    return unit


def _data_range(seen: Floats) -> str:
    if not seen.size:
        return ""
    low, high = float(seen.min()), float(seen.max())
    if low == high:
        return f"constant {tick_labels(low, low + 1.0, 2)[0]}"
    first, last = tick_labels(low, high, 2)
    return f"data {first} to {last}"


def _share_outside(seen: Floats, low: float, high: float) -> str:
    """How much of the subject is clipped by the range, in words; nothing when all of it fits."""
    if not seen.size:
        return ""
    share = float(np.count_nonzero((seen < low) | (seen > high))) / seen.size
    return f"{plain_number(100.0 * share, 2)} % outside the range" if share >= 5e-5 else ""


def _checker(height: int, width: int) -> Bytes:
    """A quiet grey checker (h, w, 3) that no data value can be mistaken for."""
    cell = max(8, round(width / 64))
    rows, columns = np.arange(height) // cell, np.arange(width) // cell
    squares: Bytes = np.array(CHECKER, np.uint8)[(rows[:, None] + columns[None, :]) % 2]
    return squares


def _with_legend(
    picture: Bytes, spec: BufferSpec, bars: tuple[Bar, ...], remarks: list[str], bad: int
) -> Bytes:
    """`picture` with a panel under it. All measures follow the body size, in px."""
    width = max(MIN_WIDTH, picture.shape[1])
    body = max(14, round(width / 84))
    small = round(body * 0.9)
    margin = round(body * 1.2)
    inner = width - 2 * margin
    meaning = wrapped(spec.meaning, body, inner)
    notes = wrapped("  ·  ".join(filter(None, remarks)), small, inner)
    line = round(body * 1.4)
    meaning_top = picture.shape[0] + margin + round(body * 2.2)
    bars_top = meaning_top + line * len(meaning) + round(body * 0.7)
    notes_top = bars_top + round(body * 3.3)
    bad_top = notes_top + line * len(notes)
    height = bad_top + (line if bad else 0) + round(body * 0.8)

    sheet = Image.new("RGB", (width, height), PANEL)
    sheet.paste(Image.fromarray(picture), ((width - picture.shape[1]) // 2, 0))
    _draw_heading(sheet, spec, (margin, picture.shape[0] + margin), inner, body)
    for row, words in enumerate(meaning):
        write(sheet, (margin, meaning_top + row * line), words, FADED, body)
    _draw_bars(sheet, bars, (margin, bars_top), inner, body)
    for row, words in enumerate(notes):
        write(sheet, (margin, notes_top + row * line), words, FADED, small)
    if bad:
        side = round(body * 0.8)
        corner = (margin, bad_top + round(body * 0.15))
        sheet.paste(MAGENTA, (*corner, corner[0] + side, corner[1] + side))
        words = f"{bad} px not finite (NaN or Inf)"
        write(sheet, (margin + round(body * 1.3), bad_top), words, INK, small)
    return np.array(sheet)


def _draw_heading(
    sheet: Image.Image, spec: BufferSpec, at: tuple[int, int], inner: int, body: int
) -> None:
    """The name on the left; unit and space on the right, on about the same baseline."""
    title, small = round(body * 1.5), round(body * 0.9)
    write(sheet, at, spec.name, INK, title)
    unit = "no unit" if spec.unit == "1" else spec.unit
    words = f"{unit}  ·  {spec.space}"
    room = inner - measure(spec.name, title) - 2 * body
    corner = (at[0] + inner, at[1] + round(0.95 * (title - small)))
    write(sheet, corner, elided(words, small, room), FADED, small, "r")


def _draw_bars(
    sheet: Image.Image, bars: tuple[Bar, ...], at: tuple[int, int], inner: int, body: int
) -> None:
    """Colour bars side by side over `inner` px, ticks under each, its label between them."""
    small = round(body * 0.9)
    gap = round(body * 1.6)
    length = (inner - gap * (len(bars) - 1)) // len(bars)
    tick_top = at[1] + body
    words_top = at[1] + round(body * 1.5)
    for index, bar in enumerate(bars):
        left = at[0] + index * (length + gap)
        strip = bar.table[np.arange(length) * 256 // length][None].repeat(body, axis=0)
        sheet.paste(Image.fromarray(strip), (left, at[1]))
        count = 2 if bar.label else 5 if length > 24 * body else 3
        for step, words in enumerate(tick_labels(bar.low, bar.high, count)):
            x = left + round((length - 1) * step / (count - 1))
            mark = (x, tick_top, x + max(1, body // 12), tick_top + round(body * 0.3))
            sheet.paste(FADED, mark)
            anchor = "l" if step == 0 else "r" if step == count - 1 else "m"
            write(sheet, (x, words_top), words, INK, small, anchor)
        write(sheet, (left + length // 2, words_top), bar.label, FADED, small, "m")
