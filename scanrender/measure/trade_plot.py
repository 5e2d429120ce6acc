"""A plot of time against error, with the points that no other beats."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from scanrender.measure.knobs import METHOD
from scanrender.measure.trade import pareto
from scanrender.outputs.lettering import write
from scanrender.outputs.png import write_bytes_png

WIDTH_PX, HEIGHT_PX = 1000, 640
LEFT, RIGHT, TOP, BOTTOM = 80, 30, 60, 70
PAPER, INK, FAINT = (250, 250, 248), (30, 30, 34), (214, 214, 210)
# Okabe and Ito's colours: apart for the colour-blind too.
COLOURS = {
    "none": (120, 120, 120),
    "gaussian_sum": (0, 114, 178),
    "separable_preintegrated": (213, 94, 0),
    "separable_artistic": (204, 121, 167),
    "disk": (0, 158, 115),
}
TICKS = (1, 2, 5)


def write_plot(path: Path, rows: Sequence[Mapping[str, Any]], view: str) -> Path:
    """Milliseconds on a logarithmic axis, dE2000 on a linear one. Raises OutputError."""
    times = [row["frame_ms"] for row in rows]
    low, high = math.log(min(times) / 1.15), math.log(max(times) * 1.15)
    most = 1.08 * max(row["dE2000"]["mean"] for row in rows)

    def place(milliseconds: float, error: float) -> tuple[float, float]:
        x = (math.log(milliseconds) - low) / (high - low)
        y = 1.0 - error / most
        return (
            LEFT + x * (WIDTH_PX - LEFT - RIGHT),
            TOP + y * (HEIGHT_PX - TOP - BOTTOM),
        )

    picture = Image.new("RGB", (WIDTH_PX, HEIGHT_PX), PAPER)
    draw = ImageDraw.Draw(picture)
    floor = place(math.exp(low), 0.0)[1]
    for value in _ticks(math.exp(low), math.exp(high)):
        x = place(value, 0.0)[0]
        draw.line([(x, TOP), (x, floor)], FAINT)
        write(picture, (round(x) - 12, round(floor) + 8), f"{value:g}", INK, 15)
    for step in range(6):
        error = most * step / 5.0
        y = place(math.exp(low), error)[1]
        draw.line([(LEFT, y), (WIDTH_PX - RIGHT, y)], FAINT)
        write(picture, (24, round(y) - 9), f"{error:.2f}", INK, 15)
    best = [place(row["frame_ms"], row["dE2000"]["mean"]) for row in pareto(rows)]
    draw.line(best, INK, 2)
    for row in rows:
        x, y = place(row["frame_ms"], row["dE2000"]["mean"])
        draw.ellipse([x - 5, y - 5, x + 5, y + 5], COLOURS[row["point"][METHOD]], PAPER)
    write(picture, (LEFT, 16), f"{view}: dE2000 to the truth over ms a frame", INK, 20)
    write(picture, (WIDTH_PX // 2 - 60, HEIGHT_PX - 30), "ms a frame", INK, 15)
    _legend(picture, [name for name in COLOURS if any(r["point"][METHOD] == name for r in rows)])
    return write_bytes_png(path, np.asarray(picture))


def _legend(picture: Image.Image, names: Sequence[str]) -> None:
    draw = ImageDraw.Draw(picture)
    for number, name in enumerate(names):
        y = TOP + 10 + 24 * number
        draw.ellipse([WIDTH_PX - 250, y, WIDTH_PX - 240, y + 10], COLOURS[name])
        write(picture, (WIDTH_PX - 230, y - 4), name, INK, 15)


def _ticks(low: float, high: float) -> list[float]:
    tens = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    found = [step * 10.0**ten for ten in tens for step in TICKS]
    return [value for value in found if low <= value <= high]
