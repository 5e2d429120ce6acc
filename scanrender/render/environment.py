"""Environment lights on the device: our own skies or a picture, prefiltered for this material.

Diffuse: the cosine integral at each normal. Glossy: the picture seen through each of the skin's two
lobes, which the shader multiplies by what the lobe reflects (split sum, Karis 2013). A material has
two roughnesses, so each gets a picture of its own and nothing is interpolated between mip levels.
"""

from __future__ import annotations

from functools import cache, cached_property
from pathlib import Path

import moderngl
import numpy as np
import numpy.typing as npt

from scanrender.errors import ConfigError, ScanError
from scanrender.images import read_image
from scanrender.optics.environment import (
    directions,
    filtered,
    irradiance_kernel,
    lobe_kernel,
    resampled,
)
from scanrender.optics.surface import SpecularLobes
from scanrender.render.camera import Matrix, rotation_y
from scanrender.render.device import Device
from scanrender.settings.light import BUILT_IN_SKIES, EnvironmentLight

Picture = npt.NDArray[np.float64]
MAX_ROWS = 256
DIFFUSE_ROWS = 64
PICTURE_FORMATS = (".exr", ".hdr")
# The largest half float: what a sun that its file calls infinite becomes.
BRIGHTEST = 65504.0


class Environment:
    """One environment light, prefiltered for a material when a pass asks for it.

    `rho` is the material's directional albedo at `cosines`. Raises ConfigError for a picture that
    cannot be used.
    """

    def __init__(
        self,
        device: Device,
        light: EnvironmentLight,
        lobes: SpecularLobes,
        cosines: npt.NDArray[np.float64],
        rho: npt.NDArray[np.float64],
    ) -> None:
        self.settings = light
        self.picture = environment_picture(light)
        self._device = device
        self._lobes = lobes
        self._entering = irradiance_kernel(cosines, rho)

    @property
    def picture_from_rig(self) -> Matrix:
        return rotation_y(-self.settings.rotation_deg)

    @cached_property
    def irradiance(self) -> moderngl.Texture:
        """Irradiance (units of pi) over normals, what the lobes reflect taken off."""
        light = filtered(self.picture, self._entering, DIFFUSE_ROWS, normalized=False)
        return _around(self._device, light)

    @cached_property
    def lobes(self) -> tuple[moderngl.Texture, moderngl.Texture]:
        """The surroundings through each lobe, over mirror directions."""
        first, second = self._lobes.m_first, self._lobes.m_second
        one = self._seen_through(first)
        return one, one if first == second else self._seen_through(second)

    def _seen_through(self, m: float) -> moderngl.Texture:
        source, rows = self.picture, MAX_ROWS
        if m >= 0.15:
            # A lobe is about 2 m radians wide: no need of a fine picture or of many rows.
            source = resampled(self.picture, *_at_most(self.picture, 2 * DIFFUSE_ROWS))
            rows = DIFFUSE_ROWS
        seen = filtered(source, lobe_kernel(m, self._lobes.f0), rows, normalized=True)
        return _around(self._device, seen)


def environment_picture(light: EnvironmentLight) -> Picture:
    """(rows, 2 rows, 3) radiance of the light, rows <= 256, before it is turned."""
    picture = built_in_sky(light.map) if light.map in BUILT_IN_SKIES else _read(Path(light.map))
    tint = light.intensity * np.asarray(light.colour, dtype=np.float64)
    return np.asarray(picture * tint)


def _read(path: Path) -> Picture:
    fix = f"use a latitude-longitude picture ({', '.join(PICTURE_FORMATS)}), twice as wide as high"
    if path.suffix.lower() not in PICTURE_FORMATS:
        raise ConfigError(f"{path.name} is no environment picture", str(path), fix)
    try:
        pixels = read_image(path)
    except ScanError as error:
        raise ConfigError(str(error), str(path), fix) from error
    height, width = pixels.shape[:2]
    if not 1.9 <= width / height <= 2.1:
        raise ConfigError(f"{path.name} is {width} x {height}", str(path), fix)
    colour = pixels[:, :, :3] if pixels.shape[2] >= 3 else np.repeat(pixels[:, :, :1], 3, axis=2)
    # Suns in half floats are often infinite, and stitching leaves negative or NaN texels.
    colour = np.clip(np.nan_to_num(colour, nan=0.0, posinf=BRIGHTEST), 0.0, None)
    return resampled(colour, *_at_most(colour, MAX_ROWS))


