"""Units and orientation: from the scan's own axes to millimetres, +Y up, the face toward +Z."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.errors import ConfigError
from scanrender.scan.raw import RawMesh
from scanrender.scan.topology import area_normals
from scanrender.settings.scan import ScanSettings

MM_PER = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}
# Largest extent of what is scanned: a face alone to head, bust and shoulders; or a whole person.
BUST_MM = (150.0, 800.0)
PERSON_MM = (1200.0, 2300.0)
ASSUMED_MM = 320.0  # head with neck, when nothing else can be said


@dataclass(frozen=True)
class Frame:
    """How raw coordinates become asset coordinates: rotation (3, 3), mm per unit, origin (3,) raw.

    x_asset = mm_per_unit * rotation @ (x_raw - origin). `units` and `axes` say why, as plain JSON.
    """

    rotation: npt.NDArray[np.float64]
    mm_per_unit: float
    origin: npt.NDArray[np.float64]
    units: dict[str, Any]
    axes: dict[str, Any]
    warnings: tuple[str, ...]

    def asset_from_raw(self, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Points (n, 3) from scan units to millimetres, in float64."""
        return np.asarray((points - self.origin) @ self.rotation.T * self.mm_per_unit)

    @property
    def raw_from_asset(self) -> list[list[float]]:
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation.T / self.mm_per_unit
        matrix[:3, 3] = self.origin
        return [[float(x) for x in row] for row in matrix]


def find_frame(
    raw: RawMesh,
    positions: npt.NDArray[np.float64],
    faces: npt.NDArray[np.int64],
    settings: ScanSettings,
) -> Frame:
    """Decide from the settings, the file format, and the mesh without its floaters.

    Raises ConfigError when the stated axes do not make a frame.
    """
    up, up_reason = _up_axis(raw, positions, settings)
    front, front_reason = _front_axis(raw, positions, faces, up, settings)
    vertical, forward = _axis(up), _axis(front)
    if abs(float(vertical @ forward)) > 0.5:
        raise ConfigError(
            f"scan.up {up} and scan.front {front} lie on the same axis",
            "scan.up, scan.front",
            "name two different axes",
        )
    rotation = np.stack([np.cross(vertical, forward), vertical, forward])
    used = positions[np.unique(faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    extent = high - low
    units = _units(raw, extent, float(np.abs(vertical) @ extent), settings)
    axes = {"up": up, "up_reason": up_reason, "front": front, "front_reason": front_reason}
    warnings = []
    if units["confidence"] == "low":
        warnings.append(f"the scale is a guess: {units['reason']}; state scan.units or height_mm")
    if "guess" in front_reason or "guess" in up_reason:
        warnings.append(f"the orientation is a guess (up {up}, front {front}): state scan.up")
    return Frame(rotation, units["mm_per_unit"], 0.5 * (low + high), units, axes, tuple(warnings))


def _axis(name: str) -> npt.NDArray[np.float64]:
    vector = np.zeros(3)
    vector["xyz".index(name[1])] = 1.0 if name[0] == "+" else -1.0
    return vector


def _name(axis: int, sign: float) -> str:
    return ("+" if sign >= 0 else "-") + "xyz"[axis]


def _units(
    raw: RawMesh, extent: npt.NDArray[np.float64], height: float, settings: ScanSettings
) -> dict[str, Any]:
    def verdict(mm: float, reason: str, confidence: str) -> dict[str, Any]:
        return {"mm_per_unit": float(mm), "reason": reason, "confidence": confidence}

    if settings.height_mm is not None:
        return verdict(settings.height_mm / height, "scan.height_mm states the height", "stated")
    if settings.units != "auto":
        mm = MM_PER[settings.units] if isinstance(settings.units, str) else settings.units
        return verdict(mm, "scan.units states the unit", "stated")
    largest = float(extent.max())
    if raw.mm_hint is not None and _fits(largest * raw.mm_hint) is not None:
        return verdict(raw.mm_hint, "the file format is in metres, and the size agrees", "high")
    for unit in ("mm", "m", "cm"):
        kind = _fits(largest * MM_PER[unit])
        if kind is not None:
            reason = f"read as {unit}, the size is a {kind}'s: {largest * MM_PER[unit]:.0f} mm"
            return verdict(MM_PER[unit], reason, "medium")
    return verdict(
        ASSUMED_MM / largest,
        f"no unit makes {largest:.4g} the size of a person, so {ASSUMED_MM:.0f} mm is assumed",
        "low",
    )


def _fits(size_mm: float) -> str | None:
    if BUST_MM[0] <= size_mm <= BUST_MM[1]:
        return "head or bust"
    return "person" if PERSON_MM[0] <= size_mm <= PERSON_MM[1] else None


def _up_axis(
    raw: RawMesh, positions: npt.NDArray[np.float64], settings: ScanSettings
) -> tuple[str, str]:
    if settings.up != "auto":
        return settings.up, "stated"
    if raw.up_hint is not None:
        return raw.up_hint, "the file format fixes it"
    extent = np.ptp(positions, axis=0)
    if extent[2] > 1.25 * extent[1] and extent[2] > 1.1 * extent[0]:
        return "+z", "a guess: the scan is tallest along z"
    if extent[1] >= 0.8 * extent.max():
        return "+y", "the usual axis, and the scan is tall along it"
    return "+y", "a guess: the usual axis"


def _front_axis(
    raw: RawMesh,
    positions: npt.NDArray[np.float64],
    faces: npt.NDArray[np.int64],
    up: str,
    settings: ScanSettings,
) -> tuple[str, str]:
    """Stated; or where an open shell looks; or across the mirror plane; or the usual axis."""
    vertical = "xyz".index(up[1])
    if settings.front != "auto":
        return settings.front, "stated"
    usual = {1: "+z", 2: "-y", 0: "+z"}[vertical]
    normal = area_normals(positions, faces)
    mean = normal.sum(axis=0) / max(float(np.linalg.norm(normal, axis=1).sum()), 1e-300)
    mean[vertical] = 0.0
    axis = int(np.abs(mean).argmax())
    if abs(mean[axis]) > 0.12:
        return _name(axis, mean[axis]), "the surface is open at the opposite side"
    mirror = _mirror_axis(positions, faces, vertical)
    if mirror is not None and mirror == "xyz".index(usual[1]):
        other = 3 - vertical - mirror
        return _name(other, 1.0), "a guess: the left and right halves mirror along the usual front"
    return usual, "a guess: the usual axis"


def _mirror_axis(
    positions: npt.NDArray[np.float64], faces: npt.NDArray[np.int64], vertical: int
) -> int | None:
    """The horizontal axis along which the shape mirrors clearly better than along the other."""
    from scipy.spatial import cKDTree

    points = positions[np.unique(faces)]
    rng = np.random.default_rng(0)
    if len(points) > 20_000:
        points = points[rng.choice(len(points), 20_000, replace=False)]
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    tree = cKDTree(points)
    error = {}
    for axis in range(3):
        if axis != vertical:
            mirrored = points[::7].copy()
            mirrored[:, axis] = 2.0 * centre[axis] - mirrored[:, axis]
            error[axis] = float(np.median(tree.query(mirrored)[0]))
    (a, error_a), (_, error_b) = sorted(error.items(), key=lambda item: item[1])
    return a if error_a < 0.6 * error_b else None
