"""Frames of one asset to files: video, PNGs, contact sheet, buffers with their pictures."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.buffers import Frame, buffer_spec
from scanrender.outputs.contact_sheet import Tile, contact_sheet
from scanrender.outputs.exr import write_exr
from scanrender.outputs.falsecolour import false_colour_png
from scanrender.outputs.png import write_frame_png
from scanrender.outputs.video import VideoWriter
from scanrender.render.frame import Renderer

Progress = Callable[[str, float], None]


@dataclass
class Written:
    """What a turntable left behind: files relative to the folder, seconds per kind of work, and
    milliseconds of each frame that was only shown."""

    files: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    frame_ms: list[float] = field(default_factory=list)

    def add_time(self, name: str, started: float) -> None:
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - started


def buffer_names(renderer: Renderer, asked: Sequence[str]) -> list[str]:
    """`all` spelled out; other names as they are, checked. Raises UsageError."""
    if "all" in asked:
        return renderer.buffer_names
    for name in asked:
        buffer_spec(name)
    return list(asked)


def write_turntable(
    renderer: Renderer,
    folder: Path,
    title: str,
    progress: Progress,
    frames: Sequence[int] | None = None,
) -> Written:
    """Render `frames` (default: all) and write what `outputs:` asks for.

    A part of the turn, as render farms ask for, is written as PNG frames: a video or contact sheet
    of a part would pass for the whole. Each file appears complete or not at all.
    """
    pipeline = renderer.pipeline
    outputs = pipeline.outputs
    whole = frames is None
    indices = list(range(pipeline.turntable.frames)) if frames is None else list(frames)
    contact = _spread(indices, outputs.contact_frames) if whole and outputs.contact_sheet else set()
    dumped = buffer_names(renderer, outputs.buffers)
    tiles: list[Tile] = []
    written = Written()
    with contextlib.ExitStack() as stack:
        video = None
        if whole and outputs.video:
            width, height = renderer.camera.size_px
            video = stack.enter_context(
                VideoWriter(folder / "turntable.mp4", width, height, pipeline.turntable.fps)
            )
            written.files.append("turntable.mp4")
        for done, index in enumerate(indices):
            buffers = dumped if index in outputs.buffer_frames else []
            started = time.perf_counter()
            frame = renderer.render(renderer.view(index), buffers)
            written.add_time("render", started)
            if not buffers:
                written.frame_ms.append(1e3 * (time.perf_counter() - started))
            started = time.perf_counter()
            if video is not None:
                video.write(frame.buffers["display"])
            if outputs.frames or not whole:
                name = f"frames/frame_{index:04d}.png"
                write_frame_png(folder / name, frame)
                written.files.append(name)
            if buffers:
                written.files += write_buffers(
                    folder, frame, index, outputs.exr_layout, buffers, outputs.false_colour
                )
            if index in contact:
                tiles.append(Tile(_angle_label(renderer, index), _small(frame)))
            written.add_time("write", started)
            progress("render", (done + 1) / len(indices))
    if tiles:
        started = time.perf_counter()
        contact_sheet(
            folder / "contact_sheet.png",
            tiles,
            columns=_columns(len(tiles)),
            title=title,
            subtitle=_subtitle(renderer),
            footer=renderer.device.renderer,
        )
        written.files.append("contact_sheet.png")
        written.add_time("write", started)
    return written


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


def _spread(indices: Sequence[int], count: int) -> set[int]:
    """`count` of `indices`, evenly spread over a closed turn (the last is not the first again)."""
    count = min(count, len(indices))
    return {indices[int(i * len(indices) / count)] for i in range(count)}


def _angle_label(renderer: Renderer, index: int) -> str:
    turntable = renderer.pipeline.turntable
    angle = turntable.start_deg + turntable.degrees * index / turntable.frames
    return f"{angle:.0f}°  frame {index}"


def _small(frame: Frame) -> npt.NDArray[np.float32]:
    """The display picture, box-reduced to at most about 540 px high for the contact sheet."""
    pixels = frame.buffers["display"]
    step = max(1, pixels.shape[0] // 540)
    # A picture of one column has no block of several.
    down, across = (min(step, side) for side in pixels.shape[:2])
    rows, columns = pixels.shape[0] // down, pixels.shape[1] // across
    blocks = pixels[: rows * down, : columns * across].reshape(rows, down, columns, across, 3)
    return np.ascontiguousarray(blocks.mean(axis=(1, 3)))


def _columns(count: int) -> int:
    return count if count <= 4 else (4 if count <= 12 else 6)


def _subtitle(renderer: Renderer) -> str:
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
