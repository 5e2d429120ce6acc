"""Vertex and face colours as files store them: bytes, 16 bits, or fractions, all in sRGB."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.images import linear_from_srgb


def colors_from_stored(
    stored: npt.NDArray[Any], full: float | None, notes: list[str], what: str = "vertices"
) -> npt.NDArray[np.float32] | None:
    """(n, 3) linear Rec.709 of stored sRGB values (n, 3); None when none of them is a number.

    full: what white is stored as, or None where the file does not say: then 1, 255 or 65535, the
    least that holds them all. Those without a colour take the mean one; what: what has them.
    """
    if stored.dtype == np.uint8 and full == 255.0:
        table = linear_from_srgb(np.arange(256) / 255.0).astype(np.float32)
        return np.asarray(table[stored])
    stored = np.asarray(stored, np.float64)
    known = np.isfinite(stored).all(axis=1)
    if not known.any():
        if len(stored):
            notes.append(f"the colours of its {what} are not numbers: they are ignored")
        return None
    if not known.all():
        notes.append(f"{int((~known).sum())} {what} have no colour: they take the mean one")
        stored = np.where(known[:, None], stored, stored[known].mean(axis=0))
    if full is None:
        largest = float(stored.max())
        full = 1.0 if largest <= 1.5 else 255.0 if largest <= 255.0 else 65535.0
    return np.asarray(linear_from_srgb(stored / full), np.float32)
