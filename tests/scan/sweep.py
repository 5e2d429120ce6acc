"""Prepare every scan of `../shared/scans` with tiny maps, and print what became of each.

    python tests/scan/sweep.py [--jobs 2] [--only PATTERN] [--tsv FILE]

Each file goes through `scanrender prep` in a process of its own. It must end within LIMIT_S as an
asset, or with exit code 4 and one clear sentence; no traceback, no half-written folder. The result
is a Markdown table on standard output; the exit code is 1 when any file broke these rules.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple, dataclass
from pathlib import Path

SCANS = Path(__file__).parents[2].parent / "shared" / "scans"
SUFFIXES = {".obj", ".ply", ".glb", ".gltf", ".stl", ".off"}
LIMIT_S = 120.0
TINY = {
    "prep.simplify.triangles": 5000,
    "prep.bake.albedo_px": 128,
    "prep.bake.normal_px": 128,
    "prep.bake.data_px": 128,
    "prep.bake.ao_rays": 16,
    "prep.bake.thickness_rays": 4,
}


@dataclass
class Row:
    """outcome: `asset`, `refused` (exit 4) or `BROKEN`; text: what it is, or the sentence."""

    file: str
    outcome: str
    seconds: float
    text: str


def all_scans(root: Path = SCANS) -> list[Path]:
    return sorted(p for p in root.rglob("*") if p.suffix.lower() in SUFFIXES)


def prepare_one(path: Path) -> Row:
    """Run `scanrender prep` on one file in a scratch folder and judge how it ended."""
    started = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="sweep-") as scratch:
        out = Path(scratch) / "asset"
        command = [sys.executable, "-m", "scanrender", "prep", str(path), "--out", str(out)]
        command += ["--json", "--progress", "none"]
        for key, value in TINY.items():
            command += ["--set", f"{key}={value}"]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=LIMIT_S, check=False
            )
        except subprocess.TimeoutExpired:
            return Row(
                str(path.relative_to(SCANS)), "BROKEN", LIMIT_S, f"took longer than {LIMIT_S:g} s"
            )
        outcome, text = _judge(done, out, sorted(os.listdir(scratch)))
    return Row(str(path.relative_to(SCANS)), outcome, time.monotonic() - started, text)


def _judge(done: subprocess.CompletedProcess[str], out: Path, left: list[str]) -> tuple[str, str]:
    if "Traceback" in done.stderr:
        return "BROKEN", done.stderr.strip().splitlines()[-1]
    if done.returncode == 0:
        from scanrender.asset import load_asset

        load_asset(out)
        return ("asset", _summary(json.loads(done.stdout))) if left == ["asset"] else _litter(left)
    said = " / ".join(line.strip() for line in done.stderr.strip().splitlines())
    if left:
        return _litter(left)
    return ("refused" if done.returncode == 4 else "BROKEN"), f"[{done.returncode}] {said}"


def _litter(left: list[str]) -> tuple[str, str]:
    return "BROKEN", f"left behind: {', '.join(left)}"


def _summary(info: dict[str, object]) -> str:
    counts, units, axes = info["counts"], info["units"], info["axes"]
    assert isinstance(counts, dict)
    assert isinstance(units, dict)
    assert isinstance(axes, dict)
    stages = info["stages"]
    assert isinstance(stages, list)
    ingest = next(stage for stage in stages if stage["name"] == "ingest")
    warnings = info["warnings"]
    assert isinstance(warnings, list)
    return (
        f"{counts['raw']['triangles']} -> {counts['prepared']['triangles']} triangles, "
        f"colour: {ingest['notes']['color']}, {units['mm_per_unit']:.4g} mm a unit "
        f"({units['confidence']}), up {axes['up']}, front {axes['front']}; "
        + "; ".join(str(w) for w in warnings)
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", default="*", help="glob on the path below shared/scans")
    parser.add_argument("--tsv", type=Path)
    options = parser.parse_args()
    paths = [p for p in all_scans() if p.relative_to(SCANS).match(options.only)]
    with ThreadPoolExecutor(options.jobs) as pool:
        rows = list(pool.map(prepare_one, paths))
    print("| scan | outcome | s | what |\n|---|---|---|---|")
    for row in rows:
        text = row.text.replace("|", "\\|")
        print(f"| {row.file} | {row.outcome} | {row.seconds:.1f} | {text} |")
    if options.tsv:
        lines = ["\t".join(str(x) for x in astuple(row)) for row in rows]
        options.tsv.write_text("\n".join(lines) + "\n", encoding="utf-8")
    broken = [row.file for row in rows if row.outcome == "BROKEN"]
    print(f"\n{len(rows)} scans, {len(broken)} broken: {', '.join(broken) or 'none'}")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
