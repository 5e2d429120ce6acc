"""Units and orientation: from the scan's own axes to millimetres, +Y up, the face toward +Z."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.errors import ConfigError
from scanrender.scan.facing import find_facing, spread_samples
from scanrender.scan.outliers import bulk_extent
from scanrender.scan.raw import RawMesh
from scanrender.scan.topology import edges_of, extent, span, used_vertices
from scanrender.settings.scan import ScanSettings

MM_PER = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}
# Largest extent of what is scanned: a face alone to head, bust and shoulders; or a whole person.
BUST_MM = (150.0, 800.0)
PERSON_MM = (1200.0, 2300.0)
HEAD_MM = (190.0, 300.0)  # from the neck's narrowest place to the crown, child to tall adult
HEAD_TYPICAL_MM = 240.0
ASSUMED_MM = 320.0  # head with neck, when nothing else can be said
TURN_DEG = 15.0  # a face that looks further than this past an axis is turned onto it
_FLAT = 0.02
_BULK = 5.0  # times the size of nearly all vertices: more is a size that a few of them make
_LIKELY_MM = (10.0, 5000.0)  # from a fingertip to a group of people: else the unit is another
_NO_HEIGHT = 1e-6  # of the largest extent: rounding
_BASE = 0.2  # the lowest part of a bust, where the rim of its base lies even when it is tilted
# An axis, the reason, and the confidence: stated, high, medium or low.
_Verdict = tuple[str, str, str]


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
        moved = (points - self.origin) @ self.rotation.T
        moved *= self.mm_per_unit  # in place: fresh memory of a million points takes longer
        return np.asarray(moved)

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

    Raises ConfigError when the stated axes do not make a frame, or the stated height no scale.
    """
    up = _up_axis(raw, positions, faces, settings)
    front, past, head = _front(raw, positions, faces, up, settings)
    vertical, forward = _axis(up[0]), _axis(front[0])
    if abs(float(vertical @ forward)) > 0.5:
        raise ConfigError(
            f"scan.up {up[0]} and scan.front {front[0]} lie on the same axis",
            "scan.up, scan.front",
            "name two different axes",
        )
    forward = _turned(vertical, forward, past)
    rotation = np.stack([np.cross(vertical, forward), vertical, forward])
    used = _used(positions, faces)
    low, high = extent(used)
    bulk_low, bulk_high = bulk_extent(used)
    is_doubtful = float((high - low).max()) > _BULK * float((bulk_high - bulk_low).max())
    units = _units(raw, span(used @ rotation.T), head, is_doubtful, settings)
    axes = {
        "up": up[0],
        "up_reason": up[1],
        "up_confidence": up[2],
        "front": front[0],
        "front_turn_deg": past,
        "front_reason": front[1],
        "front_confidence": front[2],
    }
    warnings = []
    if units["confidence"] == "low":
        warnings.append(f"the scale is a guess: {units['reason']}; state scan.units or height_mm")
    size_mm = float((high - low).max()) * units["mm_per_unit"]
    if units["confidence"] == "stated" and not _LIKELY_MM[0] <= size_mm <= _LIKELY_MM[1]:
        warnings.append(
            f"the scan is {size_mm:.3g} mm large, as scan.units or scan.height_mm states it: "
            "if that is not what it shows, state another, or none"
        )
    unsure = [name for name, verdict in (("up", up), ("front", front)) if verdict[2] == "low"]
    if unsure:
        warnings.append(
            f"the orientation is a guess (up {up[0]}, front {front[0]}): "
            f"state {' and '.join('scan.' + name for name in unsure)}"
        )
    return Frame(rotation, units["mm_per_unit"], 0.5 * (low + high), units, axes, tuple(warnings))


def _used(
    positions: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]
) -> npt.NDArray[np.float64]:
    """The vertices that faces name: not a copy where that is all of them."""
    named = used_vertices(faces, len(positions))
    return positions if named.all() else positions[named]


def _axis(name: str) -> npt.NDArray[np.float64]:
    vector = np.zeros(3)
    vector["xyz".index(name[1])] = 1.0 if name[0] == "+" else -1.0
    return vector


def _name(axis: int, sign: float) -> str:
    return ("+" if sign >= 0 else "-") + "xyz"[axis]


