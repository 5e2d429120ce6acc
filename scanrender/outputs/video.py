"""H.264 video from display-encoded frames, streamed through PyAV; same frames, same bytes.

The conversion to Y'CbCr is done here and not by swscale, which takes BT.601 for small pictures
unless told otherwise, puts chroma elsewhere than H.264 expects, and rounds differently from one
version to the next. ITU-R BT.709-6, item 3.2 to 3.4, 8 bits, narrow ("tv") range:

    Y' = 0.2126 R' + 0.7152 G' + 0.0722 B'   C_B = (B' - Y') / 1.8556   C_R = (R' - Y') / 1.5748
    y  = 16 + 219 Y'                         c   = 128 + 224 C

Frames are sRGB-encoded yet tagged with the BT.709 transfer curve: players show both alike, and some
change colours when they meet the sRGB tag.

How to check a file alone: `probe_video`, or `ffprobe -show_streams FILE.mp4`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import av
import av.error
import numpy as np
import numpy.typing as npt

from scanrender.errors import OutputError
from scanrender.files import atomic_path

BT709 = 1  # the code of BT.709 for matrix, primaries and transfer alike (ITU-T H.273)
TV_RANGE = 1  # FFmpeg's AVCOL_RANGE_MPEG: luma 16-235, chroma 16-240
K_R, K_B = 0.2126, 0.0722

# Fixed, because x264 splits its work, and with it the bits, by the number of threads.
THREADS = 2


class _Abandoned(Exception):  # noqa: N818 - never seen outside: it is a signal, not an error
    """The body of `with VideoWriter(...)` failed; the unfinished file has to go."""


class VideoWriter:
    """Streams frames into an H.264 yuv420p MP4 that appears only on a clean exit.

        with VideoWriter("turn.mp4", 1280, 720, fps=24) as video:
            for picture in pictures:
                video.write(picture)

    `width`, `height` px of the frames that will come; an odd size is padded to even by repeating
    the last column or row, since 4:2:0 halves chroma. `fps` is a number or a Fraction. `crf` is
    x264's constant quality, 0 (lossless) to 51; 16 is visually lossless for smooth skin. Raises
    OutputError when encoding or writing fails, or when no frame came.
    """

    def __init__(
        self, path: Path | str, width: int, height: int, fps: float | Fraction, crf: int = 16
    ) -> None:
        self.path = Path(path)
        self.width, self.height = width, height
        self.fps = Fraction(fps).limit_denominator(1001)
        self.crf = crf
        self.frames = 0
        self._cleanup = ExitStack()
        self._container: Any = None
        self._stream: Any = None

    def __enter__(self) -> Self:
        with ExitStack() as opening:
            temporary = opening.enter_context(atomic_path(self.path))
            with _encoding(self.path):
                self._open(temporary)
            self._cleanup = opening.pop_all()
        return self

    def write(self, frame: npt.NDArray[Any]) -> None:
        """Append one frame, (h, w, 3): uint8, or float in [0, 1], both display-encoded.

        NaN is shown as black. Raises ValueError for another shape, OutputError when encoding fails.
        """
        if frame.shape != (self.height, self.width, 3):
            raise ValueError(f"frame of shape {frame.shape} for {self.width} x {self.height} video")
        picture = av.VideoFrame.from_ndarray(yuv420_from_display(frame), format="yuv420p")
        picture.colorspace = picture.color_primaries = picture.color_trc = BT709
        picture.color_range = TV_RANGE
        picture.pts = self.frames
        with _encoding(self.path):
            self._container.mux(self._stream.encode(picture))
        self.frames += 1

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # `_cleanup` renames the temporary file when nothing is raised inside it, else removes it.
        # A stand-in is raised there, so that the caller's own error passes through unaltered.
        with suppress(_Abandoned), self._cleanup:
            if error is not None:
                with suppress(av.error.FFmpegError, OSError):
                    self._container.close()
                raise _Abandoned
            with _encoding(self.path):
                if self.frames:
                    self._container.mux(self._stream.encode(None))
                self._container.close()
            if not self.frames:
                raise OutputError(f"no frame came for video {self.path}", where=str(self.path))

    def _open(self, temporary: Path) -> None:
        # faststart puts the index first, so that browsers start before the end has arrived;
        # bitexact leaves FFmpeg's version out. No creation time is written unless asked for.
        options = {"movflags": "+faststart", "fflags": "+bitexact"}
        self._container = av.open(str(temporary), "w", format="mp4", options=options)
        try:
            self._stream = self._container.add_stream("libx264", rate=self.fps)
            self._stream.width = self.width + self.width % 2
            self._stream.height = self.height + self.height % 2
            self._stream.pix_fmt = "yuv420p"
            codec = self._stream.codec_context
            codec.colorspace = codec.color_primaries = codec.color_trc = BT709
            codec.color_range = TV_RANGE
            codec.thread_count = THREADS
            codec.gop_size = max(1, round(self.fps))  # a key frame a second: scrubbing stays fluid
            codec.options = {
                "crf": str(self.crf),
                "preset": "medium",
                # Same bits on every processor, whatever vector instructions it has.
                "x264-params": "cpu-independent=1",
            }
            codec.open()
        except BaseException:
            self._container.close()
            raise


def yuv420_from_display(frame: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """(h, w, 3) display-encoded R'G'B' -> planar Y, C_B, C_R as (1.5 h, w) uint8, h and w even.

    Chroma is sited as H.264 assumes unless told: on the left luma column, between two rows. So the
    horizontal filter is [1 2 1]/4 around even columns and the vertical one the mean of two rows.
    """
    red, green, blue = (_even_plane(frame[:, :, channel]) for channel in range(3))
    luma = K_R * red + (1.0 - K_R - K_B) * green + K_B * blue
    planes = [16.0 + 219.0 * luma]
    for difference, largest in ((blue - luma, 1.0 - K_B), (red - luma, 1.0 - K_R)):
        rows = difference[0::2] + difference[1::2]
        left = np.concatenate([rows[:, :1], rows[:, 1:-1:2]], axis=1)
        quadrupled = 2.0 * rows[:, 0::2] + left + rows[:, 1::2]
        # 1/8 for the six weights 1 2 1 x 1 1, 1/2 for C in [-1/2, 1/2].
        planes.append(128.0 + (224.0 / 16.0 / largest) * quadrupled)
    flat = np.concatenate([np.rint(plane).astype(np.uint8).ravel() for plane in planes])
    return flat.reshape(-1, luma.shape[1])


def _even_plane(channel: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """(h, w) uint8 or float -> float32 in [0, 1], contiguous, padded to even sizes."""
    plane = np.ascontiguousarray(channel, dtype=np.float32)
    if channel.dtype == np.uint8:
        plane = plane * np.float32(1.0 / 255.0)
    else:
        # fmax and fmin take the number where the other is NaN: NaN becomes 0, infinities clip.
        plane = np.fmin(np.fmax(plane, np.float32(0.0)), np.float32(1.0))
    height, width = plane.shape
    if height % 2 or width % 2:
        plane = np.pad(plane, ((0, height % 2), (0, width % 2)), mode="edge")
    return plane


def probe_video(path: Path | str) -> dict[str, Any]:
    """Decode `path`: frames (counted, not believed), width, height (px), fps, codec.

    Raises OutputError when it is not a readable video.
    """
    try:
        with av.open(str(path)) as container:
            stream = container.streams.video[0]
            frames = sum(1 for _ in container.decode(stream))
            return {
                "frames": frames,
                "width": int(stream.width),
                "height": int(stream.height),
                "fps": float(stream.average_rate),
                "codec": str(stream.codec_context.codec.canonical_name),
            }
    except (av.error.FFmpegError, OSError, IndexError) as error:
        raise OutputError(f"cannot read video {path}: {error}", where=str(path)) from error


@contextmanager
def _encoding(path: Path) -> Iterator[None]:
    """Turn PyAV's errors, some of which pose as OSError or ValueError, into one sentence."""
    try:
        yield
    except (av.error.FFmpegError, OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(
            f"cannot encode video {path}: {reason}",
            where=str(path),
            fix="check free space and permissions there; H.264 takes at most 16384 px a side",
        ) from error
