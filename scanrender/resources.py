"""Finds what the package ships: pipelines, presets and shaders.

In a wheel, `pipelines/` and `configs/` lie under `scanrender/data/`; in an editable install or a
checkout they are the top-level folders of the repository.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent


@cache
def data_folder(name: str) -> Path:
    """The folder `pipelines` or `configs`, wherever this installation keeps it."""
    installed = PACKAGE / "data" / name
    return installed if installed.is_dir() else PACKAGE.parent / name


def shader_folder() -> Path:
    return PACKAGE / "render" / "shaders"


def shipped_pipelines() -> dict[str, Path]:
    """Name (`turntable`, `figures/fig1`) to file, sorted."""
    folder = data_folder("pipelines")
    return {
        str(path.relative_to(folder).with_suffix("")): path
        for path in sorted(folder.rglob("*.yaml"))
    }


def shipped_presets() -> dict[str, Path]:
    """`section/name` (`light/three_point`) to file, sorted."""
    folder = data_folder("configs")
    return {
        str(path.relative_to(folder).with_suffix("")): path
        for path in sorted(folder.rglob("*.yaml"))
    }
