"""One GL context per process: finding it, compiling into it, drawing a full-screen pass.

Only this module creates contexts. Minimum GL 3.3 core. EGL needs no display, so this works on a
server; Mesa's llvmpipe is a supported and the reference device.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
import numpy.typing as npt

from scanrender.errors import CrashError, DeviceError
from scanrender.resources import shader_folder

REQUIRED_GL = 330
RASTER_THREADS = "LP_NUM_THREADS"
_INCLUDE = re.compile(r'^#include "([\w.]+)"$', re.MULTILINE)
_NO_GL = (
    "install EGL and Mesa's software driver (Debian: apt-get install libegl1 libgl1 "
    "libgl1-mesa-dri), then run: scanrender doctor"
)


class Device:
    """The process's GL context with its compiled programs."""

    def __init__(self, context: moderngl.Context) -> None:
        self.context = context
        self.renderer = str(context.info["GL_RENDERER"])
        self.version = str(context.info["GL_VERSION"])
        self.vendor = str(context.info["GL_VENDOR"])
        self.driver = f"{self.renderer} | {self.version}"
        self.most_px = int(context.info["GL_MAX_TEXTURE_SIZE"])  # a side of a picture
        self._programs: dict[tuple[str, str, tuple[str, ...]], moderngl.Program] = {}
        self._triangles: dict[int, moderngl.VertexArray] = {}

    @property
    def is_software(self) -> bool:
        return any(word in self.renderer.lower() for word in ("llvmpipe", "softpipe", "swrast"))

    def program(
        self, name: str, vertex: str = "fullscreen", defines: tuple[str, ...] = ()
    ) -> moderngl.Program:
        """Compile `shaders/{name}.frag` with `shaders/{vertex}.vert`, once. Raises DeviceError.

        `defines` are switched on in the fragment shader: what a mode does not use costs nothing,
        where a software rasteriser runs both sides of a branch.
        """
        key = (name, vertex, defines)
        if key not in self._programs:
            fragment = _source(f"{name}.frag")
            head, rest = fragment.split("\n", 1)
            switches = "".join(f"#define {word}\n" for word in defines)
            try:
                self._programs[key] = self.context.program(
                    vertex_shader=_source(f"{vertex}.vert"),
                    fragment_shader=f"{head}\n{switches}{rest}",
                )
            except moderngl.Error as error:
                raise DeviceError(
                    f"the GL driver ({self.renderer}) cannot compile {name}: {error}",
                    where=str(shader_folder() / f"{name}.frag"),
                    fix="update the driver, or use Mesa's software renderer",
                ) from error
        return self._programs[key]

    def fill(self, program: moderngl.Program) -> None:
        """Run a fragment program on every pixel of the bound framebuffer (inside its scissor)."""
        key = program.glo
        if key not in self._triangles:
            self._triangles[key] = self.context.vertex_array(program, [])
        self._triangles[key].render(moderngl.TRIANGLES, vertices=3)

    def table(self, values: npt.NDArray[Any], *, linear: bool = False) -> moderngl.Texture:
        """A float32 texture (rows, columns, 1 to 4 components), clamped at its edges."""
        data = np.ascontiguousarray(values, dtype=np.float32)
        rows, columns, components = data.shape
        texture = self.context.texture((columns, rows), components, data.tobytes(), dtype="f4")
        texture.filter = (moderngl.LINEAR,) * 2 if linear else (moderngl.NEAREST,) * 2
        texture.repeat_x = texture.repeat_y = False
        return texture

    def let_go(self) -> None:
        """Delete the GL objects that nothing refers to any more: a turntable makes thousands."""
        waiting = self.context.objects
        while waiting:
            # Not `context.gc()`: it fails on what has been released by name (moderngl 5.13).
            release = getattr(waiting.popleft(), "release", None)
            if release is not None:
                release()

    def finish(self) -> None:
        self.context.finish()

    def check(self) -> None:
        """A context that was lost goes on giving pictures: black ones. Raises CrashError."""
        error = self.context.error
        if error != "GL_NO_ERROR":
            raise CrashError(
                f"the GL driver ({self.renderer}) failed: {error}",
                fix="run it again; if it persists, update the driver or use a smaller picture",
            )


def bind(program: moderngl.Program, uniforms: Mapping[str, Any]) -> None:
    """Set uniforms and textures by name. Names that the compiler removed as unused are skipped.

    `bytes` are an array in the program's own layout. 4x4 matrices are given in mathematical order
    (row, column); GL wants columns first.
    """
    unit = 0
    for name, value in uniforms.items():
        is_texture = isinstance(value, moderngl.Texture | moderngl.Texture3D)
        member: Any = program.get(name, None)
        if member is None:
            continue
        if is_texture:
            value.use(unit)
            member.value = unit
            unit += 1
        elif isinstance(value, bytes):
            member.write(value)
        elif isinstance(value, np.ndarray) and value.ndim == 2:
            member.write(np.ascontiguousarray(value.T, dtype=np.float32).tobytes())
        elif isinstance(value, np.ndarray):
            member.value = tuple(float(x) for x in value)
        else:
            member.value = value


@cache
def device() -> Device:
    """The process's device, created on first use. Raises DeviceError when there is no usable GL."""
    problems = []
    # Slim images carry no unversioned libGL.so/libEGL.so, which is what glcontext asks for first.
    attempts: list[Any] = [
        {"backend": "egl", "libgl": "libGL.so.1", "libegl": "libEGL.so.1"},
        {"backend": "egl"},
    ]
    for names in attempts:
        try:
            with _without_raster_threads():
                context = moderngl.create_context(standalone=True, require=REQUIRED_GL, **names)
        except Exception as error:  # noqa: BLE001  glcontext raises bare Exceptions
            problems.append(str(error))
            continue
        # What Python lets go of waits for `let_go`: in "auto" it is deleted by whichever thread
        # collects garbage, and where that has no context GL ignores it and the memory is lost.
        context.gc_mode = "context_gc"
        return Device(context)
    raise DeviceError(f"no usable OpenGL: {problems[0]}", fix=_NO_GL)


@contextlib.contextmanager
def _without_raster_threads() -> Iterator[None]:
    """llvmpipe draws in the thread that asks, unless LP_NUM_THREADS says otherwise.

    Its own threads write into freed memory now and then: `lp_fence_signalled` reads a fence's count
    without its lock, so that the fence can be freed while a thread is still unlocking it
    (docs/decisions/0034).
    """
    asked = os.environ.get(RASTER_THREADS)
    os.environ[RASTER_THREADS] = asked or "0"
    try:
        yield
    finally:
        if asked is None:
            del os.environ[RASTER_THREADS]
        else:
            os.environ[RASTER_THREADS] = asked


@cache
def _source(file: str) -> str:
    folder: Path = shader_folder()
    text = (folder / file).read_text(encoding="utf-8")
    return _INCLUDE.sub(lambda match: _source(match.group(1)), text)
