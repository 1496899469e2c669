"""Standardisation and principal components with stored statistics."""

import numpy as np
import torch
from torch import nn

from rapl_core.errors import ShapeError

_LARGEST_SAMPLE = 4000
_SMALLEST_DEVIATION = 1e-3


class Projection(nn.Module):
    """(features - mean) / deviation, then the first principal components, if asked for.

    The components keep their spectrum: all are divided by the one number that gives the first a
    standard deviation of 1, so that what varies little stays small (whitening would blow up noise).
    """

    mean: torch.Tensor
    deviation: torch.Tensor
    components: torch.Tensor

    def __init__(self, features: int, components: int | None) -> None:
        super().__init__()
        if components is not None and not 0 < components <= features:
            raise ShapeError(
                f"{components} principal components of {features} features, "
                f"expected 1 to {features}"
            )
        self.features = features
        self.dimension = features if components is None else components
        self.register_buffer("mean", torch.zeros(features))
        self.register_buffer("deviation", torch.ones(features))
        size = 0 if components is None else components
        self.register_buffer("components", torch.zeros(features, size))  # (F, K)
        self.explained = 1.0
        """Share of the standardised variance that the components keep, after a fit."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """(..., F) -> (..., K)."""
        standardised = (x - self.mean) / self.deviation
        return standardised @ self.components if self.components.shape[1] else standardised

    def fit(self, frames: torch.Tensor, rng: np.random.Generator) -> None:
        """Take the statistics of training frames; components from a sample of at most 4000.

        :param frames: (N, F) features of training videos only.
        :raises ShapeError: for another width, or fewer than two frames.
        """
        if frames.ndim != 2 or frames.shape[1] != self.features or len(frames) < 2:
            raise ShapeError(
                f"statistics of features of shape {tuple(frames.shape)}, "
                f"expected (2 or more, {self.features})"
            )
        self.mean.copy_(frames.mean(0))
        self.deviation.copy_(frames.std(0) + _SMALLEST_DEVIATION)
        if self.components.shape[1]:
            size = min(len(frames), _LARGEST_SAMPLE)
            rows = np.sort(rng.choice(len(frames), size, replace=False))
            self._fit_components((frames[torch.from_numpy(rows)] - self.mean) / self.deviation)

    def _fit_components(self, x: torch.Tensor) -> None:
        """Eigenvectors of the covariance, or of the Gram matrix where frames are fewer."""
        count = self.components.shape[1]
        covariance = x.T @ x / len(x) if len(x) >= x.shape[1] else x @ x.T / len(x)
        values, vectors = torch.linalg.eigh(covariance)  # ascending
        values, vectors = values.flip(0).clamp_min(0.0), vectors.flip(1)
        vectors = vectors[:, :count]
        if len(x) < x.shape[1]:
            lengths = (values[:count] * len(x)).sqrt().clamp_min(1e-6)
            vectors = x.T @ vectors / lengths  # (F, min(N, K))
        largest = values[0].sqrt().clamp_min(1e-6)
        self.components.zero_()
        self.components[:, : vectors.shape[1]] = vectors / largest
        self.explained = float(values[:count].sum() / values.sum().clamp_min(1e-12))
