"""The prepared asset and the `--as-is` asset of one scan before the same camera: what simplifying
and baking did to the picture.

The as-is asset keeps the raw triangles and the raw texture coordinates, so that its pictures are
those of the scan itself, under the same lights, skin and view transform.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.asset import Asset, load_asset
from scanrender.buffers import BufferSpec, Frame
from scanrender.metrics import Summary, delta_e_2000_linear, linear_from_srgb, summarize
from scanrender.outputs.falsecolour import false_colour_png
from scanrender.outputs.png import write_frame_png
from scanrender.render.device import device
from scanrender.render.frame import Renderer, View
from scanrender.settings.loading import load_pipeline
from scanrender.settings.pipeline import Pipeline

Array = npt.NDArray[Any]

VIEWS_DEG = {"front": 0.0, "profile": 90.0}
RENDERED_MAPS = ("albedo", "normal_ts", "ao", "skin")
HEAT = BufferSpec(
    "dE2000", "scalar", "display", "CIEDE2000", "Colour difference to the as-is asset.",
    "Black; about 1 can just be noticed.", (0.0, 5.0),
)  # fmt: skip


@dataclass(frozen=True)
class Pictures:
    """Frames of one asset by name, and the camera distance that others must take over."""

    frames: Mapping[str, Frame]
    renderer: str


def view_settings(size_px: int, supersampling: int, extra: Sequence[str] = ()) -> Pipeline:
    """The shipped turntable at size_px², the camera on its way around a subject that stands."""
    return load_pipeline(
        "turntable",
        (
            f"camera.width_px={size_px}",
            f"camera.height_px={size_px}",
            f"quality.supersampling={supersampling}",
            "turntable.mode=camera",
            "turntable.frames=4",
            *extra,
        ),
    )


def renderer_like(asset: Asset, pipeline: Pipeline, other: Renderer | None = None) -> Renderer:
    """A renderer of `asset`, with the camera of `other`: framing follows the vertices, and two
    meshes of one subject do not have the same."""
    renderer = Renderer(device(), asset, pipeline)
    if other is not None:
        renderer.camera, renderer.guard_px = other.camera, other.guard_px
    return renderer


def compare_views(
    reference: Path, candidate: Path, out: Path, size_px: int = 1024, supersampling: int = 4
) -> dict[str, dict[str, float]]:
    """dE2000 of the asset folder `candidate` against `reference`, by view, over the pixels that
    either covers: mean, p95, maximum, count.

    Writes OUT/VIEW_asset.png, VIEW_as_is.png and the heat map VIEW_de2000.png. Raises ScanError,
    DeviceError, StageError, OutputError.
    """
    pipeline = view_settings(size_px, supersampling)
    first = renderer_like(load_asset(reference, RENDERED_MAPS), pipeline)
    views = {name: View(0, 0.0, degrees) for name, degrees in VIEWS_DEG.items()}
    truth = {name: first.render(view) for name, view in views.items()}
    second = renderer_like(load_asset(candidate, RENDERED_MAPS), pipeline, first)
    result = {}
    for name, view in views.items():
        frame = second.render(view)
        error, seen = picture_error(frame, truth[name])
        result[name] = {key: float(x) for key, x in asdict(_summary(error, seen)).items()}
        write_frame_png(out / f"{name}_asset.png", frame)
        write_frame_png(out / f"{name}_as_is.png", truth[name])
        false_colour_png(out / f"{name}_de2000.png", HEAT, error, seen.astype(np.float32))
    return result


def picture_error(frame: Frame, truth: Frame) -> tuple[Array, npt.NDArray[np.bool_]]:
    """(h, w) dE2000 of the finished pictures, and the pixels that the subject covers in either."""
    pair = [linear_from_srgb(picture.buffers["display"]) for picture in (frame, truth)]
    return delta_e_2000_linear(*pair), np.asarray((frame.alpha > 0) | (truth.alpha > 0))


def _summary(error: Array, seen: npt.NDArray[np.bool_]) -> Summary:
    return summarize(error, seen)
