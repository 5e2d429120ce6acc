"""One pass, one Python file and one GLSL file of the same name.

Each module has `passes(scene) -> list[Pass]`: what this scene could run. Order is the graph's
business; this list is alphabetical.
"""

from __future__ import annotations

from scanrender.render.graph import Pass
from scanrender.render.passes import (
    baked,
    compose,
    curvature,
    curvature_raw,
    diffuse,
    diffusion_input,
    disk,
    edge_guide,
    energy_ratio,
    gaussian_sum,
    gbuffer,
    irradiance,
    jacobian,
    kernel_px,
    lab,
    nan_map,
    scattered,
    separable,
    shadow,
    specular,
    tonemap,
    transmission,
    visibility,
)
from scanrender.render.scene import Scene

MODULES = (
    baked,
    compose,
    curvature,
    curvature_raw,
    diffuse,
    diffusion_input,
    disk,
    edge_guide,
    energy_ratio,
    gaussian_sum,
    gbuffer,
    irradiance,
    jacobian,
    kernel_px,
    lab,
    nan_map,
    scattered,
    separable,
    shadow,
    specular,
    tonemap,
    transmission,
    visibility,
)


def all_passes(scene: Scene) -> list[Pass]:
    """Every pass that could contribute to a picture of `scene`."""
    return [step for module in MODULES for step in module.passes(scene)]
