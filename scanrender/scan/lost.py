"""What the preparation lost: the distance between the prepared and the raw surface, both ways.

Cignoni, Rocchini, Scopigno: Metro: Measuring Error on Simplified Surfaces, CGF 17(2), 1998.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.scan.rays import Hits, Target
from scanrender.scan.topology import face_areas

Array = npt.NDArray[Any]

SAMPLES = 20_000


def surface_distance(
    raw: Target, positions: Array, faces: Array, samples: int = SAMPLES
) -> dict[str, Any]:
    """Mean, 99 % and largest distance in mm, by seeded samples, for each direction and for both."""
    low = Target(positions, faces)
    to_raw = raw.nearest(sample_surface(positions, faces, samples, 1)).distance
    to_low = low.nearest(sample_surface(raw.positions, raw.faces, samples, 2)).distance
    both = np.concatenate([to_raw, to_low])
    return {
        "prepared_to_raw_mm": _summary(to_raw),
        "raw_to_prepared_mm": _summary(to_low),
        "symmetric_mm": _summary(both),
        "samples": samples,
    }


def sample_surface(positions: Array, faces: Array, count: int, seed: int) -> Array:
    """Points (count, 3) spread evenly by area."""
    hits = sample_hits(positions, faces, count, seed)
    return np.asarray(np.einsum("kc,kcd->kd", hits.bary, positions[faces[hits.face]]))


def sample_hits(positions: Array, faces: Array, count: int, seed: int) -> Hits:
    """The same points as faces and barycentric coordinates."""
    rng = np.random.default_rng(seed)
    area = face_areas(positions, faces)
    face = rng.choice(len(faces), count, p=area / area.sum())
    r, s = np.sqrt(rng.random(count)), rng.random(count)
    bary = np.stack([1.0 - r, r * (1.0 - s), r * s], axis=1)
    return Hits(face, bary, np.zeros(count))


def _summary(distance: Array) -> dict[str, float]:
    return {
        "mean": float(distance.mean()),
        "p99": float(np.percentile(distance, 99)),
        "max": float(distance.max()),
    }
