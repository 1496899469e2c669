"""Name what the system lacks before set-up downloads anything. Needs only the standard library.

Prints two lines: the name of a working software or hardware GL for MuJoCo (``egl``, ``osmesa`` or
nothing), and the Debian packages that are missing, separated by spaces.
"""

import ctypes
import importlib.util
import shutil
import sys
import sysconfig
from pathlib import Path

GL_PACKAGES = ["libegl1", "libgl1", "libgl1-mesa-dri"]

EGL_PLATFORM_DEVICE_EXT = 0x313F
MAX_DEVICES = 16


def egl_works() -> bool:
    """Tell whether one EGL device can be initialised, as MuJoCo does it."""
    try:
        egl = ctypes.CDLL("libEGL.so.1")
        ctypes.CDLL("libGL.so.1")
    except OSError:
        return False
    egl.eglGetProcAddress.restype = ctypes.c_void_p
    query_address = egl.eglGetProcAddress(b"eglQueryDevicesEXT")
    display_address = egl.eglGetProcAddress(b"eglGetPlatformDisplayEXT")
    if not query_address or not display_address:
        return False
    handle, count = ctypes.c_void_p, ctypes.c_int
    query = ctypes.CFUNCTYPE(ctypes.c_uint, count, ctypes.POINTER(handle), ctypes.POINTER(count))
    get_display = ctypes.CFUNCTYPE(handle, ctypes.c_uint, handle, handle)
    devices, found = (handle * MAX_DEVICES)(), count(0)
    if not query(query_address)(MAX_DEVICES, devices, ctypes.byref(found)):
        return False
    egl.eglInitialize.argtypes = [handle, handle, handle]
    egl.eglTerminate.argtypes = [handle]
    for device in devices[: found.value]:
        display = get_display(display_address)(EGL_PLATFORM_DEVICE_EXT, device, None)
        if display and egl.eglInitialize(display, None, None):
            egl.eglTerminate(display)
            return True
    return False


def osmesa_works() -> bool:
    """Tell whether off-screen Mesa can be loaded."""
    for name in ("libOSMesa.so.8", "libOSMesa.so"):
        try:
            ctypes.CDLL(name)
        except OSError:
            continue
        return True
    return False


def missing_packages(gl: str) -> list[str]:
    """Return the Debian packages that bring what is missing."""
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    missing = []
    if not any(shutil.which(compiler) for compiler in ("c++", "g++", "clang++")):
        missing.append("g++")
    if importlib.util.find_spec("ensurepip") is None:
        missing.append(f"{version}-venv")
    if not (Path(sysconfig.get_path("include")) / "Python.h").exists():
        missing.append(f"{version}-dev")
    if not gl:
        missing += GL_PACKAGES
    return missing


def main() -> None:
    """Print both lines."""
    gl = "egl" if egl_works() else "osmesa" if osmesa_works() else ""
    print(gl)
    print(*missing_packages(gl))


if __name__ == "__main__":
    main()
