"""Frames of one asset to files: video, PNGs, contact sheet, buffers with their pictures.

Rendering, encoding and writing overlap: all but rendering is done by threads, a few frames behind;
what they call (OpenImageIO, FFmpeg, NumPy) lets the interpreter go meanwhile. Video and sheet are
made of the 8-bit pixels of the PNGs, so that a run that was interrupted, and finds half of its
frames, makes the same ones.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.batch.jobs import Job
from scanrender.batch.record import Record, Stage
from scanrender.batch.state import SHEET, VIDEO, Work
from scanrender.batch.turn_crew import TurnCrew, worth
from scanrender.batch.writing import Writing
from scanrender.buffers import Frame, buffer_spec
from scanrender.images import read_colors
from scanrender.outputs.contact_sheet import Tile, contact_sheet
from scanrender.outputs.exr import write_exr
from scanrender.outputs.falsecolour import false_colour_png
from scanrender.outputs.png import bytes_from_unit, write_bytes_png
from scanrender.outputs.video import VideoWriter
from scanrender.render.frame import Renderer

Progress = Callable[[str, float], None]
Bytes = npt.NDArray[np.uint8]

KEPT, WAITING = 4, 1  # compression of frames
# Frames that are held while an earlier one is waited for.
LEAST_AHEAD, AHEAD_BYTES = 4, 512 << 20


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
    say: Callable[[str], None] = lambda _: None
    seconds: dict[str, float] = field(default_factory=dict)
    _here: dict[int, Future[Bytes]] = field(default_factory=dict)  # rendered before their turn

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
            writing = stack.enter_context(Writing(self.record))
            video = self._video(stack) if shown else None
            encoder = stack.enter_context(ThreadPoolExecutor(1))
            crew = stack.enter_context(TurnCrew(self._file, self.say))
            if work.render:
                self.frames.notes["processes"] = 1
            for index in self._in_order(order, writing, crew, progress):
                started = time.perf_counter()
                pixels = self._here.pop(index, None)
                if index in shown or index in tiled:
                    pixels = pixels or self._read(index, writing)
                    if video is not None:
                        writing.add(encoder.submit(_encode, video, pixels))
                    if index in tiled:
                        tiles.append(Tile(angle_label(job, index), _small(pixels.result())))
                self._add_time("write", started)
        if video is not None:
            self._made("video", [VIDEO])
        if tiles:
            started = time.perf_counter()
            self._write_sheet(tiles)
            self._add_time("write", started)

    def _in_order(
        self, order: Sequence[int], writing: Writing, crew: TurnCrew, progress: Progress
    ) -> Iterator[int]:
        """Indices in order, each when its frame is in `self._here` or in its file, whoever of the
        crew or here renders them in which order.

        Each is in one place at a time: to be rendered here alone (`own`) or by whoever comes first
        (`shared`), given to the crew, in `self._here`, or in a file (`filed`).
        """
        work, camera = self.work, self.job.pipeline.camera
        own = sorted(work.dump)
        shared = [i for i in order if i in work.render and i not in work.dump]
        old = set(order) - {*own, *shared}
        filed = set(old)
        ahead = max(LEAST_AHEAD, AHEAD_BYTES // (3 * camera.width_px * camera.height_px))
        count = 0
        for index in order:
            count += index in old
            while index not in self._here and index not in filed:
                waits = not (own or shared) or len(self._here) >= ahead
                for frame in self._taken_over(crew, writing, shared, waits):
                    filed.add(frame)
                    count += 1
                crew.give(shared)
                if (own or shared) and not (waits and crew.is_busy):
                    mine = own if not shared or (own and own[0] < shared[0]) else shared
                    frame = mine.pop(0)
                    self._here[frame] = self._pixels(frame, writing)
                    self._gather(crew, frame, len(shared))
                    count += 1
                progress("render", count / len(order))
            if index in old:
                progress("render", count / len(order))
            yield index

    def _gather(self, crew: TurnCrew, index: int, left: int) -> None:
        """A crew, once it is known what a frame takes: the first one compiles, too."""
        times = self.frames.notes.get("ms", {})
        if crew.was_started or str(index) not in times or len(times) < 2:
            return
        renderer = self.renderer()
        frame_s = min(times.values()) / 1e3
        if count := worth(renderer.device, frame_s, left):
            crew.start(count, frame_s, self.job.asset, renderer)
            self.frames.notes["processes"] = 1 + crew.size

    def _taken_over(
        self, crew: TurnCrew, writing: Writing, shared: list[int], wait: bool
    ) -> list[int]:
        """Frames that the crew has rendered meanwhile; those that it will not are shared again."""
        started = time.perf_counter()
        done, lost = crew.done(wait)
        self._add_time("render", started)
        shared[:] = sorted([*shared, *lost])
        for index, ms in done.items():
            self.frames.notes.setdefault("ms", {})[str(index)] = ms
            name = self.job.frame_file(index)
            writing.write(self.frames, index, lambda name=name: [name])  # type: ignore[misc]
        return list(done)

    def _read(self, index: int, writing: Writing) -> Future[Bytes]:
        """Frame `index`, as the crew or an earlier run left it."""
        path, _ = self._file(index)
        return writing.begin(lambda: _read_png(path))

    def _file(self, index: int) -> tuple[Path, int]:
        """Where a frame goes and how hard it is compressed: what only waits for its video is gone
        in a minute, and the cores have better to do."""
        job = self.job
        return job.folder / job.frame_file(index), KEPT if job.keeps_frames else WAITING

    def _pixels(self, index: int, writing: Writing) -> Future[Bytes]:
        """Frame `index`, rendered and on its way to its files."""
        job, work = self.job, self.work
        name = job.frame_file(index)
        dumps = index in work.dump
        renderer = self.renderer()
        names = buffer_names(renderer, job.pipeline.outputs.buffers) if dumps else []
        started = time.perf_counter()
        frame = renderer.render(renderer.view(index), names)
        renderer.device.check()
        self._add_time("render", started)
        if not dumps:
            times = self.frames.notes.setdefault("ms", {})
            times[str(index)] = round(1e3 * (time.perf_counter() - started), 1)
        started = time.perf_counter()
        pixels = writing.begin(lambda: bytes_from_unit(frame.buffers["display"]))
        if index in work.render:
            path, level = self._file(index)

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


def _read_png(path: Path) -> Bytes:
    return np.ascontiguousarray(read_colors(path), np.uint8)


def _encode(video: VideoWriter, pixels: Future[Bytes]) -> None:
    video.write(pixels.result())


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
