"""Scenes at the extremes: axes along which a shot or a subject can become hard, and cases drawn
from them. A case is plain data, which can be written down and rendered again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from scanrender.asset import Asset
from scanrender.measure.extreme_meshes import MAPS, SHAPES, asset_of
from scanrender.settings.pipeline import Pipeline

HEAD_MM = 200.0
Data = dict[str, Any]
Draw = Callable[[np.random.Generator], Any]

# What a case is before an axis moves it: everything on, small.
PLAIN: Data = {
    "camera": {"width_px": 48, "height_px": 40, "height_mm": 1.3 * HEAD_MM, "elevation_deg": 10.0},
    "lights": [
        {"type": "directional", "azimuth_deg": 40.0, "irradiance": 1.0, "shadow_px": 128},
        {"type": "ambient", "irradiance": 0.1},
    ],
    "diffusion": {"samples": 9},
    "quality": {"supersampling": 1},
    "turntable": {"frames": 4},
}


@dataclass(frozen=True)
class Case:
    """A subject (shape and maps of extreme_meshes, `size_mm` high) and a pipeline as plain data.

    `axes` says which axes were moved, and to what.
    """

    shape: str = "ball"
    size_mm: float = HEAD_MM
    maps: str = "plain"
    settings: Data = field(default_factory=lambda: PLAIN)
    axes: Mapping[str, Any] = field(default_factory=dict)

    def asset(self) -> Asset:
        return asset_of(self.shape, self.size_mm, self.maps)

    def pipeline(self, *more: Data) -> Pipeline:
        data = self.settings
        for layer in more:
            data = merged(data, layer)
        return Pipeline.model_validate(data)

    def without(self, axis: str) -> Case:
        """The same case with one axis left alone."""
        return case_of({name: value for name, value in self.axes.items() if name != axis})


def merged(base: Data, top: Data) -> Data:
    """`top` over `base`, mapping by mapping."""
    result = dict(base)
    for key, value in top.items():
        both = isinstance(value, dict) and isinstance(result.get(key), dict)
        result[key] = merged(result[key], value) if both else value
    return result


def _power(low: float, high: float) -> Draw:
    return lambda rng: float(f"{10.0 ** rng.uniform(low, high):.4g}")


def _one_of(*values: Any) -> Draw:
    return lambda rng: values[int(rng.integers(len(values)))]


def _between(low: float, high: float) -> Draw:
    return lambda rng: round(float(rng.uniform(low, high)), 4)


def _whole(low: int, high: int) -> Draw:
    return lambda rng: int(rng.integers(low, high + 1))


def _set(section: str, key: str) -> Callable[[Data, Any], Data]:
    def apply(data: Data, value: Any) -> Data:
        parts = [*section.split("."), key]
        layer: Data = {parts[-1]: value}
        for part in reversed(parts[:-1]):
            layer = {part: layer}
        return merged(data, layer)

    return apply


def _distance(data: Data, heights: float) -> Data:
    """The camera `heights` subjects of HEAD_MM away, by the part of it that the picture shows."""
    focal = data["camera"].get("focal_mm", 85.0)
    return merged(data, {"camera": {"height_mm": HEAD_MM * heights * 24.0 / focal}})


def _field(data: Data, degrees: float) -> Data:
    """A field of view that high, from where the picture shows as much of the subject."""
    return merged(data, {"camera": {"focal_mm": 12.0 / float(np.tan(np.deg2rad(degrees) / 2))}})


def _lamp(key: str) -> Callable[[Data, Any], Data]:
    return lambda data, value: merged(
        data, {"lights": [{**data["lights"][0], key: value}, *data["lights"][1:]]}
    )


def _lamp_kind(data: Data, lamp: Data) -> Data:
    """The first light becomes `lamp`, with the strength and colour that it had."""
    kept = {
        k: v for k, v in data["lights"][0].items() if k in ("irradiance", "colour", "shadow_px")
    }
    return merged(data, {"lights": [{**kept, **lamp}, *data["lights"][1:]]})


def _profile(data: Data, ratio: float) -> Data:
    """Red scatters `ratio` times as far as blue."""
    wide = 1.0 * ratio**0.5
    narrow = wide / ratio
    terms = [
        {"variance_mm2": narrow**2, "weight": [0, 0, 1]},
        {"variance_mm2": wide * narrow, "weight": [0, 1, 0]},
        {"variance_mm2": wide**2, "weight": [1, 0, 0]},
    ]
    return merged(data, {"skin": {"profile": terms}})


LAMPS: tuple[Data, ...] = (
    {"type": "directional", "azimuth_deg": 180.0, "elevation_deg": 0.0},
    {"type": "directional", "azimuth_deg": 90.0, "elevation_deg": 0.0},
    {"type": "directional", "azimuth_deg": 0.0, "elevation_deg": 90.0},
    {"type": "directional", "azimuth_deg": -30.0, "size_deg": 40.0},
    {"type": "point", "position_mm": [0.0, 1.0, 0.0]},
    {"type": "point", "position_mm": [60.0, 60.0, 60.0], "radius_mm": 30.0},
    {"type": "point", "distance_mm": 1e7, "azimuth_deg": 60.0},
    {"type": "point", "distance_mm": 130.0, "azimuth_deg": -100.0, "radius_mm": 5.0},
    {"type": "spot", "distance_mm": 500.0, "cone_deg": 1.0},
    {"type": "spot", "distance_mm": 1e7, "cone_deg": 170.0, "edge": 0.0},
    {"type": "spot", "position_mm": [0.0, 0.0, 50.0], "cone_deg": 90.0, "edge": 1.0},
)


@dataclass(frozen=True)
class Axis:
    """One axis: how to draw a value, how it changes the settings, and values to walk along."""

    draw: Draw
    apply: Callable[[Data, Any], Data]
    unit: str = ""
    walk: tuple[Any, ...] = ()


def _same(data: Data, value: Any) -> Data:
    """The subject's axes change no setting."""
    return data


