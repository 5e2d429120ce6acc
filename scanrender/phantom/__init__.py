"""A procedural human head that stands in for a scan: seeded, labelled, and damaged on purpose.

`make_head` gives the undamaged truth (mm, linear albedo, labels), `scan_head` what a scanner would
hand over, and `write_ply` / `write_obj` / `write_truth` put them on disk.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scanrender.phantom.damage import Damage, RawScan, scan_head
    from scanrender.phantom.head import LABELS, Head, make_head
    from scanrender.phantom.write import write_obj, write_ply, write_truth

__all__ = [
    "LABELS",
    "Damage",
    "Head",
    "RawScan",
    "make_head",
    "scan_head",
    "write_obj",
    "write_ply",
    "write_truth",
]

_HOME = {
    "LABELS": "head",
    "Head": "head",
    "make_head": "head",
    "Damage": "damage",
    "RawScan": "damage",
    "scan_head": "damage",
    "write_obj": "write",
    "write_ply": "write",
    "write_truth": "write",
}


def __getattr__(name: str) -> Any:
    """Load a part when it is first asked for: importing this package must not import NumPy."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
