"""Success of SAC on franka_group by reward: the same pool, rankings, learner and starts for all.

One call is one reward and one seed; ``summarise.py`` makes the table and the picture.

    python experiments/franka_group/learn.py --reward rapl --preset tuned --seed 0
    python experiments/franka_group/learn.py --reward ground_truth --seed 0

Seed s gives the pool, the queries, the alignment and the learner their seeds. Without ROS: a test
shows that the graph learns the same (tests/ros/test_learner_node.py). Goes on where it was cut, but
for a run that is aligned again meanwhile, which begins anew.
"""

import argparse
import json
import os
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from online_alignment import AlignmentRounds

from rapl_core.analysis import measures
from rapl_core.analysis.provenance import commit, machine, versions
from rapl_core.analysis.scenes import TASK, Scenes
from rapl_core.demonstrators import collect
from rapl_core.policies.config import SacConfig, ScheduleConfig
from rapl_core.policies.in_process import LearningEvent, train_in_process
from rapl_core.policies.rewards import (
    EncoderReward,
    EpisodeReward,
    GroundTruthReward,
    fit_scale,
)
from rapl_core.preferences import ContestQueries, SimulatedHuman, expert_set
from rapl_core.preferences.own_videos import online_alignments, online_share, online_steps
from rapl_core.preferences.strategies import strategy_of
from rapl_core.representations import (
    Encoder,
    FeatureStore,
    get_preset,
    make_extractor,
    raw_encoder_from,
)
from rapl_core.representations.pretrained import RAW_RECIPE
from rapl_core.representations.registry import DEFAULT_BACKBONE
from rapl_core.simulation.simulation import Simulation
from rapl_core.tasks import get_task
from rapl_core.types import EmbeddedEpisode, Episode, Ranking

HERE = Path(__file__).parent
LAST_VIDEOS = 40
"""The learner's last training videos, on which its reward is held against r* at the end."""


def make_videos(
    seed: int,
    stream: str,
    count: int,
    folder: Path,
    only: Sequence[str] = (),
    first: int = 0,
) -> list[Episode]:
    """Return ``count`` scripted videos; kept in ``folder`` for the other rewards of the seed.

    :param only: behaviours to show; empty for all in their shares.
    :param first: number of the first video.
    """
    kept = folder / f"{stream}-{seed}-{count}{f'-from-{first}' if first else ''}.npz"
    if not kept.is_file():
        simulation = Simulation(get_task(TASK))
        videos = list(collect(simulation, count, seed, stream, only, first))
        simulation.close()
        beside = kept.with_suffix(f".{os.getpid()}.npz")
        np.savez(beside, episodes=np.array([asdict(v) for v in videos], dtype=object))
        beside.replace(kept)
    with np.load(kept, allow_pickle=True) as content:  # our own file of a moment ago
        return [Episode(**fields) for fields in content["episodes"]]


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


def raw_encoder(
    pool: list[Episode], rankings: list[Ranking], seed: int, work: Path
) -> tuple[Encoder, list[EmbeddedEpisode]]:
    """Raw ImageNet features and the experts in them: only these come from rankings."""
    extractor = make_extractor(DEFAULT_BACKBONE, RAW_RECIPE)
    features = FeatureStore(extractor, work / "features", precision="bfloat16")
    for video in pool:
        features.add_episode(video)
    encoder = raw_encoder_from(features, expert_set(rankings, 10), np.random.default_rng(seed))
    by_id = {video.episode_id: video for video in pool}
    return encoder, [encoder.embed_expert(n, by_id[n].frames) for n in encoder.expert_ids]


def judge(reward: EpisodeReward, videos: Sequence[Episode]) -> dict[str, float]:
    """Hold a reward against r* on some videos."""
    human = [video.human_rewards[1:] for video in videos if video.human_rewards is not None]
    return asdict(measures.agreement([reward(video) for video in videos], human))


