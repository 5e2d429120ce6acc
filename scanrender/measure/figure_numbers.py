"""What is measured on the panels of a figure: each number of a panel, some against the first."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from scanrender.buffers import Frame
from scanrender.measure.bands import border_band, step_band
from scanrender.metrics import delta_e_2000_linear, energy_ratio

Array = npt.NDArray[Any]
Mask = npt.NDArray[np.bool_]

DETAIL_PX = 2.0  # Gaussian below which a structure counts as high frequency
STEP_BAND_MM = 1.5  # the surroundings of a depth step
STEP_BAND_PX = 4  # where the picture's scale is not known
BORDER_PX = 3  # a border's band, to either side
HARD_SPACE = "\N{NO-BREAK SPACE}"
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def measure(frame: Frame, first: Frame, shown: str, numbers: Sequence[str]) -> dict[str, Any]:
    """The numbers of one panel that shows the buffer `shown`.

    Panels of a buffer get only what is measured on it: not the picture's, which they do not show.
    """
    fits = OF_BUFFERS if shown != "display" else NUMBERS.keys() - {"mean"}
    return {name: NUMBERS[name](frame, first, shown) for name in numbers if name in fits}


def in_words(values: Mapping[str, Any]) -> str:
    """The numbers in a few words, which break between them only; what the first panel is against
    itself is left out."""
    found = filter(None, (WORDS[name](value) for name, value in values.items()))
    return f"{HARD_SPACE}· ".join(words.replace(" ", HARD_SPACE) for words in found)


def black_pixels(frame: Frame, first: Frame, shown: str) -> int:
    """Pixels inside the subject that are black to the last bit in the picture, or not finite."""
    beauty = frame.buffers["beauty"]
    inside = ndimage.binary_erosion(frame.alpha >= 1.0, iterations=1)
    dark = ~np.isfinite(beauty).all(axis=2) | (beauty.max(axis=2) <= 0.0)
    return int((dark & inside).sum())


def delta_e(frame: Frame, first: Frame, shown: str) -> dict[str, float]:
    """dE2000 of the scene-linear picture against the first panel's, over the subject."""
    mask = _subject(frame, first)
    error = delta_e_2000_linear(frame.buffers["beauty"], first.buffers["beauty"])[mask]
    if not error.size:
        return {"mean": 0.0, "p95": 0.0, "max": 0.0}
    p95 = float(np.percentile(error, 95))
    return {"mean": float(error.mean()), "p95": p95, "max": float(error.max())}


def energy(frame: Frame, first: Frame, shown: str) -> list[float]:
    """Light per channel over the subject, as a share of the first panel's."""
    mask = _subject(frame, first)
    ratio = energy_ratio(frame.buffers["beauty"], first.buffers["beauty"], mask)
    return [float(value) for value in ratio]


def high_frequency(frame: Frame, first: Frame, shown: str) -> float:
    """Root mean square of what the shown buffer has below DETAIL_PX, inside the subject."""
    values = frame.buffers[shown].astype(np.float64)
    if values.ndim == 2:
        values = values[:, :, None]
    inside = frame.alpha >= 1.0
    weight = ndimage.gaussian_filter(inside.astype(np.float64), DETAIL_PX)
    total = 0.0
    deep = ndimage.binary_erosion(inside, iterations=BORDER_PX)
    for channel in range(values.shape[2]):
        plane = np.where(inside, np.nan_to_num(values[:, :, channel]), 0.0)
        smooth = ndimage.gaussian_filter(plane, DETAIL_PX) / np.maximum(weight, 1e-9)
        total += float(((plane - smooth)[deep] ** 2).mean()) if deep.any() else 0.0
    return float(np.sqrt(total))


