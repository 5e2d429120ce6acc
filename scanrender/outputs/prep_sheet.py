"""The picture sheet of one preparation: raw against prepared, triangles, charts, stretch, maps."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.images import srgb_from_linear
from scanrender.outputs.colourmaps import diverging_table, sequential_table
from scanrender.outputs.contact_sheet import Tile, contact_sheet

Array = npt.NDArray[Any]
Views = Mapping[str, Array]

GROUND = 0.11  # display value beside the subject
CLAY = np.array([0.56, 0.54, 0.52])
CHECKS = 64  # squares along the atlas
STRETCH = 1.5  # the stretch map runs from 1/1.5 to 1.5 of the median density
CURVATURE_SPAN = 0.15  # 1/mm
THICKNESS_SPAN = 30.0  # mm
COLUMNS = 4


def write_prep_sheet(path: Path | str, views: Views, report: Mapping[str, Any]) -> Path:
    """Draw the arrays of `scan.views` and the numbers of prep_report.json. Raises OutputError."""
    return contact_sheet(
        path,
        tiles(views, report),
        columns=COLUMNS,
        title=str(report["source"]["file"]),
        subtitle=_subtitle(report),
        footer=_footer(report),
    )


def tiles(views: Views, report: Mapping[str, Any]) -> list[Tile]:
    """All pictures, labelled, in rows of four."""
    raw, prepared = (report["counts"][key]["triangles"] for key in ("raw", "prepared"))
    found = []
    for view in ("front", "side"):
        found += [
            Tile(f"raw, {raw:,} triangles, {view}", _lit(views, view, "raw_color", "raw_normal")),
            Tile(
                f"prepared, {prepared:,} triangles, {view}", _lit(views, view, "albedo", "normal")
            ),
            Tile(f"raw shape, {view}", _lit(views, view, "", "raw_normal")),
            Tile(f"prepared shape with its normal map, {view}", _lit(views, view, "", "normal")),
        ]
    lost = report["lost"]
    spread = lost["stretch"]
    found += [
        Tile("triangles", _wire(views, "side")),
        Tile(f"{lost['charts']} charts, checker of 1/{CHECKS} atlas", _charts(views, "front")),
        Tile("charts", _charts(views, "side")),
        Tile(
            f"density, {spread['median_px_per_mm']:.1f} px/mm / {STRETCH} to x {STRETCH}",
            _stretch(views, "front"),
        ),
    ]
    found += [
        Tile(label, _scalar(views, "front", name, low, high))
        for name, label, low, high in _ON_THE_MODEL
        if f"front.{name}" in views
    ]
    return found + [Tile(f"map: {name[4:]}", _map(views, name)) for name in _maps(views)]


_ON_THE_MODEL = (
    ("skin", "skin: violet 0, yellow 1", 0.0, 1.0),
    ("curvature", f"curvature, -{CURVATURE_SPAN} to {CURVATURE_SPAN} / mm", -CURVATURE_SPAN,
     CURVATURE_SPAN),
    ("ao", "ambient visibility, 0 to 1", 0.0, 1.0),
    ("thickness_mm", f"thickness, 0 to {THICKNESS_SPAN:g} mm", 0.0, THICKNESS_SPAN),
)  # fmt: skip


def _maps(views: Views) -> list[str]:
    return [name for name in views if name.startswith("map.")]


def _lit(views: Views, view: str, color: str, normal: str) -> Array:
    """Lambert under one lamp and a little light from all sides, sRGB-encoded."""
    n = views[f"{view}.{normal}"]
    cosine = np.clip(n @ views[f"{view}.light"], 0.0, 1.0)[..., None]
    albedo = views.get(f"{view}.{color}", CLAY)
    return _on_ground(srgb_from_linear(np.nan_to_num(albedo * (0.25 + 0.85 * cosine))), n)


def _on_ground(picture: Array, layer: Array) -> Array:
    beside = ~np.isfinite(layer[..., :1])
    return np.asarray(np.where(beside, GROUND, np.clip(np.nan_to_num(picture), 0.0, 1.0)))


def _wire(views: Views, view: str) -> Array:
    lit = _lit(views, view, "", "normal")
    line = np.clip(1.2 - np.nan_to_num(views[f"{view}.edge"], nan=9.0), 0.0, 1.0)
    return np.asarray(lit * (1.0 - 0.75 * line))


def _charts(views: Views, view: str) -> Array:
    chart, uv = views[f"{view}.chart"][..., 0], np.nan_to_num(views[f"{view}.uv"])
    number = np.nan_to_num(chart, nan=0.0).astype(np.int64)
    # Golden-ratio hues: neighbours in number, which are often neighbours in space, differ.
    hue = (number * 0.61803398875) % 1.0
    offset = np.array([0.0, 1.0 / 3.0, 2.0 / 3.0])
    rgb = 0.5 + 0.42 * np.cos(2.0 * np.pi * (hue[..., None] - offset))
    check = (np.floor(uv * CHECKS).sum(axis=2) % 2)[..., None]
    cosine = np.clip(views[f"{view}.normal"] @ views[f"{view}.light"], 0.0, 1.0)[..., None]
    shade = (0.6 + 0.4 * cosine) * (0.72 + 0.28 * check)
    return _on_ground(rgb * shade, views[f"{view}.chart"])


def _stretch(views: Views, view: str) -> Array:
    density = views[f"{view}.density"][..., 0]
    ratio = np.log(np.maximum(density, 1e-9) / float(views["density_median"])) / np.log(STRETCH)
    return _coloured(ratio, -1.0, 1.0, diverging_table())


def _scalar(views: Views, view: str, name: str, low: float, high: float) -> Array:
    table = diverging_table() if low == -high else sequential_table()
    return _coloured(views[f"{view}.{name}"][..., 0], low, high, table)


def _coloured(values: Array, low: float, high: float, table: Array) -> Array:
    unit = np.clip((np.nan_to_num(values, nan=low) - low) / (high - low), 0.0, 1.0)
    picture = table[(unit * 255.0 + 0.5).astype(np.uint8)] / 255.0
    return _on_ground(picture, values[..., None])


def _map(views: Views, name: str) -> Array:
    """A whole map, reduced."""
    values = views[name]
    if name == "map.albedo":
        return np.asarray(srgb_from_linear(values))
    if values.shape[2] == 3:
        return np.asarray(np.clip(0.5 * values + 0.5, 0.0, 1.0))
    for layer, _, low, high in _ON_THE_MODEL:
        if name == f"map.{layer}":
            table = diverging_table() if low == -high else sequential_table()
            return _coloured(values[..., 0], low, high, table)
    return np.asarray(np.repeat(np.clip(values, 0.0, 1.0), 3, axis=2))


def _subtitle(report: Mapping[str, Any]) -> str:
    lost = report["lost"]
    words = [
        f"distance {lost['symmetric_mm']['mean']:.3f} mm mean, "
        f"{lost['symmetric_mm']['p99']:.2f} mm at 99 %",
        f"{lost['charts']} charts, {100 * lost['atlas_use']:.0f} % of the atlas",
        f"{100 * lost['stretch']['within_1_5']:.1f} % of texels within 1.5x density",
    ]
    if lost.get("color_de2000"):
        words.insert(1, f"colour dE2000 {lost['color_de2000']['mean']:.2f} mean")
    return "  ·  ".join(words)


def _footer(report: Mapping[str, Any]) -> str:
    spent = ", ".join(f"{s['name']} {s['seconds']:.1f} s" for s in report["stages"])
    warnings = "".join(f"   warning: {sentence}." for sentence in report["warnings"])
    return f"scanrender prep: {spent}.{warnings}"
