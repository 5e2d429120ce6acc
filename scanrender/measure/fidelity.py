"""`scanrender bench fidelity`: what preparing to 50 k triangles loses of scans with a known truth:
distance, ears and pieces, colour, the finished picture, and whether seams can be seen.

A scanner's noise is not worth keeping: up to 0.05 mm the prepared surface is held against the raw
one, and where noise is larger, against the surface before the noise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.asset import Asset, Mesh
from scanrender.errors import DeviceError, ScanrenderError
from scanrender.files import make_folder
from scanrender.measure import tables
from scanrender.measure.bust import Truth, bust_scan, phantom_bust
from scanrender.measure.chosen import chosen
from scanrender.measure.limits import ATLAS, Limits
from scanrender.measure.prep_bench import write_rows
from scanrender.scan.ingest import read_scan
from scanrender.scan.lost import sample_surface, surface_distance
from scanrender.scan.prepare import prepare
from scanrender.scan.rays import Target
from scanrender.scan.topology import components, face_areas
from scanrender.settings.prep import PrepSettings
from scanrender.settings.scan import ScanSettings

Array = npt.NDArray[Any]
Say = Callable[[str], None]

STATED = ScanSettings(units="mm", up="+y", front="+z")
SAMPLES = 100_000
EAR_MM = 1.0  # an ear that lost its rim is off by ten
MAPS = {"albedo_px": 4096, "normal_px": 4096, "data_px": 1024}

COMMON: Limits = {
    **ATLAS,
    "ears_mm.max": ("<=", EAR_MM),
    "components_changed": ("<=", 0),
    "lost.color_de2000.mean": ("<=", 1.0),
    "front.mean": ("<=", 1.0),
    "front.p95": ("<=", 3.0),
    "profile.mean": ("<=", 1.0),
    "profile.p95": ("<=", 3.0),
    "seams.contrast": ("<=", 1.05),
    "seams.seam_px": (">=", 1000),
}


@dataclass(frozen=True)
class FidelityCase:
    """A scan with its truth, how it is prepared, and whether `raw` or `truth` judges the shape."""

    name: str
    meaning: str
    make: Callable[[Path, Path], Truth]  # (folder for inputs, folder of the real scans)
    judge: str = "raw"
    triangles: int = 50_000
    bake: Mapping[str, Any] = field(default_factory=lambda: MAPS)
    picture_px: int = 1024
    supersampling: int = 4

    @property
    def limits(self) -> dict[str, tuple[str, float]]:
        shape = f"distance_{self.judge}_mm"
        return {f"{shape}.mean": ("<=", 0.05), f"{shape}.p99": ("<=", 0.2), **COMMON}


def _bust(noise_mm: float) -> Callable[[Path, Path], Truth]:
    return lambda folder, scans: bust_scan(folder, scans, noise_mm)


FIDELITY_CASES = {
    case.name: case
    for case in (
        *(
            FidelityCase(
                f"noise_{noise_mm:g}",
                f"bust of 388 mm, 1.13 M to 50 k, sensor noise {noise_mm:g} mm",
                _bust(noise_mm),
                "raw" if noise_mm <= 0.05 else "truth",
            )
            for noise_mm in (0.0, 0.02, 0.05, 0.1)
        ),
        FidelityCase(
            "phantom",
            "our own head, 1.1 M to 50 k, sensor noise 0.03 mm",
            lambda folder, scans: phantom_bust(folder, 1_100_000),
        ),
    )
}


def fidelity_list(text: str) -> list[FidelityCase]:
    """`noise_0,phantom`, or `all`. Raises UsageError for a case that does not exist."""
    return [FIDELITY_CASES[name] for name in chosen(text, FIDELITY_CASES)]


def bench_fidelity(
    cases: Sequence[FidelityCase], out: Path, scans: Path, say: Say
) -> list[dict[str, Any]]:
    """Run the cases and write OUT/fidelity.json and .csv, and pictures to OUT/pictures/CASE.

    One row each, also for failures. Without a GL device the pictures are left out, and their
    limits count as missed. Raises OutputError.
    """
    make_folder(out)
    rows: list[dict[str, Any]] = []
    for case in cases:
        say(f"{case.name}: {case.meaning}")
        try:
            rows.append(_row(case, out, scans, say))
        except ScanrenderError as error:
            say(str(error))
            rows.append({"case": case.name, "meaning": case.meaning, "failed": error.what})
        write_rows(out, "fidelity", rows)
    return rows


def _row(case: FidelityCase, out: Path, scans: Path, say: Say) -> dict[str, Any]:
    truth = case.make(out / "inputs", scans)
    folder = out / "assets" / f"fidelity_{case.name}"
    wanted = {"simplify": {"triangles": case.triangles}, "bake": dict(case.bake)}
    asset = prepare(truth.scan, STATED, PrepSettings.model_validate(wanted), folder, maps=())
    info = asset.info
    row = {
        "case": case.name,
        "meaning": case.meaning,
        "raw_triangles": info["counts"]["raw"]["triangles"],
        "triangles": info["counts"]["prepared"]["triangles"],
        "judge": case.judge,
        **shape_losses(asset, truth),
        "lost": info["lost"],
        "stages": {stage["name"]: {"seconds": stage["seconds"]} for stage in info["stages"]},
        "warnings": info["warnings"],
        "limits": case.limits,
    }
    say(f"{case.name}: pictures")
    try:
        row.update(_pictures(case, truth, folder, out))
    except DeviceError as error:
        say(f"no pictures: {error.what}")
    return row


def shape_losses(asset: Asset, truth: Truth) -> dict[str, Any]:
    """Distances in mm between the prepared surface and the raw and the undamaged one, both ways;
    from the undamaged ears to the prepared surface; and how the number of pieces changed."""
    positions, faces = _welded(asset.mesh)
    asset_from_raw = np.linalg.inv(np.asarray(asset.info["raw_from_asset"]))
    raw = read_scan(truth.scan)
    raw_positions = _moved(asset_from_raw, raw.positions)
    clean = _moved(asset_from_raw @ np.linalg.inv(truth.truth_from_raw), truth.positions_mm)
    prepared = Target(positions, faces)
    ears = sample_surface(clean, truth.faces[truth.ears], SAMPLES // 4, 5)
    away = prepared.nearest(ears).distance
    pieces = components(faces, len(positions))[0]
    return {
        "distance_raw_mm": _both_ways(raw_positions, raw.faces, positions, faces),
        "distance_truth_mm": _both_ways(clean, truth.faces, positions, faces),
        "ears_mm": {"mean": float(away.mean()), "max": float(away.max())},
        "components_changed": abs(pieces - truth.components),
    }


def _both_ways(target: Array, target_faces: Array, positions: Array, faces: Array) -> Any:
    solid = face_areas(target, target_faces) > 0.0
    measured = surface_distance(Target(target, target_faces[solid]), positions, faces, SAMPLES)
    return measured["symmetric_mm"]


def _pictures(case: FidelityCase, truth: Truth, folder: Path, out: Path) -> dict[str, Any]:
    from scanrender.measure.compare_views import RENDERED_MAPS, compare_views
    from scanrender.measure.seams import seam_visibility
    from scanrender.render.device import device

    device()
    pictures, reference = out / "pictures" / case.name, folder.with_name(f"{folder.name}_as_is")
    wanted = {"report": "short", "bake": {**case.bake, "maps": list(RENDERED_MAPS)}}
    settings = PrepSettings.model_validate(wanted)
    asset = prepare(truth.scan, STATED, settings, reference, as_is=True, maps=())
    unwrap = next(stage for stage in asset.info["stages"] if stage["name"] == "unwrap")
    views = compare_views(reference, folder, pictures, case.picture_px, case.supersampling)
    seams = seam_visibility(reference, folder, pictures, case.picture_px)
    return {**views, "seams": seams, "as_is_unwrap": unwrap["notes"]["rung"]}


def _welded(mesh: Mesh) -> tuple[Array, Array]:
    unique, index = np.unique(mesh.positions_mm, axis=0, return_inverse=True)
    return unique.astype(np.float64), index.reshape(-1)[mesh.faces].astype(np.int64)


def _moved(matrix: Array, points: Array) -> Array:
    return np.asarray(points @ matrix[:3, :3].T + matrix[:3, 3])


def fidelity_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows as one table for people, a column a case."""
    return tables.text(tables.case_table(rows, FIDELITY_LINES)) or "no case was completed"


