"""Our own head as a prepared asset of 50 k triangles: what is timed where no scan is given."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from scanrender.measure import prep_inputs
from scanrender.scan.prepare import prepare
from scanrender.settings.prep import PrepSettings
from scanrender.settings.scan import ScanSettings

PREPARED: Mapping[str, Any] = {
    "simplify": {"triangles": 50_000},
    "bake": {"albedo_px": 4096, "normal_px": 4096, "data_px": 1024},
    "report": "short",
}


def own_head(out: Path, say: Callable[[str], None]) -> Path:
    """OUT/assets/own_head, prepared once. Raises ScanrenderError's kinds."""
    folder = out / "assets" / "own_head"
    if not folder.exists():
        say("preparing our own head")
        scan = out / "inputs" / "phantom_1100k.ply"
        if not scan.exists():
            prep_inputs.phantom_scan(scan, 1_100_000)
        settings = PrepSettings.model_validate(PREPARED)
        prepare(scan, ScanSettings(), settings, folder, maps=())
    return folder
