"""Every reward of the paper on one pool, one set of rankings and one evaluation.

    python experiments/rewards/table.py --seeds 0 1 2 3 4          # everything, then the table
    python experiments/rewards/table.py --seeds 0 --presets paper --rewards rapl tcc clock
    python experiments/rewards/table.py --table                    # the table of what there is

Seed s gives a pool of 300 scripted videos, 150 rankings and 100 test videos from a seed stream of
their own. One JSON a seed, preset and reward lies in ``results``; what is there is not made again.
Rewards whose published weights are not given (``--weights FOLDER``) are left out and named.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from rapl_core.analysis import measures
from rapl_core.analysis.provenance import commit, machine, versions
from rapl_core.demonstrators import preferred_behaviours
from rapl_core.errors import WeightsError
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
from rapl_core.representations.masked import MaskedConfig, fine_tune_lora, pretrain
from rapl_core.representations.masked_architecture import MAE_BACKBONE
from rapl_core.representations.methods import Method, get_method, method_names
from rapl_core.representations.probe import supervised_probe
from rapl_core.representations.report import wilson_interval
from rapl_core.representations.tcc import VIEW_MARK, TccConfig, learn_tcc, originals
from rapl_core.representations.trainable import save_network
from rapl_core.tasks import get_task
from rapl_core.types import EmbeddedEpisode, Episode

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "franka_group"))

from learn import TASK, make_videos, rank  # noqa: E402

POOL, TEST, TRIPLETS, TEST_TRIPLETS = 300, 100, 150, 1000


class Study:
    """One seed: its videos, rankings and features."""

    def __init__(self, seed: int, work: Path, weights: Path | None, views: int) -> None:
        self.seed, self.work, self.weights, self.views = seed, work, weights, views
        self.pool = make_videos(seed, "demonstrate", POOL, work)
        self.test = make_videos(seed, "test", TEST, work)
        rankings = rank(self.pool, TRIPLETS, seed, "contest")
        self.triplets, self.experts = triplets_from(rankings), expert_set(rankings, 10)
        preferred = preferred_behaviours(get_task(TASK))
        self.shown = [v for v in self.pool if v.behaviour in preferred]
        self.mine: dict[str, Path] = {}
        """Weights of backbones trained here, by method."""

    def features(self, method: Method, preset: Preset, videos: Iterable[Episode]) -> FeatureStore:
        """Features of some videos as the preset reads the method's backbone."""
        weights = self.mine.get(method.name, self.weights)
        backbone = MAE_BACKBONE if method.name in self.mine else method.backbone
        extractor = make_extractor(backbone, preset.recipe, weights)
        by_id = {v.episode_id: v.frames[1:] for v in self.pool}
        find_parts(extractor, list(by_id), by_id.__getitem__, self.seed)
        folder = self.work / "features"
        store = FeatureStore(extractor, folder, "bfloat16", mirror=preset.mirror)
        for video in videos:
            store.add_episode(video)
        return store

    def make(self, method: Method, preset: Preset) -> tuple[Encoder, dict[str, Any]]:
        """An encoder and what is to be said of its making."""
        rng = np.random.default_rng(self.seed)
        if method.lesson == "frames":
            self._train_backbone(method, rng)
        shown = self.shown if method.lesson == "demonstrations" else self.pool
        features = self.features(method, preset, shown)
        began = time.monotonic()
        told: dict[str, Any] = {}
        if method.name in ("rapl", "rlhf"):
            learn = align if method.name == "rapl" else learn_reward
            encoder, report = learn(features, self.triplets, self.experts, preset, rng)
            told = {"held_out_accuracy": report.held_out_accuracy, "epoch": report.best_epoch}
        elif method.lesson == "demonstrations":
            encoder, told = self._tcc(method, preset, features, rng)
        elif method.name == "supervised_probe":
            truth = {v.episode_id: human(v) for v in self.pool}
            encoder = supervised_probe(features, truth, self.experts, preset, rng)
        else:
            encoder = raw_encoder_from(features, self.experts, rng, method.name, preset)
        return encoder, {**told, "seconds": time.monotonic() - began}

    def _tcc(
        self, method: Method, preset: Preset, features: FeatureStore, rng: np.random.Generator
    ) -> tuple[Encoder, dict[str, Any]]:
        for video in self.shown:
            for view in range(self.views):
                changed = augment_video(video.frames[1:], Augmentation(), rng)
                features.add(f"{video.episode_id}{VIEW_MARK}{view}", changed)
        experts = self.experts
        if method.reward == "goal":
            experts = originals(features)
        else:  # the expert set needs features too, whoever is in it
            for video in self.pool:
                if video.episode_id in experts and video.episode_id not in features:
                    features.add_episode(video)
        config = TccConfig(views=self.views)
        encoder, report = learn_tcc(features, experts, preset, config, rng, method.name)
        return encoder, report.to_json()

    def _train_backbone(self, method: Method, rng: np.random.Generator) -> None:
        """Masked autoencoding on the pool; by LoRA on top of it where MVP's weights are missing."""
        if method.name in self.mine or (method.name == "mvp_finetuned" and self.weights):
            return
        frames = np.concatenate([v.frames[rng.choice(61, 20, replace=False)] for v in self.pool])
        spec, config = backbone_spec(MAE_BACKBONE), MaskedConfig()
        if "mae_scratch" not in self.mine:
            fit = pretrain(frames, spec, config, np.random.default_rng(self.seed))
            self.mine["mae_scratch"] = save_network(fit.network, MAE_BACKBONE, self.work)
        if method.name == "mvp_finetuned":
            _, network, _ = load_network(MAE_BACKBONE, self.mine["mae_scratch"])
            fit = fine_tune_lora(network, frames, spec.preprocessing, config, rng)
            self.mine[method.name] = save_network(fit.network, MAE_BACKBONE, self.work)

    def judge(self, method: Method, preset: Preset, encoder: Encoder) -> dict[str, Any]:
        """All measures on the test videos; features in bfloat16, as in training."""
        by_id = {v.episode_id: v for v in self.pool}
        used = [by_id[i] for i in encoder.expert_ids]
        store = FeatureStore(encoder.extractor, self.work / "features", "bfloat16")
        experts = []
        for video in used if encoder.needs_experts else []:
            store.add_episode(video)
            z = encoder.embed_features(store[video.episode_id])
            first = min(round(encoder.card.expert_from * len(z)), len(z) - 1)
            experts.append(EmbeddedEpisode(video.episode_id, z[first:]))
        rewards = []
        for video in self.test:
            store.add_episode(video)
            z = encoder.embed_features(store[video.episode_id])
            rewards.append(encoder.reward(z, experts).values)
        return judge(rewards, self.test, self.seed)


