"""The morning report of a folder of results: everything on one page, made from what lies there.

Needs no GL and no scan: batch.json says how each job ended (a manifest.json, where the folder is
one scan's), the jobs' folders hold pictures and times. What goes into the page as pixels is kept in
`.report/`, so that a batch of a thousand scans does not read a thousand videos for one new one.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

from scanrender import __version__
from scanrender.batch.jobs import FRAMES, RESUME_FRAMES
from scanrender.batch.run import Batch
from scanrender.batch.summary import SUMMARY_NAME, Failure, read_summary
from scanrender.errors import ConfigError, ScanrenderError
from scanrender.files import clean_stale, write_text
from scanrender.outputs.manifest import MANIFEST_NAME
from scanrender.outputs.report.page import safe_json, write_page
from scanrender.settings.pipeline import Pipeline

REPORT_NAME, PIXELS = "report.html", ".report"
EMBEDDED_BYTES = 24 << 20  # of pixels in the page itself; what is more is loaded from PIXELS
FORMAT = 2
DOWNLOADS = (
    ("turntable.mp4", "video"), ("contact_sheet.png", "contact sheet"), ("figure.png", "figure"),
    ("figure.json", "figure's numbers"), ("pipeline.yaml", "settings"),
    (MANIFEST_NAME, "manifest"), ("log.txt", "log"),
)  # fmt: skip
OF_ASSET = (
    ("mesh.glb", "mesh"), ("albedo.png", "albedo"), ("prep_sheet.png", "preparation sheet"),
    ("asset.json", "asset's numbers"),
)  # fmt: skip

Json = dict[str, Any]


def report_of_run(out: Path, batch: Batch) -> Path | None:
    """The report after a run, where there is something new to tell. Raises OutputError."""
    new = any(not result.cached for result in batch.results) or batch.failures
    if not out.is_dir() or (not new and (out / REPORT_NAME).exists()):
        return None
    alone = len(batch.results) + len(batch.failures) == 1
    if alone and batch.failures:
        return _write(out, _document_of_failure(batch.failures[0]))
    return write_report(out, alone)


def write_report(out: Path, alone: bool = False) -> Path:
    """OUT/report.html from what earlier runs left in OUT; `alone`: it is one scan's folder.

    Raises ConfigError when nothing there says what was done, OutputError when it cannot be written.
    """
    name = MANIFEST_NAME if alone or not (out / SUMMARY_NAME).exists() else SUMMARY_NAME
    path = out / name
    try:
        document = read_summary(path)
        if name == MANIFEST_NAME:
            document = _document_of_manifest(document)
        return _write(out, document)
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        what = f"{path} does not tell what was done ({type(error).__name__}: {error})"
        fix = "name the --out of a run; scanrender run writes the report at its end"
        raise ConfigError(what, str(path), fix) from error


def _document_of_manifest(found: Json) -> Json:
    """A scan's manifest in the form of batch.json."""
    source = found.get("source", {})
    path = str(source.get("asset") or source.get("path") or "")
    name = Path(str(source.get("file") or path)).stem or "scan"
    job = {name: found.get(name) for name in ("seconds", "warnings", "not_run", "plan", "quality")}
    files = [entry["path"] for entry in found["files"]]
    job |= {"scan": path, "name": name, "variant": "", "folder": ".", "status": "done"}
    job |= {"asset": source.get("asset") or "asset", "gl": found.get("gl"), "files": files}
    shared = {key: found.get(key) for key in ("scanrender", "versions", "platform", "frames")}
    return {**shared, "variants": {"": found["settings"]}, "jobs": [job]}


def _document_of_failure(failure: Failure) -> Json:
    error, job = failure.error, failure.job
    said = {"what": error.what, "where": error.where, "fix": error.fix}
    told: Json = {**said, "exit_code": error.exit_code}
    entry: Json = {"scan": str(job.scan), "name": job.name, "variant": job.variant, "folder": "."}
    entry |= {"status": "failed", "error": told, "asset": "asset"}
    variants = {job.variant: job.recipe.settings}
    return {"scanrender": __version__, "variants": variants, "jobs": [entry]}


def _write(out: Path, document: Json) -> Path:
    jobs, embedded, left = [], {}, EMBEDDED_BYTES
    for folder in (out, out / PIXELS):
        clean_stale(folder)
    shown = set()
    for number, entry in enumerate(document["jobs"]):
        job = _job(out, entry, number)
        stored = _pixels(out, entry)
        if stored is not None:
            shown.add(stored.name)
            job["pixels"] = f"{PIXELS}/{stored.name}"
            job["poster"], text = _stored(stored, left)
            if text:
                embedded[job["id"]] = text
                left -= len(text)
        jobs.append(job)
    names = ("scanrender", "finished", "seconds", "versions", "platform", "frames")
    data = {name: document.get(name) for name in names}
    data |= {"title": out.resolve().name, "jobs": jobs, "settings": document["variants"]}
    data |= {"defaults": Pipeline().model_dump(mode="json")}
    page = write_page(out / REPORT_NAME, data, embedded)
    for old in (out / PIXELS).glob("*.js"):  # after the page that may have named them
        if old.name not in shown:
            old.unlink(missing_ok=True)
    return page


