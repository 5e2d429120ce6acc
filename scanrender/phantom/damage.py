"""What a scanner does to a head: noise, holes, floaters, broken topology, any frame and unit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanrender.errors import UsageError
from scanrender.phantom.head import Head
from scanrender.phantom.mesh import boundary_edges, vertex_normals
from scanrender.phantom.noise import Array, noise

Faces = NDArray[np.int32]
Colours = NDArray[np.uint8]


@dataclass(frozen=True)
class Damage:
    """How much of each defect; counts are exact, lengths in mm of the truth frame.

    noise_mm: standard deviation along the normal. colour_noise: of the sRGB code values, in
    [0, 255]. baked_light: 0 for pure albedo, 1 for a full Lambert shade from the upper front.
    floaters: separate blobs around the head. holes: openings of about hole_mm diameter.
    spikes: vertices pulled out by up to spike_mm. duplicate_vertices: copies, each used by one
    face. unreferenced_vertices, zero_area_faces, nonmanifold_edges (edges of three faces),
    flipped_faces, nan_vertices (unreferenced ones first) are what they say. tilt_deg: rotation
    about a seeded axis. mm_per_unit: length of the raw unit. offset: (3,) of the raw origin, in
    raw units.
    """

    noise_mm: float = 0.03
    colour_noise: float = 1.5
    baked_light: float = 0.0
    floaters: int = 12
    holes: int = 6
    hole_mm: float = 4.0
    spikes: int = 20
    spike_mm: float = 3.0
    duplicate_vertices: int = 200
    unreferenced_vertices: int = 50
    zero_area_faces: int = 10
    nonmanifold_edges: int = 4
    flipped_faces: int = 30
    nan_vertices: int = 0
    tilt_deg: float = 7.0
    mm_per_unit: float = 25.4
    offset: tuple[float, float, float] = (3.0, -1.5, 12.0)

    @classmethod
    def none(cls) -> Damage:
        """No defect, no tilt, millimetres, truth origin."""
        return cls(
            noise_mm=0.0,
            colour_noise=0.0,
            floaters=0,
            holes=0,
            spikes=0,
            duplicate_vertices=0,
            unreferenced_vertices=0,
            zero_area_faces=0,
            nonmanifold_edges=0,
            flipped_faces=0,
            tilt_deg=0.0,
            mm_per_unit=1.0,
            offset=(0.0, 0.0, 0.0),
        )


@dataclass(frozen=True)
class RawScan:
    """What the scanner hands over.

    positions (n, 3) float64 in raw units; faces (m, 3) int32; colours_srgb_u8 (n, 3) uint8, sRGB
    encoded; raw_from_truth (4, 4) takes truth mm to raw units; truth_vertex (n,) is the vertex of
    the Head that a raw vertex was, or -1 for an invented one. head_seed and spacing_mm are the
    Head's, so that a texture can be baked.
    """

    positions: Array
    faces: Faces
    colours_srgb_u8: Colours
    raw_from_truth: Array
    mm_per_unit: float
    truth_vertex: NDArray[np.int32]
    head_seed: int
    spacing_mm: float


class _Parts:
    """The mesh while it is being damaged: grows at the end, so that indices stay valid."""

    def __init__(self, head: Head, colours: Colours, rng: np.random.Generator) -> None:
        self.rng = rng
        self.positions = head.positions_mm.copy()
        self.faces = head.faces.copy()
        self.colours = colours
        self.truth_vertex = np.arange(len(head.positions_mm), dtype=np.int32)
        self.normals = vertex_normals(head.positions_mm, head.faces)
        self.seed = head.seed

    def add_vertices(self, positions: Array, colours: Colours) -> NDArray[np.int32]:
        """Append invented vertices; returns their indices."""
        first = len(self.positions)
        self.positions = np.concatenate([self.positions, positions])
        self.colours = np.concatenate([self.colours, colours])
        invented = np.full(len(positions), -1, dtype=np.int32)
        self.truth_vertex = np.concatenate([self.truth_vertex, invented])
        return np.arange(first, first + len(positions), dtype=np.int32)

    def add_faces(self, faces: Faces) -> None:
        self.faces = np.concatenate([self.faces, faces.astype(np.int32)])


def scan_head(head: Head, damage: Damage, seed: int = 0) -> RawScan:
    """The head as raw material; the same arguments give the same bytes."""
    if damage.mm_per_unit <= 0.0:
        raise UsageError(f"mm_per_unit must be positive, not {damage.mm_per_unit}")
    rng = np.random.default_rng((seed, 0xDA))
    parts = _Parts(head, _seen_colours(head, damage, rng), rng)
    _cut_holes(parts, damage.holes, damage.hole_mm)
    sound = len(parts.positions)
    if damage.noise_mm > 0.0:
        parts.positions += (damage.noise_mm * rng.standard_normal(sound))[:, None] * parts.normals
    _pull_spikes(parts, damage.spikes, damage.spike_mm)
    _flip(parts, damage.flipped_faces)
    _duplicate(parts, damage.duplicate_vertices)
    _add_fins(parts, damage.nonmanifold_edges)
    _collapse_faces(parts, damage.zero_area_faces)
    for _ in range(damage.floaters):
        _add_floater(parts, sound)
    _add_unreferenced(parts, damage.unreferenced_vertices)
    raw_from_truth = _raw_from_truth(damage, rng)
    positions = parts.positions @ raw_from_truth[:3, :3].T + raw_from_truth[:3, 3]
    if damage.nan_vertices > 0:
        positions[len(positions) - damage.nan_vertices :] = np.nan
    return RawScan(
        positions=positions,
        faces=parts.faces,
        colours_srgb_u8=parts.colours,
        raw_from_truth=raw_from_truth,
        mm_per_unit=damage.mm_per_unit,
        truth_vertex=parts.truth_vertex,
        head_seed=head.seed,
        spacing_mm=head.spacing_mm,
    )


def srgb_u8_from_linear(linear: NDArray[np.floating]) -> Colours:
    """sRGB code values (IEC 61966-2-1) of linear Rec.709 in [0, 1], rounded."""
    clipped = np.clip(linear.astype(np.float64), 0.0, 1.0)
    high = 1.055 * np.power(np.maximum(clipped, 0.0031308), 1.0 / 2.4) - 0.055
    encoded = np.where(clipped <= 0.0031308, 12.92 * clipped, high)
    return np.asarray(np.rint(encoded * 255.0), dtype=np.uint8)


def _seen_colours(head: Head, damage: Damage, rng: np.random.Generator) -> Colours:
    linear = head.albedo_linear.astype(np.float64)
    if damage.baked_light > 0.0:
        light = np.array([0.2, 0.6, 0.77])
        normals = vertex_normals(head.positions_mm, head.faces)
        shade = 0.35 + 0.65 * np.maximum(normals @ (light / np.linalg.norm(light)), 0.0)
        linear *= (1.0 + damage.baked_light * (shade - 1.0))[:, None]
    colours = srgb_u8_from_linear(linear)
    if damage.colour_noise > 0.0:
        noisy = colours + damage.colour_noise * rng.standard_normal(colours.shape)
        colours = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return colours


def _cut_holes(parts: _Parts, count: int, diameter_mm: float) -> None:
    """Remove ragged discs of faces, and the vertices that only they used.

    They lie where the cameras in front see little: sides, back, and under brow, nose and chin.
    """
    if count == 0:
        return
    rim = parts.positions[np.unique(boundary_edges(parts.faces))]
    hidden = np.flatnonzero(parts.normals[:, 2] < 0.3)
    centres: list[Array] = []
    for _ in range(1000 * count):
        centre = parts.positions[hidden[parts.rng.integers(len(hidden))]]
        apart = all(np.linalg.norm(centre - other) > 4.0 * diameter_mm for other in centres)
        if apart and np.linalg.norm(rim - centre, axis=1).min(initial=np.inf) > 3.0 * diameter_mm:
            centres.append(centre)
        if len(centres) == count:
            break
    middle = parts.positions[parts.faces].mean(axis=1)
    gone = np.zeros(len(parts.faces), dtype=bool)
    for centre in centres:
        close = np.flatnonzero(np.abs(middle - centre).max(axis=1) < diameter_mm)
        ragged = 1.0 + 0.15 * noise(middle[close], 0.6 * diameter_mm, parts.seed + 909)
        away = np.linalg.norm(middle[close] - centre, axis=1)
        hit = close[away < 0.5 * diameter_mm * np.maximum(ragged, 0.3)]
        gone[hit if len(hit) else close[[int(away.argmin())]]] = True
    parts.faces = parts.faces[~gone]
    _drop_unused(parts)


def _drop_unused(parts: _Parts) -> None:
    used = np.zeros(len(parts.positions), dtype=bool)
    used[parts.faces] = True
    renumber = np.cumsum(used) - 1
    parts.faces = renumber[parts.faces].astype(np.int32)
    parts.positions, parts.normals = parts.positions[used], parts.normals[used]
    parts.colours, parts.truth_vertex = parts.colours[used], parts.truth_vertex[used]


def _pull_spikes(parts: _Parts, count: int, height_mm: float) -> None:
    at = parts.rng.choice(len(parts.positions), count, replace=False)
    reach = height_mm * parts.rng.uniform(0.4, 1.0, count)
    parts.positions[at] += reach[:, None] * parts.normals[at]


def _flip(parts: _Parts, count: int) -> None:
    at = parts.rng.choice(len(parts.faces), count, replace=False)
    parts.faces[at] = parts.faces[at][:, ::-1]


def _duplicate(parts: _Parts, count: int) -> None:
    """Split a corner of a face off its vertex: same place, same colour, another index."""
    rows = parts.rng.choice(len(parts.faces), min(4 * count, len(parts.faces)), replace=False)
    _, first = np.unique(parts.faces[rows, 0], return_index=True)
    rows = rows[np.sort(first)[:count]]
    source = parts.faces[rows, 0]
    copies = parts.add_vertices(parts.positions[source], parts.colours[source])
    parts.truth_vertex[copies] = parts.truth_vertex[source]
    parts.faces[rows, 0] = copies


def _add_fins(parts: _Parts, count: int) -> None:
    """A third face on an edge that has two: non-manifold."""
    owner = np.sort(parts.faces[:, :2], axis=1).astype(np.int64)
    every = np.sort(parts.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1).astype(np.int64)
    key, uses = np.unique(every[:, 0] << 32 | every[:, 1], return_counts=True)
    shared = uses[np.searchsorted(key, owner[:, 0] << 32 | owner[:, 1])] == 2
    rows = parts.rng.choice(np.flatnonzero(shared), count, replace=False)
    a, b = parts.faces[rows, 0], parts.faces[rows, 1]
    middle = 0.5 * (parts.positions[a] + parts.positions[b])
    outward = middle / np.linalg.norm(middle, axis=1, keepdims=True)
    tips = parts.add_vertices(middle + 1.2 * outward, parts.colours[a])
    parts.add_faces(np.stack([a, b, tips], axis=1))


def _collapse_faces(parts: _Parts, count: int) -> None:
    """Faces that name one vertex twice."""
    rows = parts.rng.choice(len(parts.faces), count, replace=False)
    a, b = parts.faces[rows, 0], parts.faces[rows, 1]
    parts.add_faces(np.stack([a, b, b], axis=1))


def _add_floater(parts: _Parts, sound: int) -> None:
    """A crumpled octahedron, 0.5 to 3 mm, 8 to 45 mm off the surface."""
    at = int(parts.rng.integers(sound))
    centre = parts.positions[at] + parts.rng.uniform(8.0, 45.0) * parts.normals[at]
    corners = np.concatenate([np.eye(3), -np.eye(3)])
    corners = corners * parts.rng.uniform(0.5, 3.0) * parts.rng.uniform(0.5, 1.0, (6, 1))
    index = parts.add_vertices(centre + corners, np.repeat(parts.colours[at : at + 1], 6, axis=0))
    octahedron = np.array(
        [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
    )
    parts.add_faces(index[octahedron])


def _add_unreferenced(parts: _Parts, count: int) -> None:
    points = parts.rng.uniform(-120.0, 120.0, (count, 3))
    parts.add_vertices(points, np.full((count, 3), 128, dtype=np.uint8))


def _raw_from_truth(damage: Damage, rng: np.random.Generator) -> Array:
    """Rotation by tilt_deg about a random axis, then mm to raw units, then the offset."""
    axis = rng.standard_normal(3)
    axis /= np.linalg.norm(axis)
    angle = np.radians(damage.tilt_deg)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)
    matrix = np.eye(4)
    matrix[:3, :3] = rotation / damage.mm_per_unit
    matrix[:3, 3] = damage.offset
    return matrix
