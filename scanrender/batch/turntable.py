"""Frames of one asset to files: video, PNGs, contact sheet, buffers with their pictures.

Rendering, encoding and writing overlap: all but rendering is done by threads, a few frames behind;
what they call (OpenImageIO, FFmpeg, NumPy) lets the interpreter go meanwhile. Video and sheet are
made of the 8-bit pixels of the PNGs, so that a run that was interrupted, and finds half of its
frames, makes the same ones.
"""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.batch.jobs import Job
from scanrender.batch.record import FileEntry, Record, Stage, read_entry
from scanrender.batch.state import SHEET, VIDEO, Work
from scanrender.buffers import Frame, buffer_spec
from scanrender.errors import CrashError
from scanrender.images import read_colors
from scanrender.outputs.contact_sheet import Tile, contact_sheet
from scanrender.outputs.exr import write_exr
from scanrender.outputs.falsecolour import false_colour_png
from scanrender.outputs.png import bytes_from_unit, write_bytes_png
from scanrender.outputs.video import VideoWriter
from scanrender.render.frame import Renderer
from scanrender.scan.parallel import workers

Progress = Callable[[str, float], None]
Bytes = npt.NDArray[np.uint8]

SAVE_EVERY_S = 1.0  # what a killed run has to do again
KEPT, WAITING = 4, 1  # compression of frames


def buffer_names(renderer: Renderer, asked: Sequence[str]) -> list[str]:
    """`all` spelled out; other names as they are, checked. Raises UsageError."""
    if "all" in asked:
        return renderer.buffer_names
    for name in asked:
        buffer_spec(name)
    return list(asked)


@dataclass
class Turntable:
    """Makes what `work` names. `frames` is the record's stage of the frames; its notes say what a
    sheet repeats, so that one can be made from frames that are there already.

    `renderer` is asked for only when something has to be rendered.
    """

    job: Job
    record: Record
    work: Work
    frames: Stage
    renderer: Callable[[], Renderer]
    seconds: dict[str, float] = field(default_factory=dict)

    def write(self, progress: Progress) -> None:
        """Each file appears complete or not at all, and is in the record once it is there.

        A part of the turn, as render farms ask for, is written as PNG frames: a video or contact
        sheet of a part would pass for the whole.
        """
        job, work = self.job, self.work
        shown = set(job.indices) if "video" in work.reasons else set()
        tiled = set(job.sheet_frames) if "sheet" in work.reasons else set()
        order = sorted({*work.render, *work.dump, *shown, *tiled})
        tiles: list[Tile] = []
        with contextlib.ExitStack() as stack:
            writing = stack.enter_context(_Writing(self.record))
            video = self._video(stack) if shown else None
            encoder = stack.enter_context(ThreadPoolExecutor(1))
            for done, index in enumerate(order):
                pixels = self._pixels(index, writing)
                started = time.perf_counter()
                if video is not None:
                    writing.add(encoder.submit(_encode, video, pixels))
                if index in tiled:
                    tiles.append(Tile(angle_label(job, index), _small(pixels.result())))
                self._add_time("write", started)
                progress("render", (done + 1) / len(order))
        if video is not None:
            self._made("video", [VIDEO])
        if tiles:
            started = time.perf_counter()
            self._write_sheet(tiles)
            self._add_time("write", started)

    def _pixels(self, index: int, writing: _Writing) -> Future[Bytes]:
        """Frame `index`, rendered and on its way to its files, or as an earlier run left it."""
        job, work = self.job, self.work
        name = job.frame_file(index)
        dumps = index in work.dump
        if index not in work.render and not dumps:
            return writing.begin(lambda: _read_png(job.folder / name))
        renderer = self.renderer()
        names = buffer_names(renderer, job.pipeline.outputs.buffers) if dumps else []
        started = time.perf_counter()
        frame = renderer.render(renderer.view(index), names)
        _check_device(renderer)
        self._add_time("render", started)
        if not dumps:
            times = self.frames.notes.setdefault("ms", {})
            times[str(index)] = round(1e3 * (time.perf_counter() - started), 1)
        started = time.perf_counter()
        pixels = writing.begin(lambda: bytes_from_unit(frame.buffers["display"]))
        if index in work.render:
            # What only waits for its video is gone in a minute: the cores have better to do.
            level = KEPT if job.keeps_frames else WAITING
            path = job.folder / name

            def write() -> list[str]:
                write_bytes_png(path, pixels.result(), level)
                return [name]

            writing.write(self.frames, index, write)
        if dumps:
            stage = self.record.stages["buffers"]
            writing.write(stage, index, lambda: self._write_buffers(frame, index, names))
        self._add_time("write", started)
        return pixels

    def _write_buffers(self, frame: Frame, index: int, names: Sequence[str]) -> list[str]:
        outputs = self.job.pipeline.outputs
        return write_buffers(
            self.job.folder, frame, index, outputs.exr_layout, names, outputs.false_colour
        )

    def _video(self, stack: contextlib.ExitStack) -> VideoWriter:
        camera, fps = self.job.pipeline.camera, self.job.pipeline.turntable.fps
        path = self.job.folder / VIDEO
        return stack.enter_context(VideoWriter(path, camera.width_px, camera.height_px, fps))

    def _write_sheet(self, tiles: list[Tile]) -> None:
        notes = self.frames.notes
        contact_sheet(
            self.job.folder / SHEET,
            tiles,
            columns=_columns(len(tiles)),
            title=notes["title"],
            subtitle=notes["subtitle"],
            footer=notes["gl"]["renderer"],
        )
        self._made("sheet", [SHEET])

    def _made(self, name: str, files: Sequence[str]) -> None:
        stage = self.record.put(name, Stage(self.work.key(name), self.work.reads[name]))
        for file in files:
            self.record.add(stage, file)
        self.record.save()

    def _add_time(self, name: str, started: float) -> None:
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - started


