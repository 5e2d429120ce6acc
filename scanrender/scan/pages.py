"""Texture pages: kept as stored (8 or 16 bits), decoded to linear only where they are sampled.

A 16 K page is 0.8 GiB as bytes and 3.2 GiB as float, and photogrammetry exports up to twenty.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from scanrender import images
from scanrender.errors import ScanError

Encoding = Literal["srgb", "linear"]
_CHUNK = 1_000_000


@dataclass(frozen=True)
class Page:
    """One image. pixels (h, w, 3) as stored; `factor` multiplies the decoded linear value. extent:
    the image's own width and height in pixels, where it ends within the last ones (`shrunk`)."""

    name: str
    pixels: npt.NDArray[Any]
    encoding: Encoding = "srgb"
    factor: tuple[float, float, float] = (1.0, 1.0, 1.0)
    flip_green: bool = False
    extent: tuple[float, float] | None = None

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return int(self.pixels.shape[1]), int(self.pixels.shape[0])

    def sample(self, uv: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        """Bilinear linear-light values at uv (k, 2), origin top left, repeating outside [0, 1].

        Returns (k, 3) float32. A non-finite coordinate reads as (0, 0).
        """
        out = np.empty((len(uv), 3), np.float32)
        for start in range(0, len(uv), _CHUNK):
            out[start : start + _CHUNK] = self._sample(uv[start : start + _CHUNK])
        return out

    def shrunk(self, factor: int) -> Page:
        """Averaged in linear light over factor x factor pixels, so coarse maps do not alias; over
        those that are left in the last column and row."""
        width, height = self.size
        factor = min(factor, width, height)
        if factor <= 1:
            return self
        first = np.arange(0, width, factor)
        count = np.diff(first, append=width).astype(np.float32)[:, None]
        small = np.empty((-(-height // factor), len(first), 3), np.float32)
        for row in range(len(small)):
            strip = self._decode(self.pixels[row * factor : (row + 1) * factor])
            np.divide(np.add.reduceat(strip.mean(axis=0), first, axis=0), count, out=small[row])
        extent = (width / factor, height / factor)
        return Page(self.name, small, "linear", self.factor, self.flip_green, extent)

    def _sample(self, uv: npt.NDArray[Any]) -> npt.NDArray[Any]:
        width, height = self.size
        uv = np.nan_to_num(np.asarray(uv, np.float64), posinf=0.0, neginf=0.0)
        inside = (uv >= 0.0) & (uv <= 1.0)
        # Only wrap what is outside: wrapping 1.0 to 0.0 would drag in the opposite border.
        uv = np.where(inside, uv, uv - np.floor(uv))
        across, down = self.extent or (width, height)
        x, y = uv[:, 0] * across - 0.5, uv[:, 1] * down - 0.5
        x0, y0 = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        fx, fy = (x - x0)[:, None].astype(np.float32), (y - y0)[:, None].astype(np.float32)
        left, right = np.clip(x0, 0, width - 1), np.clip(x0 + 1, 0, width - 1)
        top, bottom = np.clip(y0, 0, height - 1), np.clip(y0 + 1, 0, height - 1)
        upper = self._texel(top, left) * (1 - fx) + self._texel(top, right) * fx
        lower = self._texel(bottom, left) * (1 - fx) + self._texel(bottom, right) * fx
        return (upper * (1 - fy) + lower * fy) * np.asarray(self.factor, np.float32)

    def _texel(self, row: npt.NDArray[Any], column: npt.NDArray[Any]) -> npt.NDArray[Any]:
        return self._decode(self.pixels[row, column])

    def _decode(self, stored: npt.NDArray[Any]) -> npt.NDArray[Any]:
        if stored.dtype == np.uint8:
            return np.take(_table(self.encoding), stored)
        scale = 65535.0 if stored.dtype == np.uint16 else 1.0
        value = stored.astype(np.float32) / scale
        if self.encoding == "srgb":
            return images.linear_from_srgb(value).astype(np.float32)
        return value


def read_page(path: Path, encoding: Encoding = "srgb", name: str | None = None) -> Page:
    """Read an image as a Page. Raises ScanError when it is absent or unreadable.

    Floating-point images (EXR, HDR) are linear whatever `encoding` says.
    """
    called = name or path.name
    pixels = images.read_colors(path, called)
    if pixels.dtype == np.float32:
        if not np.isfinite(pixels).all():
            raise ScanError(f"image {called} holds non-finite values", str(path))
        encoding = "linear"
    return Page(called, pixels, encoding)


def constant_page(name: str, linear: tuple[float, float, float]) -> Page:
    """A page of one colour, for a material that has a colour and no image."""
    return Page(name, np.ones((1, 1, 3), np.float32), "linear", linear)


_TABLES: dict[str, npt.NDArray[np.float32]] = {}


def _table(encoding: Encoding) -> npt.NDArray[np.float32]:
    if encoding not in _TABLES:
        levels = np.arange(256) / 255.0
        decoded = images.linear_from_srgb(levels) if encoding == "srgb" else levels
        _TABLES[encoding] = decoded.astype(np.float32)
    return _TABLES[encoding]
