"""The picture sheet of a preparation, drawn from what the preparation left in the asset folder."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from scanrender.asset import PREP_REPORT, PREP_SHEET, PREP_VIEWS
from scanrender.outputs.prep_sheet import write_prep_sheet


def draw_prep_sheet(folder: Path) -> Path | None:
    """FOLDER/prep_sheet.png; None where nothing was left to draw. Raises OutputError."""
    stored = folder / PREP_VIEWS
    if not stored.exists():
        return None
    report = json.loads((folder / PREP_REPORT).read_text(encoding="utf-8"))
    with np.load(stored, allow_pickle=False) as archive:
        views = {name: archive[name] for name in archive.files}
    sheet = write_prep_sheet(folder / PREP_SHEET, views, report)
    stored.unlink()
    return sheet
