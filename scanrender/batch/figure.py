"""A figure: the same shot several ways, side by side and labelled, with its numbers as JSON."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.asset import Asset
from scanrender.batch.turntable import Progress
from scanrender.buffers import BufferSpec, Frame, buffer_spec
from scanrender.files import write_json
from scanrender.measure.figure_numbers import NEEDS, in_words, measure
from scanrender.outputs.contact_sheet import Tile, contact_sheet
from scanrender.outputs.falsecolour import false_colour, with_common_range
from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.settings.figure import Panel, Window
from scanrender.settings.pipeline import Pipeline
from scanrender.settings.validation import panel_pipelines

PICTURE, NUMBERS = "figure.png", "figure.json"


@dataclass(frozen=True)
class _Shot:
    """What a panel shows: its picture, the first panel's of the same part, what was not run."""

    panel: Panel
    frame: Frame
    first: Frame
    not_run: tuple[str, ...]


def write_figure(
    device: Device, asset: Asset, pipeline: Pipeline, folder: Path, name: str, progress: Progress
) -> list[str]:
    """Render each panel and write figure.png and figure.json. Returns the files' names."""
    figure = pipeline.figure
    shots = _render(device, asset, pipeline, progress)
    values = [_numbers(shot, figure.numbers) for shot in shots]
    rows = [
        {
            "label": shot.panel.label,
            "shows": shot.panel.show,
            "set": shot.panel.set,
            "crop": list(shot.panel.crop or figure.crop),
            **numbers,
            "not_run": list(shot.not_run),
        }
        for shot, numbers in zip(shots, values, strict=True)
    ]
    document = {
        "figure": figure.title,
        "scan": name,
        "description": pipeline.description,
        "renderer": device.renderer,
        "panels": rows,
    }
    write_json(folder / NUMBERS, document)
    specs = _specs(shots)
    tiles = [
        Tile(_label(shot.panel), _picture(shot, specs), in_words(numbers))
        for shot, numbers in zip(shots, values, strict=True)
    ]
    contact_sheet(
        folder / PICTURE,
        tiles,
        columns=min(figure.columns, len(tiles)),
        title="  ·  ".join(filter(None, (figure.title, name))),
        subtitle=pipeline.description,
        footer=device.renderer,
    )
    return [PICTURE, NUMBERS]


def _render(device: Device, asset: Asset, pipeline: Pipeline, progress: Progress) -> list[_Shot]:
    """Each way and part once, however many panels show it."""
    figure = pipeline.figure
    ways = panel_pipelines(pipeline, "the pipeline")
    crops = [panel.crop or figure.crop for panel in figure.panels]
    names = [way.model_dump_json() for way in ways]
    extra = {need for number in figure.numbers for need in NEEDS.get(number, ())}
    wanted: dict[str, dict[Window, set[str]]] = defaultdict(lambda: defaultdict(set))
    for name, crop, panel in zip(names, crops, figure.panels, strict=True):
        wanted[name][crop].add(panel.show)
        wanted[names[0]][crop].add("display")
    frames: dict[tuple[str, Window], Frame] = {}
    not_run: dict[str, tuple[str, ...]] = {}
    total = sum(len(parts) for parts in wanted.values())
    for name, parts in wanted.items():
        renderer = Renderer(device, asset, ways[names.index(name)])
        not_run[name] = tuple(f"{d.what}: {d.reason}" for d in renderer.decisions)
        for crop, shown in parts.items():
            renderer.show_window(crop)
            # A way without transmission, say, has no such buffer: its number is then 0.
            buffers = shown | (extra & set(renderer.buffer_names))
            frames[name, crop] = renderer.render(renderer.view(figure.frame), sorted(buffers))
            progress("render", len(frames) / total)
    return [
        _Shot(panel, frames[name, crop], frames[names[0], crop], not_run[name])
        for panel, name, crop in zip(figure.panels, names, crops, strict=True)
    ]


def _numbers(shot: _Shot, numbers: tuple[str, ...]) -> dict[str, Any]:
    """A picture of a difference is described by that alone."""
    asked = [n for n in numbers if n == "delta_e"] if shot.panel.difference else numbers
    return measure(shot.frame, shot.first, shot.panel.show, asked)


def _specs(shots: list[_Shot]) -> dict[str, BufferSpec]:
    """The buffers that are shown, each with one range for all its panels."""
    by_name = defaultdict(list)
    for shot in shots:
        if shot.panel.show != "display":
            by_name[shot.panel.show].append((shot.frame.buffers[shot.panel.show], shot.frame.alpha))
    return {
        name: with_common_range(buffer_spec(name), pictures) for name, pictures in by_name.items()
    }


def _picture(shot: _Shot, specs: Mapping[str, BufferSpec]) -> npt.NDArray[Any]:
    panel, pixels = shot.panel, shot.frame.buffers[shot.panel.show]
    if panel.show != "display":
        spec = specs[panel.show]
        spec = spec if panel.range is None else replace(spec, span=panel.range)
        return false_colour(spec, pixels, shot.frame.alpha)
    if panel.difference:
        difference = np.abs(pixels - shot.first.buffers["display"])
        return np.asarray(np.clip(panel.difference * difference, 0.0, 1.0))
    return pixels


def _label(panel: Panel) -> str:
    if panel.difference:
        return f"{panel.label}: difference from the first, x {panel.difference:g}"
    return panel.label
