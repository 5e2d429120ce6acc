"""The shot's material on the surface: what diffuses at a point, and what becomes of it after.

As `diffusion_input.frag` and `diffuse.frag`: irradiance x albedo^m diffuses, m = 1, 1/2, 0 for
texturing pre, mixed, post; what comes out is (1 - rho_dt(N.V)) albedo^(1-m) [s M + (1-s) input],
with s the skin map, so that eyes and brows keep their own light.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from scanrender.optics._math import Array
from scanrender.reference.lighting import Lighting
from scanrender.reference.parallel import each
from scanrender.reference.points import PictureCamera, Points
from scanrender.reference.rays import Faces
from scanrender.reference.surface import Geometry, Surface
from scanrender.settings.pipeline import Pipeline

_ALBEDO_POWER = {"pre": 1.0, "mixed": 0.5, "post": 0.0}
_NEUTRAL_ALBEDO = 0.5
_CHUNK = 50_000
# To a light with a size from a point whose own light is shown: nothing else averages it.
_PICTURE_RAYS = 16


@dataclass(frozen=True)
class Shading:
    """k points of a picture: ``unscattered`` (k, 3) is the diffusion input there.

    ``leaving`` (k, 3) multiplies what comes out: exit loss and the rest of the albedo. ``skin``
    (k,) is the share that scatters.
    """

    unscattered: Array
    leaving: Array
    skin: Array


@dataclass(frozen=True)
class SkinField:
    """A surface under lights with a material; `field` is what the integrals are made of."""

    surface: Surface
    lighting: Lighting
    albedo_power: float
    uses_mask: bool
    inside_albedo: Array

    @classmethod
    def of(
        cls,
        surface: Surface,
        pipeline: Pipeline,
        camera: PictureCamera,
        shadow_rays: int,
        soft_edges: bool,
    ) -> SkinField:
        """The material and lights that the pipeline describes. Raises ConfigError."""
        lighting = Lighting(
            pipeline.lights,
            camera.object_from_rig(),
            pipeline.skin.specular,
            shadow_rays,
            soft_edges,
        )
        return cls(
            surface,
            lighting,
            _ALBEDO_POWER[pipeline.skin.texturing],
            pipeline.diffusion.mask == "skin" and "skin" in surface.maps,
            np.asarray(pipeline.view.inside_albedo, np.float64),
        )

    def field(self, face: Faces, bary: Array) -> tuple[Array, Array]:
        """Light that diffuses (k, 3), and mask (k,), at barycentric coordinates (k, 3) of faces."""
        at = self.surface.geometry(face, bary)
        light = self.lighting.irradiance(at, self._map("ao", at), self.surface.caster)
        if self.albedo_power > 0.0:
            light = light * self._albedo(at) ** self.albedo_power
        mask = self._map("skin", at) if self.uses_mask else np.ones(len(face))
        return light, mask

    def shading(self, points: Points, camera: PictureCamera) -> Shading:
        """What the picture's points show besides scattered light."""
        starts = range(0, max(len(points), 1), _CHUNK)

        def work(job: int) -> Shading:
            which = np.arange(starts[job], min(starts[job] + _CHUNK, len(points)))
            return self._shading(points.chosen(which), camera)

        parts = each(len(starts), work)
        join = np.concatenate
        return Shading(
            join([part.unscattered for part in parts]),
            join([part.leaving for part in parts]),
            join([part.skin for part in parts]),
        )

    def mixed(self, shading: Shading, which: npt.NDArray[np.int64], scattered: Array) -> Array:
        """(j, 3) before the rest of the albedo, of points number ``which`` (j,)."""
        s = shading.skin[which, None]
        return np.asarray(s * scattered + (1.0 - s) * shading.unscattered[which])

    def _shading(self, points: Points, camera: PictureCamera) -> Shading:
        at = self.surface.geometry(points.face, points.bary)
        albedo, skin = self._albedo(at), self._map("skin", at)
        if not self.uses_mask:
            skin = np.ones_like(skin)
        back = points.is_inside
        if back.any():
            # The inside of an open scan is lit from the side that is seen, and scatters nothing.
            side = np.where(back, -1.0, 1.0)[:, None]
            normal = at.geometric * side
            shading = np.where(back[:, None], normal, at.shading)
            at = Geometry(at.position, normal, shading, at.lifted, at.uv)
            albedo = np.where(back[:, None], self.inside_albedo, albedo)
            skin = np.where(back, 0.0, skin)
        light = self.lighting.irradiance(
            at, self._map("ao", at), self.surface.caster, least_rays=_PICTURE_RAYS
        )
        cosine = np.einsum("ki,ki->k", at.shading, camera.to_eye(at.position))
        leaving = self.lighting.passes(cosine)[:, None] * albedo ** (1.0 - self.albedo_power)
        return Shading(light * albedo**self.albedo_power, leaving, skin)

    def _albedo(self, at: Geometry) -> Array:
        if "albedo" not in self.surface.maps:
            return np.full((len(at.uv), 3), _NEUTRAL_ALBEDO)
        return np.clip(self.surface.lookup("albedo", at.uv), 0.0, 1.0)

    def _map(self, name: str, at: Geometry) -> Array:
        if name not in self.surface.maps:
            return np.ones(len(at.uv))
        return np.clip(self.surface.lookup(name, at.uv)[:, 0], 0.0, 1.0)
