"""A turntable as one picture that is scrubbed: its frames in a grid, small, as WebP."""

from __future__ import annotations

import base64
import io
import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import av
import av.error
import numpy as np
import numpy.typing as npt
from PIL import Image

from scanrender.errors import OutputError, ScanError
from scanrender.images import read_colors

Bytes = npt.NDArray[np.uint8]

MOST_FRAMES = 36  # 10 degrees apart on a closed turn
FRAME_PX = 320  # the longer side of a frame of the strip
STILL_PX = 1024  # the longer side of the still
POSTER_PX = 128
STRIP_QUALITY, STILL_QUALITY, POSTER_QUALITY = 80, 88, 70


def turn_of(frames: Sequence[Path], video: Path | None) -> dict[str, Any]:
    """`strip` (grid of frames), `columns`, `count`, `shown` (number of the frame in each cell),
    `width`, `height` px of a cell, `still` (the first frame) and `poster`: pictures are data: URIs.

    From PNG frames, else from the video; nothing where there are neither. Raises ScanError or
    OutputError for a file that cannot be read.
    """
    small: list[Image.Image] = []
    shown: list[int] = []
    still: Image.Image | None = None
    for number, picture in _pictures(frames, video):
        still = still or picture
        small.append(_fitted(picture, FRAME_PX))
        shown.append(number)
    if still is None:
        return {}
    columns = math.ceil(math.sqrt(len(small)))
    width, height = small[0].size
    grid = Image.new("RGB", (columns * width, math.ceil(len(small) / columns) * height))
    for index, picture in enumerate(small):
        grid.paste(picture, (index % columns * width, index // columns * height))
    return {
        "strip": webp(grid, STRIP_QUALITY),
        "columns": columns,
        "rows": math.ceil(len(small) / columns),
        "shown": shown,
        "width": width,
        "height": height,
        "still": webp(_fitted(still, STILL_PX), STILL_QUALITY),
        "poster": webp(_fitted(still, POSTER_PX), POSTER_QUALITY),
    }


def webp(picture: Image.Image, quality: int) -> str:
    """The picture as a data: URI, which a page opened from the file system may also read back."""
    stream = io.BytesIO()
    picture.save(stream, "WEBP", quality=quality, method=4)
    return "data:image/webp;base64," + base64.b64encode(stream.getvalue()).decode("ascii")


def spread(count: int) -> list[int]:
    """At most MOST_FRAMES of `count` frames, evenly; the last of a closed turn is not the first."""
    kept = min(count, MOST_FRAMES)
    return sorted({index * count // kept for index in range(kept)}) if kept else []


def _pictures(frames: Sequence[Path], video: Path | None) -> Iterator[tuple[int, Image.Image]]:
    if frames:
        for index in spread(len(frames)):
            # A part of a turn has the angles of its own frames.
            named = re.search(r"(\d+)$", frames[index].stem)
            number = int(named[1]) if named else index
            yield (
                number,
                Image.fromarray(np.ascontiguousarray(read_colors(frames[index]), np.uint8)),
            )
    elif video is not None:
        yield from _of_video(video)


def _of_video(video: Path) -> Iterator[tuple[int, Image.Image]]:
    try:
        with av.open(str(video)) as container:
            stream = container.streams.video[0]
            # An MP4 of ours knows its number of frames; if it did not, they are counted.
            count = stream.frames or sum(1 for _ in container.decode(stream))
            if not stream.frames:
                container.seek(0)
            wanted = set(spread(count))
            for index, frame in enumerate(container.decode(stream)):
                if index in wanted:
                    # Told what outputs/video.py did: swscale takes BT.601 for small pictures.
                    pixels = frame.to_ndarray(
                        format="rgb24", src_colorspace="ITU709", src_color_range="MPEG"
                    )
                    yield index, Image.fromarray(pixels)
    except (av.error.FFmpegError, OSError, IndexError) as error:
        raise OutputError(f"cannot read video {video}: {error}", where=str(video)) from error


def _fitted(picture: Image.Image, longest: int) -> Image.Image:
    if max(picture.size) <= longest:
        return picture
    share = longest / max(picture.size)
    size = tuple(max(1, round(side * share)) for side in picture.size)
    return picture.resize((size[0], size[1]), Image.Resampling.LANCZOS)


def still_of(path: Path, longest: int = STILL_PX) -> str:
    """One picture (a figure, a contact sheet) as a data: URI. Raises ScanError."""
    try:
        picture = Image.fromarray(np.ascontiguousarray(read_colors(path), np.uint8))
    except ValueError as error:
        raise ScanError(f"cannot read {path}: {error}", str(path)) from error
    return webp(_fitted(picture, longest), STILL_QUALITY)
