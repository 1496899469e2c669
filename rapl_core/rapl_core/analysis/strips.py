"""A video as one row of pictures, small enough to stand inside a page."""

import base64
import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from rapl_core.types import check_shape


def strip(frames: NDArray[np.uint8], pictures: int = 8, gap: int = 2) -> NDArray[np.uint8]:
    """Return ``pictures`` frames, evenly spaced from first to last, side by side.

    :param frames: (N, H, W, 3) RGB.
    :return: (H, W', 3) RGB.
    """
    check_shape("frames", frames, (None, None, None, 3))
    chosen = np.linspace(0, len(frames) - 1, min(pictures, len(frames))).round().astype(int)
    height = frames.shape[1]
    bar = np.full((height, gap, 3), 128, np.uint8)
    parts = [part for index in chosen for part in (frames[index], bar)][:-1]
    return np.concatenate(parts, axis=1)


def picture_uri(picture: NDArray[np.uint8], quality: int = 82) -> str:
    """Return a picture as a ``data:`` URI (JPEG).

    :param picture: (H, W, 3) RGB.
    """
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, format="JPEG", quality=quality, optimize=True)
    return "data:image/jpeg;base64," + base64.b64encode(buffer.getvalue()).decode()