def human(video: Episode) -> NDArray[np.float64]:
    """(T,) r* of the frames arrived in."""
    assert video.human_rewards is not None
    return video.human_rewards[1:]


def judge(rewards: list[NDArray[np.float64]], videos: list[Episode], seed: int) -> dict[str, Any]:
    """Every measure of a reward on videos that nothing was learnt from."""
    felt = [human(v) for v in videos]
    step = measures.spearman_per_step(rewards, felt)
    partial = measures.partial_spearman_given_time(rewards, felt)
    disliked = [i for i, v in enumerate(videos) if v.behaviour == "one_at_a_time"]
    returns = {v.episode_id: float(r.sum()) for v, r in zip(videos, rewards, strict=True)}
    triplets = draw_triplets(videos, np.random.default_rng([seed, 401]))
    accuracy = measures.triplet_accuracy(returns, triplets)

    def of(behaviours: Callable[[Episode], bool]) -> list[NDArray[np.float64]]:
        return [r for v, r in zip(videos, rewards, strict=True) if behaviours(v)]

    return {
        "step": step.mean,
        "step_undefined": step.undefined,
        "step_given_time": partial.mean,
        "step_given_time_undefined": partial.undefined,
        "step_one_at_a_time": measures.spearman_per_step(
            [rewards[i] for i in disliked], [felt[i] for i in disliked]
        ).mean,
        "concordance": measures.concordance(rewards, felt).value,
        "episode": measures.episode_rank_correlation(rewards, felt),
        "arm_only": measures.arm_only_share(
            of(lambda v: bool(v.success)), of(lambda v: v.behaviour == "mime")
        ),
        "triplets": len(triplets),
        "triplet_accuracy": accuracy,
        "triplet_interval": wilson_interval(accuracy, len(triplets)),
        "videos": measures.video_mix([v.behaviour for v in videos]),
    }


