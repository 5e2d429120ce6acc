"""Shots drawn by number: lights, cameras and distances that nobody chose, everything on."""

from __future__ import annotations

from typing import Any

import numpy as np

from scanrender.settings.pipeline import Pipeline

FRAMES = 24
# What the paper switches on together, at its number of samples.
EVERYTHING: dict[str, Any] = {
    "diffusion": {"method": "gaussian_sum", "samples": 25, "limit": "lab"},
    "skin": {"transmission": {"method": "shadow_map"}},
    "quality": {"supersampling": 2, "sampling": "everywhere"},
    "turntable": {"frames": FRAMES},
}


def random_shot(number: int, size_px: int) -> Pipeline:
    """Shot `number`, the same each time: one to three lamps and ambient light or a sky around a
    subject that fills the picture, or is a few centimetres of it, or is far away."""
    rng = np.random.default_rng(number)

    def between(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 3)

    lights: list[dict[str, Any]] = [_lamp(rng, between) for _ in range(int(rng.integers(1, 4)))]
    if rng.random() < 0.25:
        sky = ("studio", "sky", "dome")[int(rng.integers(3))]
        lights.append({"type": "environment", "map": sky, "intensity": between(0.1, 0.8)})
    else:
        lights.append({"type": "ambient", "irradiance": between(0.0, 0.3)})
    data = {
        **EVERYTHING,
        "diffusion": {
            **EVERYTHING["diffusion"],
            "halo": ("depth", "cbf", "cbf_normalized", "measure")[int(rng.integers(4))],
        },
        "curvature": {"modulation": ("none", "reduce_to_minimum")[int(rng.integers(2))]},
        "lights": lights,
        "camera": {
            "width_px": size_px,
            "height_px": size_px,
            "aim": "head",
            "height_mm": round(float(np.exp(rng.uniform(np.log(120.0), np.log(3000.0)))), 1),
            "focal_mm": between(35.0, 135.0),
            "azimuth_deg": between(-180.0, 180.0),
            "elevation_deg": between(-20.0, 40.0),
        },
    }
    return Pipeline.model_validate(data)


def _lamp(rng: np.random.Generator, between: Any) -> dict[str, Any]:
    lamp: dict[str, Any] = {
        "azimuth_deg": between(-180.0, 180.0),
        "elevation_deg": between(-30.0, 70.0),
        "irradiance": round(float(np.exp(rng.uniform(np.log(0.05), np.log(3.0)))), 3),
        "shadow_px": int(2 ** rng.integers(9, 12)),
        "shadow_blur_mm": between(0.5, 6.0),
    }
    kind = ("directional", "point", "spot")[int(rng.integers(3))]
    if kind != "directional":
        lamp["distance_mm"] = between(700.0, 2500.0)
    return {"type": kind, **lamp}
