"""Uniforms that passes over lights share (`light`, `shadow_lookup`, `environment.glsl`)."""

from __future__ import annotations

import math
from typing import Any

import moderngl
import numpy as np

from scanrender.render.environment import Environment
from scanrender.render.lamps import Lamp
from scanrender.render.scene import Shot

# What one draw adds, in `irradiance.frag` and `specular.frag`.
AMBIENT, LAMP, ENVIRONMENT = "KIND 0", "KIND 1", "KIND 2"
# Taps that soften a shadow's edge, a pixel and supersample.
DISK_TAPS = 16


def light_uniforms(lamp: Lamp, shot: Shot) -> dict[str, Any]:
    """`light.glsl`: the lamp in view space."""
    view_from_rig = shot.view_from_world @ np.linalg.inv(shot.rig_from_world(lamp.settings.follows))
    position = view_from_rig @ np.append(lamp.position_mm, 1.0)
    return {
        "light_to_light": view_from_rig[:3, :3] @ lamp.to_light,
        "light_position": position[:3],
        "light_is_near": lamp.is_near,
        "light_distance_mm": lamp.distance_mm,
        "light_radius_mm": lamp.size if lamp.is_near else 0.0,
        "light_cone": lamp.cone,
        "light_irradiance": lamp.irradiance,
    }


def shadow_uniforms(lamp: Lamp, shot: Shot, shadow_map: moderngl.Texture) -> dict[str, Any]:
    """`light.glsl` and `shadow_lookup.glsl`, and the size of a texel at the subject's centre."""
    light_from_world = lamp.light_from_rig @ shot.rig_from_world(lamp.settings.follows)
    return {
        **light_uniforms(lamp, shot),
        "shadow_map": shadow_map,
        "light_from_view": light_from_world @ np.linalg.inv(shot.view_from_world),
        "clip_from_light": lamp.clip_from_light,
        "light_front_mm": lamp.distance_mm - lamp.near_mm,
        "texel_mm": lamp.width_mm / shadow_map.size[0],
        "turn": turn_rad(shot.sample),
        # A picture of half the size is alone and diffused: there is no other sample to average. At
        # full size such a pattern stands still while the subject turns, and flickers.
        "shares_taps": shot.is_halved,
    }


def turn_rad(sample: int) -> float:
    """Of one supersample's disk of taps, so that their average has many more taps than one.

    Sqrt 3 of a turn, since no number of golden angles comes near a multiple of it: otherwise taps
    of several samples stand in rows, or leave half of each ring to one side.
    """
    return math.tau * math.fmod(sample * math.sqrt(3.0), 1.0)


def environment_uniforms(environment: Environment, shot: Shot) -> dict[str, Any]:
    """`environment.glsl`: how the picture stands in view space."""
    rig_from_world = shot.rig_from_world(environment.settings.follows)
    picture_from_world = environment.picture_from_rig @ rig_from_world
    picture_from_view = picture_from_world @ np.linalg.inv(shot.view_from_world)
    return {"picture_from_view": np.asarray(picture_from_view[:3, :3])}