def draw_triplets(videos: list[Episode], rng: np.random.Generator) -> list[tuple[str, str, str]]:
    """Distinct triplets of test videos alone, best first by the human's reward."""
    returns = {v.episode_id: v.human_return for v in videos}
    names, drawn = sorted(returns), set()
    while len(drawn) < TEST_TRIPLETS:
        three = [names[i] for i in rng.choice(len(names), 3, replace=False)]
        drawn.add(tuple(sorted(three, key=lambda name: -returns[name])))
    return sorted(drawn)


def table(results: Path) -> str:
    """The table of all results in a folder, means over seeds with the half width of 95 %."""
    by_row: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for file in sorted(results.glob("*.json")):
        content = json.loads(file.read_text())
        by_row.setdefault((content["preset"], content["reward"]), []).append(content["measures"])
    columns = ("step", "step_given_time", "step_one_at_a_time", "concordance", "episode",
               "arm_only", "triplet_accuracy")  # fmt: skip
    lines = [
        "| preset | reward | seeds | step | given time | one at a time | concordance | episode "
        "| arm alone | test triplets |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for (preset, reward), rows in sorted(by_row.items()):
        cells = [_mean([row[c] for row in rows]) for c in columns]
        first = [preset, get_method(reward).title, str(len(rows))]
        lines.append(f"| {' | '.join(first + cells)} |")
    return "\n".join(lines) + "\n"


def _mean(values: list[float | None]) -> str:
    known = np.array([v for v in values if v is not None and np.isfinite(v)])
    if not len(known):
        return "-"
    text = f"{known.mean():.2f}"
    if len(known) > 1:
        from scipy.stats import t

        half = t.ppf(0.975, len(known) - 1) * known.std(ddof=1) / len(known) ** 0.5
        text += f" ± {half:.2f}"
    return text


def main() -> None:
    """Make what is missing, then the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    parser.add_argument("--presets", nargs="+", default=preset_names(), choices=preset_names())
    parser.add_argument("--rewards", nargs="+", default=method_names(), choices=method_names())
    parser.add_argument("--views", type=int, default=1, help="augmented copies of a video for TCC")
    parser.add_argument("--weights", type=Path, help="folder with published weights")
    parser.add_argument("--work", type=Path, default=Path("runs/study"), help="videos, features")
    parser.add_argument("--results", type=Path, default=HERE / "results")
    parser.add_argument("--table", action="store_true", help="only the table of what there is")
    options = parser.parse_args()
    torch.set_num_threads(1)
    options.results.mkdir(parents=True, exist_ok=True)
    for seed in [] if options.table else options.seeds:
        make_extractor("efficientnet_lite0", get_preset("paper").recipe)  # before a GL context
        study = Study(seed, options.work, options.weights, options.views)
        for preset_name in options.presets:
            for name in options.rewards:
                run(study, name, preset_name, options.results)
    (options.results / "table.md").write_text(table(options.results))
    print(table(options.results))


def run(study: Study, name: str, preset_name: str, results: Path) -> None:
    """One reward, preset and seed, unless it is there."""
    path = results / f"{name}-{preset_name}-{study.seed}.json"
    if path.is_file():
        return
    method, preset = get_method(name), get_preset(preset_name)
    if method.backbone != get_method("rapl").backbone and preset_name == "tuned":
        # Tuned features are those of one network; others keep their own last layer.
        preset = replace(preset, recipe=get_preset("paper").recipe)
    began = time.monotonic()
    try:
        encoder, told = study.make(method, preset)
    except WeightsError as error:
        print(f"{name}, {preset_name}: left out: {error}", flush=True)
        return
    found = study.judge(method, preset, encoder)
    content = {
        "reward": name,
        "preset": preset_name,
        "seed": study.seed,
        "measures": found,
        "made": told,
        "views": study.views,
        "demonstrations": len(study.shown),
        "backbone": encoder.card.backbone,
        "preset_settings": asdict(preset),
        "wall_s": time.monotonic() - began,
        "commit": commit(),
        "machine": machine(),
        "versions": versions(),
    }
    text = json.dumps(content, indent=1, default=str).replace("NaN", "null")
    path.write_text(text + "\n")
    shown = {k: round(v, 3) for k, v in found.items() if isinstance(v, float)}
    print(name, preset_name, study.seed, shown, f"{content['wall_s']:.0f} s", flush=True)


if __name__ == "__main__":
    main()
