"""`lights:` a list of lights. Angles are seen from the subject.

Azimuth 0 comes from the front (the camera's start), positive toward the subject's own left (+X);
elevation is up from the horizon. Irradiance is stated in units of pi: a light of 1 gives a perfect
white diffuser that faces it the radiance 1.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from scanrender.settings.base import Rgb, Section, setting

Follows = Literal["world", "subject", "camera"]
FOLLOWS = (
    "What it is fixed to while the turntable turns: the world, the subject, or the camera (whose "
    "axis is then azimuth 0, elevation 0)."
)


class _Lamp(Section):
    azimuth_deg: float = setting(
        30.0, "Direction it comes from, around the subject.", unit="deg", ge=-360, le=360
    )
    elevation_deg: float = setting(
        35.0, "Direction it comes from, above the horizon.", unit="deg", ge=-90, le=90
    )
    follows: Follows = setting("world", FOLLOWS, unit="")
    irradiance: float = setting(
        1.0, "Irradiance at the subject's centre, in units of pi.", unit="π", ge=0, le=1e9
    )
    colour: Rgb = setting((1.0, 1.0, 1.0), "Multiplies the irradiance (linear Rec.709).", unit="1")
    shadow: bool = setting(True, "Whether it casts shadows.", unit="")
    shadow_px: int = setting(1024, "Side of its shadow map.", unit="px", ge=16, le=8192)
    shadow_blur_mm: float = setting(
        1.5,
        "Radius of the shadow's soft edge; with a size of the light, the least radius.",
        unit="mm",
        ge=0,
        le=100,
    )


class DirectionalLight(_Lamp):
    """Parallel light from far away."""

    type: Literal["directional"] = "directional"
    size_deg: float = setting(
        0.0,
        "Angular diameter (0.53 the sun, 10 to 30 a softbox): shadows are then sharp at contact "
        "and soften with the distance from what casts them. 0 keeps their edge fixed.",
        unit="deg",
        ge=0,
        le=90,
    )


Coordinate = Annotated[float, Field(ge=-1e7, le=1e7)]


class _NearLamp(_Lamp):
    distance_mm: float = setting(
        1200.0, "From the subject's centre to the lamp.", unit="mm", ge=1, le=1e7
    )
    position_mm: tuple[Coordinate, Coordinate, Coordinate] | None = setting(
        None,
        "Where it stands from the subject's centre (+X its left, +Y up, +Z front); replaces "
        "azimuth, elevation and distance.",
        unit="mm",
    )
    radius_mm: float = setting(
        0.0,
        "Radius of the lamp: shadows are then sharp at contact and soften with the distance from "
        "what casts them. 0 keeps their edge fixed.",
        unit="mm",
        ge=0,
        le=1e5,
    )

    @model_validator(mode="after")
    def _stands_somewhere(self) -> Self:
        if self.position_mm is not None:
            squared = sum(x * x for x in self.position_mm)
            if not 1.0 <= squared <= 1e14:
                raise ValueError(
                    "position_mm must be 1 to 1e7 mm from the subject's centre: nothing tells "
                    "which way a lamp in the centre shines"
                )
        return self


class PointLight(_NearLamp):
    """A bare lamp at a distance; shines in all directions, falls off with the inverse square."""

    type: Literal["point"] = "point"


class SpotLight(_NearLamp):
    """A lamp at a distance, aimed at the subject's centre; inverse square inside its cone."""

    type: Literal["spot"] = "spot"
    cone_deg: float = setting(50.0, "Full angle of the cone.", unit="deg", ge=1, le=170)
    edge: float = setting(
        0.3, "Share of the cone over which it fades at its rim.", unit="1", ge=0, le=1
    )


class AmbientLight(Section):
    """The same light from everywhere, dimmed by ambient occlusion."""

    type: Literal["ambient"] = "ambient"
    irradiance: float = setting(0.1, "In units of pi.", unit="π", ge=0, le=1e9)
    colour: Rgb = setting((1.0, 1.0, 1.0), "Multiplies the irradiance (linear Rec.709).", unit="1")


BUILT_IN_SKIES = ("studio", "sky", "dome")


class EnvironmentLight(Section):
    """Light from all around: a picture of the surroundings, or one of our own skies.

    Its diffuse light is dimmed by ambient occlusion, its reflection by an estimate from it. It
    casts no shadow and shines through no ear: put a lamp where its sun is.
    """

    type: Literal["environment"] = "environment"
    map: str = setting(
        "studio",
        "`studio`, `sky` or `dome`, which give a surface that faces the front the irradiance 1; or "
        "a latitude-longitude picture (.exr, .hdr; linear Rec.709) in this file's folder. Its "
        "middle comes from the front.",
        unit="",
    )
    rotation_deg: float = setting(
        0.0, "Turns the surroundings toward the subject's own left.", unit="deg", ge=-360, le=360
    )
    follows: Follows = setting("world", FOLLOWS, unit="")
    intensity: float = setting(1.0, "Multiplies the picture.", unit="1", ge=0, le=1e9)
    colour: Rgb = setting((1.0, 1.0, 1.0), "Multiplies it too (linear Rec.709).", unit="1")


LampSettings = DirectionalLight | PointLight | SpotLight
Light = Annotated[
    DirectionalLight | PointLight | SpotLight | AmbientLight | EnvironmentLight,
    Field(discriminator="type"),
]
