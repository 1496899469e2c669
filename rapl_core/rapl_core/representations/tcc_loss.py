"""The losses of temporal cycle consistency (Dwibedi et al. 2019), with the options of XIRL.

A cycle starts at a frame of one video, goes to its soft nearest neighbour in another (and on to
further ones) and back. It should come back to where it started:

    beta = softmax(sim(u_i, V)),  v~ = sum_j beta_j v_j,  logits_k = sim(v~, u_k)
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import torch
from torch.nn.functional import cross_entropy, huber_loss, normalize

from rapl_core.errors import ShapeError, UnknownNameError

TccLossKind = Literal["regression_mse", "regression_mse_var", "regression_huber", "classification"]
Similarity = Literal["l2", "cosine"]

_SMALLEST_VARIANCE = 1e-8


@dataclass(frozen=True)
class TccLossConfig:
    """Which cycle-consistency loss; the defaults are those of XIRL's experiments."""

    kind: TccLossKind = "regression_mse"
    """``classification``: which frame the cycle started at. ``regression_*``: at which time, with
    squared error, squared error weighed by the predicted variance, or Huber's."""
    stochastic: bool = False
    """Draw cycles through ``cycle_length`` videos at random instead of taking every pair."""
    cycle_length: int = 2
    """Videos in a stochastic cycle."""
    cycles: int | None = None
    """Stochastic cycles a batch; None: videos times frames."""
    similarity: Similarity = "l2"
    """``l2``: minus the squared distance. ``cosine``: the inner product, of unit vectors if
    ``has_unit_embeddings``. Both divided by the number of dimensions."""
    temperature: float = 1.0
    has_unit_embeddings: bool = False
    has_relative_time: bool = True
    """Measure time in lengths of the video, not in frames."""
    label_smoothing: float = 0.1
    """Classification only."""
    variance_weight: float = 0.001
    """Of the logarithm of the predicted variance; regression_mse_var only."""
    huber_delta: float = 0.1

    def __post_init__(self) -> None:
        for what, name, known in (
            ("TCC loss", self.kind, get_args(TccLossKind)),
            ("TCC similarity", self.similarity, get_args(Similarity)),
        ):
            if name not in known:
                raise UnknownNameError(what, name, known)
        if self.temperature <= 0 or self.cycle_length < 2:
            raise ShapeError(
                f"TCC has temperature {self.temperature} and cycle_length {self.cycle_length}, "
                "expected above 0 and at least 2"
            )


def tcc_loss(
    z: torch.Tensor,
    frames: torch.Tensor,
    lengths: torch.Tensor,
    config: TccLossConfig,
    rng: np.random.Generator,
) -> torch.Tensor:
    """The mean loss over cycles through a batch of videos.

    :param z: (B, T, D) embeddings of T frames of each video, two videos or more.
    :param frames: (B, T) which frames of their videos these are.
    :param lengths: (B,) frames that each whole video has.
    :param rng: draws stochastic cycles; not used by deterministic ones.
    :raises ShapeError: for fewer videos than a cycle needs.
    """
    least = config.cycle_length if config.stochastic else 2
    if z.ndim != 3 or len(z) < least:
        raise ShapeError(f"TCC on embeddings of shape {tuple(z.shape)}, expected ({least}+, T, D)")
    if config.has_unit_embeddings:
        z = normalize(z, dim=-1)
    times = frames.to(z.dtype)
    if config.has_relative_time:
        times = times / lengths.to(z.dtype)[:, None]
    cycle = _stochastic_cycles if config.stochastic else _deterministic_cycles
    logits, started, videos = cycle(z, config, rng)  # (C, T), (C,), (C,)
    return _loss(logits, started, times[videos], config)


def scaled_similarity(x: torch.Tensor, y: torch.Tensor, config: TccLossConfig) -> torch.Tensor:
    """(..., M, D), (..., N, D) -> (..., M, N), over dimensions and temperature."""
    if config.similarity == "cosine":
        similarity = x @ y.transpose(-1, -2)
    else:
        squares = x.square().sum(-1)[..., :, None] + y.square().sum(-1)[..., None, :]
        similarity = -(squares - 2 * x @ y.transpose(-1, -2)).clamp_min(0.0)
    return similarity / (x.shape[-1] * config.temperature)


def _deterministic_cycles(
    z: torch.Tensor, config: TccLossConfig, rng: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Every frame of every ordered pair of videos."""
    del rng
    videos, steps = z.shape[:2]
    first, second = torch.nonzero(~torch.eye(videos, dtype=torch.bool), as_tuple=True)  # (P,)
    to = torch.softmax(scaled_similarity(z[first], z[second], config), dim=-1)  # (P, T, T)
    logits = scaled_similarity(to @ z[second], z[first], config)  # (P, T, T)
    started = torch.arange(steps).repeat(len(first))
    return logits.flatten(0, 1), started, first.repeat_interleave(steps)


def _stochastic_cycles(
    z: torch.Tensor, config: TccLossConfig, rng: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Cycles through distinct videos from random frames."""
    videos, steps = z.shape[:2]
    count = config.cycles or videos * steps
    routes = torch.from_numpy(
        np.stack([rng.permutation(videos)[: config.cycle_length] for _ in range(count)])
    )  # (C, L)
    started = torch.from_numpy(rng.integers(steps, size=count))
    query = z[routes[:, 0], started][:, None]  # (C, 1, D)
    for hop in range(1, config.cycle_length):
        candidates = z[routes[:, hop]]  # (C, T, D)
        query = torch.softmax(scaled_similarity(query, candidates, config), -1) @ candidates
    logits = scaled_similarity(query, z[routes[:, 0]], config)[:, 0]  # (C, T)
    return logits, started, routes[:, 0]


def _loss(
    logits: torch.Tensor, started: torch.Tensor, times: torch.Tensor, config: TccLossConfig
) -> torch.Tensor:
    """
    :param logits: (C, T) of where a cycle came back to.
    :param started: (C,) frame where it started.
    :param times: (C, T) of the frames of its video.
    """
    if config.kind == "classification":
        return cross_entropy(logits, started, label_smoothing=config.label_smoothing)
    beta = torch.softmax(logits, dim=-1)
    true = times.gather(1, started[:, None])[:, 0]  # (C,)
    found = (beta * times).sum(-1)
    if config.kind == "regression_huber":
        return huber_loss(found, true, delta=config.huber_delta)
    error = (true - found).square()
    if config.kind == "regression_mse":
        return error.mean()
    variance = (beta * (times - found[:, None]).square()).sum(-1)
    log_variance = (variance + _SMALLEST_VARIANCE).log()
    return (torch.exp(-log_variance) * error + config.variance_weight * log_variance).mean()
