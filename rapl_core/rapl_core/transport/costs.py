"""The cost of moving one frame's embedding onto another's."""

from typing import get_args

import torch

from rapl_core.errors import ShapeError, UnknownNameError
from rapl_core.transport.config import CostKind

_ZERO_NORM = 1e-12


def pairwise_cost(x: torch.Tensor, y: torch.Tensor, kind: CostKind) -> torch.Tensor:
    """Cost between every frame of ``x`` and every frame of ``y``; differentiable in both.

    Gradients are finite everywhere: at zero distance the Euclidean cost takes the subgradient 0,
    and a vector of norm below 1e-12 has no direction: its cosine cost is 1, its gradient 0.

    :param x: (..., T, D) embeddings.
    :param y: (..., S, D) embeddings; leading dimensions broadcast against those of ``x``.
    :param kind: ``cosine`` (1 - cos, within [0, 2]), ``euclidean`` or ``sqeuclidean``.
    :return: (..., T, S) costs.
    :raises ShapeError: if the embeddings are not matrices of the same width.
    :raises UnknownNameError: for another kind.
    """
    if x.ndim < 2 or y.ndim < 2 or x.shape[-1] != y.shape[-1]:
        raise ShapeError(
            f"embeddings have shapes {tuple(x.shape)} and {tuple(y.shape)}, "
            "expected (..., T, D) and (..., S, D) with the same D"
        )
    if kind == "cosine":
        return 1.0 - _unit(x) @ _unit(y).transpose(-1, -2)  # (..., T, S)
    if kind == "euclidean":
        # The matrix-product shortcut of cdist is off by 1e-3 for equal float32 vectors.
        return torch.cdist(x, y, compute_mode="donot_use_mm_for_euclid_dist")
    if kind == "sqeuclidean":
        centre = y.detach().reshape(-1, y.shape[-1]).mean(0)  # against cancellation
        x, y = x - centre, y - centre
        squares = x.square().sum(-1)[..., :, None] + y.square().sum(-1)[..., None, :]
        return (squares - 2.0 * (x @ y.transpose(-1, -2))).clamp_min(0.0)
    raise UnknownNameError("transport cost", kind, get_args(CostKind))


def _unit(x: torch.Tensor) -> torch.Tensor:
    """(..., D) vectors of length 1; those of norm below 1e-12 become 0 and stop gradients."""
    square = x.square().sum(-1, keepdim=True)
    is_zero = square < _ZERO_NORM**2
    inverse = torch.where(is_zero, torch.ones_like(square), square).rsqrt()
    return torch.where(is_zero, torch.zeros_like(x), x * inverse)
