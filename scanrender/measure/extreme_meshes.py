"""Subjects that are hard on a renderer, made with NumPy alone: broken, degenerate, or only simple.

Each is a prepared asset around the origin, one unit of radius times half of `size_mm`. Their shapes
are named, so that a scene that failed can be written down and made again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.asset import Asset, Mesh

Array = npt.NDArray[np.float64]
RINGS = 14
MAP_PX = 16


def ball(rings: int = RINGS, radius: float = 1.0) -> Mesh:
    """A sphere with a seam, and poles whose triangles have no area."""
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
    return mesh(normals * radius, normals, uv, faces)


def sheet(
    corners: Array | None = None, u: tuple[float, float] = (0.0, 1.0), facing: float = 1.0
) -> Mesh:
    """A rectangle; four `corners` (4, 3) counter-clockwise, in z = 0 without them."""
    if corners is None:
        corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float64)
    normal = np.cross(corners[1] - corners[0], corners[3] - corners[0])
    normal = facing * normal / np.linalg.norm(normal)
    faces = [[0, 1, 2], [0, 2, 3]] if facing > 0 else [[0, 2, 1], [0, 3, 2]]
    uv = [[u[0], 1], [u[1], 1], [u[1], 0], [u[0], 0]]
    return mesh(corners, np.tile(normal, (4, 1)), uv, faces)


def moved(part: Mesh, offset: npt.ArrayLike, scale: float = 1.0) -> Mesh:
    positions = part.positions_mm * scale + np.asarray(offset)
    return Mesh(positions.astype(np.float32), part.normals, part.tangents, part.uv, part.faces)


def joined(*parts: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(p.positions_mm) for p in parts)])
    faces = [p.faces + start for p, start in zip(parts, starts, strict=False)]
    names = ("positions_mm", "normals", "tangents", "uv")
    stacked = {name: np.vstack([getattr(p, name) for p in parts]) for name in names}
    return Mesh(**stacked, faces=np.vstack(faces).astype(np.uint32))


def mesh(
    positions: npt.ArrayLike, normals: npt.ArrayLike, uv: npt.ArrayLike, faces: npt.ArrayLike
) -> Mesh:
    """Tangents lie anywhere on the surface: there is no normal map to turn with them."""
    n = np.asarray(normals, dtype=np.float64)
    side = np.where(np.abs(n[:, [1]]) > 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    across = np.cross(side, n)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    return Mesh(
        np.asarray(positions, np.float32),
        n.astype(np.float32),
        np.hstack([across, np.ones((len(n), 1))]).astype(np.float32),
        np.asarray(uv, np.float32),
        np.asarray(faces, np.uint32),
    )


def _with(part: Mesh, **changed: Any) -> Mesh:
    fields = ("positions_mm", "normals", "tangents", "uv", "faces")
    return Mesh(**{name: changed.get(name, getattr(part, name)) for name in fields})


def _one_triangle() -> Mesh:
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]])
    uv = np.array([[0.0, 1], [1, 1], [0.5, 0]])
    return mesh(corners, [[0, 0, 1]] * 3, uv, [[0, 1, 2]])


def _cup() -> Mesh:
    """An open hollow: the inside of a surface is seen."""
    base = ball()
    return _with(base, faces=base.faces[base.positions_mm[base.faces[:, 0], 2] < 0.3])


def _slivers() -> Mesh:
    """Triangles a million times as long as they are wide, over a ball."""
    angle = np.linspace(0, np.pi, 40, endpoint=False)
    way = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    aside = np.stack([-way[:, 1], way[:, 0], way[:, 2]], axis=1) * 1e-6
    points = np.stack([-way, way, way + aside], axis=1).reshape(-1, 3) + np.array([0, 0, 1.0])
    needles = mesh(
        points, [[0, 0, 1]] * len(points), [[0.5, 0.5]] * len(points),
        np.arange(len(points)).reshape(-1, 3),
    )  # fmt: skip
    return joined(ball(), needles)


def _folded() -> Mesh:
    """A sheet that lies on itself, faces turned away from each other."""
    return joined(sheet(u=(0, 0.5)), sheet(u=(0.5, 1), facing=-1.0))


def _zero_area() -> Mesh:
    base = ball()
    nothing = np.repeat(np.arange(0, 60, dtype=np.uint32)[:, None], 3, axis=1)
    lines = np.stack([np.arange(60), np.arange(60) + 1, np.arange(60)], axis=1).astype(np.uint32)
    return _with(base, faces=np.vstack([base.faces, nothing, lines]))


def _dust(count: int = 2000) -> Mesh:
    """Many components, each a single small triangle, in a ball."""
    rng = np.random.default_rng(1)
    middle = rng.normal(size=(count, 1, 3))
    middle *= rng.random((count, 1, 1)) ** (1 / 3) / np.linalg.norm(middle, axis=2, keepdims=True)
    corners = middle * 0.9 + rng.normal(size=(count, 3, 3)) * 0.03
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    flat = corners.reshape(-1, 3)
    faces = np.arange(3 * count).reshape(-1, 3)
    return mesh(flat, np.repeat(normals, 3, axis=0), rng.random((3 * count, 2)), faces)


def _torn() -> Mesh:
    """Every third face turned inside out, every fifth missing."""
    base = ball()
    faces = base.faces.copy()
    faces[::3] = faces[::3, ::-1]
    return _with(base, faces=faces[np.arange(len(faces)) % 5 != 0])


def _random_normals() -> Mesh:
    base = ball()
    found = np.random.default_rng(2).normal(size=base.normals.shape)
    return _with(base, normals=(found / np.linalg.norm(found, axis=1, keepdims=True)).astype("f4"))


def _box() -> Mesh:
    """Hard edges, six sides."""
    sides = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            corners = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], dtype=np.float64)
            turned = np.roll(corners, axis, axis=1)
            sides.append(sheet(0.6 * (turned if sign > 0 else -turned[::-1])))
    return joined(*sides)


SHAPES: Mapping[str, Callable[[], Mesh]] = {
    "ball": ball,
    "sheet": sheet,
    "box": _box,
    "slab": lambda: joined(moved(sheet(), [0, 0, 0.01]), moved(sheet(facing=-1.0), [0, 0, -0.01])),
    "terrace": lambda: joined(
        sheet(np.array([[-1, -1, -0.3], [0, -1, -0.3], [0, 1, -0.3], [-1, 1, -0.3]]), (0, 0.5)),
        sheet(np.array([[0, -1, 0.3], [1, -1, 0.3], [1, 1, 0.3], [0, 1, 0.3]]), (0.5, 1)),
    ),
    "cup": _cup,
    "one_triangle": _one_triangle,
    "slivers": _slivers,
    "folded": _folded,
    "zero_area": _zero_area,
    "shells": lambda: joined(ball(), ball()),
    "dust": _dust,
    "torn": _torn,
    "inverted": lambda: _with(ball(), normals=-ball().normals),
    "no_normals": lambda: _with(
        ball(), normals=0 * ball().normals, tangents=0 * ball().tangents
    ),
    "random_normals": _random_normals,
    "uv_outside": lambda: _with(ball(), uv=(ball().uv * 40.0 - 17.0).astype(np.float32)),
    "uv_huge": lambda: _with(ball(), uv=(ball().uv * 1e30).astype(np.float32)),
    "nested": lambda: joined(ball(), ball(40, 0.4)),
}  # fmt: skip
# Coincident or interpenetrating surfaces: which one is seen there is chance.
AMBIGUOUS = {"shells", "folded", "slivers", "dust", "torn"}


MAPS = ("none", "plain", "noisy", "black", "white", "hdr", "nan")


def maps_of(name: str, seed: int = 0) -> dict[str, npt.NDArray[np.float32]]:
    """Maps of a kind of `MAPS`."""
    rng = np.random.default_rng(seed)
    if name == "none":
        return {}
    albedo = {
        "plain": np.full((1, 1, 3), 0.5) * [1.2, 0.9, 0.7],
        "black": np.zeros((1, 1, 3)),
        "white": np.ones((1, 1, 3)),
        "hdr": 1e5 * rng.random((MAP_PX, MAP_PX, 3)),
    }.get(name, np.round(rng.random((MAP_PX, MAP_PX, 3)) * 255) / 255)
    made = {"albedo": albedo}
    if name in ("noisy", "nan", "hdr"):
        slope = rng.normal(0.0, 0.4, (MAP_PX, MAP_PX, 2))
        normal = np.dstack([slope, np.ones((MAP_PX, MAP_PX))])
        made["normal_ts"] = normal / np.linalg.norm(normal, axis=2, keepdims=True)
        made["ao"] = rng.random((MAP_PX, MAP_PX, 1)).round(1)
        made["skin"] = rng.random((MAP_PX, MAP_PX, 1)).round(1)
        made["curvature"] = rng.normal(0.0, 10.0, (MAP_PX, MAP_PX, 1)) ** 3
        made["thickness_mm"] = 10.0 ** rng.uniform(-3, 6, (MAP_PX, MAP_PX, 1))
    if name == "nan":
        for pixels in made.values():
            where = rng.random(pixels.shape[:2]) < 0.1
            pixels[where] = rng.choice([np.nan, np.inf, -np.inf], size=int(where.sum()))[:, None]
    return {key: pixels.astype(np.float32) for key, pixels in made.items()}


def asset_of(shape: str, size_mm: float, maps: str = "plain") -> Asset:
    """The subject `shape`, `size_mm` high, with maps of a kind."""
    made = SHAPES[shape]()
    positions = (made.positions_mm.astype(np.float64) * (0.5 * size_mm)).astype(np.float32)
    return Asset(_with(made, positions_mm=positions), maps_of(maps))