def _powers(low: int, high: int, step: int = 1) -> tuple[float, ...]:
    return tuple(10.0**e for e in range(low, high + 1, step))


# Axes of the shot. `size_mm`, `shape` and `maps` are the subject's, see `random_case`.
AXES: Mapping[str, Axis] = {
    "fov_deg": Axis(_between(1, 160), _field, "°", (1, 5, 20, 60, 90, 120, 150, 160)),
    "distance": Axis(_power(-1, 2), _distance, "heights", _powers(-5, 4)),
    "projection": Axis(_one_of("orthographic"), _set("camera", "projection")),
    "azimuth_deg": Axis(_between(-180, 180), _set("camera", "azimuth_deg"), "°"),
    "look_up_mm": Axis(_one_of(0.0, 20.0, -80.0, 1e6), _set("camera", "look_up_mm"), "mm",
                       (0.0, 100.0, 1e3, 1e4, 1e5, 1e6)),
    "size_px": Axis(
        _one_of([1, 1], [2, 2], [1, 512], [700, 1], [37, 91], [96, 96], [3, 200]),
        lambda data, value: merged(
            data, {"camera": {"width_px": value[0], "height_px": value[1]}}),
        "px", ([1, 1], [1, 4096], [8192, 1], [2, 3], [96, 96], [512, 512])),
    # As `size_px`, for long runs: some GB and half a minute. Only looked at, see `stress.walk`.
    "frame_px": Axis(
        _one_of([7680, 4320]),
        lambda data, value: merged(
            data, {"camera": {"width_px": value[0], "height_px": value[1]}}),
        "px", ([7680, 4320],)),
    "lamp": Axis(_one_of(*LAMPS), _lamp_kind, "", LAMPS),
    "irradiance": Axis(_power(-8, 8), _lamp("irradiance"), "π", _powers(-8, 8, 2)),
    "colour": Axis(_one_of([1, 0, 0], [0, 0, 1], [0, 0, 0], [1e-4, 1.0, 1e4]), _lamp("colour"), "",
                   ([1, 0, 0], [0, 0, 0], [1e-4, 1.0, 1e4])),
    "ambient": Axis(_one_of(0.0, 1e-8, 1.0, 1e8), lambda data, value: merged(
        data, {"lights": [*data["lights"][:1], {"type": "ambient", "irradiance": value}]}), "π"),
    "lights": Axis(_one_of([]), lambda data, value: {**data, "lights": value}),
    "scale": Axis(_power(-4, 3), _set("skin", "scale"), "", (0.0, *_powers(-4, 3))),
    "profile": Axis(_power(0.5, 4), _profile, "red : blue", _powers(0, 4)),
    "texturing": Axis(_one_of("pre", "mixed", "post"), _set("skin", "texturing")),
    "method": Axis(_one_of("none", "gaussian_sum", "separable_preintegrated",
                           "separable_artistic", "disk"), _set("diffusion", "method")),
    "halo": Axis(_one_of("none", "depth", "cbf", "cbf_normalized", "measure"),
                 _set("diffusion", "halo")),
    "edge_contrast": Axis(_one_of(0.0, 1.0, 100.0, 1e6), _set("diffusion", "edge_contrast")),
    "samples": Axis(_one_of(3, 4, 5, 9, 17, 64, 255), _set("diffusion", "samples"), "taps",
                    (3, 4, 9, 64, 255)),
    "disk_taps": Axis(_whole(4, 1023), _set("diffusion", "disk_taps"), "taps"),
    "normalize": Axis(_one_of("none"), _set("diffusion", "normalize")),
    "resolution": Axis(_one_of("half"), _set("diffusion", "resolution")),
    "jitter": Axis(_one_of(True), _set("diffusion", "jitter")),
    "mask": Axis(_one_of("none"), _set("diffusion", "mask")),
    "limit": Axis(_one_of("lab"), _set("diffusion", "limit")),
    "limit_smooth_mm": Axis(_one_of(0.0, 1e-3, 20.0), _set("diffusion", "limit_smooth_mm"), "mm"),
    "limit_delta_e": Axis(_one_of(0.1, 1000.0), _set("diffusion", "limit_delta_e")),
    "gaussians": Axis(_whole(1, 6), _set("diffusion", "gaussians")),
    "roughness": Axis(
        lambda rng: [_power(-2, 0)(rng), _power(-2, 0)(rng)],
        _set("skin.specular", "roughness"), "", ([0.01, 0.01], [0.1, 0.1], [1.0, 1.0])),
    "f0": Axis(_one_of(0.0, 0.5, 1.0), _set("skin.specular", "f0"), "", (0.0, 0.028, 0.5, 1.0)),
    "strength": Axis(_one_of(0.0, 1.0, 10.0), _set("skin.specular", "strength")),
    "modulation": Axis(_one_of("increase", "reduce", "reduce_to_minimum"),
                       _set("curvature", "modulation")),
    "curvature_source": Axis(_one_of("screen", "baked"), _set("curvature", "source")),
    "full_at_mm": Axis(_power(-1, 3), _set("curvature", "full_at_mm"), "mm", _powers(-1, 3)),
    "smooth_mm": Axis(_one_of(0.0, 0.1, 50.0), _set("curvature", "smooth_mm"), "mm"),
    "forward": Axis(_one_of(True), _set("curvature", "forward_scattering")),
    "transmission": Axis(_one_of("none", "baked"), _set("skin.transmission", "method")),
    "wrap": Axis(_one_of(0.3, 1.0), _set("skin.transmission", "wrap")),
    "bias_mm": Axis(_one_of(0.0, 0.1, 20.0), _set("skin.transmission", "bias_mm"), "mm"),
    "blur_mm": Axis(_one_of(0.0, 20.0), _set("skin.transmission", "blur_mm"), "mm"),
    "precision": Axis(_one_of("half"), _set("quality", "precision")),
    "sampling": Axis(_one_of("contrast"), _set("quality", "sampling")),
    "supersampling": Axis(_one_of(2, 3), _set("quality", "supersampling")),
    "exposure_ev": Axis(_one_of(-30.0, 30.0), _set("view", "exposure_ev"), "EV",
                        (-30.0, 0.0, 30.0)),
}  # fmt: skip
# Axes of the subject.
SUBJECT: Mapping[str, Axis] = {
    "size_mm": Axis(_power(np.log10(HEAD_MM) - 6, np.log10(HEAD_MM) + 6), _same, "mm",
                    tuple(HEAD_MM * s for s in _powers(-6, 6, 2))),
    "shape": Axis(_one_of(*SHAPES), _same, "", tuple(SHAPES)),
    "maps": Axis(_one_of(*MAPS), _same, "", MAPS),
}  # fmt: skip


