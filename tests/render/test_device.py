"""What the process's one GL context does with what nobody needs any more."""

from __future__ import annotations

import ctypes
import gc
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from render.synthetic import pipeline, sphere

from scanrender.render.device import Device
from scanrender.render.frame import Renderer

pytestmark = pytest.mark.gl

SMALL = {"camera": {"width_px": 16, "height_px": 16}, "quality": {"supersampling": 1}}


@pytest.mark.parametrize("elsewhere", [False, True])
def test_what_garbage_collection_finds_is_deleted_whichever_thread_it_ran_in(
    gl: Device, elsewhere: bool
):
    """A thread that writes files has no GL context, and GL ignores what it asks to delete."""
    library = ctypes.CDLL("libGL.so.1")
    texture = gl.context.texture((4, 4), 4)
    name = texture.glo
    gl.finish()
    assert library.glIsTexture(name)
    ring = [texture]
    ring.append(ring)  # type: ignore[arg-type]
    del ring, texture
    if elsewhere:
        thread = threading.Thread(target=gc.collect)
        thread.start()
        thread.join()
    else:
        gc.collect()
    assert len(gl.context.objects) > 0
    gl.let_go()
    assert not library.glIsTexture(name)


def test_a_picture_leaves_nothing_that_waits_to_be_deleted(gl: Device):
    for _ in range(2):
        renderer = Renderer(gl, sphere(100.0, rings=8), pipeline(SMALL))
        renderer.render(renderer.view(0))
        gc.collect()
    renderer.render(renderer.view(0))
    assert not gl.context.objects


def test_what_was_released_by_name_is_not_released_again(gl: Device):
    texture = gl.context.texture((1, 1), 1)
    texture.release()
    del texture
    gl.let_go()
    assert not gl.context.objects


THREADS = """
import os
from pathlib import Path
from scanrender.render.device import device
before = dict(os.environ)
found = device()
assert dict(os.environ) == before
names = [task.read_text() for task in Path("/proc/self/task").glob("*/comm")]
print(found.is_software, sum(name.startswith("llvmpipe") for name in names))
"""


@pytest.mark.parametrize(("asked", "threads"), [(None, 0), ("2", 2)])
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="threads are counted in /proc")
def test_the_software_rasteriser_has_no_threads_unless_asked_for(asked: str | None, threads: int):
    """They write into freed memory now and then (docs/decisions/0034)."""
    environment = {k: v for k, v in os.environ.items() if k != "LP_NUM_THREADS"}
    if asked is not None:
        environment["LP_NUM_THREADS"] = asked
    said = subprocess.run(
        [sys.executable, "-c", THREADS], env=environment, capture_output=True, text=True, check=True
    ).stdout.split()
    if said[0] == "False":
        pytest.skip("the GL device is no software")
    assert int(said[1]) == threads
