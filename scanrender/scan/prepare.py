"""prepare(): one raw scan in, one asset folder out, in a child process that may die."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from scanrender.asset import Asset, load_asset
from scanrender.files import atomic_folder
from scanrender.scan.child import run_worker
from scanrender.scan.ingest import check_header
from scanrender.settings.prep import PrepSettings
from scanrender.settings.scan import ScanSettings


def prepare(
    path: Path | str,
    scan: ScanSettings,
    prep: PrepSettings,
    out: Path | str,
    *,
    progress: Callable[[str, float], None] | None = None,
    as_is: bool = False,
) -> Asset:
    """Prepare the scan at `path` and write the asset folder `out`, complete or not at all.

    progress(stage, fraction) is called as stages begin. as_is keeps the raw triangles, and the raw
    texture coordinates where there are usable ones. The work runs in one child process, whose
    native libraries run in children of their own: this process imports none of them. Returns the
    asset as read back. Raises UsageError, ConfigError, ScanError, StageError, OutputError.
    """
    path, out = Path(path), Path(out)
    check_header(path)
    with atomic_folder(out) as folder, tempfile.TemporaryDirectory(prefix="scanrender-") as name:
        inner = folder / "asset"
        job = {
            "scan_path": str(path.resolve()),
            "scan": scan.model_dump(mode="json"),
            "prep": prep.model_dump(mode="json"),
            "asset": str(inner.resolve()),
            "as_is": as_is,
        }
        (Path(name) / "job.json").write_text(json.dumps(job), encoding="utf-8")
        run_worker(["prepare", name], prep.timeout_s, progress, own_group=True)
        for file in inner.iterdir():
            os.replace(file, folder / file.name)
        inner.rmdir()
    return load_asset(out)
