"""Lights resolved into their rig's space, and the camera that each one's shadow map looks through.

A rig is what a light is fixed to (`follows`): its axes are the world's, the turned subject's or the
camera's, its origin the subject's centre. `Shot.rig_from_world` says where it stands in a frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from scanrender.render.camera import Matrix, depth_rows, linear_depth, rotation_x, rotation_y
from scanrender.settings.light import (
    AmbientLight,
    DirectionalLight,
    EnvironmentLight,
    LampSettings,
    Light,
    SpotLight,
)

Vector = npt.NDArray[np.float64]
# A lamp inside the subject's bounding sphere has the subject all around; its map sees this much.
WIDEST_MAP_DEG = 150.0


@dataclass(frozen=True)
class Lamp:
    """A directional, point or spot light around the origin of its rig, in millimetres.

    `irradiance` is RGB at the subject's centre in units of pi. The light's own space has the
    subject's centre at its origin and the lamp `distance_mm` up its +Z: a lamp 10 km away then
    costs float32 no digits; `clip_from_lamp` is from axes at the lamp itself. `sees_all` is false
    when the shadow map cannot hold all that the light reaches.
    """

    index: int
    settings: LampSettings
    irradiance: Vector
    light_from_rig: Matrix
    clip_from_light: Matrix
    clip_from_lamp: Matrix
    near_mm: float
    far_mm: float
    distance_mm: float
    sees_all: bool

    @property
    def is_near(self) -> bool:
        """A lamp that stands somewhere; parallel light does not."""
        return not isinstance(self.settings, DirectionalLight)

    @property
    def linear_depth(self) -> dict[str, tuple[float, float]]:
        """`depth_range_mm` where the shadow map's depth buffer is linear."""
        return linear_depth(self.clip_from_lamp, self.far_mm)

    @property
    def position_mm(self) -> Vector:
        """Where the lamp stands; for parallel light a point on its near side, for its axis."""
        return self.distance_mm * self.to_light

    @property
    def to_light(self) -> Vector:
        """Unit vector from the subject's centre to the light."""
        return np.asarray(self.light_from_rig[2, :3])

    @property
    def width_mm(self) -> float:
        """Width of the shadow map's view at the subject's centre."""
        at = self.distance_mm if self.is_near else 1.0
        return 2.0 * at / float(self.clip_from_light[0, 0])

    @property
    def cone(self) -> tuple[float, float]:
        """1 - cosine at which a spot begins to fade, and at its dark rim; beyond 2 for no cone."""
        if not isinstance(self.settings, SpotLight):
            return 2.5, 3.0
        half = np.deg2rad(self.settings.cone_deg) / 2
        inner = half * (1.0 - self.settings.edge)
        full = min(inner, half - 1e-4)
        return 2.0 * float(np.sin(full / 2)) ** 2, 2.0 * float(np.sin(half / 2)) ** 2

    @property
    def size(self) -> float:
        """What a penumbra grows with: tangent of the half angle, or the lamp's radius in mm."""
        if isinstance(self.settings, DirectionalLight):
            return float(np.tan(np.deg2rad(self.settings.size_deg) / 2))
        return float(self.settings.radius_mm)


def light_level(lights: Sequence[Light]) -> float:
    """What all lights give together, the brightest channel of each: how bright a white face can be.

    In units of pi, as their irradiance is stated; a picture's own values count as 1.
    """
    return float(sum(
        (light.intensity if isinstance(light, EnvironmentLight) else light.irradiance)
        * max(light.colour)
        for light in lights
    ))  # fmt: skip


def resolve_lights(lights: Sequence[Light], radius_mm: float) -> tuple[list[Lamp], Vector]:
    """Lamps around a subject inside `radius_mm` of the origin, and the ambient RGB sum.

    Environments are no lamps: `render/environment.py` has them.
    """
    lamps: list[Lamp] = []
    ambient = np.zeros(3)
    for light in lights:
        if isinstance(light, AmbientLight):
            ambient += light.irradiance * np.asarray(light.colour)
        elif isinstance(light, LampSettings):
            lamps.append(_lamp(light, len(lamps), radius_mm))
    return lamps, ambient


def _lamp(light: LampSettings, index: int, radius_mm: float) -> Lamp:
    azimuth, elevation = light.azimuth_deg, light.elevation_deg
    sees_all = True
    if isinstance(light, DirectionalLight):
        distance, near, far = 2.0 * radius_mm, 0.99 * radius_mm, 3.01 * radius_mm
        clip = _parallel(1.01 * radius_mm, near, far)
    else:
        distance = light.distance_mm
        if light.position_mm is not None:
            x, y, z = light.position_mm
            distance = float(np.linalg.norm(light.position_mm))
            azimuth = float(np.rad2deg(np.arctan2(x, z)))
            elevation = float(np.rad2deg(np.arctan2(y, np.hypot(x, z))))
        near, far = max(distance - radius_mm, 0.01 * distance), distance + radius_mm
        tan, sees_all = _map_tangent(light, distance, radius_mm)
        clip = _perspective(tan, near, far)
    back = np.eye(4)
    back[2, 3] = -distance
    frame = rotation_x(elevation) @ rotation_y(-azimuth)
    colour = light.irradiance * np.asarray(light.colour, dtype=np.float64)
    return Lamp(index, light, colour, frame, clip @ back, clip, near, far, distance, sees_all)


def _map_tangent(light: LampSettings, distance: float, radius_mm: float) -> tuple[float, bool]:
    """Half width of the shadow map's view at 1 mm, and whether it holds all that is lit.

    The map need not see more than the subject's bounding sphere, nor more than a spot's cone.
    """
    whole = np.inf
    if distance > 1.01 * radius_mm:
        whole = radius_mm / np.sqrt(distance**2 - radius_mm**2)
    if isinstance(light, SpotLight):
        return float(min(whole, np.tan(np.deg2rad(light.cone_deg) / 2))), True
    widest = np.tan(np.deg2rad(WIDEST_MAP_DEG) / 2)
    return float(min(whole, widest)), bool(whole <= widest)


def _parallel(half_width_mm: float, near: float, far: float) -> Matrix:
    clip = np.eye(4)
    clip[0, 0] = clip[1, 1] = 1.0 / half_width_mm
    clip[2, 2] = -2.0 / (far - near)
    clip[2, 3] = -(far + near) / (far - near)
    return clip


def _perspective(tan: float, near: float, far: float) -> Matrix:
    clip = np.diag([1.0 / tan, 1.0 / tan, 0.0, 0.0])
    clip[2, 2:] = depth_rows(near, far)
    clip[3, 2] = -1.0
    return clip
