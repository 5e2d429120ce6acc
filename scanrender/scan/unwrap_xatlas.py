"""xatlas, as packer of given charts and as unwrapper of its own. Runs in a child process only.

jpcy/xatlas through xatlas-python 0.0.11: no progress, no abort, holds the interpreter lock, can
freeze on degenerate input; hence the child, the timeout, and the checks before and after.
"""

from __future__ import annotations

from typing import Any

import numpy as np


def pack(arrays: dict[str, Any], params: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """corner_uv (m, 3, 2) in mm and chart (m,) -> packed corner_uv in [0, 1], y up."""
    import xatlas

    chart, corner_uv = arrays["chart"], arrays["corner_uv"]
    # One vertex per (chart, place): xatlas finds charts by their connectivity in UV.
    key = np.concatenate([np.repeat(chart, 3)[:, None], corner_uv.reshape(-1, 2)], axis=1)
    unique, index = np.unique(key, axis=0, return_inverse=True)
    # Placing charts by brute force takes time with the square of the resolution; a coarser grid
    # with its padding in proportion packs nearly as tightly.
    coarse = max(1, round(params["padding"]))
    side, padding = max(64, int(params["resolution"]) // coarse), 1
    edge1, edge2 = corner_uv[:, 1] - corner_uv[:, 0], corner_uv[:, 2] - corner_uv[:, 0]
    area = 0.5 * np.abs(edge1[:, 0] * edge2[:, 1] - edge1[:, 1] * edge2[:, 0]).sum()
    density = side * np.sqrt(0.55 / area)
    # xatlas only estimates the density that fills a given resolution, and overshoots it by 60 %:
    # the padding would shrink as much. Two corrections bring the atlas to its size.
    for attempt in range(3):
        atlas = xatlas.Atlas()
        atlas.add_uv_mesh(
            np.ascontiguousarray(unique[:, 1:], np.float32),
            np.ascontiguousarray(index.reshape(-1, 3), np.uint32),
            np.ascontiguousarray(chart.reshape(-1, 1), np.uint32),
        )
        options = _options(xatlas, {"resolution": 0, "padding": padding, "brute_force": True})
        options.texels_per_unit = float(density)
        atlas.generate(pack_options=options)
        filled = max(atlas.width, atlas.height) / side
        if attempt == 2 or 0.97 < filled < 1.03:
            break
        density /= filled
    _, indices, uv = atlas.get_mesh(0)
    packed = _square(uv, atlas)[np.asarray(indices, np.int64)]
    return {"corner_uv": packed}, _report(atlas)


def unwrap_by_xatlas(
    arrays: dict[str, Any], params: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """positions, faces -> corner_uv (m, 3, 2) in [0, 1], y up, with xatlas' own segmentation."""
    import xatlas

    atlas = xatlas.Atlas()
    atlas.add_mesh(
        np.ascontiguousarray(arrays["positions"], np.float32),
        np.ascontiguousarray(arrays["faces"], np.uint32),
    )
    atlas.generate(pack_options=_options(xatlas, params))
    _, indices, uv = atlas.get_mesh(0)
    return {"corner_uv": _square(uv, atlas)[np.asarray(indices, np.int64)]}, _report(atlas)


def _options(xatlas: Any, params: dict[str, Any]) -> Any:
    options = xatlas.PackOptions()
    options.resolution = int(params["resolution"])
    options.padding = int(params["padding"])
    options.bilinear = True
    # Its "rotation" swaps x and y, which mirrors the chart and with it the tangent frame.
    options.rotate_charts = False
    # Random placement (the default) is seeded inside xatlas; brute force is slow and little better.
    options.bruteForce = bool(params.get("brute_force", False))
    return options


def _square(uv: Any, atlas: Any) -> Any:
    """xatlas divides by width and height; a square map needs one divisor for both."""
    side = max(atlas.width, atlas.height)
    return np.asarray(uv, np.float64) * [atlas.width / side, atlas.height / side]


def _report(atlas: Any) -> dict[str, Any]:
    return {
        "charts": int(atlas.chart_count),
        "atlases": int(atlas.atlas_count),
        "packed_px": [int(atlas.width), int(atlas.height)],
    }
