"""One seed of the table: its videos, rankings, features and encoders, each made once."""

import sys
import time
from collections import defaultdict
from collections.abc import Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from judging import human, judge
from numpy.typing import NDArray

from rapl_core.analysis.scenes import TASK, Scenes
from rapl_core.demonstrators import preferred_behaviours
from rapl_core.preferences import expert_set, triplets_from
from rapl_core.representations import (
    Encoder,
    FeatureStore,
    Preset,
    align,
    find_parts,
    get_preset,
    learn_reward,
    make_extractor,
    preset_names,
    raw_encoder_from,
)
from rapl_core.representations.augmentation import Augmentation, augment_video
from rapl_core.representations.backbones import backbone_spec, load_network
from rapl_core.representations.encoder import matched_part
from rapl_core.representations.extractor import FeatureExtractor
from rapl_core.representations.heads import Embedder
from rapl_core.representations.masked import MaskedConfig, fine_tune_lora, pretrain
from rapl_core.representations.masked_architecture import MAE_BACKBONE
from rapl_core.representations.methods import DEFAULT_BACKBONE, Method, get_method
from rapl_core.representations.presets import PAPER
from rapl_core.representations.probe import supervised_probe
from rapl_core.representations.tcc import VIEW_MARK, TccConfig, fit_tcc, tcc_encoder
from rapl_core.representations.trainable import save_network
from rapl_core.representations.weights import weights_in
from rapl_core.tasks import get_task
from rapl_core.types import EmbeddedEpisode, Episode

sys.path.append(str(Path(__file__).parents[1] / "franka_group"))

from videos import make_videos, rank  # noqa: E402

POOL, TEST, TRIPLETS = 300, 100, 150
MASKED_FRAMES = 20
"""Frames of each video of the pool that a masked autoencoder learns from."""
SCRATCH_SEED = 999
"""Of the videos that a network from scratch is pre-trained on, once for all seeds of the table."""


@dataclass
class Spent:
    """Seconds of each kind of work, as the processor's and the wall's clock have them."""

    cpu: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    wall: dict[str, float] = field(default_factory=lambda: defaultdict(float))

    @contextmanager
    def on(self, what: str) -> Iterator[None]:
        """Count what runs inside; not to be nested."""
        cpu, wall = time.process_time(), time.monotonic()
        yield
        self.cpu[what] += time.process_time() - cpu
        self.wall[what] += time.monotonic() - wall

    def __str__(self) -> str:
        parts = ", ".join(f"{k} {v:.0f}" for k, v in sorted(self.cpu.items(), key=lambda x: -x[1]))
        total, wall = sum(self.cpu.values()), sum(self.wall.values())
        return f"{total:.0f} s of one core ({wall:.0f} s by the wall): {parts}"


@dataclass(frozen=True)
class Made:
    """An encoder with its experts and what is to be said of its making."""

    encoder: Encoder
    experts: tuple[EmbeddedEpisode, ...]
    told: dict[str, Any]


@dataclass(frozen=True)
class Demonstrated:
    """What TCC learnt."""

    features: FeatureStore
    """Of the demonstrations, their changed copies and the expert videos."""
    names: list[str]
    """Of the demonstrations."""
    embedder: Embedder
    losses: tuple[float, ...]


