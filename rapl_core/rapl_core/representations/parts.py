"""Parts: what the pictures of a task consist of, found without labels.

Cells of a frozen backbone's feature maps are clustered (k-means of features: Coates and Ng 2012);
a cluster is a part, such as the red cube or an edge of the goal. A picture is described by how much
of each part it shows, where, and how spread. Places are then nearly linear in the vector, whatever
the stride of the maps, and the part of one object is not mixed with that of another.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from torch import nn

from rapl_core.errors import ShapeError, WeightsError

NUMBERS_OF_A_PART = 5
"""Share, x, y, var x, var y."""

_BACKGROUND_FRAMES = 600
_CHANGING = 0.1
"""Share of cells that count as changing: those that differ most from their place's median."""
_CHANGING_CELLS, _ANY_CELLS = 14_000, 6_000
_ITERATIONS = 25
_TINY = 1e-6


class PartPool(nn.Module):
    """Pooling by parts; says nothing before :meth:`fit` or a loaded state.

    :param channels: C of the maps.
    :param parts: K.
    :param softness: how far a cell may be from a part, in units of the mean squared distance of
        cells to their nearest part.
    """

    mean: torch.Tensor
    mixing: torch.Tensor
    centres: torch.Tensor
    scale: torch.Tensor

    def __init__(self, channels: int, parts: int, softness: float) -> None:
        super().__init__()
        self.softness = softness
        self.register_buffer("mean", torch.zeros(channels))
        self.register_buffer("mixing", torch.zeros(channels, channels))
        self.register_buffer("centres", torch.zeros(parts, channels))
        self.register_buffer("scale", torch.zeros(()))

    @property
    def is_fitted(self) -> bool:
        """Whether the parts are known."""
        return bool(self.scale > 0)

    def forward(self, maps: torch.Tensor) -> torch.Tensor:
        """(N, C, h, w) -> (N, 5 K): all shares, then all x, y, var x, var y; places in -1..1.

        The place of a part that is not in the picture goes to the middle.

        :raises WeightsError: before the parts are known.
        """
        if not self.is_fitted:
            raise WeightsError("the parts of a task's pictures are not known yet: fit them first")
        n, _, h, w = maps.shape
        distances = self._distances(maps.float().permute(0, 2, 3, 1))  # (N, h, w, K)
        belonging = torch.softmax(-distances / (self.softness * self.scale), dim=-1)
        rows, columns = belonging.mean(2), belonging.mean(1)  # (N, h, K), (N, w, K)
        share = rows.mean(1)  # (N, K)
        weight = share + 1.0 / (h * w)  # one cell's worth in the middle
        numbers = [share]
        spreads = []
        for line in (columns, rows):
            at = cell_centres(line.shape[1])
            place = (line * at[:, None]).mean(1) / weight
            numbers.append(place)
            spreads.append((line * at.square()[:, None]).mean(1) / weight - place.square())
        return torch.cat([*numbers, *spreads], dim=1)

    def fit(self, maps: torch.Tensor, rng: np.random.Generator) -> None:
        """Find the parts in maps (N, C, h, w) of some hundred pictures of a task.

        Mostly the cells that change from picture to picture are clustered; the table and the walls
        would fill most clusters else.

        :raises ShapeError: for fewer pictures than two or another number of channels.
        """
        n, c, h, w = maps.shape
        if n < 2 or c != len(self.mean):
            raise ShapeError(
                f"parts of maps of shape {tuple(maps.shape)}, expected (2 or more, "
                f"{len(self.mean)}, h, w)"
            )
        cells = maps.float().permute(0, 2, 3, 1)  # (N, h, w, C)
        sample = torch.from_numpy(_chosen(cells.numpy(), rng))  # (S, C)
        self.mean.copy_(sample.mean(0))
        # halfway to whitening: channels of little variance count, and their noise does not rule
        covariance = (sample - self.mean).T @ (sample - self.mean) / len(sample)
        values, vectors = torch.linalg.eigh(covariance)
        floor = _TINY * values.max()
        self.mixing.copy_(vectors / values.clamp_min(floor).sqrt().sqrt())
        mixed = ((sample - self.mean) @ self.mixing).numpy()
        centres, _ = kmeans2(mixed, len(self.centres), minit="++", iter=_ITERATIONS, rng=rng)
        self.centres.copy_(torch.from_numpy(centres))
        nearest = torch.cdist(torch.from_numpy(mixed), self.centres).min(1).values
        self.scale.copy_(nearest.square().mean().clamp_min(_TINY))

    def _distances(self, cells: torch.Tensor) -> torch.Tensor:
        """(..., C) -> (..., K) squared distances to the parts, up to a term of the cell alone."""
        mixed = (cells - self.mean) @ self.mixing
        return self.centres.square().sum(1) - 2.0 * mixed @ self.centres.T


def cell_centres(cells: int) -> torch.Tensor:
    """Centres of cells that tile [-1, 1]."""
    return (torch.arange(cells) * 2.0 + 1.0) / cells - 1.0


def _chosen(cells: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    """Cells to cluster, (S, C): more than two thirds of them from where something changes."""
    channels = cells.shape[-1]
    deviations = cells - np.median(cells[:_BACKGROUND_FRAMES], axis=0)
    spread = deviations.reshape(-1, channels).std(axis=0) + _TINY
    change = np.square(deviations / spread).mean(axis=-1)  # (N, h, w)
    changing = cells[change > np.quantile(change, 1.0 - _CHANGING)]  # (M, C)
    anywhere = cells.reshape(-1, channels)
    drawn = [
        part[rng.choice(len(part), min(count, len(part)), replace=False)]
        for part, count in ((changing, _CHANGING_CELLS), (anywhere, _ANY_CELLS))
    ]
    return np.concatenate(drawn)
