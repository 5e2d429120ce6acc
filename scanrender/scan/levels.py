"""Levels of detail from a prepared mesh: the side of `lods` that waits for the child."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from scanrender.asset import Mesh
from scanrender.errors import StageError
from scanrender.scan.child import run_task


def make_lods(
    mesh: Mesh, targets: Sequence[int], timeout_s: float
) -> tuple[list[Mesh], list[float], list[str]]:
    """Coarser meshes on the same atlas, finest first; how far 99 % of each one's texels slid over
    the skin in mm; and a sentence for each target that gave none."""
    coarser = [target for target in targets if target < len(mesh.faces)]
    problems = [
        f"{target} triangles: the mesh has {len(mesh.faces)}"
        for target in targets
        if target >= len(mesh.faces)
    ]
    if not coarser:
        return [], [], problems
    arrays = {field.name: getattr(mesh, field.name) for field in fields(Mesh)}
    params = {"targets": sorted(coarser, reverse=True)}
    try:
        result, report = run_task("lods", arrays, params, timeout_s)
    except StageError as error:
        return [], [], [*problems, f"any size: {error.what}"]
    made = sorted(report["slide_mm"], key=int)
    levels = [
        Mesh(
            **{
                name: np.ascontiguousarray(result[f"{number}_{name}"], array.dtype)
                for name, array in arrays.items()
            }
        )
        for number in made
    ]
    slides = [report["slide_mm"][number] for number in made]
    return levels, slides, [*problems, *report["problems"]]
