"""From the videos of a run to an encoder, by every method that needs no rankings."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rapl_core.episodes import EpisodeStore
from rapl_core.episodes.summary import EpisodeSummary
from rapl_core.errors import RankingError, UnknownNameError
from rapl_core.representations.alignment import OnEpoch
from rapl_core.representations.augmentation import augment_video
from rapl_core.representations.backbones import backbone_spec, load_network
from rapl_core.representations.encoder import Encoder
from rapl_core.representations.engines import Engine
from rapl_core.representations.extractor import (
    FeatureExtractor,
    FeatureRecipe,
    Precision,
    make_extractor,
)
from rapl_core.representations.features import FeatureStore, prepare_extractor
from rapl_core.representations.masked import MaskedConfig, fine_tune_lora, pretrain
from rapl_core.representations.masked_architecture import MAE_BACKBONE
from rapl_core.representations.methods import Method, get_method
from rapl_core.representations.presets import PAPER, get_preset
from rapl_core.representations.pretrained import RAW_RECIPE, raw_encoder_from
from rapl_core.representations.probe import supervised_probe
from rapl_core.representations.tcc import VIEW_MARK, TccConfig, learn_tcc
from rapl_core.representations.tcc_block import learn_tcc_block
from rapl_core.representations.trainable import save_network
from rapl_core.tasks import get_task

MASKED_FRAMES = 6000
"""Frames at most that a masked autoencoder learns from, drawn from all videos."""

OnVideo = Callable[[int, int], None]


@dataclass(frozen=True)
class WorkshopConfig:
    """What encoders are made of, whichever the method."""

    run_folder: Path
    method: str
    preset: str
    seed: int
    precision: Precision = "bfloat16"
    purposes: tuple[str, ...] = ("demonstrate",)
    """Purposes of the episodes that are the pool of videos."""
    backbone: str = ""
    """Empty: the method's own."""
    weights: Path | None = None
    """The backbone's weights, a file or a folder; None: the default place."""
    engine: Engine = "torch"
    """What computes the features of frozen networks."""
    tcc: TccConfig = field(default_factory=TccConfig)
    masked: MaskedConfig = field(default_factory=MaskedConfig)


@dataclass(frozen=True)
class Product:
    """An encoder and how its making went."""

    encoder: Encoder
    report: dict[str, Any] | None = None


