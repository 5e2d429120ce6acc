"""tools/kill_batch.py as a module: what it compares and looks for is what these tests do."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]


def kill_tool() -> Any:
    spec = importlib.util.spec_from_file_location("kill_batch", ROOT / "tools" / "kill_batch.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


KILL = kill_tool()
