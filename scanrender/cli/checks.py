"""What `doctor` looks at. Each check answers by itself: one that fails hides no other."""

from __future__ import annotations

import importlib.metadata
import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from scanrender import __version__
from scanrender.errors import DeviceError, ScanrenderError, StageError

LIBRARIES = (
    "numpy",
    "scipy",
    "moderngl",
    "OpenImageIO",
    "trimesh",
    "pymeshlab",
    "xatlas",
    "fast-simplification",
    "libigl",
    "embreex",
    "DracoPy",
    "av",
    "pydantic",
)
APT_PYMESHLAB = "libgl1 libopengl0"

# pymeshlab prints instead of raising when a plugin cannot load; its filters are then absent.
_LIST_FILTERS = """
import json, sys
import pymeshlab
names = set(pymeshlab.filter_list())
print(json.dumps([name for name in sys.argv[1:] if name not in names]))
"""


@dataclass(frozen=True)
class Check:
    """One thing looked at. `exit_code` is what it means when it is not ok."""

    name: str
    ok: bool
    found: str
    fix: str = ""
    exit_code: int = 5

    def as_json(self) -> dict[str, Any]:
        return asdict(self)


def run_checks() -> list[Check]:
    checks: list[Callable[[], Check]] = [
        _python,
        _libraries,
        _gl,
        _video,
        _filters,
        _temporary_space,
    ]
    return [check() for check in checks]


def _python() -> Check:
    version = ".".join(str(part) for part in sys.version_info[:3])
    return Check(
        "scanrender",
        sys.version_info >= (3, 11),
        f"{__version__} on Python {version}",
        "" if sys.version_info >= (3, 11) else "use Python 3.11 or newer",
    )


def _libraries() -> Check:
    found, missing = [], []
    for name in LIBRARIES:
        try:
            found.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            missing.append(name)
    fix = f"pip install {' '.join(missing)}" if missing else ""
    shown = ", ".join(found) + (f"; missing: {', '.join(missing)}" if missing else "")
    return Check("libraries", not missing, shown, fix)


def _gl() -> Check:
    try:
        from scanrender.render.device import device

        found = device()
    except DeviceError as error:
        return Check("OpenGL", False, error.what, error.fix or "", DeviceError.exit_code)
    except ImportError as error:
        fix = "apt-get install libegl1 libgl1 libgl1-mesa-dri"
        return Check("OpenGL", False, str(error), fix, DeviceError.exit_code)
    kind = "software" if found.is_software else "hardware"
    return Check("OpenGL", True, f"{found.renderer} ({kind}), {found.version}")


def _video() -> Check:
    try:
        import av

        name = av.codec.Codec("libx264", "w").long_name
    except (ImportError, ValueError) as error:
        fix = "pip install --force-reinstall av"
        return Check("H.264 encoder", False, str(error), fix)
    return Check("H.264 encoder", True, str(name))


def _filters() -> Check:
    """Asked in a child process, as everything of pymeshlab is."""
    from scanrender.scan.meshlab import SELF_INTERSECTION

    command = [sys.executable, "-P", "-c", _LIST_FILTERS, SELF_INTERSECTION]
    try:
        answer = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        missing = json.loads(answer.stdout.strip().splitlines()[-1])
    except (subprocess.TimeoutExpired, ValueError, IndexError):
        return Check(
            "pymeshlab",
            False,
            "it does not load",
            f"apt-get install {APT_PYMESHLAB}",
            StageError.exit_code,
        )
    if missing:
        return Check(
            "pymeshlab",
            False,
            f"filters missing: {', '.join(missing)}",
            f"apt-get install {APT_PYMESHLAB}",
            StageError.exit_code,
        )
    return Check("pymeshlab", True, "the filter that is used is there")


def _temporary_space() -> Check:
    import shutil
    import tempfile

    folder = tempfile.gettempdir()
    try:
        free = shutil.disk_usage(folder).free / 2**30
    except (OSError, ScanrenderError) as error:
        return Check("temporary folder", False, str(error), "set TMPDIR")
    ok = free > 2 and os.access(folder, os.W_OK)
    return Check("temporary folder", ok, f"{free:.1f} GiB free", "" if ok else "set TMPDIR", 7)
