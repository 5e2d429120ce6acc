"""What all tests share: hypothesis without chance, one GL device, the command line as a process."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from scanrender.render.device import Device, device

settings.register_profile(
    "scanrender",
    derandomize=True,
    database=None,
    deadline=None,  # the machine is shared: time says nothing here
    max_examples=25,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
settings.load_profile("scanrender")

Cli = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture(scope="session")
def gl() -> Device:
    """The process's one GL device. Without GL these tests fail; `-m "not gl"` leaves them out."""
    return device()


@pytest.fixture
def cli(tmp_path: Path) -> Cli:
    """`cli(*arguments)`: scanrender in a process of its own, started in `tmp_path`.

    `code` runs before the command line does, for what a test wants broken in that process.
    """

    def run(*arguments: object, code: str = "") -> subprocess.CompletedProcess[str]:
        start = f"{code}\nfrom scanrender.cli.main import main\nmain()\n"
        return subprocess.run(
            [sys.executable, "-c", start, *(str(argument) for argument in arguments)],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            # A driver that crashes says where: it may not do so again for a thousand runs.
            env={**os.environ, "NO_COLOR": "1", "COLUMNS": "100", "PYTHONFAULTHANDLER": "1"},
            timeout=300,
            check=False,
        )

    return run
