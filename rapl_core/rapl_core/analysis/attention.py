"""Which places of a picture make its embedding: the paper's attention map.

The paper (appendix, "Attention Map for RAPL and RLHF") averages a feature map over the picture and
maps the mean linearly, ``W^T mean_i F_i``. The order can be changed: inflated to a 1 x 1 kernel, W
is applied to every place before the average is taken, ``mean_i W^T F_i``. What stands under that
mean is a map of embeddings, and its mean over channels is drawn.

Statistics, components and biases belong to the linear mapping here, so that the mean over places
is the embedding itself. A bias counts everywhere alike. Averages over the cells of a grid are
linear too: each place takes the weights of its cell. Places of parts and moments of attention are
quotients and a class token is no mean, so no such map of theirs exists.
"""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn import functional

from rapl_core.errors import RaplError
from rapl_core.representations.backbones import Backbone
from rapl_core.representations.encoder import Encoder
from rapl_core.representations.heads import Embedder
from rapl_core.representations.pooling import PoolingKind
from rapl_core.representations.preprocessing import preprocess

LINEAR: tuple[PoolingKind, ...] = ("gap", "grid")
"""Poolings that are means of the feature map."""


class AttentionError(RaplError):
    """An encoder's embedding is no mean over places of the picture."""


def attention_map(
    encoder: Encoder, frames: NDArray[Any], batch_size: int = 16
) -> NDArray[np.float32]:
    """What each place adds to the mean of the embedding's numbers (paper, appendix).

    The mean over places is the mean over D of the embedding. With D = 1 (``rlhf``) that is what
    each place adds to the reward. With more, it depends on the axes that the embedding happens to
    have, which neither cosine nor Euclidean distance does: see :func:`embedding_map`.

    :param frames: (N, H, W, 3) uint8 RGB of any one size.
    :return: (N, h, w), of the size of the backbone's finest map that is read.
    :raises AttentionError: if the encoder's embedding is no mean over places.
    :raises ShapeError: for frames of another shape or dtype.
    """
    return np.asarray(embedding_map(encoder, frames, batch_size).mean(-1))


def embedding_map(
    encoder: Encoder, frames: NDArray[Any], batch_size: int = 16
) -> NDArray[np.float32]:
    """The embedding before it is averaged over the picture; always by torch in float32.

    :param frames: (N, H, W, 3) uint8 RGB of any one size.
    :return: (N, h, w, D), whose mean over h and w is the embedding.
    :raises AttentionError, ShapeError: as :func:`attention_map`.
    """
    _check(encoder)
    extractor = encoder.extractor
    weight, bias = _affine(encoder.embedder, extractor.dimension)
    parts = []
    with torch.inference_mode():
        for start in range(0, max(len(frames), 1), batch_size):
            x = preprocess(frames[start : start + batch_size], extractor.preprocessing)
            maps = _maps(extractor.backbone, x)
            sizes = [tuple(m.shape[-2:]) for m in maps]
            height, width = max(sizes)
            total = bias.expand(len(x), height, width, -1)
            for of_stage, grid, rows in _pooled(encoder, maps):
                inflated = _inflated(of_stage.float(), weight[rows], grid)  # (N, h', w', D)
                total = total + _spread(inflated, height, width, encoder)
            parts.append(total.float().numpy())
    return np.concatenate(parts)


def _check(encoder: Encoder) -> None:
    """
    :raises AttentionError: naming what is not linear.
    """
    spec, recipe = encoder.extractor.backbone.spec, encoder.extractor.recipe
    who = f"encoder {encoder.card.method} (preset {encoder.card.preset}, {spec.name})"
    kinds = [pooling.kind for pooling in recipe.poolings]
    if other := [kind for kind in kinds if kind not in LINEAR]:
        raise AttentionError(
            f"{who} has no attention map: its pooling '{other[0]}' is not linear in the feature "
            f"map; poolings that are: {', '.join(LINEAR)}"
        )
    if "final" not in recipe.stages or spec.final == "map":
        return
    if spec.final == "token":
        raise AttentionError(
            f"{who} has no attention map: it ends with a class token, which is no mean of places; "
            "networks that end with a feature map have one"
        )
    network = encoder.extractor.backbone.network
    is_average = getattr(getattr(network, "global_pool", None), "pool_type", "") == "avg"
    if kinds != ["gap"] or not (is_average and isinstance(network.get_classifier(), nn.Linear)):
        raise AttentionError(
            f"{who} has no attention map: its own last layer is not linear in a mean over places; "
            "networks that end with an average and one linear layer have one"
        )


