"""Uniforms that every pass over a lamp shares (`light.glsl`, `shadow_lookup.glsl`)."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np

from scanrender.optics.kernels import GOLDEN_ANGLE_RAD
from scanrender.render.lamps import Lamp
from scanrender.render.scene import Shot

# Taps that soften a shadow's edge or average a transmittance, a pixel and supersample.
DISK_TAPS = 12


def light_uniforms(lamp: Lamp, shot: Shot) -> dict[str, Any]:
    """`light.glsl`: the lamp in view space."""
    turn = shot.view_from_world[:3, :3]
    position = shot.view_from_world @ np.append(lamp.position_mm, 1.0)
    return {
        "light_to_light": turn @ lamp.to_light,
        "light_position": position[:3],
        "light_is_spot": lamp.is_spot,
        "light_distance_mm": float(getattr(lamp.settings, "distance_mm", 1.0)),
        "light_cone": lamp.cone_cosines,
        "light_irradiance": lamp.irradiance,
    }


def shadow_uniforms(lamp: Lamp, shot: Shot, shadow_map: moderngl.Texture) -> dict[str, Any]:
    """`shadow_lookup.glsl`, and the size of a texel at the subject's centre."""
    return {
        "shadow_map": shadow_map,
        "light_from_view": lamp.light_from_world @ np.linalg.inv(shot.view_from_world),
        "clip_from_light": lamp.clip_from_light,
        "light_near_mm": lamp.near_mm,
        "texel_mm": lamp.width_mm / shadow_map.size[0],
        # Each supersample turns the disk, so that their average has many more taps than one.
        "turn": float(shot.sample * GOLDEN_ANGLE_RAD / DISK_TAPS),
    }
