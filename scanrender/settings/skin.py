"""`skin:` the material: how it scatters below its surface and reflects at it."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from scanrender.settings.base import Rgb, Section, setting

# Roundings of a guide of about 1 show beyond it: dE2000 0.05 between mirrored pictures, and in
# proportion. `cbf`, whose guide grows with the distance, is a thousandth of that and less up close.
MOST_CONTRAST = 1e4
# What the optics of the lobes is made and checked for.
Slope = Annotated[float, Field(ge=0.01, le=1)]
Length = Annotated[float, Field(ge=1e-4, le=1e3)]
Lengths = tuple[Length, Length, Length]
Share = Annotated[float, Field(ge=0, le=1)]
Shares = tuple[Share, Share, Share]


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

    method: Literal["none", "shadow_map", "baked"] = setting(
        "shadow_map",
        "Where the thickness comes from: the way of each light, or the asset's thickness map "
        "(along the normal: rims, where light takes a shorter way, then glow less).",
        unit="",
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
        "The receiver is moved this far below its surface, or two texels of the shadow map where "
        "these are larger and the light grazes; thinner skin is the lit face itself.",
        unit="mm",
        ge=0,
        le=20,
    )
    blur_mm: float = setting(
        1.5,
        "Radius over which T(d) is averaged in the light's view; at most twice the standard "
        "deviation of the profile's widest Gaussian.",
        unit="mm",
        ge=0,
        le=20,
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


class ArtisticKernel(Section):
    """Two Gaussians a channel for `separable_artistic`: near * strength + far * (1 - strength).

    The defaults are the best two to the edge response of the measured skin.
    """

    near_mm: Lengths = setting(
        (0.136, 0.093, 0.081), "Standard deviation of the near Gaussian, per channel.", unit="mm"
    )
    far_mm: Lengths = setting(
        (1.28, 0.355, 0.233), "Standard deviation of the far Gaussian, per channel.", unit="mm"
    )
    strength: Shares = setting(
        (0.40, 0.58, 0.67), "Share of the near Gaussian, per channel.", unit="1"
    )


class DiffusionSettings(Section):
    """The algorithm that scatters light below the surface, in screen space."""

    method: Literal[
        "none", "gaussian_sum", "separable_preintegrated", "separable_artistic", "disk"
    ] = setting(
        "gaussian_sum",
        "`gaussian_sum` blurs once for each Gaussian of the profile; the separable ones blur "
        "once: with the profile's own line integral, or with two Gaussians. `disk` sums up the "
        "surface around each point, by distances and areas on it: `halo` does not apply. `none` "
        "leaves plain diffuse reflection, for comparison.",
        unit="",
    )
    samples: int = setting(
        17,
        "Taps a direction, per Gaussian or for the separable kernel; any number. Gaussians wider "
        "than a tenth of the subject have 15 at least.",
        unit="taps",
        ge=3,
        le=255,
    )
    gaussians: int = setting(
        255,
        "Gaussians of the profile that `gaussian_sum` blurs by, at most: the narrowest are merged, "
        "which does not show below a pixel.",
        unit="1",
        ge=1,
        le=255,
    )
    disk_taps: int = setting(
        64, "Taps of `disk`, for each sample that scatters.", unit="taps", ge=4, le=1023
    )
    normalize: Literal["visible", "none"] = setting(
        "visible",
        "For `disk`: the mean over what the picture shows of the surface, or the plain sum, which "
        "is darker where part of the surround is hidden.",
        unit="",
    )
    resolution: Literal["full", "half"] = setting(
        "full",
        "`half` scatters light in a picture of half the width and height, from which each pixel "
        "takes it by its own surface: a third of the taps' time, and softer texture.",
        unit="",
    )
    artistic: ArtisticKernel = ArtisticKernel()
    jitter: bool = setting(
        False,
        "Moves the taps inside their cells from pixel to pixel: fine noise, which supersampling "
        "averages, instead of ghost copies where taps are few. The same in each frame.",
        unit="",
    )
    halo: Literal["none", "depth", "cbf", "cbf_normalized", "measure"] = setting(
        "measure",
        "What keeps light from crossing depth steps: nothing; Jimenez' depth correction; the "
        "cross bilateral filter on an edge guide that grows with distance; that guide normalized, "
        "with the depth correction; or the true measure of distance and area on the surface.",
        unit="",
    )
    edge_contrast: float = setting(
        3.0,
        "c of the cross bilateral filters: a tap counts exp(-c |E_p - E_q|), with E albedo times "
        "a ratio of cosines. A huge one stops leaks by stopping scattering; `cbf_normalized` takes "
        "at most 1e4, beyond which it tells roundings apart.",
        unit="1",
        ge=0,
        le=1e6,
    )
    limit: Literal["none", "lab"] = setting(
        "none",
        "`lab` lets light scatter only between skin of like colour (CIE Lab of the albedo).",
        unit="",
    )
    limit_delta_e: float = setting(
        5.0, "Colour difference at which a tap counts 0.6.", unit="ΔE", ge=0.1, le=1000
    )
    limit_smooth_mm: float = setting(
        1.0,
        "Radius over which the guide is smoothed on the surface, edges kept: the noise of a scan's "
        "texture must not stop scattering.",
        unit="mm",
        ge=0,
        le=20,
    )
    limit_floor: float = setting(
        0.01, "What a tap of any other colour still counts.", unit="1", ge=0, le=1
    )
    mask: Literal["none", "skin"] = setting(
        "skin",
        "`skin` lets only what the asset's skin map calls skin scatter; eyes and brows stay sharp.",
        unit="",
    )

    @model_validator(mode="after")
    def _contrast_tells_no_roundings_apart(self) -> Self:
        if self.halo == "cbf_normalized" and self.edge_contrast > MOST_CONTRAST:
            raise ValueError(
                f"edge_contrast is at most {MOST_CONTRAST:g} with halo: cbf_normalized, "
                "beyond which it tells roundings apart"
            )
        return self


class CurvatureSettings(Section):
    """Curvature of the geometry normals, and what it may do to the diffusion.

    With `halo: measure` the effect of curvature comes out of the surface itself: leave it `none`.
    """

    smooth_mm: float = setting(
        2.0, "Radius of the smoothing along the surface.", unit="mm", ge=0, le=50
    )
    source: Literal["screen", "baked"] = setting(
        "screen",
        "From the picture's normals, or from the asset's curvature map, which silhouettes do not "
        "disturb.",
        unit="",
    )
    modulation: Literal["none", "increase", "reduce", "reduce_to_minimum"] = setting(
        "none",
        "What convex curvature does to the kernel's width: from full on flat skin to double "
        "(`increase`), from nothing to full (`reduce`), from `minimum` to full "
        "(`reduce_to_minimum`).",
        unit="",
    )
    minimum: float = setting(
        0.3, "Width on flat skin for `reduce_to_minimum`.", unit="1", ge=0, le=1
    )
    full_at_mm: float = setting(
        10.0, "Radius of curvature at which the modulation is complete.", unit="mm", ge=0.1, le=1000
    )
    forward_scattering: bool = setting(
        False,
        "Scales the light through thin skin by the same factor: a mistake that the paper's figure "
        "9 shows (bright nostrils). For comparison only.",
        unit="",
    )
