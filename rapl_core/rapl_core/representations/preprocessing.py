"""From camera pictures to a backbone's input: the one function for training and for running."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from rapl_core.errors import ShapeError


@dataclass(frozen=True)
class Preprocessing:
    """Size and normalisation of a backbone's input: (picture / 255 - mean) / std."""

    height: int = 112
    width: int = 112
    shorter_side: int | None = None
    """None: squeeze the picture to height x width, whatever its aspect. Otherwise: resize its
    shorter side to this many pixels and cut height x width from the centre."""
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    std: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        if min(self.height, self.width) < 1:
            raise ShapeError(f"picture size {self.height} x {self.width} is not positive")
        if self.shorter_side is not None and self.shorter_side < max(self.height, self.width):
            raise ShapeError(
                f"shorter_side is {self.shorter_side}, expected at least the crop of "
                f"{self.height} x {self.width}"
            )
        if len(self.mean) != 3 or len(self.std) != 3 or min(self.std) <= 0:
            raise ShapeError(
                f"mean {self.mean} and std {self.std} must be three numbers each, std positive"
            )


IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)


def preprocess(frames: NDArray[Any], config: Preprocessing) -> torch.Tensor:
    """Turn pictures of any one size into a backbone's input.

    A picture that has the input's size already is not resampled.

    :param frames: (N, H, W, 3) uint8 RGB.
    :return: (N, 3, height, width) float32, channels last in memory.
    :raises ShapeError: if the frames are of another shape or dtype, or empty.
    """
    frames = np.asarray(frames)
    if frames.ndim != 4 or frames.shape[-1] != 3 or 0 in frames.shape:
        raise ShapeError(f"frames have shape {frames.shape}, expected (N, H, W, 3), not empty")
    if frames.dtype != np.uint8:
        raise ShapeError(f"frames have dtype {frames.dtype}, expected uint8")
    pixels = torch.from_numpy(np.ascontiguousarray(frames)).permute(0, 3, 1, 2)  # (N, 3, H, W)
    x = _fit(pixels.to(torch.float32), config)
    mean = torch.tensor(config.mean).mul(255.0)[:, None, None]
    std = torch.tensor(config.std).mul(255.0)[:, None, None]
    return ((x - mean) / std).contiguous(memory_format=torch.channels_last)


def _fit(x: torch.Tensor, config: Preprocessing) -> torch.Tensor:
    """Resample and crop (N, 3, H, W) to (N, 3, height, width)."""
    height, width = config.height, config.width
    if config.shorter_side is not None:
        shorter = min(x.shape[-2:])
        height = round(x.shape[-2] * config.shorter_side / shorter)
        width = round(x.shape[-1] * config.shorter_side / shorter)
    if tuple(x.shape[-2:]) != (height, width):
        x = functional.interpolate(
            x, size=(height, width), mode="bilinear", align_corners=False, antialias=True
        )
    top, left = (height - config.height) // 2, (width - config.width) // 2
    return x[..., top : top + config.height, left : left + config.width]
