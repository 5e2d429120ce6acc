"""What the preparation lost, measured: distance, colour, density, atlas.

Distance: Cignoni, Rocchini, Scopigno: Metro: Measuring Error on Simplified Surfaces, CGF 17(2),
1998. Colour: Sharma, Wu, Dalal: The CIEDE2000 Color-Difference Formula, Color Research and
Application 30(1), 2005, between the raw surface and the atlas at the nearest point of the prepared
mesh. Density is linear: texels per millimetre of the actual surface.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.asset import PREP_REPORT, PREP_VIEWS
from scanrender.files import write_json
from scanrender.images import Image
from scanrender.metrics import delta_e_2000_linear
from scanrender.scan.bake_albedo import ColorSource
from scanrender.scan.flatten import signed_areas
from scanrender.scan.high import High, Low
from scanrender.scan.lost import sample_hits
from scanrender.scan.pages import Page
from scanrender.scan.rasterize import overlap_share
from scanrender.scan.rays import Target
from scanrender.scan.topology import face_areas

Array = npt.NDArray[Any]

COLOR_SAMPLES = 20_000
OVERLAP_PX = 1024
NEAR = 1.5  # a texel's density within this factor of the median counts as even
# Points of the raw surface further than this from the prepared one were left out on purpose.
FOREIGN_MM = 2.0


def atlas_report(low: Low, size: int) -> dict[str, Any]:
    """Charts, atlas use, flips, overlap, and how even the density is, for a map of `size`."""
    uv, faces = low.mesh.uv.astype(np.float64), low.mesh.faces.astype(np.int64)
    area = np.abs(signed_areas(uv, faces))
    overlap = overlap_share(uv, faces, OVERLAP_PX)
    return {
        "charts": int(low.unwrapped.report["charts"]),
        "atlas_use": float(area.sum()),
        "flipped_triangles": int(low.unwrapped.report["flipped"]),
        "overlap": overlap,
        "stretch": density_spread(low, size),
    }


def face_density(low: Low, size: int) -> Array:
    """(m,) linear texels per mm of each triangle, for a map of `size`."""
    texels = np.abs(signed_areas(low.mesh.uv.astype(np.float64), low.mesh.faces.astype(np.int64)))
    surface = face_areas(low.positions, low.faces)
    return np.asarray(size * np.sqrt(texels / np.maximum(surface, 1e-12)))


def density_spread(low: Low, size: int) -> dict[str, float]:
    """Percentiles of the density by texels, and the share of texels near the median."""
    density = face_density(low, size)
    texels = np.abs(signed_areas(low.mesh.uv.astype(np.float64), low.mesh.faces.astype(np.int64)))
    order = np.argsort(density)
    passed = np.cumsum(texels[order])
    names = {"p01": 0.01, "p05": 0.05, "median": 0.5, "p95": 0.95, "p99": 0.99}
    at = {name: np.searchsorted(passed, share * passed[-1]) for name, share in names.items()}
    last = len(order) - 1
    spread = {f"{name}_px_per_mm": float(density[order[min(i, last)]]) for name, i in at.items()}
    median = spread["median_px_per_mm"]
    near = (density > median / NEAR) & (density < median * NEAR)
    spread["within_1_5"] = float(texels[near].sum() / max(float(texels.sum()), 1e-300))
    return spread


def color_error(
    high: High, low: Low, color: ColorSource, albedo: Image, samples: int = COLOR_SAMPLES
) -> dict[str, float] | None:
    """dE2000 of the atlas against the raw colours, over the raw surface; None without colours."""
    if color.kind == "none":
        return None
    surface = high.surface
    hits = sample_hits(surface.positions, surface.faces, samples, 3)
    points = np.einsum("kc,kcd->kd", hits.bary, surface.positions[surface.faces[hits.face]])
    target = Target(low.positions, low.faces)
    near = target.nearest(points)
    same = near.distance < FOREIGN_MM
    corners = low.mesh.uv[low.mesh.faces[near.face]]
    uv = np.einsum("kc,kcd->kd", near.bary, corners)
    baked = Page("albedo", albedo, "linear").sample(uv)
    error = delta_e_2000_linear(baked[same], color.at(hits)[same])
    return {
        "mean": float(error.mean()),
        "p95": float(np.percentile(error, 95)),
        "p99": float(np.percentile(error, 99)),
        "max": float(error.max()),
    }


def write_report(info: Mapping[str, Any], views: Path, folder: Path) -> None:
    """prep_report.json beside asset.json: the health of the raw scan, what was done, what was lost.
    The arrays for the picture sheet lie beside it until `outputs.prep_sheet` has drawn them."""
    keys = ("source", "health", "units", "axes", "counts", "stages", "lost", "warnings", "as_is")
    write_json(folder / PREP_REPORT, {key: info.get(key) for key in keys})
    if views.exists():
        shutil.move(views, folder / PREP_VIEWS)
