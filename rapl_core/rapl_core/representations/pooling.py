"""From feature maps to a vector a frame."""

from dataclasses import dataclass
from typing import Literal, get_args

import torch
from torch import nn
from torch.nn import functional

from rapl_core.errors import ShapeError, UnknownNameError
from rapl_core.representations.parts import NUMBERS_OF_A_PART, PartPool, cell_centres

PoolingKind = Literal["gap", "grid", "moments", "parts"]
Attention = Literal["softmax", "positive"]

_TINY = 1e-6


@dataclass(frozen=True)
class Pooling:
    """How a feature map becomes a vector.

    ``gap``: the mean of each channel, C numbers. ``grid``: means over grid x grid cells, C grid^2
    numbers. ``moments``: where each channel looks, its attention's mean position (x, y) and, with
    ``second_moments``, spread (var x, var y, cov xy), and the channel's mean: 3 C or 6 C numbers;
    positions run from -1 to 1, so that the place of an object is linear in the vector. ``parts``:
    the same for clusters of cells in place of channels, 5 numbers a part; see ``parts.py``.
    """

    kind: PoolingKind = "gap"
    grid: int = 4
    """Cells a side; grid only."""
    attention: Attention = "softmax"
    """Moments only. ``softmax``: exp(sharpness * standardised activation); ``positive``: the
    activation's part above the channel's mean over the picture. Both normalised to sum 1."""
    sharpness: float = 2.0
    """Softmax only: per standard deviation of the channel over the picture."""
    second_moments: bool = False
    parts: int = 64
    """Parts only: how many."""
    softness: float = 0.3
    """Parts only; see :class:`~rapl_core.representations.parts.PartPool`."""

    def __post_init__(self) -> None:
        for what, name, known in (
            ("pooling", self.kind, get_args(PoolingKind)),
            ("attention", self.attention, get_args(Attention)),
        ):
            if name not in known:
                raise UnknownNameError(what, name, known)
        for field in ("grid", "sharpness", "parts", "softness"):
            if not getattr(self, field) > 0:
                raise ShapeError(
                    f"pooling has {field} {getattr(self, field)}, expected more than 0"
                )

    def size(self, channels: int) -> int:
        """Length of the vector that a map of that many channels becomes."""
        if self.kind == "parts":
            return NUMBERS_OF_A_PART * self.parts
        per_channel = {
            "gap": 1,
            "grid": self.grid**2,
            "moments": 6 if self.second_moments else 3,
        }
        return channels * per_channel[self.kind]


def make_pool(config: Pooling, channels: int) -> nn.Module:
    """A module (N, C, h, w) -> (N, size(C)) for maps of that many channels."""
    if config.kind == "parts":
        return PartPool(channels, config.parts, config.softness)
    return Pool(config)


class Pool(nn.Module):
    """Pooling of every kind but ``parts``: a module without parameters."""

    def __init__(self, config: Pooling) -> None:
        super().__init__()
        self.config = config

    def forward(self, maps: torch.Tensor) -> torch.Tensor:
        """(N, C, h, w) -> (N, size(C)), float32."""
        maps = maps.float()
        if self.config.kind == "gap":
            return maps.mean((-1, -2))
        if self.config.kind == "grid":
            return functional.adaptive_avg_pool2d(maps, self.config.grid).flatten(1)
        return self._moments(maps)

    def _moments(self, maps: torch.Tensor) -> torch.Tensor:
        n, c, h, w = maps.shape
        attention = self._attention(maps.flatten(2)).reshape(n, c, h, w)
        xs, ys = cell_centres(w), cell_centres(h)
        columns, rows = attention.sum(-2), attention.sum(-1)  # (N, C, w), (N, C, h)
        x, y = columns @ xs, rows @ ys  # (N, C)
        numbers = [x, y, maps.mean((-1, -2))]
        if self.config.second_moments:
            cross = torch.einsum("nchw,h,w->nc", attention, ys, xs)
            numbers += [columns @ xs**2 - x**2, rows @ ys**2 - y**2, cross - x * y]
        return torch.cat(numbers, dim=1)

    def _attention(self, flat: torch.Tensor) -> torch.Tensor:
        """(N, C, h w) activations -> weights that sum to 1 over the picture."""
        centred = flat - flat.mean(-1, keepdim=True)
        if self.config.attention == "softmax":
            spread = centred.square().mean(-1, keepdim=True).sqrt() + _TINY
            return torch.softmax(self.config.sharpness * centred / spread, dim=-1)
        positive = centred.clamp_min(0.0) + _TINY
        return positive / positive.sum(-1, keepdim=True)