def _around(data: Data, times: float) -> Data:
    """Camera and lamps around a subject that is `times` as large, as far as settings allow."""
    data = merged(data, {"camera": {"height_mm": _within(data["camera"]["height_mm"] * times)}})
    lights = []
    for light in data["lights"]:
        moved = {}
        if "position_mm" in light:
            position = np.array(light["position_mm"]) * times
            # A little more than is allowed: turned with the world, it must not fall below that.
            far = _within(float(np.linalg.norm(position)), 1.001)
            position *= far / np.linalg.norm(position)
            moved["position_mm"] = position.tolist()
        for name in ("distance_mm", "radius_mm"):
            if light.get(name):
                moved[name] = _within(light[name] * times, 1.0, 1e5 if name == "radius_mm" else 1e7)
        lights.append({**light, **moved})
    return {**data, "lights": lights} if times != 1.0 else data


def _within(length_mm: float, low: float = 1e-3, high: float = 1e7) -> float:
    return min(max(length_mm, low), high)


def case_of(axes: Mapping[str, Any]) -> Case:
    """The case in which these axes, and no others, are moved."""
    data = PLAIN
    for name, value in axes.items():
        if name in AXES:
            data = AXES[name].apply(data, value)
    subject = {name: axes[name] for name in SUBJECT if name in axes}
    data = _around(data, axes.get("size_mm", HEAD_MM) / HEAD_MM)
    return Case(**subject, settings=data, axes=dict(axes))


# Of those axes that leave little to see, or take long.
CHANCES = {"lights": 0.02, "look_up_mm": 0.1, "size_px": 0.15, "frame_px": 0.0}


def random_case(seed: int) -> Case:
    """Case `seed`: each axis of the shot is moved with a chance of one in four, those of the
    subject with one in two."""
    rng = np.random.default_rng(seed)
    axes = {}
    for name, axis in AXES.items():
        chance = CHANCES.get(name, 0.25)
        if chance and rng.random() < chance:
            axes[name] = axis.draw(rng)
    for name, axis in SUBJECT.items():
        if rng.random() < 0.5:
            axes[name] = axis.draw(rng)
    return case_of(axes)
