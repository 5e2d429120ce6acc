"""Light that enters the skin, E = sum over lights of (1 - rho_dt(N.L)) max(0, N.L) V E_light.

What `irradiance.frag` and `visibility.frag` compute, with visibility V by shadow rays against the
whole mesh. Irradiance is in units of pi: a light of 1 gives a white diffuser the radiance 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scanrender.errors import ConfigError
from scanrender.optics._math import Array
from scanrender.optics.surface import SpecularLobes
from scanrender.reference.rays import Caster, Faces
from scanrender.reference.surface import Geometry, unit
from scanrender.settings.light import (
    AmbientLight,
    DirectionalLight,
    EnvironmentLight,
    Follows,
    LampSettings,
    Light,
    SpotLight,
)
from scanrender.settings.skin import SpecularSettings

# The renderer's table, and its reading: linear between 64 centres, constant past the ends.
_RHO_COSINES = (np.arange(64) + 0.5) / 64
_R2 = (0.7548776662466927, 0.5698402909980532)
# Past the rounding of Embree's float32 at a metre from the origin.
_LEAVE_MM = 1e-3
# A shadow's edge is looked for this far above the skin, in widths of the edge, and ends before it
# meets the skin again.
_ABOVE_EDGES = 0.03
_SHORT_OF_HIT = 0.95


@dataclass(frozen=True)
class Lamp:
    """A light in object space: unit ``to_light`` from the subject's centre, mm, RGB in units of pi.

    ``distance_mm`` is 0 for parallel light. ``size`` is the tangent of the half angle, or the
    lamp's radius in mm; ``edge_mm`` the least radius of the shadow's edge that the settings ask.
    """

    to_light: Array
    distance_mm: float
    irradiance: Array
    size: float
    edge_mm: float
    cone: tuple[float, float]
    casts_shadow: bool

    def direction(self, position: Array) -> Array:
        """(k, 3) unit, from positions (k, 3) to the lamp's middle."""
        if self.distance_mm == 0.0:
            return np.broadcast_to(self.to_light, position.shape)
        return unit(self.distance_mm * self.to_light - position)

    def incident(self, position: Array) -> Array:
        """(k, 3) irradiance at normal incidence: inverse square, cone (`light.glsl`)."""
        if self.distance_mm == 0.0:
            return np.broadcast_to(self.irradiance, position.shape)
        way = self.distance_mm * self.to_light - position
        squared = np.maximum(np.sum(way * way, axis=1), max(self.size**2, 1e-6))
        rim, full = self.cone
        t = np.clip((unit(way) @ self.to_light - rim) / (full - rim), 0.0, 1.0)
        fall = self.distance_mm**2 / squared * t * t * (3.0 - 2.0 * t)
        return np.asarray(self.irradiance * fall[:, None])


class Lighting:
    """All lights of a shot and the share of their light that enters the skin."""

    def __init__(
        self,
        lights: tuple[Light, ...],
        object_from_rig: dict[Follows, Array],
        specular: SpecularSettings,
        shadow_rays: int,
        soft_edges: bool = True,
    ) -> None:
        """Rotations (3, 3) say how each rig stands. Raises ConfigError for an environment."""
        if any(isinstance(light, EnvironmentLight) for light in lights):
            raise ConfigError(
                "the reference has no environment light yet",
                "lights",
                "use directional, point, spot and ambient lights",
            )
        lamps = [light for light in lights if isinstance(light, LampSettings)]
        self.lamps = [_lamp(light, object_from_rig[light.follows], soft_edges) for light in lamps]
        ambient = [light for light in lights if isinstance(light, AmbientLight)]
        self.ambient = sum(
            (light.irradiance * np.asarray(light.colour) for light in ambient), np.zeros(3)
        )
        self.shadow_rays = shadow_rays
        lobes = SpecularLobes(*specular.roughness, 1.0 - specular.second_lobe, specular.f0)
        rho = specular.strength * lobes.directional_albedo(_RHO_COSINES)
        self._rho = np.clip(rho, 0.0, 1.0)

    def passes(self, cosine: Array) -> Array:
        """1 - rho_dt(cosine), any shape: what is not reflected on its way in or out."""
        return np.asarray(1.0 - np.interp(np.clip(cosine, 0.0, 1.0), _RHO_COSINES, self._rho))

    def irradiance(
        self, at: Geometry, open_sky: Array, caster: Caster, least_rays: int = 1
    ) -> Array:
        """(k, 3) at k points; ``open_sky`` (k,) is their ambient visibility."""
        rays = max(self.shadow_rays, least_rays)
        mean_rho = float(np.average(self._rho, weights=_RHO_COSINES))
        total = open_sky[:, None] * self.ambient * (1.0 - mean_rho)
        for lamp in self.lamps:
            way = lamp.direction(at.position)
            cosine = np.einsum("ki,ki->k", at.shading, way)
            share: Array = np.where(cosine > 0.0, cosine * self.passes(cosine), 0.0)
            if lamp.casts_shadow:
                share *= _horizon(at, way)
                seen = np.flatnonzero(share > 0.0)
                share[seen] *= _visibility(lamp, at, seen, caster, rays)
            total = total + share[:, None] * lamp.incident(at.position)
        return np.asarray(total)


