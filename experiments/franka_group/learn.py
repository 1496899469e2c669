"""Success of SAC on franka_group by reward: the same pool, rankings, learner and starts for all.

One call is one reward and one seed; ``summarise.py`` makes the table and the picture.

    python experiments/franka_group/learn.py --reward rapl --preset tuned --seed 0
    python experiments/franka_group/learn.py --reward ground_truth --seed 0

Seed s gives the pool, the queries, the alignment and the learner their seeds. Without ROS: a test
shows that the graph learns the same (tests/ros/test_learner_node.py). Goes on where it was cut.
"""

import argparse
import json
import os
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from rapl_core.analysis import measures
from rapl_core.analysis.provenance import commit, machine, versions
from rapl_core.demonstrators import collect
from rapl_core.policies.config import SacConfig, ScheduleConfig
from rapl_core.policies.in_process import LearningEvent, train_in_process
from rapl_core.policies.rewards import (
    EncoderReward,
    EpisodeReward,
    GroundTruthReward,
    fit_scale,
)
from rapl_core.preferences import ContestQueries, SimulatedHuman, expert_set, triplets_from
from rapl_core.preferences.own_videos import OwnQueries
from rapl_core.preferences.strategies import strategy_of
from rapl_core.representations import (
    Encoder,
    FeatureStore,
    align,
    find_parts,
    get_preset,
    learn_reward,
    make_extractor,
    raw_encoder_from,
)
from rapl_core.representations.pretrained import RAW_RECIPE
from rapl_core.representations.registry import DEFAULT_BACKBONE
from rapl_core.simulation.simulation import Simulation
from rapl_core.tasks import get_task
from rapl_core.types import Episode, Ranking

TASK = "franka_group"
HERE = Path(__file__).parent
EARLY_SEED = 10_000
EARLY_VIDEOS = 48


def make_videos(seed: int, stream: str, count: int, folder: Path) -> list[Episode]:
    """Return ``count`` scripted videos; kept in ``folder`` for the other rewards of the seed."""
    kept = folder / f"{stream}-{seed}-{count}.npz"
    if not kept.is_file():
        simulation = Simulation(get_task(TASK))
        videos = list(collect(simulation, count, seed, stream))
        simulation.close()
        beside = kept.with_suffix(f".{os.getpid()}.npz")
        np.savez(beside, episodes=np.array([asdict(v) for v in videos], dtype=object))
        beside.replace(kept)
    with np.load(kept, allow_pickle=True) as content:  # our own file of a moment ago
        return [Episode(**fields) for fields in content["episodes"]]


