"""Random changes of a whole video, as XIRL makes them while it learns."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torchvision.transforms import functional as change

from rapl_core.errors import ShapeError


@dataclass(frozen=True)
class Augmentation:
    """How far a video may be changed; every frame of it is changed alike."""

    smallest_crop: float = 0.6
    """Share of the picture's area that a crop keeps at least; it is resized back."""
    aspect: float = 4 / 3
    """Of the crop over that of the picture, at most; its inverse at least."""
    brightness: float = 0.4
    contrast: float = 0.4
    saturation: float = 0.4
    hue: float = 0.1
    jitter_share: float = 0.8
    """Of the videos whose colours are changed."""
    grey_share: float = 0.2
    """Of the videos that lose their colours."""
    blur_share: float = 0.2

    def __post_init__(self) -> None:
        if not 0 < self.smallest_crop <= 1 or self.aspect < 1:
            raise ShapeError(
                f"augmentation crops to {self.smallest_crop} of aspect {self.aspect}, "
                "expected 0 < crop <= 1 and aspect at least 1"
            )


def augment_video(
    frames: NDArray[np.uint8], config: Augmentation, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Return (T, H, W, 3) uint8 of the same size.

    :param frames: (T, H, W, 3) uint8.
    """
    height, width = frames.shape[1:3]
    x = torch.from_numpy(np.ascontiguousarray(frames)).permute(0, 3, 1, 2)  # (T, 3, H, W)
    top, left, rows, columns = _crop(height, width, config, rng)
    x = change.resized_crop(x, top, left, rows, columns, [height, width], antialias=True)
    if rng.random() < config.jitter_share:
        x = change.adjust_brightness(x, 1 + rng.uniform(-1, 1) * config.brightness)
        x = change.adjust_contrast(x, 1 + rng.uniform(-1, 1) * config.contrast)
        x = change.adjust_saturation(x, 1 + rng.uniform(-1, 1) * config.saturation)
        x = change.adjust_hue(x, rng.uniform(-1, 1) * config.hue)
    if rng.random() < config.grey_share:
        x = change.rgb_to_grayscale(x, num_output_channels=3)
    if rng.random() < config.blur_share:
        x = change.gaussian_blur(x, [5, 5], [float(rng.uniform(0.1, 1.5))])
    return np.ascontiguousarray(x.permute(0, 2, 3, 1).numpy())


def _crop(
    height: int, width: int, config: Augmentation, rng: np.random.Generator
) -> tuple[int, int, int, int]:
    side = float(np.sqrt(rng.uniform(config.smallest_crop, 1.0)))
    stretch = float(np.exp(rng.uniform(-1, 1) * np.log(config.aspect) / 2))
    rows = min(height, max(1, round(height * side / stretch)))
    columns = min(width, max(1, round(width * side * stretch)))
    top, left = rng.integers(height - rows + 1), rng.integers(width - columns + 1)
    return int(top), int(left), rows, columns
