"""`prep:` how a raw scan becomes an asset."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from scanrender.settings.base import Section, setting

MapName = Literal[
    "albedo", "normal_ts", "normal_geometry", "curvature", "ao", "thickness_mm", "skin"
]


class CleanSettings(Section):
    """Removal of what a scanner adds and a person does not have."""

    floater_fraction: float = setting(
        0.01,
        "Loose pieces with a smaller share of the largest piece's area are removed.",
        unit="1",
        ge=0,
        le=1,
    )
    floater_distance_mm: float = setting(
        10.0,
        "A loose piece nearer than this to the subject is kept down to a tenth of that share; one "
        "ten times as far must have three times that share.",
        unit="mm",
        ge=0,
        le=1000,
    )
    hole_mm: float = setting(
        12.0,
        "Holes whose boundary fits in a circle of this diameter are filled; larger ones stay.",
        unit="mm",
        ge=0,
        le=200,
    )
    spike_sigma: float = setting(
        5.0,
        "A vertex further from its neighbours' mean than this many local deviations is a spike.",
        unit="1",
        ge=2,
        le=100,
    )
    close_neck: bool = setting(
        False, "Close the opening at which a bust is cut off with a flat cap.", unit=""
    )


class SimplifySettings(Section):
    """Fewer triangles, within a budget and an error bound: whichever stops first."""

    triangles: int = setting(
        50_000,
        "Budget: at most this many triangles; fewer where those keep the error bound already.",
        unit="triangles",
        ge=100,
        le=20_000_000,
    )
    error_mm: float = setting(
        0.02,
        "Error bound: as few triangles as keep 99 % of the raw and of the prepared surface within "
        "this distance from each other, but never more than the budget.",
        unit="mm",
        ge=0.001,
        le=100,
    )
    lods: tuple[Annotated[int, Field(ge=500)], ...] = setting(
        (),
        "Levels of detail: coarser meshes of so many triangles, as lod1.glb and so on; same maps.",
        unit="triangles",
    )


class UnwrapSettings(Section):
    """Texture coordinates for the simplified mesh."""

    padding_px: int = setting(
        4,
        "Gap between charts, measured in texels of the albedo map; less where that leaves "
        "the charts no room.",
        unit="px",
        ge=1,
        le=64,
    )
    timeout_s: float = setting(
        120.0,
        "The unwrapper cannot be interrupted: past this it is killed and a fallback is used.",
        unit="s",
        ge=1,
        le=3600,
    )


class BakeSettings(Section):
    """Maps made from the raw scan, each at its own size."""

    albedo_px: int = setting(2048, "Side of the albedo map.", unit="px", ge=16, le=8192)
    normal_px: int = setting(2048, "Side of the normal map.", unit="px", ge=16, le=8192)
    data_px: int = setting(
        1024,
        "Side of the curvature, ambient occlusion, thickness and skin maps.",
        unit="px",
        ge=16,
        le=8192,
    )
    maps: tuple[MapName, ...] = setting(
        ("albedo", "normal_ts", "normal_geometry", "curvature", "ao", "thickness_mm", "skin"),
        "Which maps are baked; the renderer does without those that are not there.",
        unit="",
    )
    need: Literal["all", "shot"] = setting(
        "all",
        "`shot` bakes only those of `maps` that a pass of this pipeline's shots reads, no finer "
        "than their cameras show; another look may then need another preparation.",
        unit="",
    )
    texel_mm: float | None = setting(
        None,
        "A map's side is halved while its texels stay smaller than this on the surface.",
        unit="mm",
        ge=1e-4,
        le=1e3,
    )
    supersample: int = setting(
        0,
        "Albedo samples along each side of a texel; 0 decides by the fineness of the raw texture.",
        unit="samples",
        ge=0,
        le=8,
    )
    footprint_mm: float = setting(
        0.3,
        "Raw normals are averaged over this radius, so that scanner noise does not sparkle.",
        unit="mm",
        ge=0,
        le=10,
    )
    curvature_smooth_mm: float = setting(
        1.0,
        "Least radius over which the curvature is smoothed on the surface.",
        unit="mm",
        ge=0,
        le=50,
    )
    ao_rays: int = setting(64, "Rays per vertex for ambient occlusion.", unit="rays", ge=4, le=4096)
    ao_distance_mm: float = setting(
        80.0, "Surfaces further than this do not occlude.", unit="mm", ge=0.1, le=10_000
    )
    thickness_rays: int = setting(16, "Rays per vertex for thickness.", unit="rays", ge=1, le=1024)
    default_albedo: tuple[float, float, float] = setting(
        (0.55, 0.34, 0.25),
        "Albedo of a scan that has no colour at all (linear Rec.709).",
        unit="1",
    )


class SkinMapSettings(Section):
    """What counts as skin: guessed from the scan's colours, or told."""

    mask: str | tuple[str, ...] | None = setting(
        None,
        "Image in the scan's own texture coordinates, white where there is skin; it replaces the "
        "guess. Relative to the scan's folder; a scan of several texture pages takes a list, one "
        "image a page in their order.",
        unit="",
    )


class PrepSettings(Section):
    """Preparation of one scan."""

    clean: CleanSettings = CleanSettings()
    simplify: SimplifySettings = SimplifySettings()
    unwrap: UnwrapSettings = UnwrapSettings()
    bake: BakeSettings = BakeSettings()
    skin: SkinMapSettings = SkinMapSettings()
    report: Literal["full", "short"] = setting(
        "full", "`short` leaves out what only measures: colour error, crossing faces.", unit=""
    )
    memory_mib: int | None = setting(
        None,
        "Memory that each process of a preparation may take; null: what the machine or its "
        "container has. A scan that needs more ends with an error instead of swapping.",
        unit="MiB",
        ge=256,
    )
    timeout_s: float = setting(
        900.0, "A preparation stage that takes longer is stopped.", unit="s", ge=1, le=86_400
    )
