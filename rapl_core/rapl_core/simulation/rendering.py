"""Off-screen pictures of a world."""

import os
import warnings
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import RaplError


class Renderer:
    """Draws worlds of one model. One a process, used by the thread that made it (mujoco#3444).

    :param camera: camera name in the model.
    :param size: height and width of the picture in pixels.
    :raises RaplError: if no off-screen GL can be had; names what to install.
    """

    def __init__(self, model: mujoco.MjModel, camera: str, size: int) -> None:
        try:
            self._renderer = mujoco.Renderer(model, size, size)
        except Exception as error:
            raise RaplError(
                f"no off-screen rendering with MUJOCO_GL={os.environ['MUJOCO_GL']}: {error}; "
                "install libegl1 and libgl1-mesa-dri, or libosmesa6 and set MUJOCO_GL=osmesa"
            ) from error
        self._camera = camera
        self._options = mujoco.MjvOption()
        self._options.sitegroup[:] = 0
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        warn_of_software_gl()

    def render(self, data: mujoco.MjData) -> NDArray[np.uint8]:
        """Return the picture (H, W, 3)."""
        self._renderer.update_scene(data, self._camera, self._options)
        return np.asarray(self._renderer.render(), dtype=np.uint8)

    def segment(self, data: mujoco.MjData) -> NDArray[np.int32]:
        """Return the id of the geom seen at each pixel (H, W); -1 for none."""
        self._renderer.enable_segmentation_rendering()
        try:
            self._renderer.update_scene(data, self._camera, self._options)
            seen = self._renderer.render()
        finally:
            self._renderer.disable_segmentation_rendering()
        is_geom = seen[..., 1] == mujoco.mjtObj.mjOBJ_GEOM
        return np.where(is_geom, seen[..., 0], -1)

    def close(self) -> None:
        """Free the GL context."""
        self._renderer.close()


def warn_of_software_gl() -> None:
    """Warn once where EGL draws in software although the machine has a GPU."""
    if os.environ["MUJOCO_GL"] != "egl" or not Path("/dev/dri/renderD128").exists():
        return
    from OpenGL import GL

    name = GL.glGetString(GL.GL_RENDERER).decode()
    if "llvmpipe" in name.lower():
        warnings.warn(
            f"EGL renders in software ({name}) although this machine has a GPU", stacklevel=3
        )
