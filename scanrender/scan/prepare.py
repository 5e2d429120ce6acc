"""prepare(): one raw scan in, one asset folder out, in a child process that may die."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Collection
from pathlib import Path

from scanrender.asset import Asset, check_replaceable, load_asset
from scanrender.errors import ScanError
from scanrender.files import atomic_folder
from scanrender.scan.child import child_for
from scanrender.scan.header import check_header, named
from scanrender.settings.prep import PrepSettings
from scanrender.settings.scan import ScanSettings

GRACE_S = 5.0  # a child within a stage may have the stage's timeout, and begins later


def prepare(
    path: Path | str,
    scan: ScanSettings,
    prep: PrepSettings,
    out: Path | str,
    *,
    progress: Callable[[str, float], None] | None = None,
    as_is: bool = False,
    maps: Collection[str] | None = None,
) -> Asset:
    """Prepare the scan at `path` and write the asset folder `out`, complete or not at all.

    progress(stage, fraction) is called as stages begin. as_is keeps the raw triangles, and the raw
    texture coordinates where there are usable ones. The work runs in one child process, whose
    native libraries run in children of their own: this process imports none of them. Returns the
    asset as read back, with the maps named in `maps` or all.
    Raises UsageError, ConfigError, ScanError, StageError, OutputError.
    """
    path, out = Path(path), Path(out)
    check_replaceable(out)
    check_header(path)
    with atomic_folder(out) as folder, child_for("prepare", own_group=True) as child:
        inner = folder / "asset"
        job = {
            # Not resolved: textures lie beside the name that was given, be it a link or not.
            "scan_path": os.path.abspath(path),
            "scan": scan.model_dump(mode="json"),
            "prep": prep.model_dump(mode="json"),
            "asset": str(inner.resolve()),
            "as_is": as_is,
        }
        (child.folder / "job.json").write_text(json.dumps(job), encoding="utf-8")
        try:
            limited = prep.memory_mib is not None
            child.run(prep.timeout_s, progress, GRACE_S, limited)
        except ScanError as error:
            raise named(error, path) from error
        for file in inner.iterdir():
            os.replace(file, folder / file.name)
        inner.rmdir()
    return load_asset(out, maps)