def _horizon(at: Geometry, way: Array) -> Array:
    """Chiang et al. 2019, "Taming the Shadow Terminator", as `visibility.frag` fades it."""
    geometric = np.einsum("ki,ki->k", at.geometric, way)
    shaded = np.einsum("ki,ki->k", at.shading, way)
    between = np.maximum(np.einsum("ki,ki->k", at.geometric, at.shading), 1e-3)
    lit = (geometric > 0.0) & (shaded > 0.0)
    g = np.minimum(1.0, geometric / np.maximum(shaded * between, 1e-12))
    return np.where(lit, g * (1.0 + g * (1.0 - g)), 0.0)


def _visibility(lamp: Lamp, at: Geometry, seen: Faces, caster: Caster, rays: int) -> Array:
    """Share of the lamp's disk seen from points number ``seen`` (j,)."""
    start, normal = at.lifted[seen], at.geometric[seen]
    start = start + _LEAVE_MM * normal
    is_soft = lamp.size > 0.0 or lamp.edge_mm > 0.0
    rays = rays if is_soft else 1
    total = np.zeros(len(seen))
    for number in range(rays):
        # Martin Roberts' R2 sequence over neighbouring points and their rays: few cover the disk.
        index = np.arange(len(seen)) * rays + number
        radius = np.sqrt(np.mod(0.5 + index * _R2[0], 1.0)) * is_soft
        angle = 2.0 * np.pi * np.mod(index * _R2[1], 1.0)
        offset = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        origin, way, reach = _shadow_ray(lamp, start, normal, offset, caster)
        total += ~caster.is_blocked(origin, way, reach)
    return total / rays


def _shadow_ray(
    lamp: Lamp, start: Array, normal: Array, offset: Array, caster: Caster
) -> tuple[Array, Array, float | Array]:
    """Origin, direction and reach of a ray to point ``offset`` (j, 2) of the lamp's unit disk.

    A lamp without size has an edge of fixed width instead, as the settings say: the ray then
    starts that far away on the receiver's tangent plane, as seen from the light.
    """
    way = lamp.direction(start)
    across, along = frame(way)
    aside = offset[:, :1] * across + offset[:, 1:] * along
    if lamp.size > 0.0 and lamp.distance_mm == 0.0:
        return start, unit(way + lamp.size * aside), np.inf
    if lamp.size == 0.0 and lamp.edge_mm > 0.0:
        start = _aside(lamp, start, normal, way, aside, caster)
    if lamp.distance_mm == 0.0:
        return start, np.asarray(way), np.inf
    middle = lamp.distance_mm * lamp.to_light + lamp.size * aside
    return start, unit(middle - start), np.linalg.norm(middle - start, axis=1)


def _aside(
    lamp: Lamp, start: Array, normal: Array, way: Array, aside: Array, caster: Caster
) -> Array:
    """(j, 3) starts moved along the surface by the width of the shadow's edge.

    A disk across the light, made narrower along the slope as `visibility.frag` does, and no
    further than to where the surface rises: beyond, the ray would start under the skin.
    """
    slope = np.einsum("ki,ki->k", aside, normal)[:, None]
    step = lamp.edge_mm * (aside - slope * normal)
    length = np.maximum(np.linalg.norm(step, axis=1), 1e-12)
    above = start + _ABOVE_EDGES * lamp.edge_mm * normal
    free = caster.clear_mm(above, step / length[:, None], length)
    return np.asarray(above + step * (_SHORT_OF_HIT * free / length)[:, None])


def frame(way: Array) -> tuple[Array, Array]:
    """Two unit vectors across unit ``way`` (k, 3) (Duff et al. 2017, JCGT 6(1))."""
    sign = np.copysign(1.0, way[:, 2])
    a = -1.0 / (sign + way[:, 2])
    b = way[:, 0] * way[:, 1] * a
    x = np.stack([1.0 + sign * way[:, 0] ** 2 * a, sign * b, -sign * way[:, 0]], axis=1)
    y = np.stack([b, sign + way[:, 1] ** 2 * a, -way[:, 1]], axis=1)
    return x, y


def _lamp(light: LampSettings, object_from_rig: Array, soft_edges: bool) -> Lamp:
    azimuth, elevation = np.deg2rad(light.azimuth_deg), np.deg2rad(light.elevation_deg)
    to_light = np.array(
        [
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
            np.cos(azimuth) * np.cos(elevation),
        ]
    )
    distance, size, cone = 0.0, 0.0, (-2.0, -1.5)
    if isinstance(light, DirectionalLight):
        size = float(np.tan(np.deg2rad(light.size_deg) / 2))
    else:
        distance, size = light.distance_mm, light.radius_mm
        if light.position_mm is not None:
            distance = float(np.linalg.norm(light.position_mm))
            to_light = np.asarray(light.position_mm) / distance
        if isinstance(light, SpotLight):
            half = np.deg2rad(light.cone_deg) / 2
            full = min(half * (1.0 - light.edge), half - 1e-4)
            cone = (float(np.cos(half)), float(np.cos(full)))
    return Lamp(
        object_from_rig @ to_light,
        distance,
        light.irradiance * np.asarray(light.colour, np.float64),
        size,
        light.shadow_blur_mm if soft_edges else 0.0,
        cone,
        light.shadow,
    )
