"""Assets whose picture is known: planes, spheres, boxes and slabs, built with NumPy alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.asset import Asset, Mesh
from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.settings.pipeline import Pipeline

WHITE = (1.0, 1.0, 1.0)
AMBIENT = {"type": "ambient", "irradiance": 1.0}

# Nothing but diffuse light: what the tests of diffusion want to see.
MATT: dict[str, Any] = {
    "skin": {
        "texturing": "pre",
        "specular": {"strength": 0.0},
        "transmission": {"method": "none"},
    },
    "lights": [AMBIENT],
    "camera": {"width_px": 96, "height_px": 96, "fill": 0.9, "elevation_deg": 0},
    "turntable": {"frames": 4},
    "quality": {"supersampling": 1},
}


def merged(base: Mapping[str, Any], top: Mapping[str, Any]) -> dict[str, Any]:
    """`top` over `base`, mapping by mapping."""
    result = dict(base)
    for key, value in top.items():
        both = isinstance(value, Mapping) and isinstance(result.get(key), Mapping)
        result[key] = merged(result[key], value) if both else value
    return result


def pipeline(*layers: Mapping[str, Any], **sections: Any) -> Pipeline:
    """A pipeline of plain data; later layers and `sections` lie over earlier ones."""
    data: dict[str, Any] = {}
    for layer in (*layers, sections):
        data = merged(data, layer)
    return Pipeline.model_validate(data)


def render(
    gl: Device, asset: Asset, settings: Pipeline, *names: str, index: int = 0
) -> dict[str, npt.NDArray[np.float32]]:
    """Buffers of one frame, `beauty` and `display` with them, and `alpha`."""
    renderer = Renderer(gl, asset, settings)
    frame = renderer.render(renderer.view(index), names)
    return {**frame.buffers, "alpha": frame.alpha[:, :, None]}


def flat_map(*value: float) -> npt.NDArray[np.float32]:
    return np.array(value, dtype=np.float32).reshape(1, 1, -1)


def mesh(
    positions: npt.ArrayLike,
    normals: npt.ArrayLike,
    uv: npt.ArrayLike,
    faces: npt.ArrayLike,
    tangents: npt.ArrayLike | None = None,
) -> Mesh:
    normals = np.asarray(normals, dtype=np.float64)
    if tangents is None:
        # Any direction on the surface serves where there is no normal map.
        side = np.where(np.abs(normals[:, [1]]) > 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
        across = np.cross(side, normals)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        tangents = np.hstack([across, np.ones((len(normals), 1))])
    return Mesh(
        np.asarray(positions, np.float32),
        np.asarray(normals, np.float32),
        np.asarray(tangents, np.float32),
        np.asarray(uv, np.float32),
        np.asarray(faces, np.uint32),
    )


def joined(meshes: Sequence[Mesh]) -> Mesh:
    starts = np.cumsum([0, *(len(m.positions_mm) for m in meshes)])
    return Mesh(
        *(np.vstack([getattr(m, name) for m in meshes])
          for name in ("positions_mm", "normals", "tangents", "uv")),
        np.vstack([m.faces + start for m, start in zip(meshes, starts, strict=False)]).astype(
            np.uint32
        ),
    )  # fmt: skip


def quad(
    low: tuple[float, float],
    high: tuple[float, float],
    *,
    z: float = 0.0,
    u: tuple[float, float] = (0.0, 1.0),
    v: tuple[float, float] = (1.0, 0.0),
    facing: float = 1.0,
) -> Mesh:
    """A rectangle in x and y that faces +Z (or -Z); `u` runs along +X, `v` along +Y."""
    (x0, y0), (x1, y1) = low, high
    faces = [[0, 1, 2], [0, 2, 3]] if facing > 0 else [[0, 2, 1], [0, 3, 2]]
    return mesh(
        [[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]],
        [[0, 0, facing]] * 4,
        [[u[0], v[0]], [u[1], v[0]], [u[1], v[1]], [u[0], v[1]]],
        faces,
        # glTF's v runs down the picture: +Y of the tangent space is -v, hence w = 1 with +X.
        [[1, 0, 0, 1]] * 4,
    )


def plane(half_mm: float = 20.0, albedo: Sequence[float] = WHITE, **maps: Any) -> Asset:
    found = {name: np.asarray(pixels, np.float32) for name, pixels in maps.items()}
    return Asset(
        quad((-half_mm, -half_mm), (half_mm, half_mm)), {"albedo": flat_map(*albedo), **found}
    )


def two_tone_plane(
    half_mm: float,
    left: Sequence[float] = (0.0, 0.0, 0.0),
    right: Sequence[float] = WHITE,
    vertical: bool = True,
) -> Asset:
    """A plane whose albedo steps at x = 0 (or at y = 0), sharp at any resolution.

    Each half has one texel for all of its vertices, so no filter softens the step.
    """
    maps = {"albedo": np.array([[left, right]], dtype=np.float32)}
    h = half_mm
    dark, bright = {"u": (0.25, 0.25), "v": (0.5, 0.5)}, {"u": (0.75, 0.75), "v": (0.5, 0.5)}
    if vertical:
        halves = quad((-h, -h), (0, h), **dark), quad((0, -h), (h, h), **bright)
    else:
        halves = quad((-h, -h), (h, 0), **dark), quad((-h, 0), (h, h), **bright)
    return Asset(joined(halves), maps)


def turned(asset: Asset, degrees: float, axis: str = "x") -> Asset:
    """The asset turned about the X or Y axis through the origin."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    about_x = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    about_y = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    matrix = about_x if axis == "x" else about_y
    old = asset.mesh
    tangents = np.hstack([old.tangents[:, :3] @ matrix.T, old.tangents[:, 3:]])
    new = mesh(old.positions_mm @ matrix.T, old.normals @ matrix.T, old.uv, old.faces, tangents)
    return Asset(new, asset.maps, asset.info)


