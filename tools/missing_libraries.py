"""Prints the Debian packages of the system libraries that are missing here, one a line.

Standard library only: it runs before anything is installed. A library counts as there when the
dynamic loader opens it; a GL driver counts as there when EGL initialises on some device, so that a
machine with a vendor's driver is not asked for Mesa.
"""

from __future__ import annotations

import ctypes

# Loader name -> Debian and Ubuntu package.
LIBRARIES = {
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libOpenGL.so.0": "libopengl0",  # pymeshlab's filters
}
SOFTWARE_DRIVER = ("libegl-mesa0", "libgl1-mesa-dri")

EGL_OPENGL_API = 0x30A2
EGL_PLATFORM_DEVICE_EXT = 0x313F
MAX_DEVICES = 16


def loads(name: str) -> bool:
    try:
        ctypes.CDLL(name)
    except OSError:
        return False
    return True


def egl_works() -> bool:
    """Whether some EGL device initialises and knows desktop OpenGL."""
    egl = ctypes.CDLL("libEGL.so.1")
    egl.eglGetProcAddress.restype = ctypes.c_void_p
    query = egl.eglGetProcAddress(b"eglQueryDevicesEXT")
    display_of = egl.eglGetProcAddress(b"eglGetPlatformDisplayEXT")
    if not query or not display_of:
        return False
    handle = ctypes.c_void_p
    query_devices = ctypes.CFUNCTYPE(
        ctypes.c_uint, ctypes.c_int, ctypes.POINTER(handle), ctypes.POINTER(ctypes.c_int)
    )(query)
    get_display = ctypes.CFUNCTYPE(handle, ctypes.c_uint, handle, handle)(display_of)
    egl.eglInitialize.argtypes = [handle, handle, handle]
    devices, count = (handle * MAX_DEVICES)(), ctypes.c_int(0)
    if not query_devices(MAX_DEVICES, devices, ctypes.byref(count)):
        return False
    for index in range(count.value):
        display = get_display(EGL_PLATFORM_DEVICE_EXT, devices[index], None)
        if display and egl.eglInitialize(display, None, None):
            return bool(egl.eglBindAPI(EGL_OPENGL_API))
    return False


def missing() -> list[str]:
    packages = [package for name, package in LIBRARIES.items() if not loads(name)]
    if "libegl1" in packages or not egl_works():
        packages += SOFTWARE_DRIVER
    return packages


if __name__ == "__main__":
    print("\n".join(missing()))
