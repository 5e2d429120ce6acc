"""What this scene requires, and why the rest does not run.

The first of the project's rules for a picture: a pass that would not change it is not run, and the
tool says why. These reasons need no measurement; measured ones join them here.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from scanrender.render.lamps import light_level
from scanrender.settings.light import EnvironmentLight, LampSettings
from scanrender.settings.pipeline import Pipeline

HALF_MAX = 65504.0
# Times what lamps near the surface and grazing pixels add to it: well below HALF_MAX.
BRIGHTEST_IN_HALF = 100.0
# Half floats have all their digits down to 6e-5: a shadow a tenth as bright as this keeps them.
DIMMEST_IN_HALF = 1e-3


@dataclass(frozen=True)
class Decision:
    """One pass that is not run, and the reason as a sentence."""

    what: str
    reason: str


def plan(
    pipeline: Pipeline, maps: Collection[str] | None = None
) -> tuple[Pipeline, list[Decision]]:
    """The pipeline without lights and effects that cannot change the picture.

    `maps` are those of the asset; None takes it to have all.
    """
    decisions: list[Decision] = []
    pipeline = _without_black_lights(pipeline, decisions)
    pipeline = _with_precision_that_holds(pipeline, decisions)
    pipeline = _with_transmission_that_can_be(pipeline, maps, decisions)
    pipeline = _with_diffusion_that_can_be(pipeline, decisions)
    return _with_curvature_that_can_be(pipeline, maps, decisions), decisions


def _without_black_lights(pipeline: Pipeline, decisions: list[Decision]) -> Pipeline:
    lights = []
    for index, light in enumerate(pipeline.lights):
        strength = light.intensity if isinstance(light, EnvironmentLight) else light.irradiance
        if strength == 0.0 or not any(light.colour):
            decisions.append(Decision(f"lights.{index}", "it is black"))
        else:
            lights.append(light)
    return pipeline.model_copy(update={"lights": tuple(lights)})


def _with_precision_that_holds(pipeline: Pipeline, decisions: list[Decision]) -> Pipeline:
    level = light_level(pipeline.lights)
    holds = DIMMEST_IN_HALF <= level <= BRIGHTEST_IN_HALF or not pipeline.lights
    if pipeline.quality.precision == "full" or holds:
        return pipeline
    reason = (
        f"light of {level:.3g} could pass what half floats hold ({HALF_MAX:g})"
        if level > 1.0
        else f"light of {level:.3g} is so dim that half floats lose its digits"
    )
    decisions.append(Decision("quality.precision: half", reason))
    full = pipeline.quality.model_copy(update={"precision": "full"})
    return pipeline.model_copy(update={"quality": full})


def _with_transmission_that_can_be(
    pipeline: Pipeline, maps: Collection[str] | None, decisions: list[Decision]
) -> Pipeline:
    skin = pipeline.skin
    lamps = [light for light in pipeline.lights if isinstance(light, LampSettings)]
    reason = ""
    if skin.transmission.method == "shadow_map" and not any(lamp.shadow for lamp in lamps):
        reason = "no light casts a shadow, so nothing tells how thick the skin is"
    elif skin.transmission.method == "baked" and not lamps:
        reason = "there is no lamp that could shine through"
    elif skin.transmission.method == "baked" and maps is not None and "thickness_mm" not in maps:
        reason = "the asset has no thickness map"
    if not reason:
        return pipeline
    decisions.append(Decision("transmission", reason))
    none = skin.transmission.model_copy(update={"method": "none"})
    return pipeline.model_copy(update={"skin": skin.model_copy(update={"transmission": none})})


def _with_diffusion_that_can_be(pipeline: Pipeline, decisions: list[Decision]) -> Pipeline:
    diffusion = pipeline.diffusion
    reason = ""
    if diffusion.method == "none":
        return pipeline
    if not pipeline.lights:
        reason = "there is no light to diffuse"
    elif pipeline.skin.scale == 0.0:
        reason = "skin.scale is 0, so light leaves where it enters"
    if reason:
        decisions.append(Decision("diffusion", reason))
        return pipeline.model_copy(
            update={"diffusion": diffusion.model_copy(update={"method": "none"})}
        )
    updates: dict[str, object] = {}
    if diffusion.limit == "lab" and diffusion.limit_floor == 1.0:
        decisions.append(Decision("diffusion.limit", "its floor is 1, so nothing is limited"))
        updates["limit"] = "none"
    if diffusion.method == "disk":
        reason = "the disk measures distance and area on the surface itself"
        decisions.append(Decision("diffusion.halo", reason))
        updates["halo"] = "none"
    elif diffusion.halo == "cbf" and diffusion.edge_contrast == 0.0:
        decisions.append(Decision("diffusion.halo", "edge_contrast is 0, so no tap is held back"))
        updates["halo"] = "none"
    elif diffusion.halo == "cbf_normalized" and diffusion.edge_contrast == 0.0:
        reason = "edge_contrast is 0: what is left of cbf_normalized is its depth correction"
        decisions.append(Decision("diffusion.halo", reason))
        updates["halo"] = "depth"
    return pipeline.model_copy(update={"diffusion": diffusion.model_copy(update=updates)})


# A kernel that reaches this many bounding radii has a tap or none on each part of the subject.
REACH_IN_RADII = {"disk": 1.0, "separable_preintegrated": 2.0, "separable_artistic": 2.0}


def with_taps_that_meet(
    pipeline: Pipeline, reach_mm: float, radius_mm: float, decisions: list[Decision]
) -> Pipeline:
    """The pipeline with a sum of Gaussians for what blurs once, where that outgrows the subject.

    Each tap of a kernel that blurs once meets a single pixel or nothing, and which is chance: a
    mirrored picture of 64 taps on a disk differs by up to dE2000 9. Each Gaussian of the sum blurs
    what the one before has blurred.
    `reach_mm` is the radius of 99.9 % of the light.
    """
    diffusion = pipeline.diffusion
    most = REACH_IN_RADII.get(diffusion.method)
    plain_sum = diffusion.method == "disk" and diffusion.normalize == "none"
    if most is None or plain_sum or reach_mm <= most * radius_mm:
        return pipeline
    reason = (
        f"the profile reaches {reach_mm:.3g} mm on a subject of {radius_mm:.3g} mm radius, "
        "where single taps would show: its Gaussians blur one after the other instead"
    )
    decisions.append(Decision(f"diffusion.method: {diffusion.method}", reason))
    halo = "measure" if diffusion.method == "disk" else diffusion.halo
    changed = diffusion.model_copy(update={"method": "gaussian_sum", "halo": halo})
    return pipeline.model_copy(update={"diffusion": changed})


def _with_curvature_that_can_be(
    pipeline: Pipeline, maps: Collection[str] | None, decisions: list[Decision]
) -> Pipeline:
    curvature = pipeline.curvature
    updates: dict[str, object] = {}
    transmits = curvature.forward_scattering and pipeline.skin.transmission.method != "none"
    if curvature.modulation != "none" and pipeline.diffusion.method == "none" and not transmits:
        decisions.append(Decision("curvature.modulation", "nothing diffuses"))
        updates["modulation"] = "none"
    elif curvature.modulation == "reduce_to_minimum" and curvature.minimum == 1.0:
        decisions.append(Decision("curvature.modulation", "its minimum is 1, the full width"))
        updates["modulation"] = "none"
    if curvature.source == "baked" and maps is not None and "curvature" not in maps:
        reason = "the asset has no curvature map, so the screen's is used"
        decisions.append(Decision("curvature.source: baked", reason))
        updates["source"] = "screen"
    return pipeline.model_copy(update={"curvature": curvature.model_copy(update=updates)})


def maps_read(pipeline: Pipeline) -> dict[str, str]:
    """The maps that some pass of this shot reads, each with the pass that does."""
    planned, _ = plan(pipeline)
    read = {"albedo": "gbuffer", "normal_ts": "gbuffer", "skin": "gbuffer"}
    if any(not isinstance(light, LampSettings) for light in planned.lights):
        read["ao"] = "irradiance, specular"
    # Where the screen's curvature is used, the map still tells how smooth it has to be.
    if planned.curvature.modulation != "none":
        read["curvature"] = "curvature"
    if planned.skin.transmission.method == "baked":
        read["thickness_mm"] = "transmission"
    dumped = {"ao", "thickness_mm", "curvature"} & set(pipeline.outputs.buffers)
    return read | dict.fromkeys(sorted(dumped - read.keys()), "a buffer that is asked for")
