"""What each stage depends on: the settings it reads, its code, its libraries, its input's bytes.

A stage's `reads` is plain data; two runs whose reads are equal make equal files. Nothing here opens
GL or loads a library: whether there is anything to do must be known in a fraction of a second.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from functools import cache, cached_property
from importlib import metadata
from pathlib import Path
from typing import Any

from scanrender.asset import MAPS
from scanrender.batch.record import digest
from scanrender.resources import PACKAGE
from scanrender.settings.light import BUILT_IN_SKIES
from scanrender.settings.pipeline import Pipeline

Reads = dict[str, Any]

# The maps that some pass of today's renderer reads.
RENDERED_MAPS = ("albedo", "normal_ts", "ao", "skin", "curvature", "thickness_mm")
_SHOT = ("skin", "diffusion", "curvature", "lights", "camera", "view")
_SHOWN = ("supersampling", "sampling", "precision")  # of `quality`, what a frame itself reads
_WISHES = ("tolerance_delta_e", "max_delta_e", "budget_ms", "preset")

# Stage -> the sources that decide its files, and the libraries. A source that changes makes a stage
# stale even where it only gained a comment: a result that is wrongly believed costs more.
_CODE = {
    "prep": ("scan", "asset.py", "images.py", "outputs/prep_sheet.py", "batch/prep_report.py"),
    "frames": ("render", "optics", "asset.py", "images.py", "buffers.py", "outputs/png.py"),
    "plan": ("measure/choice.py", "batch/shot.py", "metrics.py"),
    "buffers": ("outputs/exr.py", "outputs/falsecolour.py", "outputs/colourmaps.py",
                "outputs/lettering.py"),
    "video": ("outputs/video.py",),
    "sheet": ("outputs/contact_sheet.py", "outputs/lettering.py", "batch/turntable.py"),
    "figure": ("batch/figure.py", "measure/figure_numbers.py", "outputs"),
}  # fmt: skip
_LIBRARIES = {
    "prep": ("numpy", "scipy", "OpenImageIO", "trimesh", "pymeshlab", "xatlas",
             "fast-simplification", "libigl", "embreex", "DracoPy", "pillow"),
    "frames": ("numpy", "moderngl", "glcontext", "OpenImageIO"),
    "plan": (),
    "buffers": ("OpenImageIO", "pillow"),
    "video": ("av",),
    "sheet": ("pillow", "OpenImageIO"),
    "figure": ("pillow", "OpenImageIO", "scipy"),
}  # fmt: skip


STAGES = tuple(_CODE)


@cache
def code_digest(stage: str) -> str:
    return sources_digest(_CODE[stage])


def sources_digest(names: Sequence[str]) -> str:
    """Of files and folders of the package."""
    found = hashlib.sha256()
    for name in names:
        path = PACKAGE / name
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.suffix in (".py", ".frag", ".vert", ".glsl", ".comp"):
                found.update(f"{file.relative_to(PACKAGE).as_posix()}\0".encode())
                found.update(file.read_bytes())
    return found.hexdigest()[:24]


@cache
def library_versions(stage: str) -> dict[str, str]:
    versions = {}
    for name in _LIBRARIES[stage]:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = "none"
    return versions


def _made_by(stage: str) -> Reads:
    return {"code": code_digest(stage), "libraries": library_versions(stage)}


class Recipe:
    """A pipeline's settings as plain data, by the stage that reads them; its scans share it."""

    def __init__(self, pipeline: Pipeline) -> None:
        self.pipeline = pipeline

    @cached_property
    def settings(self) -> Reads:
        data: Reads = self.pipeline.model_dump(mode="json")
        return data

    @cached_property
    def prep(self) -> Reads:
        """`prep.memory_mib` bounds a preparation and changes nothing in it."""
        prep = {k: v for k, v in self.settings["prep"].items() if k != "memory_mib"}
        return {"settings": {"scan": self.settings["scan"], "prep": prep}, **_made_by("prep")}

    @cached_property
    def shot(self) -> Reads:
        """What a frame reads, as it is asked for; a plan may leave some of it out."""
        return shot_settings(self.settings)

    @cached_property
    def wishes(self) -> Reads:
        return {name: self.settings["quality"][name] for name in _WISHES}

    @cached_property
    def is_planned(self) -> bool:
        return any(value is not None for value in self.wishes.values())

    @cached_property
    def pictures(self) -> list[str]:
        """Paths of environment maps that are files."""
        maps = [light.get("map") for light in self.settings["lights"]]
        return [name for name in maps if name is not None and name not in BUILT_IN_SKIES]

    @cached_property
    def written(self) -> str:
        """A digest of all settings, for what only repeats them (pipeline.yaml, the manifest)."""
        return digest(self.settings)


