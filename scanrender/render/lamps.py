"""Lights resolved into world space, and the camera that each one's shadow map looks through."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from scanrender.render.camera import Matrix, rotation_x, rotation_y
from scanrender.settings.light import AmbientLight, DirectionalLight, Light, SpotLight

Vector = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Lamp:
    """A directional or spot light around the origin, in world millimetres.

    `irradiance` is RGB at the subject's centre in units of pi. The light's own space looks along
    -Z, like a camera; `depth_mm` in it is measured from its near plane.
    """

    index: int
    settings: DirectionalLight | SpotLight
    irradiance: Vector
    light_from_world: Matrix
    clip_from_light: Matrix
    near_mm: float
    far_mm: float

    @property
    def is_spot(self) -> bool:
        return isinstance(self.settings, SpotLight)

    @property
    def position_mm(self) -> Vector:
        """World position of a spot; for parallel light a point on its near side, for its axis."""
        return np.asarray(np.linalg.inv(self.light_from_world)[:3, 3])

    @property
    def to_light(self) -> Vector:
        """World unit vector from the subject's centre to the light."""
        return np.asarray(self.light_from_world[2, :3])

    @property
    def width_mm(self) -> float:
        """Width of the shadow map's view at the subject's centre."""
        if isinstance(self.settings, SpotLight):
            return 2.0 * self.settings.distance_mm / float(self.clip_from_light[0, 0])
        return 2.0 / float(self.clip_from_light[0, 0])

    @property
    def cone_cosines(self) -> tuple[float, float]:
        """Cosines at which a spot is dark (rim) and fully bright."""
        if not isinstance(self.settings, SpotLight):
            return -2.0, -1.5
        half = np.deg2rad(self.settings.cone_deg) / 2
        inner = half * (1.0 - self.settings.edge)
        return float(np.cos(half)), float(np.cos(min(inner, half - 1e-4)))


def resolve_lights(lights: Sequence[Light], radius_mm: float) -> tuple[list[Lamp], Vector]:
    """Lamps around a subject inside `radius_mm` of the origin, and the ambient RGB sum."""
    lamps: list[Lamp] = []
    ambient = np.zeros(3)
    for light in lights:
        if isinstance(light, AmbientLight):
            ambient += light.irradiance * np.asarray(light.colour)
        else:
            lamps.append(_lamp(light, len(lamps), radius_mm))
    return lamps, ambient


def _lamp(light: DirectionalLight | SpotLight, index: int, radius_mm: float) -> Lamp:
    turn = rotation_x(light.elevation_deg) @ rotation_y(-light.azimuth_deg)
    back = np.eye(4)
    clip = np.eye(4)
    if isinstance(light, SpotLight):
        distance = light.distance_mm
        near = max(distance - radius_mm, 0.01 * distance)
        far = distance + radius_mm
        # The map need not see more than the subject, and never more than the cone.
        tan = np.tan(np.deg2rad(light.cone_deg) / 2)
        if distance > 1.01 * radius_mm:
            tan = min(tan, radius_mm / np.sqrt(distance**2 - radius_mm**2))
        clip = np.array(
            [
                [1 / tan, 0, 0, 0],
                [0, 1 / tan, 0, 0],
                [0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)],
                [0, 0, -1, 0],
            ]
        )
    else:
        distance, near, far = 2.0 * radius_mm, 0.99 * radius_mm, 3.01 * radius_mm
        clip[0, 0] = clip[1, 1] = 1.0 / (1.01 * radius_mm)
        clip[2, 2] = -2.0 / (far - near)
        clip[2, 3] = -(far + near) / (far - near)
    back[2, 3] = -distance
    colour = light.irradiance * np.asarray(light.colour, dtype=np.float64)
    return Lamp(index, light, colour, back @ turn, clip, near, far)