FIDELITY_LINES = (
    ("case", "case"),
    ("raw_triangles", "raw triangles"),
    ("triangles", "triangles"),
    ("distance_raw_mm.mean", "to the raw surface: mean mm"),
    ("distance_raw_mm.p99", "to the raw surface: 99 % mm"),
    ("distance_truth_mm.mean", "to the undamaged surface: mean mm"),
    ("distance_truth_mm.p99", "to the undamaged surface: 99 % mm"),
    ("ears_mm.max", "furthest point of an ear mm"),
    ("components_changed", "pieces gained or lost"),
    ("lost.color_de2000.mean", "colour reprojected dE2000 mean"),
    ("lost.color_de2000.p95", "colour reprojected dE2000 95 %"),
    ("as_is_unwrap", "texture coordinates of the as-is asset"),
    ("front.mean", "picture, front: dE2000 mean"),
    ("front.p95", "picture, front: dE2000 95 %"),
    ("profile.mean", "picture, profile: dE2000 mean"),
    ("profile.p95", "picture, profile: dE2000 95 %"),
    ("seams.contrast", "edges at seams / without seams"),
    ("seams.seam_px", "seam pixels looked at"),
    ("lost.charts", "charts"),
    ("lost.atlas_use", "atlas use"),
    ("lost.overlap", "atlas overlap"),
    ("lost.flipped_triangles", "flipped triangles"),
    ("lost.stretch.within_1_5", "texels within 1.5x density"),
    ("stages.unwrap.seconds", "unwrap s"),
)
