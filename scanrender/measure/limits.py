"""What the project promises about a measured row, and which promises a row breaks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

# Key of the flat row -> (sign, bound). Kept in the row itself, so that files of rows explain it.
Limits = Mapping[str, tuple[str, float]]

ATLAS: Limits = {
    "lost.charts": ("<=", 60),
    "lost.atlas_use": (">=", 0.65),
    "lost.overlap": ("<=", 0),
    "lost.flipped_triangles": ("<=", 0),
    "lost.stretch.within_1_5": (">=", 0.95),
    "stages.unwrap.seconds": ("<=", 15),
}
# Memory can only be sampled where /proc tells it: without a figure, this limit says nothing.
MAY_BE_UNKNOWN = ("peak_tree_mib",)


def missed_limits(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """A sentence for each failed row, and for each limit that a row does not keep. A figure that is
    missing, or is not a number, does not keep its limit."""
    found = []
    for row in rows:
        if "failed" in row:
            found.append(f"{row['case']} failed: {row['failed']}")
            continue
        flat = flat_row(row)
        for key, (sign, bound) in row.get("limits", {}).items():
            value = flat.get(key)
            if value is None and key in MAY_BE_UNKNOWN:
                continue
            if value is None:
                found.append(f"{row['case']}: {key} was not measured")
            elif not (value <= bound if sign == "<=" else value >= bound):
                found.append(f"{row['case']}: {key} is {value:.4g}, the limit is {sign} {bound:g}")
    return found


def flat_row(row: Mapping[str, Any]) -> dict[str, Any]:
    """One row without nesting: `stages.albedo.seconds`, `lost.charts`. Lists become their length;
    limits are left out."""
    flat: dict[str, Any] = {}

    def put(prefix: str, value: Any) -> None:
        if isinstance(value, Mapping):
            for key, inner in value.items():
                put(f"{prefix}.{key}" if prefix else key, inner)
        elif isinstance(value, (list, tuple)):
            flat[prefix] = len(value)
        else:
            flat[prefix] = value

    put("", {key: value for key, value in row.items() if key != "limits"})
    return flat
