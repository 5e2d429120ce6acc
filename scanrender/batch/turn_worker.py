"""A process that renders frames of a turn beside the one whose turn it is:
`python -m scanrender.batch.turn_worker`, started by `turn_crew`.

The first line of standard input says what is rendered, each further one a frame and its file;
standard output carries a line for each: `{"frame": ..., "ms": ...}` or `{"error": ...}`. It plans
nothing, records nothing, and ends with its parent.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import IO

from scanrender.asset import load_asset
from scanrender.batch.keys import RENDERED_MAPS
from scanrender.errors import CrashError, ScanrenderError
from scanrender.outputs.png import bytes_from_unit, write_bytes_png
from scanrender.render.device import device
from scanrender.render.frame import Renderer
from scanrender.scan.worker import tie_to_parent
from scanrender.settings.pipeline import Pipeline


def main() -> int:
    tie_to_parent()
    signal.signal(signal.SIGTERM, _stop)
    with suppress(AttributeError):  # Ctrl-C is the parent's to answer
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    protocol = os.fdopen(os.dup(1), "w", buffering=1, encoding="utf-8")
    os.dup2(2, 1)
    try:
        _serve(sys.stdin, protocol)
    except (ScanrenderError, MemoryError) as error:
        # Of anything else the traceback goes to standard error, whose end the parent tells.
        what = str(error).replace("\n", " ") or "memory ran out"
        protocol.write(json.dumps({"error": what}) + "\n")
        return 1
    return 0


def _stop(*_: object) -> None:
    raise SystemExit(0)  # what is half-written goes


def _serve(lines: IO[str], protocol: IO[str]) -> None:
    turn = json.loads(lines.readline())
    asset = load_asset(Path(turn["asset"]), RENDERED_MAPS)
    renderer = Renderer(device(), asset, Pipeline.model_validate(turn["pipeline"]))
    if renderer.device.driver != turn["driver"]:
        raise CrashError(f"the GL driver is another one here: {renderer.device.driver}")
    for line in lines:
        task = json.loads(line)
        started = time.perf_counter()
        frame = renderer.render(renderer.view(task["frame"]))
        renderer.device.check()
        ms = round(1e3 * (time.perf_counter() - started), 1)
        pixels = bytes_from_unit(frame.buffers["display"])
        write_bytes_png(task["file"], pixels, task["compression"])
        protocol.write(json.dumps({"frame": task["frame"], "ms": ms}) + "\n")


if __name__ == "__main__":
    code = main()
    # Without interpreter teardown: drivers wait for their threads there, and nothing is unwritten.
    sys.stderr.flush()
    os._exit(code)
