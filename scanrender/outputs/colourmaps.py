"""Colour tables and number words shared by false-colour pictures and heat maps.

Tables are (256, 3) uint8, display-encoded. Magenta occurs in none of them: it is kept for values
that are not finite numbers.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenImageIO

from scanrender.images import srgb_from_linear
from scanrender.outputs.png import bytes_from_unit

Bytes = npt.NDArray[np.uint8]

MAGENTA = (255, 0, 255)

# ColorBrewer "RdBu", 11 classes (Brewer & Harrower, colorbrewer2.org), from low to high: blue is
# negative, white is zero, red is positive; safe for red-green blindness.
_DIVERGING_KNOTS = (
    0x053061, 0x2166AC, 0x4393C3, 0x92C5DE, 0xD1E5F0, 0xF7F7F7,
    0xFDDBC7, 0xF4A582, 0xD6604D, 0xB2182B, 0x67001F,
)  # fmt: skip


@cache
def sequential_table() -> Bytes:
    """Viridis, dark to bright: even steps of lightness (Smith & van der Walt 2015).

    OpenImageIO gives its colour tables linearised, hence the encoding.
    """
    steps: Any = np.linspace(0.0, 1.0, 256, dtype=np.float32).reshape(1, 256, 1).copy()
    mapped = OpenImageIO.ImageBufAlgo.color_map(OpenImageIO.ImageBuf(steps), 0, "viridis")
    linear = np.asarray(mapped.get_pixels(OpenImageIO.FLOAT)).reshape(256, 3)
    return bytes_from_unit(srgb_from_linear(linear))


@cache
def diverging_table() -> Bytes:
    """Blue, white at the middle, red."""
    knots = np.array([[k >> 16, (k >> 8) & 255, k & 255] for k in _DIVERGING_KNOTS], dtype=float)
    at = np.linspace(0.0, len(knots) - 1.0, 256)
    columns = [np.interp(at, np.arange(len(knots)), knots[:, channel]) for channel in range(3)]
    table: Bytes = np.rint(np.stack(columns, axis=1)).astype(np.uint8)
    return table


def tick_labels(low: float, high: float, count: int) -> list[str]:
    """`count` evenly spaced values from `low` to `high`, with the decimals their spacing needs."""
    values = [low + (high - low) * step / (count - 1) for step in range(count)]
    span = high - low
    if not 1e-5 <= span < 1e6 or max(abs(low), abs(high)) >= 1e7:
        return [f"{value:.3g}" for value in values]
    decimals = max(0, 2 - math.floor(math.log10(span)))
    return [plain_number(value, decimals) for value in values]


def plain_number(value: float, decimals: int) -> str:
    """`value` with at most `decimals` places, without trailing zeros and without -0."""
    text = f"{value:.{decimals}f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return "0" if text in ("-0", "") else text
