"""TCC on pictures: the backbone's last block learns together with the head."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from rapl_core.errors import RankingError
from rapl_core.representations.alignment import OnEpoch, fit_projection
from rapl_core.representations.augmentation import augment_video
from rapl_core.representations.encoder import Encoder
from rapl_core.representations.extractor import make_extractor
from rapl_core.representations.features import FeatureStore, find_parts
from rapl_core.representations.heads import Embedder, linear_head
from rapl_core.representations.presets import Preset
from rapl_core.representations.tcc import (
    TccConfig,
    TccReport,
    draw_frames,
    draw_videos,
    minimise,
    tcc_encoder,
)
from rapl_core.representations.trainable import TrainableBackbone

_STATISTICS_VIDEOS = 40


def learn_tcc_block(
    videos: Mapping[str, NDArray[np.uint8]],
    expert_ids: Sequence[str],
    backbone: str,
    preset: Preset,
    config: TccConfig,
    rng: np.random.Generator,
    folder: Path,
    weights: Path | None = None,
    method: str = "tcc",
    on_epoch: OnEpoch | None = None,
    demonstrations: Sequence[str] | None = None,
) -> tuple[Encoder, TccReport]:
    """Learn last block and head from demonstrations; see :func:`tcc.learn_tcc`.

    Each video of a batch is shown changed (``config.augmentation``) unless ``config.views`` is 0.

    :param videos: (T, H, W, 3) of each demonstration and expert.
    :param demonstrations: those that are learnt from; None: all.
    :param folder: gets the backbone's new weights.
    """
    started = time.monotonic()
    names = sorted(videos if demonstrations is None else demonstrations)
    if len(names) < 2:
        raise RankingError(f"TCC needs two demonstrations or more, got {len(names)}")
    first = make_extractor(backbone, preset.recipe, weights)
    find_parts(first, names, videos.__getitem__, int(rng.integers(2**31)))
    network = TrainableBackbone(first, weights)
    projection = None
    if preset.has_projection:  # statistics of the features before the block learns; then fixed
        sample = {n: first.extract(videos[n]).numpy() for n in names[:_STATISTICS_VIDEOS]}
        projection = fit_projection(sample, preset, rng)
    width = network(videos[names[0]][:1]).shape[1]
    head = linear_head(projection.dimension if projection else width, preset.dimension, rng)
    embedder = Embedder(projection, head)
    optimisers = [
        torch.optim.Adam(
            head.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay
        ),
        torch.optim.Adam(
            network.free_parameters(),
            lr=config.block_learning_rate,
            weight_decay=config.weight_decay,
        ),
    ]

    def embed_batch() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        drawn = draw_videos(names, config, rng)
        taken = [draw_frames(len(videos[name]), config, rng) for name in drawn]
        shown = [videos[name][rows.numpy()] for name, rows in zip(drawn, taken, strict=True)]
        if config.views:
            shown = [augment_video(frames, config.augmentation, rng) for frames in shown]
        features = network(np.concatenate(shown)).unflatten(0, (len(drawn), config.frames))
        lengths = torch.tensor([len(videos[name]) for name in drawn])
        return embedder(features), torch.stack(taken), lengths

    losses = minimise(embed_batch, optimisers, config, rng, on_epoch)
    features = FeatureStore(network.trained(folder))
    for name, frames in sorted(videos.items()):
        features.add(name, frames)
    return tcc_encoder(
        features, embedder, losses, expert_ids, preset, config, rng, method, started,
        has_own_backbone=True,
    )  # fmt: skip