def _units(
    raw: RawMesh,
    size: npt.NDArray[np.float64],
    head: float | None,
    is_doubtful: bool,
    settings: ScanSettings,
) -> dict[str, Any]:
    """size (3,): across, up and forward; head: neck to crown, where known; in scan units.
    is_doubtful: a few vertices alone make the size."""

    def verdict(mm: float, reason: str, confidence: str) -> dict[str, Any]:
        return {"mm_per_unit": float(mm), "reason": reason, "confidence": confidence}

    if settings.height_mm is not None:
        if size[1] <= _NO_HEIGHT * size.max():
            raise ConfigError(
                "scan.height_mm cannot give the scale: the scan has no height along its up axis",
                "scan.height_mm",
                "state scan.units instead, or another scan.up",
            )
        return verdict(
            settings.height_mm / float(size[1]), "scan.height_mm states the height", "stated"
        )
    if settings.units != "auto":
        mm = MM_PER[settings.units] if isinstance(settings.units, str) else settings.units
        return verdict(mm, "scan.units states the unit", "stated")
    largest = float(size.max())
    if raw.mm_hint is not None and _fits(largest * raw.mm_hint) is not None:
        return verdict(raw.mm_hint, "the file format is in metres, and the size agrees", "high")
    confidence = "medium"
    for unit in ("mm", "m", "cm", "in"):
        size_mm = largest * MM_PER[unit]
        kind = _fits(size_mm)
        # Inches are rare enough to need a second witness: the size of the head above its neck.
        if unit == "in" and (head is None or not HEAD_MM[0] <= head * 25.4 <= HEAD_MM[1]):
            continue
        if kind is not None:
            reason = f"read as {unit}, the size is a {kind}'s: {size_mm:.0f} mm"
            if is_doubtful:
                reason += ", but nearly all of its vertices lie in a small part of that"
                confidence = "low"
            if raw.mm_hint is not None:
                reason = f"in metres, as the file format says, it is {largest:.4g} m; {reason}"
                confidence = "low"
            return verdict(MM_PER[unit], reason, confidence)
    if head is not None:
        reason = f"no unit makes {largest:.4g} the size of a person, so the head above its neck is "
        return verdict(HEAD_TYPICAL_MM / head, reason + f"taken as {HEAD_TYPICAL_MM:.0f} mm", "low")
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
    raw: RawMesh,
    positions: npt.NDArray[np.float64],
    faces: npt.NDArray[np.int64],
    settings: ScanSettings,
) -> _Verdict:
    if settings.up != "auto":
        return settings.up, "scan.up states it", "stated"
    if raw.up_hint is not None:
        return raw.up_hint, "the file format fixes it", "high"
    used = _used(positions, faces)
    cut = _cut_end(used, faces, positions)
    if cut is not None:
        return cut, "the surface is cut open at the opposite end, as a bust is", "high"
    size = span(used)
    if size[2] > 1.25 * size[1] and size[2] > 1.1 * size[0]:
        return "+z", "a guess: the scan is tallest along z", "low"
    if size[1] >= 0.8 * size.max():
        return "+y", "the usual axis, and the scan is tall along it", "medium"
    return "+y", "a guess: the usual axis", "low"


def _cut_end(
    used: npt.NDArray[np.float64],
    faces: npt.NDArray[np.int64],
    positions: npt.NDArray[np.float64],
) -> str | None:
    """The axis whose lower end holds nearly all of a wide opening: a bust cut off at its base."""
    edges = edges_of(faces)
    open_pairs = edges.pairs[edges.count == 1]
    if not len(open_pairs):
        return None
    ends = positions[open_pairs]
    length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    low, high = extent(used)
    size = high - low
    if length.sum() < 0.35 * size.sum():  # a few holes are not a base
        return None
    place = (ends.mean(axis=1) - low) / np.maximum(size, 1e-300)
    below = [float(length[place[:, axis] < _BASE].sum()) for axis in range(3)]
    above = [float(length[place[:, axis] > 1.0 - _BASE].sum()) for axis in range(3)]
    share = np.array(below + above) / length.sum()
    share[np.tile(size < _FLAT * size.max(), 2)] = 0.0  # a sheet has no ends across itself
    best = int(share.argmax())
    # Eye sockets lie at one end too, but do not span it.
    across = np.delete(span(place), best % 3).min()
    if share[best] < 0.8 or across < 0.4:
        return None
    return _name(best % 3, 1.0 if best < 3 else -1.0)


def _front(
    raw: RawMesh,
    positions: npt.NDArray[np.float64],
    faces: npt.NDArray[np.int64],
    up: _Verdict,
    settings: ScanSettings,
) -> tuple[_Verdict, float, float | None]:
    """The axis that the face looks along, by how many degrees about `up` it looks past it, and the
    height of the head in scan units where it could be told from the neck."""
    vertical = _axis(up[0])
    usual = {1: "+z", 2: "-y", 0: "+z"}["xyz".index(up[0][1])]
    first = _axis(usual)
    canonical = np.stack([first, np.cross(vertical, first), vertical])
    points, normals = spread_samples(positions, faces)
    found = find_facing(points @ canonical.T, normals @ canonical.T)
    head = None if found is None else found.head
    if settings.front != "auto":
        return (settings.front, "scan.front states it", "stated"), 0.0, head
    if found is None:
        if raw.up_hint is not None:
            reason = "the file format's convention; the shape does not say"
            return (usual, reason, "medium"), 0.0, head
        return (usual, "a guess: the usual axis, since the shape does not say", "low"), 0.0, head
    quarter = round(found.yaw / (np.pi / 2.0))
    past = float(np.degrees(found.yaw - quarter * np.pi / 2.0))
    forward = np.cos(quarter * np.pi / 2.0) * first + np.sin(quarter * np.pi / 2.0) * canonical[1]
    axis = int(np.abs(forward).argmax())
    confidence = "low" if up[2] == "low" else found.confidence
    reason = ("a guess like its up axis: " if up[2] == "low" else "") + found.reason
    # The pose of a head in its scan is rarely exact: only a plain turn is taken out.
    past = float(round(past)) if abs(past) > TURN_DEG else 0.0
    return (_name(axis, forward[axis]), reason, confidence), past, head


def _turned(
    vertical: npt.NDArray[np.float64], forward: npt.NDArray[np.float64], degrees: float
) -> npt.NDArray[np.float64]:
    angle = np.radians(degrees)
    return np.asarray(np.cos(angle) * forward + np.sin(angle) * np.cross(vertical, forward))
