"""`camera:`, `turntable:`, `quality:` and `view:`: how the subject is looked at."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import model_validator

from scanrender.settings.base import Rgb, Section, setting


class CameraSettings(Section):
    """Where the picture is taken from, and how much of the subject it shows."""

    width_px: int = setting(720, "Width of the picture.", unit="px", ge=1, le=16384)
    height_px: int = setting(720, "Height of the picture.", unit="px", ge=1, le=16384)
    focal_mm: float = setting(
        85.0,
        "Focal length on a 24 mm high sensor; 85 is portrait.",
        unit="mm",
        ge=2,
        le=2000,
    )
    projection: Literal["perspective", "orthographic"] = setting(
        "perspective",
        "`orthographic` keeps the scale at every depth, for measuring; no focal length then.",
        unit="",
    )
    height_mm: float | None = setting(
        None,
        "Millimetres at the point looked at that the picture is high: the same scale for every "
        "scan (252 is a close-up of a head). Without it, `fill` frames the whole subject.",
        unit="mm",
        ge=1e-3,
        le=1e7,
    )
    fill: float = setting(
        0.92,
        "Share of the picture's smaller side that the subject fills, whichever way it is turned.",
        unit="1",
        ge=0.01,
        le=50,
    )
    azimuth_deg: float = setting(
        0.0, "Where the camera stands, around the subject.", unit="deg", ge=-360, le=360
    )
    elevation_deg: float = setting(
        4.0, "Where the camera stands, above the horizon.", unit="deg", ge=-89, le=89
    )
    aim: Literal["subject", "head"] = setting(
        "subject",
        "The point looked at: the subject's centre, or half a head (113 mm) below its top.",
        unit="",
    )
    look_up_mm: float = setting(
        0.0, "Moves the point looked at up from there.", unit="mm", ge=-1e6, le=1e6
    )


class TurntableSettings(Section):
    """One full turn, or part of one."""

    frames: int = setting(96, "Number of pictures.", unit="frames", ge=1, le=100_000)
    fps: float = setting(24.0, "Pictures a second in the video.", unit="1/s", ge=1, le=240)
    mode: Literal["subject", "camera"] = setting(
        "subject",
        "What turns: the subject under fixed lights, or the camera around a fixed scene.",
        unit="",
    )
    start_deg: float = setting(0.0, "Angle of frame 0.", unit="deg", ge=-360, le=360)
    degrees: float = setting(360.0, "Angle turned in all.", unit="deg", ge=-3600, le=3600)


class QualitySettings(Section):
    """How much work a frame gets."""

    supersampling: int = setting(
        2, "Samples along each side of a pixel: 2 means 4 samples.", unit="1", ge=1, le=16
    )
    sampling: Literal["everywhere", "contrast"] = setting(
        "everywhere",
        "Where they are taken: in every pixel, or only where neighbouring pixels differ; light "
        "then scatters once a pixel, and elsewhere the pixel's centre speaks for it.",
        unit="",
    )
    precision: Literal["full", "half"] = setting(
        "full",
        "Floats of light, normals and guides between passes: `half` is 16 bits wide, which a GPU "
        "moves in half the time. Lengths and sums always are full.",
        unit="",
    )
    check: bool = setting(
        False,
        "Looks at what each pass has written, and stops at the first value that is not finite or "
        "that its buffer cannot hold: pass, buffer, place. The picture always is looked at.",
        unit="",
    )
    tolerance_delta_e: float | None = setting(
        None,
        "Before a turntable, what changes its picture by less than this is measured and left out: "
        "dE2000 of 95 % of the subject, and of any part of it. Without it everything runs.",
        unit="ΔE",
        ge=0.01,
        le=100,
    )
    max_delta_e: float | None = setting(
        None,
        "Picks the cheapest way to render (method, samples, supersampling) that is predicted to be "
        "as near to truth: mean dE2000 over the skin. Instead of `budget_ms` and `preset`.",
        unit="ΔE",
        ge=0.01,
        le=100,
    )
    budget_ms: float | None = setting(
        None,
        "Picks the way nearest to truth whose frames take no longer on this machine.",
        unit="ms",
        ge=0.1,
        le=1e7,
    )
    preset: Literal["draft", "standard", "reference"] | None = setting(
        None,
        "`reference` is the way nearest to truth; `standard` picks the cheapest that is within "
        "dE2000 0.2 of its error, `draft` 0.35.",
        unit="",
    )

    @model_validator(mode="after")
    def _one_need(self) -> Self:
        needs = [n for n in ("max_delta_e", "budget_ms", "preset") if getattr(self, n) is not None]
        if len(needs) > 1:
            raise ValueError(f"{' and '.join(needs)} are different wishes: state one of them")
        return self


class ViewSettings(Section):
    """From scene-linear to the screen. Never touches the EXR."""

    exposure_ev: float = setting(0.0, "Exposure in stops.", unit="EV", ge=-30, le=30)
    transform: Literal["filmic", "neutral"] = setting(
        "filmic",
        "OpenColorIO view: `filmic` is the ACES SDR rendering, `neutral` is plain sRGB.",
        unit="",
    )
    background: Rgb = setting(
        (0.035, 0.037, 0.042), "Scene-linear colour behind the subject.", unit="1"
    )
    inside_albedo: Rgb = setting(
        (0.03, 0.03, 0.032),
        "Albedo of the inside of an open scan, where its back or a hole shows it (linear Rec.709).",
        unit="1",
    )
