"""What a shot might do without: each as a change of its settings, the most saving first.

A trial says nothing about whether the picture bears it: `measured_plan.py` renders and compares.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from scanrender.settings.light import LampSettings
from scanrender.settings.pipeline import Pipeline

Change = Callable[[Pipeline], Pipeline | None]


@dataclass(frozen=True)
class Trial:
    """`options` are (label, change), the cheapest first: the first one that the picture bears is
    taken. A change is None where the setting is no dearer already. `per_pixel` is a trial whose
    effect is a matter of pixels, not of millimetres: it is judged at the picture's own scale.
    """

    what: str
    options: tuple[tuple[str, Change], ...]
    per_pixel: bool = False


def trials(pipeline: Pipeline) -> Iterator[Trial]:
    """Every trial of this shot, in the order in which they are made.

    Scattering first: what it does tells where the trials in pixels have to look.
    """
    yield Trial(
        "diffusion.method",
        (("none", _word("diffusion", "method", "none")), ("separable_preintegrated", _separable)),
    )
    yield Trial("quality.sampling", (("contrast", _sampling_by_contrast),), per_pixel=True)
    yield Trial(
        "quality.supersampling",
        tuple((str(side), _at_most("quality", "supersampling", side)) for side in (2, 3, 4)),
        per_pixel=True,
    )
    yield Trial("transmission", (("none", _without_transmission),))
    for index, light in enumerate(pipeline.lights):
        if isinstance(light, LampSettings):
            yield Trial(f"lights.{index}.shadow", (("false", _light(index, "shadow", False)),))
            yield Trial(
                f"lights.{index}.shadow_px",
                tuple((str(px), _smaller_map(index, px)) for px in (512, 1024, 2048)),
            )
    yield Trial("specular", (("none", _without_specular),))
    yield Trial("diffusion.limit", (("none", _word("diffusion", "limit", "none")),))
    yield Trial("diffusion.halo", (("none", _word("diffusion", "halo", "none")),))
    yield Trial("curvature", (("none", _word("curvature", "modulation", "none")),))
    yield Trial(
        "diffusion.gaussians",
        tuple((str(n), _fewer_gaussians(n)) for n in (2, 3, 4, 5)),
        per_pixel=True,
    )
    yield Trial(
        "diffusion.samples",
        tuple((str(n), _at_most("diffusion", "samples", n)) for n in (5, 7, 9, 13, 17)),
        per_pixel=True,
    )
    yield Trial(
        "diffusion.disk_taps",
        tuple((str(n), _at_most("diffusion", "disk_taps", n)) for n in (16, 32, 64)),
        per_pixel=True,
    )


def changed(pipeline: Pipeline, section: str, key: str, value: object) -> Pipeline:
    """The pipeline with one setting of one section replaced."""
    part = getattr(pipeline, section).model_copy(update={key: value})
    return pipeline.model_copy(update={section: part})


def _word(section: str, key: str, cheapest: str) -> Change:
    def change(pipeline: Pipeline) -> Pipeline | None:
        idle = section != "curvature" and pipeline.diffusion.method == "none"
        if idle or getattr(getattr(pipeline, section), key) == cheapest:
            return None
        if key == "halo" and pipeline.diffusion.method == "disk":
            return None
        return changed(pipeline, section, key, cheapest)

    return change


def _at_most(section: str, key: str, value: int) -> Change:
    owners = {"samples": ("gaussian_sum", "separable_preintegrated", "separable_artistic"),
              "disk_taps": ("disk",)}  # fmt: skip

    def change(pipeline: Pipeline) -> Pipeline | None:
        used = key not in owners or pipeline.diffusion.method in owners[key]
        if not used or getattr(getattr(pipeline, section), key) <= value:
            return None
        return changed(pipeline, section, key, value)

    return change


def _separable(pipeline: Pipeline) -> Pipeline | None:
    """The same profile in two passes instead of two a Gaussian, or 64 taps a pixel."""
    if pipeline.diffusion.method not in ("gaussian_sum", "disk"):
        return None
    return changed(pipeline, "diffusion", "method", "separable_preintegrated")


def _fewer_gaussians(count: int) -> Change:
    def change(pipeline: Pipeline) -> Pipeline | None:
        profile = pipeline.skin.profile
        terms = 6 if isinstance(profile, str) else len(profile)
        if pipeline.diffusion.method != "gaussian_sum":
            return None
        if min(terms, pipeline.diffusion.gaussians) <= count:
            return None
        return changed(pipeline, "diffusion", "gaussians", count)

    return change


def _sampling_by_contrast(pipeline: Pipeline) -> Pipeline | None:
    quality = pipeline.quality
    if quality.supersampling == 1 or quality.sampling == "contrast":
        return None
    return changed(pipeline, "quality", "sampling", "contrast")


def _without_transmission(pipeline: Pipeline) -> Pipeline | None:
    transmission = pipeline.skin.transmission
    if transmission.method == "none":
        return None
    none = transmission.model_copy(update={"method": "none"})
    return changed(pipeline, "skin", "transmission", none)


def _without_specular(pipeline: Pipeline) -> Pipeline | None:
    specular = pipeline.skin.specular
    if specular.strength == 0.0:
        return None
    none = specular.model_copy(update={"strength": 0.0})
    return changed(pipeline, "skin", "specular", none)


def _light(index: int, key: str, value: object) -> Change:
    def change(pipeline: Pipeline) -> Pipeline | None:
        light = pipeline.lights[index]
        if getattr(light, key) == value:
            return None
        lights = list(pipeline.lights)
        lights[index] = light.model_copy(update={key: value})
        return pipeline.model_copy(update={"lights": tuple(lights)})

    return change


def _smaller_map(index: int, side_px: int) -> Change:
    def change(pipeline: Pipeline) -> Pipeline | None:
        light = pipeline.lights[index]
        assert isinstance(light, LampSettings)
        # A map smaller than the picture costs a hundredth of a frame: not worth a trial.
        is_small = light.shadow_px**2 <= 4 * pipeline.camera.width_px * pipeline.camera.height_px
        if not light.shadow or light.shadow_px <= side_px or is_small:
            return None
        return _light(index, "shadow_px", side_px)(pipeline)

    return change
