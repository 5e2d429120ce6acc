"""Dumped buffers for the page: a false-colour picture, its legend, and values to read off.

Values travel as 16-bit steps of their own range: code 0 is "no surface", 1 "not finite", 2 to 65535
the range from the smallest to the largest value of the channel, so they are exact to 1/65533 of it.
Rows are differences to the left neighbour, high bytes before low ones, then deflated (RFC 1950): a
browser inflates that by itself. Every `step`-th pixel is kept, and none is averaged: the number
under the pointer is one that is in the EXR.
"""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from scanrender.buffers import SUFFIXES, BufferSpec, buffer_spec
from scanrender.errors import UsageError
from scanrender.outputs.colourmaps import tick_labels
from scanrender.outputs.exr import layers_of
from scanrender.outputs.falsecolour import Bar, explained
from scanrender.outputs.report.turn import webp

Floats = npt.NDArray[np.float32]

PICTURE_PX = 1024  # the longer side of a buffer's picture
VALUES_PX = 320  # the longer side of its values
PICTURE_QUALITY = 88
NOTHING, NOT_FINITE, FIRST, LAST = 0, 1, 2, 65535
STOPS = 9  # colours of a bar's gradient


def layers_of_frame(files: list[Path], frame: int) -> Iterator[dict[str, Any]]:
    """A dictionary for each buffer in the EXR files of one frame, one in memory at a time.

    Raises ScanError for a file that cannot be read.
    """
    # The file that has the coverage goes first.
    for path in sorted(files, key=lambda file: len(file.name)):
        alpha: Floats | None = None
        for name, pixels in layers_of(path):
            if name == "alpha":
                alpha = pixels[:, :, 0]
                continue
            try:
                spec = buffer_spec(name)
            except UsageError:
                continue
            if pixels.shape[2] == len(spec.channels):
                yield _layer(spec, pixels, _coverage(spec, pixels, alpha), frame)


def _coverage(spec: BufferSpec, pixels: Floats, alpha: Floats | None) -> Floats | None:
    """Of the camera's picture: a shadow map's is another, and `display` fills its frame."""
    fits = alpha is not None and alpha.shape == pixels.shape[:2]
    return alpha if fits and not spec.name.startswith(("shadow_", "display")) else None


def _layer(spec: BufferSpec, pixels: Floats, alpha: Floats | None, frame: int) -> dict[str, Any]:
    shown = explained(spec, pixels, alpha)
    picture = Image.fromarray(shown.picture)
    share = min(1.0, PICTURE_PX / max(picture.size))
    size = tuple(max(1, round(side * share)) for side in picture.size)
    if share < 1.0:
        picture = picture.resize((size[0], size[1]), Image.Resampling.BOX)
    height, width = pixels.shape[:2]
    return {
        "name": spec.name,
        "frame": frame,
        "unit": "no unit" if spec.unit == "1" else spec.unit,
        "space": spec.space,
        "meaning": spec.meaning,
        "healthy": spec.healthy,
        "width": width,
        "height": height,
        "picture": webp(picture, PICTURE_QUALITY),
        "bars": [_bar(bar) for bar in shown.bars],
        "remarks": list(shown.remarks),
        "channels": list(SUFFIXES[spec.kind]) if len(spec.channels) > 1 else [""],
        "values": packed(pixels, alpha),
    }


def _bar(bar: Bar) -> dict[str, Any]:
    at = np.linspace(0, 255, STOPS).astype(int)
    colours = ["#" + bytes(row).hex() for row in np.asarray(bar.table, np.uint8)[at].tolist()]
    ticks = tick_labels(bar.low, bar.high, 2 if bar.label else 3)
    return {"label": bar.label, "colours": colours, "ticks": ticks}


def packed(pixels: Floats, alpha: Floats | None) -> dict[str, Any]:
    """`pixels` (h, w, c) as the module's docstring says: `step`, `width`, `height`, `ranges` per
    channel, `data` in base64."""
    step = max(1, math.ceil(max(pixels.shape[:2]) / VALUES_PX))
    kept = pixels[::step, ::step].astype(np.float64)
    finite = np.isfinite(kept)
    codes = np.full(kept.shape, NOT_FINITE, np.uint16)
    ranges = []
    for channel in range(kept.shape[2]):
        good = finite[:, :, channel]
        seen = kept[:, :, channel][good]
        low, high = (float(seen.min()), float(seen.max())) if seen.size else (0.0, 0.0)
        scale = (LAST - FIRST) / (high - low) if high > low else 0.0
        codes[:, :, channel][good] = np.rint(FIRST + (seen - low) * scale).astype(np.uint16)
        ranges.append([low, high])
    if alpha is not None:
        codes[(alpha[::step, ::step] <= 0) & finite.all(axis=2)] = NOTHING
    # Planes of a channel each; differences wrap around, as sums in the page do.
    planes = np.ascontiguousarray(np.moveaxis(codes, 2, 0))
    planes[:, :, 1:] = planes[:, :, 1:] - planes[:, :, :-1]
    split = np.concatenate([(planes >> 8).astype(np.uint8), (planes & 255).astype(np.uint8)])
    data = base64.b64encode(zlib.compress(split.tobytes(), 9)).decode("ascii")
    height, width = kept.shape[:2]
    return {"step": step, "width": width, "height": height, "ranges": ranges, "data": data}
