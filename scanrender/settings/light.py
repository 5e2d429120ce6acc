"""`lights:` a list of lights. Angles are seen from the subject.

Azimuth 0 comes from the front (the camera's start), positive toward the subject's own left (+X);
elevation is up from the horizon. Irradiance is stated in units of pi: a light of 1 gives a perfect
white diffuser that faces it the radiance 1.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from scanrender.settings.base import Rgb, Section, setting


class _Lamp(Section):
    azimuth_deg: float = setting(
        30.0, "Direction it comes from, around the subject.", unit="deg", ge=-360, le=360
    )
    elevation_deg: float = setting(
        35.0, "Direction it comes from, above the horizon.", unit="deg", ge=-90, le=90
    )
    irradiance: float = setting(
        1.0, "Irradiance at the subject's centre, in units of pi.", unit="π", ge=0, le=1e9
    )
    colour: Rgb = setting((1.0, 1.0, 1.0), "Multiplies the irradiance (linear Rec.709).", unit="1")
    shadow: bool = setting(True, "Whether it casts shadows.", unit="")
    shadow_px: int = setting(1024, "Side of its shadow map.", unit="px", ge=16, le=8192)
    shadow_blur_mm: float = setting(
        1.5, "Radius of the shadow's soft edge.", unit="mm", ge=0, le=100
    )


class DirectionalLight(_Lamp):
    """Parallel light from far away."""

    type: Literal["directional"] = "directional"


class SpotLight(_Lamp):
    """A lamp at a distance, aimed at the subject's centre."""

    type: Literal["spot"] = "spot"
    distance_mm: float = setting(
        1200.0, "From the subject's centre to the lamp.", unit="mm", ge=1, le=1e7
    )
    cone_deg: float = setting(50.0, "Full angle of the cone.", unit="deg", ge=1, le=170)
    edge: float = setting(
        0.3, "Share of the cone over which it fades at its rim.", unit="1", ge=0, le=1
    )


class AmbientLight(Section):
    """The same light from everywhere, dimmed by ambient occlusion."""

    type: Literal["ambient"] = "ambient"
    irradiance: float = setting(0.1, "In units of pi.", unit="π", ge=0, le=1e9)
    colour: Rgb = setting((1.0, 1.0, 1.0), "Multiplies the irradiance (linear Rec.709).", unit="1")


Light = Annotated[DirectionalLight | SpotLight | AmbientLight, Field(discriminator="type")]
