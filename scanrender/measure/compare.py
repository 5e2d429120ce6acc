"""How far one rendered picture is from another: `scanrender compare A B`.

EXR files are compared as scene-linear light; colour differences are those of the sRGB view at one
exposure. PNG files are what a display shows, and are decoded from sRGB. B is the reference.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from scanrender.buffers import BufferSpec
from scanrender.errors import UsageError
from scanrender.images import read_image, srgb_from_linear
from scanrender.measure.bands import border_band, step_band
from scanrender.metrics import (
    delta_e_2000_linear,
    energy_ratio,
    flip,
    linear_from_srgb,
    rel_mse,
    rmse,
    summarize,
)
from scanrender.outputs.exr import read_exr
from scanrender.outputs.falsecolour import false_colour_png

Floats = npt.NDArray[np.floating]
Mask = npt.NDArray[np.bool_]
MaskKind = Literal["auto", "all", "subject", "skin"]

BAND_PX = 4
SKIN = 0.5
HEAT_DE = BufferSpec(
    "dE2000", "scalar", "display", "CIEDE2000", "Colour difference to the reference.",
    "Black; about 1 can just be noticed.", (0.0, 5.0),
)  # fmt: skip
HEAT_FLIP = BufferSpec(
    "FLIP", "scalar", "display", "1", "Difference seen when the two are flipped.",
    "Black; 1 is the most there can be.", (0.0, 0.5),
)  # fmt: skip


@dataclass(frozen=True)
class Picture:
    """linear (h, w, 3) scene-linear Rec.709; alpha (h, w); skin and depth_mm (h, w), None where
    the file has no such layer."""

    linear: Floats
    alpha: Floats
    skin: Floats | None = None
    depth_mm: Floats | None = None


def read_picture(path: Path) -> Picture:
    """An EXR's beauty with what layers it has, or any other picture, decoded from sRGB.

    Raises UsageError for a missing file or one without a picture, ScanError for one that cannot be
    read.
    """
    if not path.is_file():
        raise UsageError(f"{path} is not there", fix="name an EXR or PNG file")
    if path.suffix.lower() != ".exr":
        pixels = read_image(path)
        colour = np.repeat(pixels, 3, axis=2) if pixels.shape[2] < 3 else pixels[:, :, :3]
        alpha = pixels[:, :, 3] if pixels.shape[2] == 4 else np.ones(pixels.shape[:2])
        return Picture(linear_from_srgb(colour), alpha)
    layers = read_exr(path)
    if "beauty" not in layers:
        raise UsageError(f"{path} has no R, G, B", fix="compare frames, not dumps of one buffer")
    flat = {name: layers[name][:, :, 0] for name in ("alpha", "skin", "depth_mm") if name in layers}
    linear = layers["beauty"][:, :, :3].astype(np.float64)
    alpha = flat.get("alpha", np.ones(linear.shape[:2], np.float32))
    return Picture(linear, alpha, flat.get("skin"), flat.get("depth_mm"))


def chosen_mask(image: Picture, reference: Picture, kind: MaskKind) -> tuple[Mask, str]:
    """The pixels that count, and their name: skin where a file tells it, else the subject.

    Raises UsageError for a skin mask that neither file has.
    """
    inside = (image.alpha >= 1.0) & (reference.alpha >= 1.0)
    skin = reference.skin if reference.skin is not None else image.skin
    if kind == "all":
        return np.ones(inside.shape, bool), "all pixels"
    if kind == "skin" and skin is None:
        fix = "render with --buffers skin, or take --mask subject"
        raise UsageError("neither picture has a layer `skin`", fix=fix)
    if kind == "subject" or skin is None:
        return inside, "the subject"
    return inside & (skin > SKIN), "skin"


def compare_pictures(
    image: Picture, reference: Picture, kind: MaskKind, ppd: float, exposure_ev: float = 0.0
) -> tuple[dict[str, Any], dict[str, Floats]]:
    """Every figure of `metrics` on the mask, and the maps dE2000 and FLIP (h, w).

    `silhouette_leak` and `border_leak` are the mean |difference| of linear light near depth steps
    and near the borders of skin, over the mean light of the reference; None without their layers.
    Raises UsageError when sizes differ.
    """
    if image.linear.shape != reference.linear.shape:
        a, b = (f"{p.linear.shape[1]} x {p.linear.shape[0]}" for p in (image, reference))
        raise UsageError(f"the pictures are {a} and {b}", fix="render both at one size")
    mask, name = chosen_mask(image, reference, kind)
    gain = 2.0**exposure_ev
    test, truth = (np.clip(p.linear * gain, 0.0, 1.0) for p in (image, reference))
    maps: dict[str, Floats] = {
        "dE2000": delta_e_2000_linear(test, truth),
        "FLIP": flip(srgb_from_linear(test), srgb_from_linear(truth), ppd),
    }
    light = max(float(reference.linear[mask].mean()), 1e-12) if mask.any() else 1.0
    off = np.abs(image.linear - reference.linear).mean(axis=2) / light

    def leak(band: Mask | None) -> float | None:
        return float(off[band].mean()) if band is not None and band.any() else None

    inside = (image.alpha >= 1.0) & (reference.alpha >= 1.0)
    depth, skin = reference.depth_mm, reference.skin
    figures: dict[str, Any] = {
        "mask": name,
        "pixels": int(mask.sum()),
        "rmse": rmse(image.linear, reference.linear, mask),
        "rel_mse": rel_mse(image.linear, reference.linear, mask),
        "dE2000": asdict(summarize(maps["dE2000"], mask)),
        "FLIP": {**asdict(summarize(maps["FLIP"], mask)), "ppd": ppd},
        "energy_ratio": [float(x) for x in energy_ratio(image.linear, reference.linear, mask)],
        "silhouette_leak": leak(None if depth is None else step_band(depth, inside, BAND_PX)),
        "border_leak": leak(None if skin is None else border_band(skin > SKIN, inside, BAND_PX)),
    }
    return figures, maps


def write_heat_maps(folder: Path, maps: Mapping[str, Floats], mask: Mask) -> list[Path]:
    """dE2000.png and FLIP.png with legends; pixels outside the mask are left out of them."""
    alpha = mask.astype(np.float32)
    return [
        false_colour_png(folder / f"{spec.name}.png", spec, maps[spec.name], alpha)
        for spec in (HEAT_DE, HEAT_FLIP)
    ]


def in_words(figures: Mapping[str, Any]) -> str:
    """One line a figure."""
    de, seen = figures["dE2000"], figures["FLIP"]
    red, green, blue = figures["energy_ratio"]
    rows = [
        ("compared", f"{figures['mask']}, {figures['pixels']:,} pixels"),
        ("dE2000", f"mean {de['mean']:.4g}, 95 % {de['p95']:.4g}, most {de['maximum']:.4g}"),
        ("FLIP", f"mean {seen['mean']:.4g}, 95 % {seen['p95']:.4g}, {seen['ppd']:.4g} px/degree"),
        ("linear light", f"RMSE {figures['rmse']:.4g}, relMSE {figures['rel_mse']:.4g}"),
        ("energy", f"red {red:.5g}, green {green:.5g}, blue {blue:.5g} of the reference's"),
    ]
    for key, text in (("silhouette_leak", "depth steps"), ("border_leak", "borders of skin")):
        if figures[key] is not None:
            rows.append((f"off at {text}", f"{figures[key]:.4g} of the mean light"))
    return "\n".join(f"  {name:<25} {text}" for name, text in rows)