def _at_most(picture: npt.NDArray[np.floating], rows: int) -> tuple[int, int]:
    rows = min(picture.shape[0], rows)
    return rows, 2 * rows


def _around(device: Device, picture: Picture) -> moderngl.Texture:
    texture = device.table(picture, linear=True)
    texture.repeat_x = True
    return texture


@cache
def built_in_sky(name: str) -> Picture:
    """`studio`, `sky` or `dome`: (256, 512, 3), irradiance 1 (green) on a normal to the front."""
    toward = directions(MAX_ROWS, 2 * MAX_ROWS)
    picture = {"studio": _studio, "sky": _sky, "dome": _dome}[name](toward)
    cosine = np.maximum(toward[:, :, 2], 0.0)
    weight = cosine * np.sin((np.arange(MAX_ROWS) + 0.5) * np.pi / MAX_ROWS)[:, None]
    green = float(np.average(picture[:, :, 1], weights=weight))
    return np.asarray(picture / green)


def _dome(toward: Picture) -> Picture:
    """An overcast sky (CIE: (1 + 2 sin elevation) / 3) over pale ground."""
    up = toward[:, :, 1]
    sky = (1.0 + 2.0 * np.maximum(up, 0.0)) / 3.0
    grey = np.where(up > 0, sky, 0.22 + (1 / 3 - 0.22) * np.exp(up / 0.03))
    return np.asarray(grey[:, :, None] * [0.96, 1.0, 1.05])


def _sky(toward: Picture) -> Picture:
    """A clear sky without its sun, which casts shadows and so is a lamp; its glow is here."""
    up = toward[:, :, 1]
    high = np.clip(up, 0.0, 1.0)[:, :, None] ** 0.5
    sky = (1.0 - high) * [1.0, 1.04, 1.08] + high * [0.50, 0.66, 0.95]
    sun = _direction(40.0, 42.0)
    glow = np.exp((toward @ sun - 1.0) / 0.06)[:, :, None] * [3.2, 2.7, 2.0]
    ground = np.array([0.30, 0.26, 0.21])
    below = np.clip(-up / 0.04, 0.0, 1.0)[:, :, None]
    return np.asarray((1.0 - below) * (sky + glow) + below * ground)


def _studio(toward: Picture) -> Picture:
    """Softboxes in a dark room: key, fill, two strips behind, a bounce below."""
    room = np.broadcast_to([0.045, 0.045, 0.05], toward.shape).copy()
    boxes = (
        # azimuth, elevation, width, height in degrees, radiance
        (42.0, 32.0, 46.0, 46.0, (9.5, 9.1, 8.5)),
        (-58.0, 8.0, 40.0, 60.0, (1.5, 1.6, 1.75)),
        (142.0, 22.0, 14.0, 70.0, (6.0, 6.0, 6.2)),
        (-142.0, 22.0, 14.0, 70.0, (6.0, 6.0, 6.2)),
        (0.0, -60.0, 90.0, 30.0, (0.5, 0.47, 0.44)),
    )
    for azimuth, elevation, width, height, radiance in boxes:
        middle = _direction(azimuth, elevation)
        right = np.cross([0.0, 1.0, 0.0], middle)
        right /= np.linalg.norm(right)
        above = np.cross(middle, right)
        ahead = toward @ middle
        x = np.arctan2(toward @ right, ahead) / np.deg2rad(width / 2)
        y = np.arctan2(toward @ above, ahead) / np.deg2rad(height / 2)
        # Cloth is brighter in the middle, and its edge is soft: no hard outline in an eye.
        inside = np.clip((1.0 - np.maximum(np.abs(x), np.abs(y))) / 0.12, 0.0, 1.0)
        cloth = np.where(ahead > 0, inside * (1.0 - 0.3 * np.clip(x * x + y * y, 0, 1)), 0.0)
        room += cloth[:, :, None] * np.array(radiance)
    return room


def _direction(azimuth_deg: float, elevation_deg: float) -> Picture:
    a, e = np.deg2rad([azimuth_deg, elevation_deg])
    return np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