def early_videos(reward: EpisodeReward, steps: int, seed: int) -> list[Episode]:
    """Videos of a learner that the reward has taught for so many world steps, spread evenly.

    Its own seed, so that its starts are not those of the learning that is measured.
    """
    seen: list[Episode] = []
    train_in_process(
        TASK,
        reward,
        SacConfig(),
        ScheduleConfig(steps=steps, evaluate_episodes=0),
        EARLY_SEED + seed,
        on_event=lambda event: seen.extend(event.episodes),
    )
    late = seen[len(seen) // 4 :]  # before, it acts at random
    return [late[int(i)] for i in np.linspace(0, len(late) - 1, EARLY_VIDEOS).round()]


def rank_own(
    rankings: list[Ranking], pool: list[Episode], early: list[Episode], count: int, seed: int
) -> list[Ranking]:
    """Ask the simulated human about the early learner's videos, each query beside an expert."""
    rng = np.random.default_rng([seed, 202])
    human = SimulatedHuman(rng)
    returns = {video.episode_id: video.human_return for video in [*pool, *early]}
    own = OwnQueries(rng, [video.episode_id for video in early], expert_set(rankings, 10))
    rankings = list(rankings)
    for number in range(len(rankings), len(rankings) + count):
        shown = own.next(list(returns), [r.episode_ids for r in rankings])
        ranks = human.rank([returns[name] for name in shown])
        rankings.append(Ranking(f"r{number}", "simulated", shown, ranks))
    return rankings


def rank(pool: list[Episode], triplets: int, seed: int, strategy: str) -> list[Ranking]:
    """Ask the simulated human.

    :param strategy: uniform or contest.
    """
    rng = np.random.default_rng([seed, 201])
    human = SimulatedHuman(rng)
    returns = {video.episode_id: video.human_return for video in pool}
    asked: list[tuple[str, ...]] = []
    rankings: list[Ranking] = []
    for number in range(triplets):
        wanted = triplets if strategy == "contest" else 0  # 0: all of them are uniform
        shown = ContestQueries(rng, rankings, wanted).next(list(returns), asked)
        asked.append(shown)
        ranks = human.rank([returns[name] for name in shown])
        rankings.append(Ranking(f"r{number}", "simulated", shown, ranks))
    return rankings


def make_encoder(
    reward: str,
    preset_name: str,
    pool: list[Episode],
    rankings: list[Ranking],
    seed: int,
    work: Path,
) -> tuple[Encoder, dict[str, object]]:
    """Learn an encoder from rankings alone."""
    preset = get_preset(preset_name)
    recipe = RAW_RECIPE if reward == "imagenet" else preset.recipe
    mirror = preset.mirror and reward != "imagenet"
    extractor = make_extractor(DEFAULT_BACKBONE, recipe)
    by_id = {video.episode_id: video.frames[1:] for video in pool}
    find_parts(extractor, list(by_id), by_id.__getitem__, seed)
    features = FeatureStore(extractor, work / "features", precision="bfloat16", mirror=mirror)
    for video in pool:
        features.add_episode(video)
    experts = expert_set(rankings, 10)
    rng = np.random.default_rng(seed)
    began = time.monotonic()
    if reward == "imagenet":
        return raw_encoder_from(features, experts, rng), {}
    method = align if reward == "rapl" else learn_reward
    encoder, report = method(features, triplets_from(rankings), experts, preset, rng)
    return encoder, {
        "align_s": time.monotonic() - began,
        "held_out_accuracy": report.held_out_accuracy,
        "best_epoch": report.best_epoch,
    }


def judge(reward: EpisodeReward, test: list[Episode]) -> dict[str, float]:
    """Hold a reward against r* on videos that nothing was learnt from."""
    values = [reward(video) for video in test]
    human = [video.human_rewards[1:] for video in test if video.human_rewards is not None]
    step = measures.spearman_per_step(values, human)
    return {
        "step": step.mean,
        "step_undefined": step.undefined,
        "concordance": measures.concordance(values, human).value,
        "episode": measures.episode_rank_correlation(values, human),
    }


def main() -> None:
    """Run one reward and seed and write ``results/<reward>-<preset>-<seed>.json``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--reward", default="rapl", choices=["rapl", "rlhf", "imagenet", "ground_truth"]
    )
    parser.add_argument("--preset", default="tuned", choices=["paper", "authors_code", "tuned"])
    parser.add_argument("--strategy", choices=["uniform", "contest"], help="the preset's own")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--steps", type=int, default=60_000)
    parser.add_argument("--triplets", type=int, default=150)
    parser.add_argument("--pool", type=int, default=300)
    parser.add_argument(
        "--early", type=int, default=0, help="world steps of an early learner, whose videos join"
    )
    parser.add_argument("--own", type=int, default=50, help="of the triplets, about its videos")
    parser.add_argument("--evaluate-every", type=int, default=5_000)
    parser.add_argument("--work", type=Path, default=Path("runs/study"), help="pools, checkpoints")
    parser.add_argument("--results", type=Path, default=HERE / "results")
    options = parser.parse_args()
    torch.set_num_threads(1)
    # torchvision crashes when it is first imported after an EGL context was made
    make_extractor(DEFAULT_BACKBONE, RAW_RECIPE)
    is_preset = options.reward in ("rapl", "rlhf")
    parts = [options.reward, *([options.preset] if is_preset else [])]
    name = "-".join([*parts, *(["early"] if options.early else []), str(options.seed)])
    folder = options.work / name
    folder.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    begun_at = commit()  # what runs, whatever is committed meanwhile
    pool = make_videos(options.seed, "demonstrate", options.pool, options.work)
    result: dict[str, object] = {"reward": options.reward, "seed": options.seed}
    result["preset"] = options.preset if is_preset else ""
    if options.reward == "ground_truth":
        scale = fit_scale(v.human_rewards[1:] for v in pool if v.human_rewards is not None)
        reward: EpisodeReward = GroundTruthReward(scale)
    else:
        strategy = options.strategy or strategy_of(options.preset)
        result["strategy"] = strategy
        first = options.triplets - (options.own if options.early else 0)
        rankings = rank(pool, first, options.seed, strategy)
        if options.early:
            encoder, _ = make_encoder(
                options.reward, options.preset, pool, rankings, options.seed, options.work
            )
            by_id = {video.episode_id: video for video in pool}
            experts = [encoder.embed_expert(i, by_id[i].frames) for i in encoder.expert_ids]
            early = early_videos(EncoderReward(encoder, experts), options.early, options.seed)
            result["early_successes"] = sum(bool(video.success) for video in early)
            rankings = rank_own(rankings, pool, early, options.own, options.seed)
            pool = [*pool, *early]
        encoder, learnt = make_encoder(
            options.reward, options.preset, pool, rankings, options.seed, options.work
        )
        by_id = {video.episode_id: video for video in pool}
        experts = [encoder.embed_expert(i, by_id[i].frames) for i in encoder.expert_ids]
        result["experts_successful"] = sum(bool(by_id[i].success) for i in encoder.expert_ids)
        result |= learnt
        reward = EncoderReward(encoder, experts)
        result["offline"] = judge(reward, make_videos(options.seed, "test", 100, options.work))
        print(name, {k: v for k, v in result.items()}, flush=True)
    schedule = ScheduleConfig(steps=options.steps, evaluate_every=options.evaluate_every)
    sac = SacConfig()

    def tell(event: LearningEvent) -> None:
        if event.evaluation is not None:
            print(
                f"{name} {event.steps} steps: success {event.evaluation.success_rate:.2f}, "
                f"training return of r* {event.human_return_mean:.1f}, reward "
                f"{event.reward_mean:.1f}, {event.steps_per_s:.0f} steps/s",
                flush=True,
            )

    curve = train_in_process(
        TASK, reward, sac, schedule, options.seed, folder, resume=True, on_event=tell
    )
    result |= {
        "curve": [asdict(point) for point in curve.points],
        "success_last_three": curve.last(3),
        "steps": options.steps,
        "triplets": options.triplets,
        "pool": options.pool,
        "early": options.early,
        "schedule": asdict(schedule),
        "sac": asdict(sac),
        "wall_s": time.monotonic() - began,
        "commit": begun_at,
        "machine": machine(),
        "versions": versions(),
    }
    options.results.mkdir(parents=True, exist_ok=True)
    (options.results / f"{name}.json").write_text(json.dumps(result, indent=1, default=str) + "\n")


if __name__ == "__main__":
    main()