def _job(out: Path, entry: Json, number: int) -> Json:
    """What the page says of one job, from batch.json and the files of its folder."""
    folder = out / str(entry["folder"])
    manifest, asset = _read(folder / MANIFEST_NAME), out / str(entry["asset"])
    record, info = _read(folder / "record.json"), _read(asset / "asset.json")
    frames = record.get("stages", {}).get("frames", {}).get("notes", {})
    kept = ("name", "variant", "scan", "status", "error", "warnings", "not_run", "plan", "quality")
    job: Json = {name: entry.get(name) for name in kept}
    prep = {name: value for name, value in (entry.get("prep") or {}).items() if value}
    job |= {
        "id": f"{number}-{re.sub(r'[^A-Za-z0-9]+', '-', _label(entry)).strip('-').lower()[:40]}",
        "label": _label(entry),
        # Of all runs that made what is there; batch.json has those of its own run.
        "seconds": manifest.get("seconds") or entry.get("seconds") or {},
        "frame_ms": entry.get("frame_ms") or frames.get("ms") or {},
        "gl": entry.get("gl") or manifest.get("gl") or {},
        "lost": prep.get("lost") or info.get("lost"),
        "counts": prep.get("counts") or info.get("counts"),
        "units": prep.get("units") or info.get("units"),
        "prep_stages": [
            {"name": x["name"], "seconds": x["seconds"], "mib": x.get("peak_memory_mib")}
            for x in info.get("stages", [])
        ],
        "downloads": _downloads(out, folder, asset) if entry["status"] != "failed" else [],
    }
    if entry["status"] == "failed" and (folder / "log.txt").exists():
        job["downloads"] = [_link(out, folder / "log.txt", "log")]
    return job


def _label(entry: Json) -> str:
    return f"{entry['name']} {entry.get('variant') or ''}".strip()


def _downloads(out: Path, folder: Path, asset: Path) -> list[Json]:
    named = [(folder / name, label) for name, label in DOWNLOADS]
    named += [(path, "buffers") for path in sorted((folder / "buffers").glob("*.exr"))]
    named += [(asset / name, label) for name, label in OF_ASSET]
    return [_link(out, path, label) for path, label in named if path.exists()]


def _link(out: Path, path: Path, label: str) -> Json:
    try:
        href = quote(path.resolve().relative_to(out.resolve()).as_posix())
    except ValueError:
        href = path.resolve().as_uri()
    return {"label": label, "name": path.name, "href": href, "bytes": path.stat().st_size}


def _stored(path: Path, most: int) -> tuple[str, str]:
    """The poster of a file in PIXELS, and its JSON if that has at most `most` bytes: a thousand
    scans are gigabytes, of which the page takes little."""
    with path.open(encoding="utf-8") as stream:
        poster = str(json.loads(stream.readline().removeprefix("// "))["poster"])
        if path.stat().st_size > most:
            return poster, ""
        return poster, stream.readline().partition(",")[2].removesuffix(");\n")


def _pixels(out: Path, entry: Json) -> Path | None:
    """The file in PIXELS with a job's pictures, made if they have changed; None without any."""
    folder = out / str(entry["folder"])
    if entry["status"] == "failed":
        return None
    frames = sorted((folder / FRAMES).glob("*.png")) or sorted((folder / RESUME_FRAMES).glob("*"))
    videos = [path for path in [folder / "turntable.mp4"] if path.exists()]
    pages = [
        path for path in (folder / "figure.png", folder / "contact_sheet.png") if path.exists()
    ]
    buffers = sorted((folder / "buffers").glob("frame_*.exr"))
    used = [*frames, *videos, *pages[:1], *buffers]
    if not used:
        return None
    stats = [(path.name, path.stat().st_size, path.stat().st_mtime_ns) for path in used]
    key = hashlib.sha256(repr((FORMAT, __version__, stats)).encode()).hexdigest()[:16]
    place = hashlib.sha256(str(entry["folder"]).encode()).hexdigest()[:8]
    stored = out / PIXELS / f"{place}-{key}.js"
    if not stored.exists():
        found = {**_read_pictures(frames, videos, pages, buffers), "key": key}
        first = safe_json({"poster": found["turn"].get("poster", "")})
        write_text(stored, f'// {first}\nscanrenderPixels("{key}",{safe_json(found)});\n')
    return stored


def _read_pictures(
    frames: list[Path], videos: list[Path], pages: list[Path], buffers: list[Path]
) -> Json:
    """A picture that cannot be read is told, and costs no report."""
    # Here, since a run that has nothing to do must not wait for what reads pictures.
    from scanrender.outputs.report.layers import layers_of_frame
    from scanrender.outputs.report.turn import still_of, turn_of

    found: Json = {"turn": {}, "layers": [], "page": "", "unread": []}
    try:
        found["turn"] = turn_of(frames, videos[0] if videos else None)
    except ScanrenderError as error:
        found["unread"].append(error.what)
    if not found["turn"] and pages:
        try:
            found["page"] = still_of(pages[0])
        except ScanrenderError as error:
            found["unread"].append(error.what)
    for number, files in _by_frame(buffers).items():
        try:
            found["layers"] += layers_of_frame(files, number)
        except ScanrenderError as error:
            found["unread"].append(error.what)
    return found


def _by_frame(buffers: list[Path]) -> Mapping[int, list[Path]]:
    """frame_0012.exr and frame_0012.shadow_0.exr belong together."""
    frames: dict[int, list[Path]] = {}
    for path in buffers:
        if match := re.match(r"frame_(\d+)\.", path.name):
            frames.setdefault(int(match[1]), []).append(path)
    return frames


def _read(path: Path) -> Json:
    try:
        return read_summary(path)
    except (OSError, ValueError):
        return {}
