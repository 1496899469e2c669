"""An encoder: pictures in, embeddings and rewards out."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from rapl_core.errors import ShapeError, WeightsError
from rapl_core.representations.card import EncoderCard
from rapl_core.representations.extractor import FeatureExtractor
from rapl_core.representations.heads import Embedder
from rapl_core.transport import TransportConfig, ot_reward
from rapl_core.transport.plain_rewards import (
    KINDS_WITH_EXPERTS,
    RewardKind,
    clock_reward,
    goal_reward,
    scalar_reward,
)
from rapl_core.types import EmbeddedEpisode, EncoderInfo, Episode, RewardTrace, check_shape

POOLS = "pools."
"""How the names of the poolings' tensors begin in a checkpoint."""


class Encoder:
    """Preprocessing, frozen backbone, pooling, statistics and head, and a rule for rewards.

    Immutable after creation; always computes in float32.
    """

    def __init__(
        self,
        extractor: FeatureExtractor,
        embedder: Embedder,
        card: EncoderCard,
        experts: Sequence[EmbeddedEpisode] = (),
    ) -> None:
        """
        :param experts: D+ through this encoder, where it brings them along; see :attr:`experts`.
        :raises WeightsError: if the parts do not belong together or have NaN weights.
        """
        if card.backbone_sha256 != extractor.backbone.weights_sha256:
            raise WeightsError(
                f"encoder {card.method} was made with {card.backbone} weights "
                f"{card.backbone_sha256[:12]}..., found "
                f"{extractor.backbone.weights_sha256[:12]}... of {extractor.backbone.spec.name}"
            )
        if extractor.needs_parts:
            raise WeightsError(f"encoder {card.method}: the parts of its pictures are not known")
        for name, tensor in encoder_tensors(extractor, embedder).items():
            if not bool(torch.isfinite(tensor).all()):
                raise WeightsError(f"encoder {card.method}: {name} has NaN or infinite values")
        self.card = card
        self.extractor = extractor.eval().requires_grad_(False)
        self.embedder = embedder.eval().requires_grad_(False)
        self.experts = tuple(experts)
        """D+ where it came with them, from an exported file; empty: embed the videos that
        :attr:`expert_ids` names."""
        for expert in self.experts:
            check_shape(f"expert {expert.episode_id}", expert.values, (None, card.dimension))
        self._version = card.version(self.tensors)

    @property
    def tensors(self) -> dict[str, torch.Tensor]:
        """What a checkpoint holds: everything but the backbone."""
        return encoder_tensors(self.extractor, self.embedder)

    @property
    def info(self) -> EncoderInfo:
        """Name, version and sizes."""
        return EncoderInfo(
            name=self.card.method,
            version=self._version,
            backbone=self.card.backbone,
            preset=self.card.preset,
            dimension=self.card.dimension,
            image_width=self.card.preprocessing.width,
            image_height=self.card.preprocessing.height,
            reward_scale=self.card.reward_scale,
        )

    @property
    def transport(self) -> TransportConfig:
        """How rewards of kind ``ot`` are computed."""
        return self.card.transport

    @property
    def reward_kind(self) -> RewardKind:
        """``ot``, ``scalar``, ``goal`` or ``clock``."""
        return self.card.reward_kind

    @property
    def needs_experts(self) -> bool:
        """False where embeddings alone make the reward."""
        return self.card.reward_kind in KINDS_WITH_EXPERTS

    @property
    def expert_ids(self) -> tuple[str, ...]:
        """The preferred videos that it was made with."""
        return self.card.expert_ids

    def embed(self, frames: NDArray[Any], batch_size: int = 16) -> NDArray[np.float32]:
        """Embed pictures of any one size.

        :param frames: (N, H, W, 3) uint8 RGB.
        :return: (N, D) float32.
        :raises ShapeError: for frames of another shape or dtype.
        """
        features = self.extractor.extract(frames, "float32", batch_size)
        return self.embed_features(features.numpy())

    def embed_features(self, features: NDArray[Any]) -> NDArray[np.float32]:
        """Embed what the extractor gave: (N, F) -> (N, D) float32."""
        with torch.inference_mode():
            z = self.embedder(torch.from_numpy(np.asarray(features, dtype=np.float32)))
        return np.array(z.numpy(), dtype=np.float32)

    def embed_episode(self, episode: Episode) -> EmbeddedEpisode:
        """Embed frames 1..T of an episode: those arrived in by its transitions."""
        return EmbeddedEpisode(episode.episode_id, self.embed(episode.frames[1:]))

    def embed_expert(self, episode_id: str, frames: NDArray[Any]) -> EmbeddedEpisode:
        """Embed the part of an expert video that rewards are matched with.

        :param frames: (T + 1, H, W, 3) all frames of the video.
        """
        kept = matched_part(frames[1:], self.card.expert_from)
        return EmbeddedEpisode(episode_id, self.embed(kept))

    def reward(self, z: NDArray[Any], experts: Sequence[EmbeddedEpisode]) -> RewardTrace:
        """Reward of each frame of a video by this encoder's own rule and scale.

        :param z: (T, D) embeddings of frames 1..T.
        :param experts: D+ through this encoder; not used by a scalar reward or the clock.
        :raises ShapeError: for embeddings of another width, NaN, or without experts.
        """
        return reward_of(self.card, z, experts)


def encoder_tensors(extractor: FeatureExtractor, embedder: Embedder) -> dict[str, torch.Tensor]:
    """An encoder's own tensors by name; those of the poolings begin with :data:`POOLS`."""
    pools = {POOLS + name: tensor for name, tensor in extractor.pools.state_dict().items()}
    return {**embedder.state_dict(), **pools}


def matched_part(frames: NDArray[Any], expert_from: float) -> NDArray[Any]:
    """The frames (T, ...) of an expert video that come after a share of it; at least one."""
    return frames[min(int(round(expert_from * len(frames))), len(frames) - 1) :]


def reward_of(
    card: EncoderCard, z: NDArray[Any], experts: Sequence[EmbeddedEpisode]
) -> RewardTrace:
    """Reward of each frame by a card's rule and scale; see :meth:`Encoder.reward`."""
    z = np.asarray(z)
    if z.ndim != 2 or z.shape[1] != card.dimension:
        raise ShapeError(f"embedding has shape {z.shape}, expected (T, {card.dimension})")
    if card.reward_kind == "ot":
        return ot_reward(z, experts, card.transport, card.reward_scale)
    if card.reward_kind == "goal":
        return goal_reward(z, experts, card.reward_scale)
    return (clock_reward if card.reward_kind == "clock" else scalar_reward)(z, card.reward_scale)
