"""What MeshLab sees in a mesh. GPL code: runs in a child process only, and nothing depends on it.

Cleaning itself is ours (`repair`, `orient`, `holes`), because MeshLab's filters lose track of which
raw face a face came from, and with it of its texture. Known trouble: a missing system library only
prints, and the filters are then absent; broken input ends the process.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.errors import StageError
from scanrender.scan.child import run_task

SELF_INTERSECTION = "compute_selection_by_self_intersections_per_face"


def count_self_intersections(
    positions: npt.NDArray[Any], faces: npt.NDArray[Any], timeout_s: float
) -> int | None:
    """Faces that pass through others, or None where MeshLab cannot say."""
    arrays = {"positions": positions, "faces": faces}
    try:
        _, report = run_task("self_intersections", arrays, {}, timeout_s)
    except StageError:
        return None
    return int(report["faces"]) if "faces" in report else None


def self_intersections(
    arrays: dict[str, Any], params: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """In the child: one MeshLab filter."""
    import pymeshlab

    if SELF_INTERSECTION not in pymeshlab.filter_list():
        return {}, {"missing": SELF_INTERSECTION}
    meshes = pymeshlab.MeshSet(verbose=False)
    faces = np.ascontiguousarray(arrays["faces"], np.int32)
    meshes.add_mesh(pymeshlab.Mesh(np.ascontiguousarray(arrays["positions"], np.float64), faces))
    meshes.apply_filter(SELF_INTERSECTION)
    return {}, {"faces": int(meshes.current_mesh().face_selection_array().sum())}