class Study:
    """Makes and judges the rewards of one seed; nothing is computed twice.

    :param work: videos, features and backbones are kept here for other calls.
    :param weights: folder with published weights.
    :param demonstrations: that TCC learns from; 0: the preferred ones of the pool.
    :param views: changed copies of each of them.
    :param masked: how a masked autoencoder is pre-trained.
    :param lora_iterations: of its adaptation to the seed's pool.
    :param presets: that rows may be asked for; empty: all.
    """

    def __init__(
        self,
        seed: int,
        work: Path,
        weights: Path | None = None,
        demonstrations: int = 500,
        views: int = 1,
        masked: MaskedConfig | None = None,
        lora_iterations: int = 500,
        presets: Sequence[Preset] = (),
    ) -> None:
        self.presets = presets or [get_preset(name) for name in preset_names()]
        self.masked = masked or MaskedConfig()
        self.lora = replace(self.masked, iterations=lora_iterations)
        self.seed, self.work, self.weights = seed, work, weights
        self.demonstrations, self.views = demonstrations, views
        self.spent = Spent()
        with self.spent.on("videos"):
            self.pool = make_videos(seed, "demonstrate", POOL, work)
            self.test = make_videos(seed, "test", TEST, work)
            self.scenes = Scenes.drawn(work)
        rankings = rank(self.pool, TRIPLETS, seed, "contest")
        self.triplets, self.experts = triplets_from(rankings), expert_set(rankings, 10)
        self._by_id = {v.episode_id: v for v in self.pool}
        self._extractors: dict[Hashable, FeatureExtractor] = {}
        self._stores: dict[Hashable, FeatureStore] = {}
        self._seen: dict[str, tuple[list[NDArray[Any]], NDArray[Any]]] = {}
        self._shown: dict[Hashable, FeatureStore] = {}
        self._shown_names: list[str] = []
        self._tcc: dict[Hashable, Demonstrated] = {}
        self._made: dict[Hashable, Made] = {}
        self._judged: dict[Hashable, dict[str, Any]] = {}

    def row(self, method: Method, preset: Preset) -> tuple[Made, dict[str, Any]]:
        """An encoder and its measures.

        :raises WeightsError: if the backbone's weights are not to be had.
        """
        made = self.make(method, preset)
        key = what_matters(method, self.preset_for(method, preset))
        if key not in self._judged:
            self._judged[key] = self._judge(made)
        return made, self._judged[key]

    def make(self, method: Method, preset: Preset) -> Made:
        """An encoder without its measures.

        :raises WeightsError: if the backbone's weights are not to be had.
        """
        preset = self.preset_for(method, preset)
        key = what_matters(method, preset)
        if key not in self._made:
            self._made[key] = self._make(method, preset)
        return self._made[key]

    def truth(self) -> dict[str, Any]:
        """The measures of r* itself."""
        return judge([human(v) for v in self.test], self.test, self.scenes.truth(), self.seed)

    def preset_for(self, method: Method, preset: Preset) -> Preset:
        """Tuned features are those of one network; others keep their own last layer."""
        is_common = method.backbone == DEFAULT_BACKBONE
        return preset if is_common else replace(preset, recipe=PAPER.recipe)

    def _make(self, method: Method, preset: Preset) -> Made:
        rng = np.random.default_rng(self.seed)
        if method.lesson == "frames":
            self._train_backbone(method)
        if method.lesson == "demonstrations":
            return self._make_tcc(method, preset, rng)
        features = self._pool_features(method, preset)
        told: dict[str, Any] = {}
        with self.spent.on(method.name):
            if method.lesson == "rankings":
                learn = align if method.name == "rapl" else learn_reward
                encoder, report = learn(features, self.triplets, self.experts, preset, rng)
                told = {"held_out_accuracy": report.held_out_accuracy, "epoch": report.best_epoch}
            elif method.name == "supervised_probe":
                truth = {v.episode_id: human(v) for v in self.pool}
                encoder = supervised_probe(features, truth, self.experts, preset, rng)
            else:
                encoder = raw_encoder_from(features, self.experts, rng, method.name, preset)
                if method.lesson == "frames":
                    told = {"iterations": self._taught_by(method)[1].iterations}
        return Made(encoder, embedded_experts(encoder, features), told)

    def _make_tcc(self, method: Method, preset: Preset, rng: np.random.Generator) -> Made:
        began = time.monotonic()
        shown = self._demonstrated(preset)
        experts = shown.names if method.reward == "goal" else self.experts
        encoder, report = tcc_encoder(
            shown.features, shown.embedder, shown.losses, experts, preset,
            TccConfig(views=self.views), rng, method.name, began,
        )  # fmt: skip
        told = {**report.to_json(), "demonstrations": len(shown.names), "views": self.views}
        return Made(encoder, embedded_experts(encoder, shown.features), told)

    def _demonstrated(self, preset: Preset) -> Demonstrated:
        """The one representation of both ways to reward by TCC."""
        key = (seen_as(preset), preset.dimension)
        if key not in self._tcc:
            if not self._shown:
                self._read_demonstrations()
            features = self._shown[preset.recipe, preset.mirror]
            config, rng = TccConfig(views=self.views), np.random.default_rng(self.seed)
            with self.spent.on("TCC"):
                learnt = fit_tcc(features, preset.dimension, preset, config, rng)
            with self.spent.on("features"):
                for name in self.experts:  # only now: nothing is learnt from them
                    features.add_episode(self._by_id[name])
            self._tcc[key] = Demonstrated(features, self._shown_names, *learnt)
        return self._tcc[key]

    def _read_demonstrations(self) -> None:
        """Features of demonstrations and changed copies for all presets in one pass.

        The copies cost more than their features do.
        """
        shown = self._demonstrations()
        self._shown_names = [video.episode_id for video in shown]
        for preset in self.presets:
            extractor = self._extractor(get_method("tcc"), preset)
            store = self._store(extractor, preset)
            self._shown.setdefault((preset.recipe, preset.mirror), store)
        rng = np.random.default_rng([self.seed, 402])
        for video in shown:
            with self.spent.on("changed copies"):
                copies = [
                    augment_video(video.frames[1:], Augmentation(), rng) for _ in range(self.views)
                ]
            with self.spent.on("features"):
                for store in self._shown.values():
                    store.add_episode(video)
                    for view, copy in enumerate(copies):
                        store.add(f"{video.episode_id}{VIEW_MARK}{view}", copy)

    def _judge(self, made: Made) -> dict[str, Any]:
        encoder = made.encoder
        videos, scenes = self._seen_by(encoder.extractor)
        with self.spent.on("judging"):
            rewards = [
                encoder.reward(encoder.embed_features(features), made.experts).values
                for features in videos
            ]
            landscape = self.scenes.judge(encoder, made.experts, encoder.embed_features(scenes))
            return judge(rewards, self.test, landscape, self.seed)

    def _seen_by(self, extractor: FeatureExtractor) -> tuple[list[NDArray[Any]], NDArray[Any]]:
        """Features of the test videos and of the scenes; in bfloat16, as in training."""
        if extractor.version not in self._seen:
            with self.spent.on("features"):
                store = FeatureStore(extractor, self.work / "features", "bfloat16")
                videos = [store.look_up(v.episode_id, v.frames[1:]) for v in self.test]
                scenes = store.look_up("scenes", self.scenes.frames)
            self._seen[extractor.version] = videos, scenes
        return self._seen[extractor.version]

    def _extractor(self, method: Method, preset: Preset) -> FeatureExtractor:
        """The backbone as the preset reads it."""
        backbone, weights = self._backbone(method)
        key = (backbone, str(weights), preset.recipe)
        if key not in self._extractors:
            extractor = make_extractor(backbone, preset.recipe, weights)
            with self.spent.on("features"):
                frames_of = {name: v.frames[1:] for name, v in self._by_id.items()}.__getitem__
                find_parts(extractor, list(self._by_id), frames_of, self.seed)
            self._extractors[key] = extractor
        return self._extractors[key]

    def _pool_features(self, method: Method, preset: Preset) -> FeatureStore:
        extractor = self._extractor(method, preset)
        key = ("pool", extractor.version, preset.mirror)
        if key not in self._stores:
            with self.spent.on("features"):
                store = self._store(extractor, preset)
                for video in self.pool:
                    store.add_episode(video)
            self._stores[key] = store
        return self._stores[key]

    def _demonstrations(self) -> list[Episode]:
        preferred = preferred_behaviours(get_task(TASK))
        if not self.demonstrations:
            return [v for v in self.pool if v.behaviour in preferred]
        with self.spent.on("videos"):
            return make_videos(
                self.seed, "demonstrate", self.demonstrations, self.work, preferred, POOL
            )

    def _store(self, extractor: FeatureExtractor, preset: Preset) -> FeatureStore:
        return FeatureStore(extractor, self.work / "features", "bfloat16", mirror=preset.mirror)

    def _backbone(self, method: Method) -> tuple[str, Path | None]:
        """Network and weights; where MVP's are not given, ours stands for it."""
        if method.lesson != "frames":
            return method.backbone, self.weights
        if method.name == "mvp_finetuned" and self._has_weights(method):
            return method.backbone, self._kept(method, method.backbone)
        return MAE_BACKBONE, self._kept(method, MAE_BACKBONE)

    def _has_weights(self, method: Method) -> bool:
        return bool(self.weights and weights_in(self.weights, method.backbone))

    def _kept(self, method: Method, backbone: str) -> Path:
        seed, config = self._taught_by(method)
        name = f"{method.name}-{seed}-{config.iterations}-{backbone}"
        return self.work / "backbones" / f"{name}.safetensors"

    def _taught_by(self, method: Method) -> tuple[int, MaskedConfig]:
        """Seed of the videos and the way in which a masked autoencoder learns from them."""
        is_scratch = method.name == "mae_scratch"
        return (SCRATCH_SEED, self.masked) if is_scratch else (self.seed, self.lora)

    def _train_backbone(self, method: Method) -> None:
        """Masked autoencoding: from scratch once for all seeds, by LoRA on the seed's own pool.

        LoRA starts from MVP's weights or, where they are not given, from those from scratch.
        """
        backbone, file = self._backbone(method)
        assert file is not None
        if file.is_file():
            return
        seed, config = self._taught_by(method)
        with self.spent.on("videos"):
            videos = make_videos(seed, "demonstrate", POOL, self.work)
        rng = np.random.default_rng([seed, 403])
        frames = np.concatenate(
            [v.frames[rng.choice(len(v.frames), MASKED_FRAMES, replace=False)] for v in videos]
        )
        if method.name == "mae_scratch":
            with self.spent.on("masked autoencoder"):
                network = pretrain(frames, backbone_spec(backbone), config, rng).network
        else:
            start = self.weights
            if backbone == MAE_BACKBONE:
                scratch = get_method("mae_scratch")
                self._train_backbone(scratch)
                start = self._backbone(scratch)[1]
            spec, network, _ = load_network(backbone, start)
            with self.spent.on("LoRA"):
                network = fine_tune_lora(network, frames, spec.preprocessing, config, rng).network
        save_network(network, backbone, file.parent).replace(file)


def embedded_experts(encoder: Encoder, features: FeatureStore) -> tuple[EmbeddedEpisode, ...]:
    """The matched part of each expert video; none for a reward that needs none."""
    if not encoder.needs_experts:
        return ()
    start = encoder.card.expert_from
    return tuple(
        EmbeddedEpisode(name, matched_part(encoder.embed_features(features[name]), start))
        for name in encoder.expert_ids
    )


def seen_as(preset: Preset) -> Hashable:
    """What a preset makes of pictures before anything is learnt."""
    return preset.recipe, preset.mirror, preset.has_projection, preset.components


def what_matters(method: Method, preset: Preset) -> Hashable:
    """What of a preset a row depends on: rows alike in it are one and the same."""
    seen, rewarded = seen_as(preset), (preset.reward, preset.expert_from)
    if method.name == "clock":
        return method.name
    if method.name == "supervised_probe":
        return method.name, seen
    if method.name == "mean_distance":
        return method.name, seen, preset.expert_from
    if method.name == "tcc":
        return method.name, seen, preset.dimension
    if method.name == "tcc_ot":
        return method.name, seen, preset.dimension, rewarded
    if method.lesson == "rankings":
        return method.name, replace(preset, name="")
    return method.name, seen, rewarded