def main() -> None:
    """Run one reward and seed and write ``results/<reward>-<preset>-online<N>-<seed>.json``."""
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
    parser.add_argument("--online", type=int, help="alignments while it learns; the preset's own")
    parser.add_argument("--evaluate-every", type=int, default=5_000)
    parser.add_argument("--work", type=Path, default=Path("runs/study"), help="pools, checkpoints")
    parser.add_argument("--results", type=Path, default=HERE / "results")
    options = parser.parse_args()
    torch.set_num_threads(1)
    # torchvision crashes when it is first imported after an EGL context was made
    make_extractor(DEFAULT_BACKBONE, RAW_RECIPE)
    is_preset = options.reward in ("rapl", "rlhf")
    parts = [options.reward, *([options.preset] if is_preset else [])]
    online = online_alignments(options.preset) if options.online is None else options.online
    online = online if is_preset else 0
    own = online_share(options.triplets, online)
    parts += [f"online{online}"] if online else []
    name = "-".join([*parts, str(options.seed)])
    folder = options.work / name
    folder.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    begun_at = commit()  # what runs, whatever is committed meanwhile
    pool = make_videos(options.seed, "demonstrate", options.pool, options.work)
    result: dict[str, object] = {"reward": options.reward, "seed": options.seed}
    result["preset"] = options.preset if is_preset else ""
    revise: AlignmentRounds | None = None
    if options.reward == "ground_truth":
        scale = fit_scale(v.human_rewards[1:] for v in pool if v.human_rewards is not None)
        reward: EpisodeReward = GroundTruthReward(scale)
    else:
        strategy = options.strategy or strategy_of(options.preset)
        result["strategy"] = strategy
        rankings = rank(pool, options.triplets - online * own, options.seed, strategy)
        test = make_videos(options.seed, "test", 100, options.work)
        scenes = Scenes.drawn(options.work)
        if options.reward == "imagenet":
            made = raw_encoder(pool, rankings, options.seed, options.work)
            reward = EncoderReward(*made)
            result["scenes"] = scenes.judge(*made).to_json()
        else:
            revise = AlignmentRounds(
                videos=pool,
                rankings=rankings,
                method=options.reward,
                preset=get_preset(options.preset),
                seed=options.seed,
                work=options.work,
                scenes=scenes,
                marks=online_steps(options.steps, online),
                more=own,
            )
            reward = revise.align()
            result["alignments"], result["scenes"] = revise.report, revise.judged
        result["offline"] = judge(reward, test)
        print(name, result, flush=True)
    schedule = ScheduleConfig(
        steps=options.steps,
        evaluate_every=options.evaluate_every,
        checkpoint_every=0 if online else 5_000,  # what is revised cannot be resumed
    )
    sac = SacConfig()
    last: deque[Episode] = deque(maxlen=LAST_VIDEOS)

    def tell(event: LearningEvent) -> None:
        last.extend(event.episodes)
        if event.evaluation is not None:
            print(
                f"{name} {event.steps} steps: success {event.evaluation.success_rate:.2f}, "
                f"training return of r* {event.human_return_mean:.1f}, reward "
                f"{event.reward_mean:.1f}, {event.steps_per_s:.0f} steps/s",
                flush=True,
            )

    begun_s = time.monotonic()
    curve = train_in_process(
        TASK,
        reward,
        sac,
        schedule,
        options.seed,
        folder,
        resume=not online,
        on_event=tell,
        revise=revise,
    )
    if revise is not None and online:
        reward = revise.reward
        result["offline_last"] = judge(reward, test)
        result["scenes_last"] = revise.judged
    if last and options.reward != "ground_truth":  # empty in a run that had ended before
        result["learner_videos"] = judge(reward, last)
    result |= {
        "curve": [asdict(point) for point in curve.points],
        "success_last_three": curve.last(3),
        "steps": options.steps,
        "triplets": options.triplets,
        "pool": options.pool,
        "online": online,
        "schedule": asdict(schedule),
        "sac": asdict(sac),
        "learning_s": time.monotonic() - begun_s,
        "wall_s": time.monotonic() - began,
        "commit": begun_at,
        "machine": machine(),
        "versions": versions(),
    }
    options.results.mkdir(parents=True, exist_ok=True)
    (options.results / f"{name}.json").write_text(json.dumps(result, indent=1, default=str) + "\n")


if __name__ == "__main__":
    main()