def sphere_mesh(radius_mm: float, rings: int = 48, centre: Sequence[float] = (0, 0, 0)) -> Mesh:
    theta, phi = np.meshgrid(
        np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, 2 * rings + 1), indexing="ij"
    )
    normals = np.stack(
        [np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)], axis=-1
    ).reshape(-1, 3)
    uv = np.stack([phi / (2 * np.pi), theta / np.pi], axis=-1).reshape(-1, 2)
    row = 2 * rings + 1
    i, j = np.meshgrid(np.arange(rings), np.arange(2 * rings), indexing="ij")
    a = (i * row + j).ravel()
    faces = np.vstack([
        np.stack([a, a + row, a + row + 1], axis=1), np.stack([a, a + row + 1, a + 1], axis=1),
    ])  # fmt: skip
    return mesh(normals * radius_mm + np.asarray(centre), normals, uv, faces)


def sphere(radius_mm: float, albedo: Sequence[float] = WHITE, rings: int = 48) -> Asset:
    return Asset(sphere_mesh(radius_mm, rings), {"albedo": flat_map(*albedo)})


def slab(half_mm: float, thickness_mm: float) -> Asset:
    """A front and a back sheet, `thickness_mm` apart, around z = 0."""
    z = thickness_mm / 2
    sheets = (
        quad((-half_mm, -half_mm), (half_mm, half_mm), z=z),
        quad((-half_mm, -half_mm), (half_mm, half_mm), z=-z, facing=-1.0),
    )
    return Asset(joined(sheets), {"albedo": flat_map(*WHITE)})


def stepped_terrace(half_mm: float, step_mm: float) -> Asset:
    """A dark far floor on the left, a bright near one on the right, without a wall between."""
    maps = {"albedo": np.array([[(0.0,) * 3, WHITE]], dtype=np.float32)}
    h = half_mm
    halves = (
        quad((-h, -h), (0, h), z=-step_mm / 2, u=(0.25, 0.25), v=(0.5, 0.5)),
        quad((0, -h), (h, h), z=step_mm / 2, u=(0.75, 0.75), v=(0.5, 0.5)),
    )
    return Asset(joined(halves), maps)