class Workshop:
    """Makes encoders that learn from no rankings, from the videos of a run.

    :param on_video: told how many videos of how many are read; what it raises ends the work.
    :param on_epoch: the same for epochs.
    """

    def __init__(self, config: WorkshopConfig, on_video: OnVideo, on_epoch: OnEpoch) -> None:
        """
        :raises UnknownNameError: for another method, preset or backbone, naming the known ones.
        """
        self.config, self.on_video, self.on_epoch = config, on_video, on_epoch
        self.method: Method = get_method(config.method)
        self.preset = get_preset(config.preset)
        self.backbone = config.backbone or self.method.backbone
        self.weights = config.weights
        backbone_spec(self.backbone)
        self.episodes = EpisodeStore(config.run_folder / "episodes")
        self.pool = [e for e in self.episodes.summaries() if e.purpose in config.purposes]

    def make(self, expert_ids: Sequence[str], rng: np.random.Generator) -> Product:
        """Make the encoder.

        :param expert_ids: D+, the most preferred videos.
        :raises RankingError: if there are too few videos or experts.
        :raises WeightsError: if the backbone's weights cannot be had.
        """
        makers = {
            "nothing": self._raw,
            "demonstrations": self._demonstrated,
            "frames": self._masked,
            "truth": self._probe,
        }
        if self.method.lesson not in makers:
            raise RankingError(f"{self.method.name} learns from rankings: align it")
        return makers[self.method.lesson](list(expert_ids), rng)

    def _raw(self, experts: list[str], rng: np.random.Generator) -> Product:
        features = self._features(RAW_RECIPE)
        return Product(raw_encoder_from(features, experts, rng, self.method.name))

    def _probe(self, experts: list[str], rng: np.random.Generator) -> Product:
        features, truth = self._features(self.preset.recipe), {}
        for episode in self.pool:
            rewards = self.episodes.load(episode.episode_id).human_rewards
            if rewards is not None:
                truth[episode.episode_id] = rewards[1:]
        encoder = supervised_probe(features, truth, experts, self.preset, rng)
        return Product(encoder)

    def _demonstrated(self, experts: list[str], rng: np.random.Generator) -> Product:
        shown = demonstrations_in(self.pool) or experts
        if self.method.reward == "goal":
            experts = shown
        names = list(dict.fromkeys([*shown, *experts]))
        config = self.config.tcc
        if config.trained == "last_block":
            videos = {n: self.episodes.frames(n)[1:] for n in names}
            encoder, report = learn_tcc_block(
                videos, experts, self.backbone, self.preset, config, rng,
                self.config.run_folder / "backbones", self.weights, self.method.name, self.on_epoch,
                shown,
            )  # fmt: skip
        else:
            features = self._features(self.preset.recipe, names, config.views, rng, shown)
            encoder, report = learn_tcc(
                features, experts, self.preset, config, rng, self.method.name, self.on_epoch, shown
            )
        return Product(encoder, report.to_json())

    def _masked(self, experts: list[str], rng: np.random.Generator) -> Product:
        """Pre-train from scratch, or adapt what is given; then as raw features."""
        report: dict[str, Any] = {"method": self.method.name, "backbone": self.backbone}
        folder = self.config.run_folder / "backbones"
        frames = self._frames(rng)
        began = time.monotonic()
        is_scratch = self.method.name == "mae_scratch"
        if is_scratch or (self.backbone == MAE_BACKBONE and self.weights is None):
            spec = backbone_spec(self.backbone)
            fit = pretrain(frames, spec, self.config.masked, rng, self.on_epoch)
            report["pretrained"] = fit.to_json()
            self.weights = save_network(fit.network, self.backbone, folder)
        if not is_scratch:
            spec, network, _ = load_network(self.backbone, self.weights)
            fit = fine_tune_lora(
                network, frames, spec.preprocessing, self.config.masked, rng, self.on_epoch
            )
            report["fine_tuned"] = fit.to_json()
            self.weights = save_network(fit.network, self.backbone, folder)
        report["seconds"] = time.monotonic() - began
        features = self._features(RAW_RECIPE)
        encoder = raw_encoder_from(
            features, experts, rng, self.method.name, PAPER, has_own_backbone=True
        )
        return Product(encoder, report)

    def _frames(self, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Frames (N, H, W, 3) of all videos, at most ``MASKED_FRAMES``."""
        each = max(1, MASKED_FRAMES // max(1, len(self.pool)))
        parts = []
        for done, episode in enumerate(self.pool):
            self.on_video(done, len(self.pool))
            frames = self.episodes.frames(episode.episode_id)
            rows = rng.choice(len(frames), min(each, len(frames)), replace=False)
            parts.append(frames[np.sort(rows)])
        return np.concatenate(parts)

    def _features(
        self,
        recipe: FeatureRecipe,
        names: Sequence[str] | None = None,
        views: int = 0,
        rng: np.random.Generator | None = None,
        changed: Sequence[str] = (),
    ) -> FeatureStore:
        """Features of the pool's videos; those in no triplet serve the statistics.

        :param names: only of these videos.
        :param views: randomly changed copies of each that is in ``changed``, drawn from ``rng``.
        """
        names = [e.episode_id for e in self.pool] if names is None else list(names)
        extractor: FeatureExtractor = make_extractor(self.backbone, recipe, self.weights)
        pool = [e.episode_id for e in self.pool]
        prepare_extractor(
            extractor, pool, lambda n: self.episodes.frames(n)[1:], self.config.seed,
            self.config.engine,
        )  # fmt: skip
        mirror = self.preset.mirror and recipe is self.preset.recipe
        folder = self.config.run_folder / "features"
        store = FeatureStore(extractor, folder, self.config.precision, mirror=mirror)
        for done, name in enumerate(names):
            self.on_video(done, len(names))
            frames = self.episodes.frames(name)[1:]
            store.add(name, frames)
            for view in range(views if rng and name in changed else 0):
                assert rng is not None
                copy = augment_video(frames, self.config.tcc.augmentation, rng)
                store.add(f"{name}{VIEW_MARK}{view}", copy)
        self.on_video(len(names), len(names))
        return store


def demonstrations_in(pool: Sequence[EpisodeSummary]) -> list[str]:
    """Episodes that were made to show how it should be done; none of a task without scripts."""
    from rapl_core.demonstrators import preferred_behaviours  # loads the simulator

    preferred: set[str] = set()
    for task in {e.task for e in pool}:
        try:
            preferred.update(preferred_behaviours(get_task(task)))
        except UnknownNameError:  # a robot or a task that nobody scripted
            continue
    return [e.episode_id for e in pool if e.behaviour in preferred]
