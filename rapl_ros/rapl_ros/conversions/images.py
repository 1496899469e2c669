"""Pictures and cameras."""

import io
import math

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage
from PIL import UnidentifiedImageError
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from rapl_core.errors import ShapeError
from rapl_ros.conversions.headers import bytes_to_ros, header_to_ros
from rapl_ros.wire import (
    JoinKey,
)

# Channels a pixel, and their order as indices into the message's channels.
ENCODINGS: dict[str, tuple[int, tuple[int, int, int]]] = {
    "rgb8": (3, (0, 1, 2)),
    "bgr8": (3, (2, 1, 0)),
    "rgba8": (4, (0, 1, 2)),
    "bgra8": (4, (2, 1, 0)),
    "mono8": (1, (0, 0, 0)),
}


def image_to_ros(frame: NDArray[np.uint8], key: JoinKey) -> Image:
    """``frame`` (H, W, 3) RGB to an rgb8 image."""
    if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3:
        raise ShapeError(f"frame is {frame.dtype} {frame.shape}, expected uint8 (H, W, 3)")
    height, width = int(frame.shape[0]), int(frame.shape[1])
    return Image(
        header=header_to_ros(key),
        height=height,
        width=width,
        encoding="rgb8",
        is_bigendian=0,
        step=width * 3,
        data=bytes_to_ros(frame),
    )


def image_from_ros(msg: Image) -> NDArray[np.uint8]:
    """Image of a known 8-bit encoding to (H, W, 3) RGB; rows may be padded.

    :raises ShapeError: with width, height, step, encoding and bytes when they contradict.
    """
    facts = (
        f"image with width={msg.width} height={msg.height} step={msg.step} "
        f"encoding='{msg.encoding}' and {len(msg.data)} bytes"
    )
    if msg.encoding not in ENCODINGS:
        raise ShapeError(f"{facts}: unknown encoding; known: {', '.join(sorted(ENCODINGS))}")
    channels, order = ENCODINGS[msg.encoding]
    if msg.width == 0 or msg.height == 0:
        raise ShapeError(f"{facts}: has no pixels")
    if msg.step < msg.width * channels:
        raise ShapeError(f"{facts}: expected a step of at least {msg.width * channels}")
    if len(msg.data) != msg.height * msg.step:
        raise ShapeError(f"{facts}: expected height * step = {msg.height * msg.step} bytes")
    rows = np.frombuffer(msg.data, dtype=np.uint8).reshape(msg.height, msg.step)
    pixels = rows[:, : msg.width * channels].reshape(msg.height, msg.width, channels)
    if channels == 3 and order == (0, 1, 2):
        return pixels
    return np.ascontiguousarray(pixels[:, :, list(order)])  # (H, W, 3)


def compressed_image_from_ros(msg: CompressedImage) -> NDArray[np.uint8]:
    """JPEG or PNG image to (H, W, 3) RGB.

    :raises ShapeError: if the bytes are no complete JPEG or PNG.
    """
    facts = f"compressed image with format='{msg.format}' and {len(msg.data)} bytes"
    try:
        with PillowImage.open(io.BytesIO(bytes(msg.data)), formats=("JPEG", "PNG")) as picture:
            return np.array(picture.convert("RGB"), dtype=np.uint8)
    except UnidentifiedImageError as error:
        raise ShapeError(f"{facts}: neither jpeg nor png") from error
    except (OSError, SyntaxError, ValueError, PillowImage.DecompressionBombError) as error:
        raise ShapeError(f"{facts}: cannot be decoded: {error}") from error


def camera_info_to_ros(key: JoinKey, width: int, height: int, fovy_deg: float) -> CameraInfo:
    """Pinhole camera without distortion, from its vertical field of view.

    The focal length is H / 2 / tan(fovy / 2) pixels, the principal point the picture's middle.
    """
    focal = height / 2 / math.tan(math.radians(fovy_deg) / 2)
    x, y = width / 2, height / 2
    return CameraInfo(
        header=header_to_ros(key),
        width=int(width),
        height=int(height),
        distortion_model="plumb_bob",
        d=[0.0] * 5,
        k=[focal, 0.0, x, 0.0, focal, y, 0.0, 0.0, 1.0],
        r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p=[focal, 0.0, x, 0.0, 0.0, focal, y, 0.0, 0.0, 0.0, 1.0, 0.0],
    )
