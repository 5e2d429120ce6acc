"""Names of result folders: every photogrammetry export is called model.obj."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path


def scan_ids(paths: Sequence[Path]) -> list[str]:
    """One id a path: the stem, with the parent's name and a short path hash where stems repeat.

    Ids depend on the paths alone, so that a second run finds the first one's folders.
    """
    stems = [_safe(path.stem) for path in paths]
    counts = Counter(stem.lower() for stem in stems)
    return [
        stem if counts[stem.lower()] == 1 else f"{_safe(path.parent.name)}-{stem}-{_hash(path)}"
        for path, stem in zip(paths, stems, strict=True)
    ]


def _safe(name: str) -> str:
    return re.sub(r"[^\w.\-]+", "_", name).strip("._") or "scan"


def _hash(path: Path) -> str:
    return hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:6]