def border_contrast(frame: Frame, first: Frame, shown: str) -> dict[str, float]:
    """Mean gradient of the diffuse light's luminance at the skin map's borders and away from them,
    1/px: what a limit keeps sharp, and what it must leave soft."""
    luminance = frame.buffers["diffuse"] @ LUMINANCE
    gradient = np.hypot(*np.gradient(luminance))
    skin = frame.buffers["skin"]
    skin = skin[:, :, 0] if skin.ndim == 3 else skin
    inside = ndimage.binary_erosion(frame.alpha >= 1.0, iterations=2 * BORDER_PX)
    border = border_band(skin > 0.5, inside, BORDER_PX)
    smooth = inside & ~ndimage.binary_dilation(border, iterations=2 * BORDER_PX)
    return {
        "at_borders": float(gradient[border].mean()) if border.any() else 0.0,
        "elsewhere": float(gradient[smooth].mean()) if smooth.any() else 0.0,
    }


def mean(frame: Frame, first: Frame, shown: str) -> float:
    """Mean of the shown buffer over the subject, all channels alike."""
    inside = frame.alpha >= 1.0
    values = frame.buffers[shown][inside]
    return float(values.mean()) if values.size else 0.0


def silhouette_leak(frame: Frame, first: Frame, shown: str) -> float:
    """Light that diffusion moved within STEP_BAND_MM of depth steps of STEP_MM, against the
    undiffused first panel's: the mean of |difference| of the diffuse light there, per unit of its
    mean."""
    depth = frame.buffers["depth_mm"]
    depth = depth[:, :, 0] if depth.ndim == 3 else depth
    inside = frame.alpha >= 1.0
    scale = frame.info.get("px_per_mm")
    reach = max(1, round(STEP_BAND_MM * scale)) if scale else STEP_BAND_PX
    band = step_band(depth, inside, reach)
    if not band.any():
        return 0.0
    moved = np.abs(frame.buffers["diffuse"] - first.buffers["diffuse"])[band]
    return float(moved.mean() / max(first.buffers["diffuse"][inside].mean(), 1e-12))


def transmitted(frame: Frame, first: Frame, shown: str) -> float:
    """Light that came through thin skin, as a share of all the light of the picture."""
    if "transmission" not in frame.buffers:
        return 0.0
    inside = frame.alpha >= 1.0
    light = float((frame.buffers["beauty"][inside] @ LUMINANCE).sum())
    through = float((frame.buffers["transmission"][inside] @ LUMINANCE).sum())
    return through / max(light, 1e-12)


def _subject(frame: Frame, first: Frame) -> Mask:
    return np.asarray((frame.alpha > 0.5) & (first.alpha > 0.5))


NUMBERS: dict[str, Callable[[Frame, Frame, str], Any]] = {
    "black_pixels": black_pixels,
    "delta_e": delta_e,
    "energy_ratio": energy,
    "high_frequency": high_frequency,
    "border_contrast": border_contrast,
    "mean": mean,
    "silhouette_leak": silhouette_leak,
    "transmitted": transmitted,
}
# Those that are measured on whatever buffer is shown.
OF_BUFFERS = {"high_frequency", "mean"}
# Buffers that a number reads besides the picture.
NEEDS = {
    "border_contrast": ("diffuse", "skin"),
    "silhouette_leak": ("diffuse", "depth_mm"),
    "transmitted": ("transmission",),
}


def _energy_in_words(value: Sequence[float]) -> str:
    if all(share == 1.0 for share in value):
        return ""
    return "energy " + " / ".join(f"{share:.3f}" for share in value)


WORDS: dict[str, Callable[[Any], str]] = {
    "black_pixels": lambda value: f"{value} black pixels",
    "delta_e": lambda value: (
        f"dE2000 {value['mean']:.2f}, 95 % {value['p95']:.2f}" if value["max"] > 0.0 else ""
    ),
    "energy_ratio": _energy_in_words,
    "high_frequency": lambda value: f"detail {value:.3g}",
    "border_contrast": lambda value: (
        f"gradient {value['at_borders']:.4f} at borders, {value['elsewhere']:.4f} elsewhere"
        if value["at_borders"] > 0.0
        else ""
    ),
    "mean": lambda value: f"mean {value:.3g}",
    "silhouette_leak": lambda value: f"leak {100.0 * value:.2f} %",
    "transmitted": lambda value: f"through skin {100.0 * value:.2f} %",
}
