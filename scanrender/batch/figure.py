"""A figure: the same shot several ways, side by side and labelled, with its numbers as JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from scanrender.asset import Asset
from scanrender.batch.turntable import Progress
from scanrender.buffers import Frame, buffer_spec
from scanrender.files import write_json
from scanrender.measure.figure_numbers import NEEDS, measure
from scanrender.outputs.contact_sheet import Tile, contact_sheet
from scanrender.outputs.falsecolour import false_colour
from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.settings.loading import panel_pipelines
from scanrender.settings.pipeline import Pipeline

PICTURE, NUMBERS = "figure.png", "figure.json"


def write_figure(
    device: Device, asset: Asset, pipeline: Pipeline, folder: Path, title: str, progress: Progress
) -> list[str]:
    """Render each panel and write figure.png and figure.json. Returns the files' names."""
    figure = pipeline.figure
    extra = {name for number in figure.numbers for name in NEEDS.get(number, ())}
    frames, decisions = [], []
    for number, panel in enumerate(figure.panels):
        renderer = Renderer(device, asset, panel_pipelines(pipeline, "the pipeline")[number])
        wanted = extra | {panel.show}
        frames.append(renderer.render(renderer.view(figure.frame), sorted(wanted)))
        decisions.append([f"{d.what}: {d.reason}" for d in renderer.decisions])
        progress("render", (number + 1) / len(figure.panels))
    shown = [panel.show for panel in figure.panels]
    values = measure(frames, shown, figure.numbers)
    rows = [
        {"label": panel.label, "shows": panel.show, "set": panel.set, **numbers, "not_run": reasons}
        for panel, numbers, reasons in zip(figure.panels, values, decisions, strict=True)
    ]
    document = {
        "figure": title,
        "description": pipeline.description,
        "renderer": device.renderer,
        "panels": rows,
    }
    write_json(folder / NUMBERS, document)
    tiles = [
        Tile(_label(panel.label, numbers), _picture(frame, panel.show, figure.crop))
        for panel, frame, numbers in zip(figure.panels, frames, values, strict=True)
    ]
    contact_sheet(
        folder / PICTURE,
        tiles,
        columns=min(figure.columns, len(tiles)),
        title=title,
        subtitle=pipeline.description,
        footer=device.renderer,
    )
    return [PICTURE, NUMBERS]


def _picture(frame: Frame, name: str, crop: tuple[float, float, float, float]) -> Any:
    pixels = frame.buffers[name]
    height, width = pixels.shape[:2]
    left, top, right, bottom = crop
    rows = slice(int(top * height), max(int(bottom * height), int(top * height) + 1))
    columns = slice(int(left * width), max(int(right * width), int(left * width) + 1))
    if name == "display":
        return np.ascontiguousarray(pixels[rows, columns])
    return false_colour(buffer_spec(name), pixels[rows, columns], frame.alpha[rows, columns])


def _label(label: str, numbers: dict[str, Any]) -> str:
    error = numbers.get("delta_e")
    return f"{label}   dE2000 {error['mean']:.2f}" if error and error["max"] > 0.0 else label
