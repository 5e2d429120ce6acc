"""What tests of preparation share."""

from __future__ import annotations

import subprocess
from typing import Any

import pytest

from scanrender.scan import child


@pytest.fixture
def children(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The processes that preparations have started, in order."""
    started: list[Any] = []
    popen = subprocess.Popen

    def remember(*arguments: Any, **keywords: Any) -> Any:
        started.append(popen(*arguments, **keywords))
        return started[-1]

    monkeypatch.setattr(child.subprocess, "Popen", remember)
    return started
