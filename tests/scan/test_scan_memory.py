"""The bound on memory holds in the process that states it and in all that it starts."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytest.importorskip("resource", reason="this system has no such limits")

NESTED = """
import subprocess, sys
from scanrender.scan.memory import limit_memory
limit_memory(400)
inner = "from scanrender.scan.memory import limit_memory; limit_memory(); import numpy as np; "
for mib in sys.argv[1:]:
    code = inner + f"np.ones({mib} << 17)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    print(done.returncode, "MemoryError" in done.stderr)
"""


def test_children_cannot_lift_a_stated_limit():
    done = subprocess.run(
        [sys.executable, "-c", NESTED, "50", "600"], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == ["0 False", "1 True"]


LARGE_PARENT = """
import subprocess, sys
held = bytearray(b"x" * (500 << 20))
child = "from scanrender.scan.journal import peak_mib; print(peak_mib())"
print(subprocess.run([sys.executable, "-c", child], capture_output=True, text=True).stdout)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="/proc")
def test_peak_memory_does_not_count_the_parents():
    done = subprocess.run(
        [sys.executable, "-c", LARGE_PARENT], capture_output=True, text=True, check=True
    )
    assert 0 < int(done.stdout) < 300
