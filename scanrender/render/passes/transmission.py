"""transmission: light that crosses thin skin from behind, its way from shadow maps or baked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import moderngl
import numpy as np

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.lamps import Lamp
from scanrender.render.passes._lamp import shadow_uniforms
from scanrender.render.passes._scatter import width_by_curvature
from scanrender.render.passes.visibility import MAX_PENUMBRA
from scanrender.render.scene import Scene, Shot

# Taps that average T(d), a pixel, lamp and supersample.
TAPS, MOST_TAPS = 8, 128
# An average over more than this share of the bounding radius, 2 mm of a head and shoulders, meets
# a shape that bends: it needs more of them.
TAPS_SHARE = 0.012
REACH_SIGMAS = 2.0  # of the profile's widest Gaussian
TABLE_SIZE = 1024
OPAQUE_BELOW = 1e-4
SURFACE = ("position", "normal_geometry", "albedo", "skin")


def passes(scene: Scene) -> list[Pass]:
    """Thickness and transmittance of the first lamp that casts a shadow; light of all of them."""
    lamps = scene.transmitting_lamps
    if not lamps:
        return []
    is_baked = scene.pipeline.skin.transmission.method == "baked"
    by_curvature = modulates_transmission(scene)
    table, opaque_mm = _transmittance_table(scene)

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        device = scene.device
        defines = {"BAKED": is_baked, "CURVATURE": by_curvature}
        program = device.program(
            "transmission", defines=tuple(name for name, used in defines.items() if used)
        )
        common = {**_material(scene), **{name.lstrip("_"): inputs[name] for name in surface}}
        common |= {"transmittance_table": table, "opaque_mm": opaque_mm}
        for number, lamp in enumerate(lamps):
            if number == 1:
                # Later lamps add their light but must leave the first one's thickness alone.
                device.context.enable(moderngl.BLEND)
                device.context.blend_func = moderngl.ONE, moderngl.ONE
                _write_to(target, True, False, False)
            bind(program, {**common, **_lamp_uniforms(scene, lamp, shot, inputs)})
            device.fill(program)
        if len(lamps) > 1:
            _write_to(target, True, True, True)

    surface: tuple[str, ...] = SURFACE
    surface += ("_baked",) if is_baked else ()
    surface += ("curvature",) if by_curvature else ()
    reads = (*surface, *(f"shadow_{lamp.index}" for lamp in lamps if lamp.settings.shadow))
    writes = (
        Buffer("transmission"),
        Buffer("thickness_mm", components=1, exact=True),
        Buffer("transmittance"),
    )
    return [Pass("transmission", reads, writes, draw, in_picture=True)]


def modulates_transmission(scene: Scene) -> bool:
    """Whether curvature scales T, as the paper's figure 9 does."""
    curvature = scene.pipeline.curvature
    return curvature.forward_scattering and curvature.modulation != "none"


def _write_to(target: moderngl.Framebuffer, *attachments: bool) -> None:
    """Which attachments take colour (moderngl's stub knows only the form for one). Those that
    nobody reads are not there."""
    count = len(target.color_attachments)
    if count > 1:
        masks = tuple((on,) * 4 for on in attachments[:count])
        target.color_mask = masks  # type: ignore[assignment]


def _transmittance_table(scene: Scene) -> tuple[moderngl.Texture, float]:
    """T(d) over sqrt(d / opaque_mm), and opaque_mm, past which less than 1e-4 comes through.

    The root gives the narrow Gaussians of blue as many texels as the wide ones of red; a test
    holds the table to the closed form.
    """
    depths_mm = np.geomspace(1e-4, 1e5, 4000)
    opaque = depths_mm[(scene.profile.transmittance(depths_mm) > OPAQUE_BELOW).any(axis=1)]
    opaque_mm = float(opaque.max(initial=depths_mm[0]))
    root = np.linspace(0.0, 1.0, TABLE_SIZE)
    table = scene.profile.transmittance(opaque_mm * root**2)
    return scene.device.table(table[None], linear=True), opaque_mm


def _lamp_uniforms(
    scene: Scene, lamp: Lamp, shot: Shot, inputs: Mapping[str, moderngl.Texture]
) -> dict[str, Any]:
    shadow_map = inputs[f"shadow_{lamp.index}"] if lamp.settings.shadow else scene.white
    return {
        **shadow_uniforms(lamp, shot, shadow_map),
        "has_shadow": lamp.settings.shadow,
        "far_mm": 2.0 * scene.radius_mm,
    }


def blur_mm(scene: Scene) -> float:
    """No further than light scatters: an average over more is of ways that it does not take, and
    most of its taps find no light at all, so that the few that do are noise."""
    asked = scene.pipeline.skin.transmission.blur_mm
    scattered = REACH_SIGMAS * math.sqrt(scene.profile.variances_mm2[-1])
    return min(asked, scattered, MAX_PENUMBRA * scene.radius_mm)


def tap_count(scene: Scene) -> int:
    """In proportion to the width of the average, within bounds."""
    share = blur_mm(scene) / (TAPS_SHARE * scene.radius_mm)
    return min(max(TAPS, math.ceil(TAPS * share)), MOST_TAPS)


def _material(scene: Scene) -> dict[str, Any]:
    transmission = scene.pipeline.skin.transmission
    return {
        "least_bias_mm": transmission.bias_mm,
        "blur_mm": blur_mm(scene),
        "wrap": transmission.wrap,
        "use_skin": scene.uses_skin_map,
        "tap_count": tap_count(scene),
        "width_by_curvature": width_by_curvature(scene),
    }
