"""Reading and writing pixels through OpenImageIO, with errors raised instead of returned.

Arrays are (height, width, channels) float32, top row first, unless a docstring says otherwise.
OpenImageIO reports failure by return values and `geterror()`; every call is checked here, once.
"""

from __future__ import annotations

import mmap
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenImageIO as oiio  # noqa: N813

from scanrender.errors import OutputError, ScanError
from scanrender.files import atomic_path

Image = npt.NDArray[np.float32]

# Refuse an image whose decoded size would take the machine's memory (an "image bomb"), before
# decoding it. 32768^2 is twice the largest atlas that photogrammetry tools export (16 K).
MAX_PIXELS = 32768 * 32768
MAX_STORED_BYTES = 4 << 30
_IMAGE_AGAIN = "export the image again, or remove it and what names it"
_ROWS = 64
# Other than those without a length: temporary, restart and start of image.
_JPEG_MARKER = re.compile(rb"\xff([^\x00\x01\xd0-\xd8\xff])")
_TIFF_LAB = (8, 9, 10)


def srgb_from_linear(linear: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Encode linear values in [0, 1] with the sRGB transfer curve (IEC 61966-2-1)."""
    clipped = np.clip(linear, 0.0, 1.0)
    high = 1.055 * np.power(np.maximum(clipped, 0.0031308), 1 / 2.4) - 0.055
    return np.asarray(np.where(clipped <= 0.0031308, 12.92 * clipped, high))


def linear_from_srgb(encoded: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Decode sRGB values in [0, 1] to linear Rec.709 (IEC 61966-2-1)."""
    clipped = np.clip(encoded, 0.0, 1.0)
    high = np.power((np.maximum(clipped, 0.04045) + 0.055) / 1.055, 2.4)
    return np.asarray(np.where(clipped <= 0.04045, clipped / 12.92, high))


def read_image(path: Path | str) -> Image:
    """All channels of the first subimage as stored (no colour conversion), integers in [0, 1].

    Raises ScanError when the file is absent, unreadable, or too large to decode.
    """
    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise ScanError(f"cannot read image {path}: {oiio.geterror()}", where=str(path))
    try:
        spec = source.spec()
        if spec.width * spec.height > MAX_PIXELS:
            raise ScanError(f"image {path} is {spec.width} x {spec.height}", where=str(path))
        pixels = source.read_image(0, 0, 0, spec.nchannels, oiio.FLOAT)
        if pixels is None:
            raise ScanError(f"cannot decode image {path}: {source.geterror()}", where=str(path))
    finally:
        source.close()
    return np.asarray(pixels, dtype=np.float32).reshape(spec.height, spec.width, spec.nchannels)


def channel_count(path: Path | str) -> int:
    """Channels of the first subimage. Raises ScanError when the file is absent or no image."""
    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise ScanError(f"cannot read image {path}: {oiio.geterror()}", where=str(path))
    channels = int(source.spec().nchannels)
    source.close()
    return channels


def read_colors(path: Path | str, name: str | None = None) -> npt.NDArray[Any]:
    """The first three channels (h, w, 3) as stored, without a detour over floats: uint8, uint16 or
    float32; grey is repeated. Colours are not multiplied by alpha: a texture's alpha is a cut-out,
    and its colours are valid everywhere. `name` is what errors call the image.

    Raises ScanError when the file is absent, unreadable, or too large to decode.
    """
    called = name or Path(path).name
    keep = oiio.ImageSpec()
    keep.attribute("oiio:UnassociatedAlpha", 1)
    try:
        source = oiio.ImageInput.open(str(path), keep)
    except TypeError as error:
        what = f"the path of image {called!a} is not UTF-8"
        raise ScanError(what, ascii(str(path)), "rename it") from error
    # OpenImageIO's "null" makes up a black picture for any file of that suffix.
    if source is None or source.format_name() == "null":
        said = _first_line(oiio.geterror()).replace(f' "{path}"', "")
        raise ScanError(f"cannot read image {called}: {said}", str(path), _IMAGE_AGAIN)
    try:
        spec = source.spec()
        if spec.get_int_attribute("tiff:PhotometricInterpretation", 2) in _TIFF_LAB:
            raise ScanError(f"image {called} is in CIE Lab", str(path), "convert it to sRGB")
        dtype = {"uint8": np.uint8, "uint16": np.uint16}.get(str(spec.format), np.float32)
        channels = min(spec.nchannels, 3) if spec.nchannels >= 3 else 1
        size = spec.width * spec.height * channels * np.dtype(dtype).itemsize
        if spec.width * spec.height > MAX_PIXELS or size > MAX_STORED_BYTES:
            raise ScanError(
                f"image {called} says that it is {spec.width} x {spec.height} pixels: too large",
                str(path),
                "scale it down to 16384 x 16384 or less",
            )
        kind = oiio.TypeDesc(_OIIO_TYPES[np.dtype(dtype).name])
        pixels = source.read_image(0, 0, 0, channels, kind)
        said = source.geterror()
        if pixels is None:
            what = f"cannot decode image {called}: {_first_line(said)}"
            raise ScanError(what, str(path), _IMAGE_AGAIN)
        # What is missing of a JPEG is filled with grey: an error is left, but none for zeros.
        if "remature end" in said or (source.format_name() == "jpeg" and not _jpeg_ends(path)):
            raise ScanError(f"image {called} is cut short", str(path), _IMAGE_AGAIN)
    finally:
        source.close()
    pixels = np.asarray(pixels, dtype).reshape(spec.height, spec.width, channels)
    return pixels if channels == 3 else np.repeat(pixels, 3, axis=2)


def _jpeg_ends(path: Path | str) -> bool:
    """Whether its end marker is there, be it that of a camera's picture before other data.

    ITU-T T.81 (1992) B.1: a segment says its length, and in coded data 0 follows a byte of 255.
    """
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        place = 0
        while found := _JPEG_MARKER.search(data, place):
            if found[1] == b"\xd9":
                return True
            place = found.end() + int.from_bytes(data[found.end() : found.end() + 2], "big")
    return False


def _first_line(text: str) -> str:
    return (text.strip().splitlines() or ["it is not an image"])[0]


def write_image(
    path: Path | str,
    pixels: npt.NDArray[Any],
    *,
    channels: Sequence[str] | None = None,
    attributes: Mapping[str, Any] | None = None,
) -> Path:
    """Write (h, w, c) `pixels` with their own dtype (uint8, uint16, float16, float32)."""
    if pixels.ndim == 2:
        pixels = pixels[:, :, None]
    # OpenImageIO used to take wrong strides from non-contiguous arrays (OpenImageIO#4843).
    height, width, count = pixels.shape
    data: Any = np.ascontiguousarray(pixels)
    spec = oiio.ImageSpec(width, height, count, oiio.TypeDesc(_OIIO_TYPES[pixels.dtype.name]))
    if channels is not None:
        spec.channelnames = tuple(channels)
    for name, value in (attributes or {}).items():
        spec.attribute(name, value)
    with atomic_path(path) as temporary:
        target = oiio.ImageOutput.create(str(temporary))
        if target is None:
            raise OutputError(f"cannot write image {path}: {oiio.geterror()}", where=str(path))
        written = target.open(str(temporary), spec) and target.write_image(data)
        error = target.geterror() if not written else ""
        if not (target.close() and written):
            raise OutputError(f"cannot write image {path}: {error}", where=str(path))
    return Path(path)


def write_srgb_png(path: Path | str, linear: npt.NDArray[Any]) -> Path:
    """Write linear Rec.709 (h, w, 3) as an 8-bit sRGB PNG."""
    levels = by_rows(linear, np.uint8, lambda rows: _levels8(srgb_from_linear(rows)))
    return write_image(path, levels, attributes=FAST_PNG)


def write_png8(path: Path | str, encoded: npt.NDArray[Any]) -> Path:
    """Write already encoded values in [0, 1] as an 8-bit PNG."""
    return write_image(path, by_rows(encoded, np.uint8, _levels8), attributes=FAST_PNG)


def _levels8(encoded: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return np.asarray(np.clip(np.nan_to_num(encoded), 0.0, 1.0) * 255.0 + 0.5)


def by_rows(
    image: npt.NDArray[Any], dtype: Any, encode: Callable[[npt.NDArray[Any]], npt.NDArray[Any]]
) -> npt.NDArray[Any]:
    """encode(image) as whole numbers, some rows at a time: the temporary arrays of a large map
    would be fresh memory, which takes longer than the sums."""
    levels = np.empty(image.shape, dtype)
    for start in range(0, len(image), _ROWS):
        levels[start : start + _ROWS] = encode(image[start : start + _ROWS])
    return levels


# Level 1 after the "up" filter (32): of a 4096 x 4096 normal map a third of the time that zlib's
# default takes, for 3 % more bytes; of an albedo half the time for a sixth more. Looking for runs
# alone is a third faster again, at the same size: what is left after the filter has no phrases.
FAST_PNG = {"png:compressionLevel": 1, "png:filter": 32, "compression": "rle"}


_OIIO_TYPES = {
    "uint8": "uint8",
    "uint16": "uint16",
    "uint32": "uint32",
    "float16": "half",
    "float32": "float",
}