def shot_settings(settings: Mapping[str, Any]) -> Reads:
    """Of all settings, those that a frame reads."""
    turntable = {k: v for k, v in settings["turntable"].items() if k != "fps"}
    quality = {name: settings["quality"][name] for name in _SHOWN}
    shot = {name: settings[name] for name in _SHOT}
    return {**shot, "turntable": turntable, "quality": quality}


def prep_reads(recipe: Recipe, files: Mapping[str, str]) -> Reads:
    """`files`: sha256 of the scan and of what it names, by name."""
    return {**recipe.prep, "files": dict(files)}


def plan_reads(recipe: Recipe, asset: Reads, pictures: Reads, frames: Sequence[int]) -> Reads:
    """A plan is measured on frames that are asked for, and with a budget on this machine."""
    return {
        "settings": {**recipe.shot, "quality": {**recipe.shot["quality"], **recipe.wishes}},
        "asset": asset,
        "pictures": pictures,
        "frames": [frames[0], frames[-1], len(frames)],
        **_made_by("plan"),
        "render": code_digest("frames"),
    }


def frames_reads(shot: Reads, asset: Reads, pictures: Reads, gl: str) -> Reads:
    """`shot`: settings of the frames as they are rendered, after a plan. `gl`: the driver."""
    return {
        "settings": shot, "asset": asset, "pictures": pictures, "gl": gl, **_made_by("frames"),
    }  # fmt: skip


def buffers_reads(recipe: Recipe, frames_key: str) -> Reads:
    outputs = recipe.settings["outputs"]
    names = {name: outputs[name] for name in ("buffers", "exr_layout", "false_colour")}
    return {"frames": frames_key, "settings": {"outputs": names}, **_made_by("buffers")}


def video_reads(recipe: Recipe, frames_key: str) -> Reads:
    fps = recipe.settings["turntable"]["fps"]
    return {"frames": frames_key, "settings": {"turntable": {"fps": fps}}, **_made_by("video")}


def sheet_reads(recipe: Recipe, frames_key: str, title: str) -> Reads:
    count = {"contact_frames": recipe.settings["outputs"]["contact_frames"]}
    said = {"frames": frames_key, "title": title, "settings": {"outputs": count}}
    return {**said, **_made_by("sheet")}


def figure_reads(recipe: Recipe, asset: Reads, pictures: Reads, gl: str) -> Reads:
    """A panel may set anything that a shot reads."""
    settings = {**recipe.shot, "figure": recipe.settings["figure"]}
    settings["description"] = recipe.settings["description"]
    made_by = {**_made_by("figure"), "render": code_digest("frames")}
    return {"settings": settings, "asset": asset, "pictures": pictures, "gl": gl, **made_by}


def described(folder: Path) -> dict[str, Any]:
    """An asset's own description; empty where it cannot be read: loading it will say why."""
    try:
        info = json.loads((folder / "asset.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return info if isinstance(info, dict) else {}


def asset_files(info: Mapping[str, Any]) -> list[str]:
    """Names of an asset's files that the renderer reads, by its description."""
    maps = info.get("maps") or ()
    return ["mesh.glb", *(MAPS[name].file for name in RENDERED_MAPS if name in maps)]


def curvature_scale_mm(info: Mapping[str, Any]) -> float | None:
    """What a renderer reads of the description: how far the curvature map is smoothed."""
    notes = [stage.get("notes", {}) for stage in info.get("stages", ())]
    scales = [note.get("curvature_scale_mm") for note in notes]
    return max((float(scale) for scale in scales if scale), default=None)
