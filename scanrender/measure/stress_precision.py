"""Sections of the stress page on precision: float32 against float64, and half floats by buffer."""

from __future__ import annotations

from collections.abc import Iterator

from scanrender.measure.extremes import LAMPS, Case, Data, case_of
from scanrender.measure.float_errors import FloatError, float_errors
from scanrender.measure.half_errors import half_errors
from scanrender.measure.stress_page import table
from scanrender.render.device import Device
from scanrender.render.frame import Renderer

SHARP: Data = {"quality": {"supersampling": 1}, "camera": {"width_px": 96, "height_px": 96}}
# Between them they run every pass that is evaluated in float64.
FLOAT_SCENES: tuple[Data, ...] = (
    {"maps": "noisy", "mask": "none", "smooth_mm": 20.0},
    {"maps": "noisy", "method": "separable_preintegrated"},
    {"maps": "noisy", "halo": "cbf"},
    {"maps": "noisy", "roughness": [0.01, 0.05], "irradiance": 1e8},
    {"maps": "noisy", "distance": 100.0, "fov_deg": 1.0},
    {"maps": "noisy", "method": "disk", "disk_taps": 64},
    {"maps": "noisy", "limit": "lab"},
    {"maps": "noisy", "limit": "lab", "limit_smooth_mm": 0.0},
    {"maps": "noisy", "wrap": 0.3, "scale": 4.0, "lamp": LAMPS[0]},
)
FLOATS = """## float32 against float64

Each pass evaluated in float64 NumPy from its input buffers on the device: relative error over
the pixels of a few scenes (values below a thousandth of the largest count as that). Filtered: a
table is read through the device's filter, which a GPU does with 8 bits of fraction. Compared: the
share of values that hang on no decision (a tap in one texel or the next, an occluder before the
surface or not) nearer to its border than float32 resolves. `lab` is relative to the longest of its
three, `transmittance`, which fades in where two depths cancel, to the largest of all pixels.
"""
HALVES = """## Half floats

One buffer at a time in 16 bits, all else in 32: dE2000 of the picture. `quality.precision: half`
keeps those marked half, because none of them shows. The others stay full whatever this scene says:
positions, depths and shadow maps are lengths (half a millimetre in a metre); `specular` and
`radiance` pass 65504 at grazing highlights, `edge_guide` with `halo: cbf` from 250 m, `jacobian`
far behind a subject. Light above 100 or below 0.001 keeps everything full, and says so.
"""


def precision_sections(device: Device) -> str:
    """Both sections, measured now."""
    return "\n".join([FLOATS, _floats(device), HALVES, _halves(device)])


def _floats(device: Device) -> str:
    worst: dict[str, FloatError] = {}
    for error in _float_errors(device):
        if error.largest >= worst.get(error.buffer, error).largest:
            worst[error.buffer] = error
    rows = [
        (
            f"`{e.buffer}`",
            f"{e.largest:.1e}",
            f"{e.p999:.1e}",
            "yes" if e.is_filtered else "",
            f"{e.known:.2%}",
        )
        for e in worst.values()
    ]  # fmt: skip
    return table(("Buffer", "Largest", "99.9 %", "Filtered", "Compared"), rows)


def _float_errors(device: Device) -> Iterator[FloatError]:
    for axes in FLOAT_SCENES:
        case = case_of(axes)
        yield from float_errors(Renderer(device, case.asset(), case.pipeline(SHARP)))


def _halves(device: Device) -> str:
    case: Case = case_of({"maps": "noisy", "halo": "measure"})
    rows = [
        (f"`{e.buffer}`", *(f"{value:.4f}" for value in e.delta_e), f"{e.saved}",
         "half" if e.is_half else "full")
        for e in half_errors(device, case.asset(), case.pipeline(SHARP))
    ]  # fmt: skip
    head = ("Buffer", "Mean dE2000", "95 %", "Largest", "Bytes a pixel saved", "Kept")
    return table(head, rows)
