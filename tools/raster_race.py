"""Shows what decision 34 is about: `python tools/raster_race.py` (Linux, a C compiler, llvmpipe).

Renders small scenes in processes whose rasteriser threads sleep for a millisecond between counting
a scene as done and unlocking its fence, as they do when the kernel takes them off their core there.
Prints how many of the processes died, with a thread of the rasteriser and without.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

RUNS = 5
SLEEPER = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <pthread.h>
#include <string.h>
#include <unistd.h>

/* Called by lp_fence_signal, which holds the fence's lock and has counted already. */
int pthread_cond_broadcast(pthread_cond_t *condition)
{
    static __thread int is_raster = -1;
    static __thread unsigned calls;
    int (*real)(pthread_cond_t *) = dlsym(RTLD_NEXT, "pthread_cond_broadcast");
    if (is_raster < 0) {
        char name[32] = "";
        pthread_getname_np(pthread_self(), name, sizeof name);
        is_raster = strncmp(name, "llvmpipe", 8) == 0;
    }
    if (is_raster && calls++ % 7 == 0)
        usleep(1000);
    return real(condition);
}
"""
RENDER = """
from scanrender.measure.extremes import random_case
from scanrender.measure.stress import examine_scene
from scanrender.render.device import device
for number in range(12):
    examine_scene(device(), random_case(number), number)
"""


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        source, library = Path(folder, "sleeper.c"), Path(folder, "sleeper.so")
        source.write_text(SLEEPER, encoding="utf-8")
        compile_it = ["cc", "-shared", "-fPIC", "-O1", str(source), "-o", str(library), "-ldl"]
        subprocess.run(compile_it, check=True)
        for threads in ("1", "0"):
            own = {"LD_PRELOAD": str(library), "LP_NUM_THREADS": threads}
            codes = [
                subprocess.run(
                    [sys.executable, "-c", RENDER], env={**os.environ, **own}, check=False
                ).returncode
                for _ in range(RUNS)
            ]
            died = [code for code in codes if code]
            print(f"LP_NUM_THREADS={threads}: {len(died)} of {RUNS} died {died or ''}".rstrip())


if __name__ == "__main__":
    main()