def _affine(embedder: Embedder, features: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Statistics, components and head as one mapping ``f @ weight + bias``.

    :return: weight (F, D) and bias (D,), float64.
    """
    weight, bias = torch.eye(features, dtype=torch.float64), torch.zeros(features).double()
    projection, head = embedder.projection, embedder.head
    if projection is not None:
        scale = 1.0 / projection.deviation.double()
        weight, bias = torch.diag(scale), -projection.mean.double() * scale
        if projection.components.shape[1]:
            components = projection.components.double()
            weight, bias = weight @ components, bias @ components
    if head is not None:
        weight, bias = weight @ head.weight.double().T, bias @ head.weight.double().T
        bias = bias + head.bias.double()
    return weight, bias


def _maps(backbone: Backbone, x: torch.Tensor) -> list[torch.Tensor]:
    """Each stage's (N, C, h, w); a network's own last layer is inflated, not averaged."""
    maps: list[torch.Tensor] = backbone(x)
    if backbone.spec.final != "output" or "final" not in backbone.stages:
        return maps
    last = backbone.network.forward_features(x)  # (N, C', h, w)
    n, _, height, width = last.shape
    places = last.permute(0, 2, 3, 1).reshape(n * height * width, -1, 1, 1)
    own = backbone.network.forward_head(places).reshape(n, height, width, -1)
    return [
        own.permute(0, 3, 1, 2) if stage == "final" else of_stage
        for stage, of_stage in zip(backbone.stages, maps, strict=True)
    ]


def _pooled(
    encoder: Encoder, maps: list[torch.Tensor]
) -> Iterator[tuple[torch.Tensor, int, slice]]:
    """For each pooling its map, cells a side, and where its numbers are among the features."""
    start = 0
    for of_stage in maps:
        for pooling in encoder.extractor.recipe.poolings:
            end = start + pooling.size(of_stage.shape[1])
            yield of_stage, pooling.grid if pooling.kind == "grid" else 1, slice(start, end)
            start = end


def _inflated(maps: torch.Tensor, weight: torch.Tensor, grid: int) -> torch.Tensor:
    """Apply each cell's weights to the places in it.

    :param maps: (N, C, h, w).
    :param weight: (C grid^2, D), as the pooling orders its numbers.
    :return: (N, h, w, D) float64, whose mean over places is ``pooled @ weight``.
    """
    n, channels, height, width = maps.shape
    count = height * width
    of_cells = weight.reshape(channels, grid * grid, -1)  # (C, G, D)
    one_each = torch.eye(count, dtype=torch.float64).reshape(count, 1, height, width)
    shares = functional.adaptive_avg_pool2d(one_each, grid).reshape(count, -1)  # (h w, G)
    flat = maps.double().flatten(2).transpose(1, 2)  # (N, h w, C)
    result = torch.zeros(n, count, weight.shape[1], dtype=torch.float64)
    for cell in range(grid * grid):
        inside = torch.nonzero(shares[:, cell]).flatten()
        share = count * shares[inside, cell, None]  # (I, 1)
        result[:, inside] += share * (flat[:, inside] @ of_cells[:, cell])
    return result.reshape(n, height, width, -1)


def _spread(values: torch.Tensor, height: int, width: int, encoder: Encoder) -> torch.Tensor:
    """(N, h, w, D) repeated to the finest stage's size, which keeps the mean.

    :raises AttentionError: if the sizes are no multiples.
    """
    down, across = height / values.shape[1], width / values.shape[2]
    if not (math.floor(down) == down and math.floor(across) == across):
        raise AttentionError(
            f"encoder {encoder.card.method} has no attention map: its stages' maps of "
            f"{values.shape[1]} x {values.shape[2]} and {height} x {width} do not divide each "
            "other; read one stage, or pictures of another size"
        )
    return values.repeat_interleave(int(down), 1).repeat_interleave(int(across), 2)