class _Writing:
    """Files on their way, a bounded number, noted in the record as they are complete.

    On the way out everything that was begun is finished and noted, also after an error.
    """

    def __init__(self, record: Record) -> None:
        self.record = record
        threads = max(2, workers())
        self._pool = ThreadPoolExecutor(threads)
        self._most = 2 * threads
        self._waiting: deque[Future[Any]] = deque()
        self._saved = time.monotonic()

    def __enter__(self) -> _Writing:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        try:
            while self._waiting:
                try:
                    self._finish(self._waiting.popleft())
                except Exception:
                    if kind is None:  # otherwise the first error is the one to tell
                        raise
        finally:
            self._pool.shutdown()
            self.record.save()

    def begin(self, make: Callable[[], Bytes]) -> Future[Bytes]:
        """Pixels that others wait for: begun before those, so that nobody waits for a thread."""
        return self._pool.submit(make)

    def write(self, stage: Stage, part: int, make: Callable[[], list[str]]) -> None:
        """Call `make`, which writes files and returns their names, in a thread."""
        folder = self.record.folder

        def written() -> tuple[Stage, dict[str, FileEntry]]:
            return stage, {name: read_entry(folder / name, part) for name in make()}

        self.add(self._pool.submit(written))

    def add(self, future: Future[Any]) -> None:
        self._waiting.append(future)
        while len(self._waiting) > self._most or (self._waiting and self._waiting[0].done()):
            self._finish(self._waiting.popleft())
        if time.monotonic() - self._saved > SAVE_EVERY_S:
            self.record.save()
            self._saved = time.monotonic()

    def _finish(self, future: Future[Any]) -> None:
        result = future.result()
        if result is not None:
            stage, entries = result
            stage.files.update(entries)
            self.record.changed = True


def _read_png(path: Path) -> Bytes:
    return np.ascontiguousarray(read_colors(path), np.uint8)


def _encode(video: VideoWriter, pixels: Future[Bytes]) -> None:
    video.write(pixels.result())


def _check_device(renderer: Renderer) -> None:
    """A context that was lost goes on giving pictures: black ones. Raises CrashError."""
    error = renderer.device.context.error
    if error != "GL_NO_ERROR":
        raise CrashError(
            f"the GL driver ({renderer.device.renderer}) failed: {error}",
            fix="run it again; if it persists, update the driver or use a smaller picture",
        )


def write_buffers(
    folder: Path,
    frame: Frame,
    index: int,
    layout: str,
    names: Sequence[str],
    false_colour: bool,
) -> list[str]:
    """`buffers/frame_NNNN.exr` with all layers, and a PNG with a legend for each."""
    base = folder / "buffers" / f"frame_{index:04d}.exr"
    layers = ["beauty", *(name for name in names if name != "beauty")]
    files = [*write_exr(base, frame, layout=layout, names=layers)]  # type: ignore[arg-type]
    if false_colour:
        for name in names:
            target = base.with_suffix("") / f"{name}.png"
            pixels = frame.buffers[name]
            # Coverage belongs to the camera's picture, not to a shadow map that happens to fit.
            covers = pixels.shape[:2] == frame.alpha.shape and not name.startswith("shadow_")
            alpha = frame.alpha if covers and name != "display" else None
            false_colour_png(target, buffer_spec(name), pixels, alpha)
            files.append(target)
    return [str(path.relative_to(folder)) for path in files]


def angle_label(job: Job, index: int) -> str:
    turntable = job.pipeline.turntable
    angle = turntable.start_deg + turntable.degrees * index / turntable.frames
    return f"{angle:.0f}°  frame {index}"


def subtitle(renderer: Renderer) -> str:
    """What a sheet's pictures were made with."""
    pipeline = renderer.pipeline
    width, height = renderer.camera.size_px
    method = pipeline.diffusion.method.replace("_", " ")
    parts: list[Any] = [
        f"{width} x {height} px",
        f"{pipeline.quality.supersampling**2} samples a pixel",
        f"diffusion: {method}, {pipeline.diffusion.samples} taps",
        f"{len(renderer.scene.asset.mesh.faces):,} triangles",
    ]
    return "  ·  ".join(str(part) for part in parts)


def _small(pixels: Bytes) -> npt.NDArray[np.float32]:
    """The picture, box-reduced to at most about 540 px high for the contact sheet."""
    step = max(1, pixels.shape[0] // 540)
    # A picture of one column has no block of several.
    down, across = (min(step, side) for side in pixels.shape[:2])
    rows, columns = pixels.shape[0] // down, pixels.shape[1] // across
    blocks = pixels[: rows * down, : columns * across].reshape(rows, down, columns, across, 3)
    return np.ascontiguousarray(blocks.mean(axis=(1, 3), dtype=np.float32) / np.float32(255.0))


def _columns(count: int) -> int:
    return count if count <= 4 else (4 if count <= 12 else 6)
