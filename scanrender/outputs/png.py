"""The finished picture as an 8-bit PNG: what people look at; EXR holds the numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from scanrender.buffers import Frame
from scanrender.errors import UsageError
from scanrender.images import write_image

Bytes = npt.NDArray[np.uint8]


def bytes_from_unit(values: npt.NDArray[np.floating]) -> Bytes:
    """[0, 1] -> 0..255, rounded to nearest; NaN becomes 0, what lies outside is clipped."""
    # fmax and fmin take the number where the other is NaN: NaN becomes 0, infinities are clipped.
    clipped = np.fmin(np.fmax(values, 0.0), 1.0)
    levels: Bytes = (clipped * 255.0 + 0.5).astype(np.uint8)
    return levels


def write_bytes_png(path: Path | str, pixels: Bytes, compression: int = 4) -> Path:
    """Write display-encoded (h, w, 3 or 4) bytes, marked as sRGB; alpha is coverage, unassociated.

    `compression` is zlib's, 1 (quick) to 9 (small); the pixels are the same. Raises OutputError
    when the file cannot be written.
    """
    attributes = {
        "oiio:ColorSpace": "srgb_rec709_display",
        "png:compressionLevel": compression,
        # Otherwise OpenImageIO takes colours for premultiplied and divides them by alpha.
        "oiio:UnassociatedAlpha": 1,
    }
    return write_image(path, pixels, attributes=attributes)


def write_frame_png(path: Path | str, frame: Frame, *, alpha: bool = False) -> Path:
    """Write `display` of `frame`, 8 bits a channel.

    With `alpha`, coverage is added as a fourth channel. Colours stay as displayed: where coverage
    is partial they still hold their share of the background, since a view transform cannot be
    undone on 8 bits. For compositing take beauty and A from the EXR.

    Raises UsageError when the frame has no `display`, OutputError when the file cannot be written.
    """
    if "display" not in frame.buffers:
        raise UsageError(
            "a PNG needs the buffer 'display', which this frame does not hold",
            fix="add display to the buffers that are rendered",
        )
    channels = [frame.buffers["display"]]
    if alpha:
        channels.append(frame.alpha[:, :, None])
    return write_bytes_png(path, bytes_from_unit(np.concatenate(channels, axis=2)))
