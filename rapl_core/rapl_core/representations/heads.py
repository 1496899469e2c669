"""The trained last layer, and what lies between it and the frozen features."""

import numpy as np
import torch
from torch import nn

from rapl_core.representations.projection import Projection


def linear_head(features: int, dimension: int, rng: np.random.Generator) -> nn.Linear:
    """A linear layer, initialised uniformly within 1 / sqrt(features) from ``rng``."""
    bound = features**-0.5
    head = empty_head(features, dimension)
    with torch.no_grad():
        for parameter in head.parameters():
            values = rng.uniform(-bound, bound, size=tuple(parameter.shape))
            parameter.copy_(torch.from_numpy(values))
    return head


def empty_head(features: int, dimension: int) -> nn.Linear:
    """A linear layer whose weights are yet to be set."""
    return nn.Linear(features, dimension, device="meta").to_empty(device="cpu")


class Embedder(nn.Module):
    """What follows the frozen features: standardisation and components, then the head.

    Either may be absent; without both the features are the embedding.
    """

    def __init__(self, projection: Projection | None, head: nn.Linear | None) -> None:
        super().__init__()
        self.projection = projection
        self.head = head

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """(..., F) -> (..., D)."""
        if self.projection is not None:
            features = self.projection(features)
        return features if self.head is None else self.head(features)
