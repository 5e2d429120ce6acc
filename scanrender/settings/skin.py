"""`skin:` the material: how it scatters below its surface and reflects at it."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from scanrender.settings.base import Rgb, Section, setting

# What the optics of the lobes is made and checked for.
Slope = Annotated[float, Field(ge=0.01, le=1)]


class GaussianTerm(Section):
    """One Gaussian of a diffusion profile."""

    variance_mm2: float = setting(
        ..., "Variance of the Gaussian on the skin's surface.", unit="mm²", ge=1e-6, le=1e6
    )
    weight: Rgb = setting(..., "Share of the energy that it carries, per channel.", unit="1")


class SpecularSettings(Section):
    """Kelemen/Szirmay-Kalos reflection with two Beckmann lobes; never blurred."""

    f0: float = setting(
        0.028, "Reflectance at normal incidence (0.028 is skin oil, n = 1.4).", unit="1", ge=0, le=1
    )
    roughness: tuple[Slope, Slope] = setting(
        (0.38, 0.22),
        "Root mean square slope m of each lobe: 0.1 wet, 0.3 skin, 0.6 matt.",
        unit="1",
    )
    second_lobe: float = setting(
        0.3, "Share of the second, usually sharper lobe.", unit="1", ge=0, le=1
    )
    strength: float = setting(
        1.0, "Scales the whole reflection; 1 is physical.", unit="1", ge=0, le=10
    )


class TransmissionSettings(Section):
    """Light that enters on the far side of thin skin (ears, nostrils) and leaves toward us."""

    method: Literal["none", "shadow_map"] = setting(
        "shadow_map", "Where the thickness comes from.", unit=""
    )
    wrap: float = setting(
        0.0,
        "Lets light enter past the terminator: 0 matches the physics, 0.3 the published figures.",
        unit="1",
        ge=0,
        le=1,
    )
    bias_mm: float = setting(
        0.6,
        "The receiver is moved this far below its surface; thinner skin is the lit face itself.",
        unit="mm",
        ge=0,
        le=20,
    )
    blur_mm: float = setting(
        1.5, "Radius over which T(d) is averaged in the light's view.", unit="mm", ge=0, le=20
    )


class SkinSettings(Section):
    """The skin material."""

    profile: tuple[GaussianTerm, ...] | Literal["skin"] = setting(
        "skin",
        "Diffusion profile: the measured three-layer `skin` of d'Eon and Luebke (2007), or a list "
        "of Gaussians whose weights sum to 1 per channel.",
        unit="",
    )
    scale: float = setting(1.0, "Multiplies every length of the profile.", unit="1", ge=0, le=1000)
    texturing: Literal["pre", "mixed", "post"] = setting(
        "mixed",
        "When albedo multiplies light: before diffusion (soft texture), half before and half "
        "after, or after (sharp texture).",
        unit="",
    )
    specular: SpecularSettings = SpecularSettings()
    transmission: TransmissionSettings = TransmissionSettings()

    @model_validator(mode="after")
    def _profile_sums_to_one(self) -> Self:
        if not isinstance(self.profile, str):
            sums = [sum(term.weight[c] for term in self.profile) for c in range(3)]
            if any(abs(total - 1.0) > 1e-3 for total in sums):
                shown = ", ".join(f"{total:.4g}" for total in sums)
                raise ValueError(f"profile weights must sum to 1 per channel, not {shown}")
            if len({term.variance_mm2 for term in self.profile}) < len(self.profile):
                raise ValueError("two Gaussians of the profile have the same variance: merge them")
        return self


class DiffusionSettings(Section):
    """The algorithm that scatters light below the surface, in screen space."""

    method: Literal["none", "gaussian_sum"] = setting(
        "gaussian_sum", "`none` leaves plain diffuse reflection, for comparison.", unit=""
    )
    samples: int = setting(
        17, "Taps per Gaussian and direction; any number.", unit="taps", ge=3, le=255
    )
    halo: Literal["none", "depth", "measure"] = setting(
        "measure",
        "What keeps light from crossing depth steps: nothing, Jimenez' correction, or the true "
        "measure of distance and area on the surface.",
        unit="",
    )
    mask: Literal["none", "skin"] = setting(
        "skin",
        "`skin` lets only what the asset's skin map calls skin scatter; eyes and brows stay sharp.",
        unit="",
    )


class CurvatureSettings(Section):
    """Curvature of the geometry normals, on screen."""

    smooth_mm: float = setting(
        2.0, "Radius of the smoothing along the surface.", unit="mm", ge=0, le=50
    )
