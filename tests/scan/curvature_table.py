"""Mean curvature against closed forms, as the bake computes it; prints the table of RMS errors.

    python -m tests.scan.curvature_table [--quick]

Each cell writes nothing but goes the preparation's own way: coordinates in mm, cm or m through
`clean` (welding, spikes, units) and `make_high` (which chooses the scale of smoothing). The error
is the RMS over the inner vertices as a share of the largest principal curvature there.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, Delaunay

from scanrender.scan.clean import clean
from scanrender.scan.high import make_high
from scanrender.scan.raw import RawMesh
from scanrender.scan.topology import vertex_normals
from scanrender.settings.prep import BakeSettings, CleanSettings
from scanrender.settings.scan import ScanSettings

Array = npt.NDArray[Any]
Rng = np.random.Generator
RADII = (5.0, 20.0, 100.0)
FINENESS = (10, 25)  # edges to a radius
UNITS = {"mm": 1.0, "cm": 0.1, "m": 0.001}
NOISE_MM = 0.1


@dataclass(frozen=True)
class Shape:
    """positions (n, 3) mm; faces (m, 3); expected (n,) 1/mm; inner (n,) where it is judged."""

    positions: Array
    faces: Array
    expected: Array
    inner: Array


def sheet(half_x: float, half_y: float, edge: float, rng: Rng, kind: str) -> tuple[Array, Array]:
    """Parameters (n, 2) and counter-clockwise faces of a rectangle, triangulated as `kind` says:
    shaken (a hexagonal grid, displaced), random (points without order), stretched (triangles four
    times as wide as high), graded (edges from `edge` down to a quarter of it), grid (regular)."""
    if kind == "random":
        count = int(4.0 * half_x * half_y / (0.866 * edge * edge))
        points = rng.uniform(-1.0, 1.0, (count, 2)) * [half_x, half_y]
    else:
        wide, high = (edge, 0.25 * edge) if kind == "stretched" else (edge, 0.866 * edge)
        columns, rows = int(2.0 * half_x / wide) + 1, int(2.0 * half_y / high) + 1
        x, y = np.linspace(-1.0, 1.0, columns), np.linspace(-1.0, 1.0, rows)
        if kind == "graded":
            x = np.linspace(-1.0, 1.0, 2 * columns)
            x = 0.625 * x + 0.375 * x * np.abs(x)
        x, y = np.meshgrid(half_x * x, half_y * y)
        x = x + 0.5 * wide * (np.arange(rows) % 2)[:, None] * (kind != "grid")
        points = np.stack([x, y], axis=-1).reshape(-1, 2)
        if kind != "grid":
            least = 0.25 if kind == "graded" else 1.0
            points += rng.uniform(-0.3, 0.3, points.shape) * [least * wide, high]
    faces = Delaunay(points * ([0.25, 1.0] if kind == "stretched" else 1.0)).simplices
    faces = faces.astype(np.int64)
    u, v = points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]]
    clockwise = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] < 0.0
    faces[clockwise] = faces[clockwise][:, ::-1]
    return points, faces


def sphere(radius: float, edge: float, rng: Rng, kind: str) -> Shape:
    """Points on the whole sphere, triangulated by their hull."""
    count = int(4.0 * np.pi * radius**2 / (edge**2 * 0.866))
    step = np.arange(count) + 0.5
    polar, around = np.arccos(1.0 - 2.0 * step / count), np.pi * (1.0 + 5.0**0.5) * step
    if kind == "random":
        polar, around = np.arccos(rng.uniform(-1, 1, count)), rng.uniform(0, 2 * np.pi, count)
    way = np.stack(
        [np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar), np.cos(polar)], axis=1
    )
    if kind == "graded":  # half the edges on one hemisphere
        fine = sphere(1.0, 0.5 * edge / radius, rng, "shaken").positions
        way = np.concatenate([way[way[:, 2] < 0.0], fine[fine[:, 2] >= 0.0]])
    if kind == "stretched":  # circles of latitude a quarter of an edge apart
        rows = int(np.pi * radius / (0.25 * edge))
        rings = []
        for row in range(1, rows):
            angle = np.pi * row / rows
            many = max(6, int(2.0 * np.pi * radius * np.sin(angle) / edge))
            turn = 2.0 * np.pi * (np.arange(many) + rng.random()) / many
            across = np.sin(angle) * np.ones(many)
            rings.append(
                np.stack(
                    [np.cos(turn) * across, np.sin(turn) * across, np.full(many, np.cos(angle))],
                    axis=1,
                )
            )
        way = np.concatenate([*rings, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])
    if kind == "shaken":
        way += rng.normal(0.0, 0.2 * edge / radius, way.shape)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    faces = ConvexHull(way).simplices.astype(np.int64)
    a, b, c = (way[faces[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return Shape(radius * way, faces, np.full(len(way), 1.0 / radius), np.ones(len(way), bool))


def cap(radius: float, edge: float, rng: Rng, kind: str) -> Shape:
    """The top of a sphere: a whole one of 100 mm at 1 mm edges has 145 000 vertices."""
    q, faces = sheet(0.45 * radius, 0.45 * radius, edge, rng, kind)
    height = np.sqrt(radius**2 - (q**2).sum(axis=1))
    inner = np.abs(q).max(axis=1) < 0.3 * radius
    positions = np.concatenate([q, height[:, None]], axis=1)
    return Shape(positions, faces, np.full(len(q), 1.0 / radius), inner)


def cylinder(radius: float, edge: float, rng: Rng, kind: str) -> Shape:
    q, faces = sheet(1.6 * radius, 2.0 * radius, edge, rng, kind)
    angle = q[:, 0] / radius
    positions = np.stack([radius * np.sin(angle), q[:, 1], radius * np.cos(angle)], axis=1)
    inner = (np.abs(q[:, 0]) < 0.6 * radius) & (np.abs(q[:, 1]) < radius)
    return Shape(positions, faces, np.full(len(q), 0.5 / radius), inner)


def saddle(radius: float, edge: float, rng: Rng, kind: str) -> Shape:
    """z = (x^2 - y^2) / 2R, whose principal curvatures at the middle are +-1/R."""
    q, faces = sheet(1.5 * radius, 1.5 * radius, edge, rng, kind)
    x, y = q.T
    positions = np.stack([x, y, (x * x - y * y) / (2.0 * radius)], axis=1)
    p, r = x / radius, -y / radius
    mean = ((1.0 + r * r) - (1.0 + p * p)) / (2.0 * radius * (1.0 + p * p + r * r) ** 1.5)
    return Shape(positions, faces, -mean, np.abs(q).max(axis=1) < 0.5 * radius)


def torus(radius: float, edge: float, rng: Rng, kind: str) -> Shape:
    """Tube of `radius` about a circle of 2.5 times that."""
    big = 2.5 * radius
    q, faces = sheet(0.8 * np.pi * big, 0.95 * np.pi * radius, edge, rng, kind)
    a, b = q[:, 0] / big, q[:, 1] / radius
    reach = big + radius * np.cos(b)
    positions = np.stack([reach * np.cos(a), reach * np.sin(a), radius * np.sin(b)], axis=1)
    mean = 0.5 * (1.0 / radius + np.cos(b) / reach)
    return Shape(positions, faces, mean, (np.abs(a) < 2.0) & (np.abs(b) < 2.0))


SHAPES: dict[str, Callable[[float, float, Rng, str], Shape]] = {
    "sphere": sphere,
    "cylinder": cylinder,
    "torus": torus,
    "saddle": saddle,
}
KINDS = ("shaken", "random", "stretched", "graded")


def noise_case(radius: float, kind: str) -> Shape:
    """A sphere, or its cap, of about one vertex in 0.866 mm^2, with noise of NOISE_MM."""
    rng = np.random.default_rng(3)
    make = sphere if radius < 50.0 else cap
    return noisy(make(radius, 2.0 if kind == "stretched" else 1.0, rng, kind), rng)


def noisy(shape: Shape, rng: Rng, deviation_mm: float = NOISE_MM) -> Shape:
    offset = rng.normal(0.0, deviation_mm, (len(shape.positions), 1))
    moved = shape.positions + offset * vertex_normals(shape.positions, shape.faces)
    return Shape(moved, shape.faces, shape.expected, shape.inner)


def baked_curvature(shape: Shape, unit: str = "mm") -> tuple[Array, float]:
    """(n,) 1/mm at the vertices of the shape, and the scale of smoothing in mm, by the stages that
    the preparation runs; the file would have been in `unit`, far from the origin."""
    raw = RawMesh(UNITS[unit] * (shape.positions + 700.0), shape.faces)
    cleaned = clean(raw, ScanSettings(units=unit), CleanSettings(hole_mm=0.0))
    assert len(cleaned.surface.positions) == len(shape.positions), "so that rows still agree"
    high = make_high(cleaned.surface, BakeSettings(maps=("curvature",)))
    assert high.curvature is not None
    assert high.curvature_scale_mm is not None
    # An open sheet has no outside: `clean` may turn it.
    surface = cleaned.surface
    before = vertex_normals(shape.positions, shape.faces) @ cleaned.frame.rotation.T
    after = vertex_normals(surface.positions, surface.faces)
    sign = np.sign(np.einsum("ij,ij->", before, after))
    return sign * high.curvature, high.curvature_scale_mm


def rms_share(shape: Shape, largest: float, unit: str = "mm") -> tuple[float, float]:
    """RMS error as a share of the largest principal curvature, and the scale in mm."""
    found, scale = baked_curvature(shape, unit)
    assert shape.inner.sum() > 50
    error = (found - shape.expected)[shape.inner]
    return float(np.sqrt(np.mean(error**2))) / largest, scale


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one fineness, one unit")
    options = parser.parse_args()
    worst = 0.0
    print("| shape | R, mm | edge, mm | triangulation | unit | smoothed over, mm | RMS error |")
    print("|---|---|---|---|---|---|---|")
    for name, make in SHAPES.items():
        for radius in RADII:
            for fineness in FINENESS[:1] if options.quick else FINENESS:
                for kind in KINDS:
                    made = make(radius, radius / fineness, np.random.default_rng(1), kind)
                    for unit in ("mm",) if options.quick else UNITS:
                        error, scale = rms_share(made, 1.0 / radius, unit)
                        worst = max(worst, error)
                        row = f"{radius:g} | {radius / fineness:g} | {kind} | {unit} | {scale:.2f}"
                        print(f"| {name} | {row} | {100.0 * error:.2f} % |", flush=True)
    for radius in (20.0, 100.0):
        for kind in KINDS:
            made = noise_case(radius, kind)
            for unit in ("mm",) if options.quick else UNITS:
                error, scale = rms_share(made, 1.0 / radius, unit)
                row = f"{radius:g} | 1, noise 0.1 | {kind} | {unit} | {scale:.2f}"
                print(f"| sphere | {row} | {100.0 * error:.2f} % |", flush=True)
    print(f"\nworst without noise: {100.0 * worst:.2f} %")
    return 0


if __name__ == "__main__":
    sys.exit(main())
