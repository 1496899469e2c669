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
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from online_alignment import AlignmentRounds
from videos import make_videos, rank

from rapl_core.analysis import measures
from rapl_core.analysis.provenance import commit, machine, versions
from rapl_core.analysis.scenes import TASK, Scenes
from rapl_core.policies.config import SacConfig, ScheduleConfig
from rapl_core.policies.in_process import LearningEvent, train_in_process
from rapl_core.policies.learning_curve import LearningCurve
from rapl_core.policies.rewards import (
    EncoderReward,
    EpisodeReward,
    GroundTruthReward,
    fit_scale,
)
from rapl_core.preferences import expert_set
from rapl_core.preferences.own_videos import online_alignments, online_share, online_steps
from rapl_core.preferences.strategies import strategy_of
from rapl_core.representations import (
    Encoder,
    FeatureStore,
    get_preset,
    make_extractor,
    preset_names,
    raw_encoder_from,
)
from rapl_core.representations.pretrained import RAW_RECIPE
from rapl_core.representations.registry import DEFAULT_BACKBONE
from rapl_core.types import EmbeddedEpisode, Episode, Ranking

HERE = Path(__file__).parent
TEST = 100
LAST_VIDEOS = 40
"""The learner's last training videos, on which its reward is held against r* at the end."""


@dataclass(frozen=True)
class Plan:
    """One run."""

    reward: str
    preset: str
    """Empty where the reward has none."""
    strategy: str
    seed: int
    steps: int
    triplets: int
    pool: int
    online: int
    """Alignments while it learns."""
    evaluate_every: int
    work: Path
    results: Path

    @property
    def name(self) -> str:
        """``<reward>-<preset>-online<N>-<seed>``, without what there is not."""
        rounds = f"online{self.online}" if self.online else ""
        return "-".join(part for part in (self.reward, self.preset, rounds, str(self.seed)) if part)

    @property
    def share(self) -> int:
        """Rankings kept for each of these alignments."""
        return online_share(self.triplets, self.online)


@dataclass
class Taught:
    """A reward before the learning, and what makes it anew meanwhile."""

    reward: EpisodeReward
    revise: AlignmentRounds | None = None
    told: dict[str, Any] = field(default_factory=dict)
    """What goes into the results."""


def parse() -> Plan:
    """Return what the command line asks for, completed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    rewards = ["rapl", "rlhf", "imagenet", "ground_truth"]
    parser.add_argument("--reward", default="rapl", choices=rewards)
    parser.add_argument("--preset", default="tuned", choices=preset_names())
    parser.add_argument("--strategy", choices=["uniform", "contest"], help="the preset's own")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--steps", type=int, default=40_000)
    parser.add_argument("--triplets", type=int, default=150)
    parser.add_argument("--pool", type=int, default=300)
    parser.add_argument("--online", type=int, help="alignments while it learns; the preset's own")
    parser.add_argument("--evaluate-every", type=int, default=5_000)
    parser.add_argument("--work", type=Path, default=Path("runs/study"), help="pools, checkpoints")
    parser.add_argument("--results", type=Path, default=HERE / "results")
    given = vars(parser.parse_args())
    given["strategy"] = given["strategy"] or strategy_of(given["preset"])
    if given["online"] is None:
        given["online"] = online_alignments(given["preset"])
    if given["reward"] not in ("rapl", "rlhf"):
        given |= {"preset": "", "online": 0}
    return Plan(**given)


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


def teach(plan: Plan, pool: list[Episode], test: Sequence[Episode]) -> Taught:
    """Make the reward from rankings about the pool."""
    if plan.reward == "ground_truth":
        scale = fit_scale(v.human_rewards[1:] for v in pool if v.human_rewards is not None)
        return Taught(GroundTruthReward(scale))
    rankings = rank(pool, plan.triplets - plan.online * plan.share, plan.seed, plan.strategy)
    scenes = Scenes.drawn(plan.work)
    if plan.reward == "imagenet":
        made = raw_encoder(pool, rankings, plan.seed, plan.work)
        taught = Taught(EncoderReward(*made), told={"scenes": scenes.judge(*made).to_json()})
    else:
        revise = AlignmentRounds(
            videos=pool,
            rankings=rankings,
            method=plan.reward,
            preset=get_preset(plan.preset),
            seed=plan.seed,
            work=plan.work,
            scenes=scenes,
            marks=online_steps(plan.steps, plan.online),
            more=plan.share,
        )
        taught = Taught(revise.align(), revise)
        taught.told |= {"alignments": revise.report, "scenes": revise.judged}
    taught.told |= {"strategy": plan.strategy, "offline": judge(taught.reward, test)}
    return taught


def judge(reward: EpisodeReward, videos: Sequence[Episode]) -> dict[str, float]:
    """Hold a reward against r* on some videos."""
    human = [video.human_rewards[1:] for video in videos if video.human_rewards is not None]
    return asdict(measures.agreement([reward(video) for video in videos], human))


def learn(
    plan: Plan, taught: Taught, sac: SacConfig, schedule: ScheduleConfig
) -> tuple[LearningCurve, Sequence[Episode]]:
    """Teach the robot; return its curve and its last training videos."""
    last: deque[Episode] = deque(maxlen=LAST_VIDEOS)

    def tell(event: LearningEvent) -> None:
        last.extend(event.episodes)
        if event.evaluation is not None:
            print(
                f"{plan.name} {event.steps} steps: success {event.evaluation.success_rate:.2f}, "
                f"training return of r* {event.human_return_mean:.1f}, reward "
                f"{event.reward_mean:.1f}, {event.steps_per_s:.0f} steps/s",
                flush=True,
            )

    folder = plan.work / plan.name
    folder.mkdir(parents=True, exist_ok=True)
    curve = train_in_process(
        TASK, taught.reward, sac, schedule, plan.seed, folder,
        resume=not plan.online, on_event=tell, revise=taught.revise,
    )  # fmt: skip
    return curve, last


def judge_last(
    plan: Plan, taught: Taught, test: Sequence[Episode], last: Sequence[Episode]
) -> dict[str, Any]:
    """Hold the last reward against r*, also on what the learner did."""
    found: dict[str, Any] = {}
    reward = taught.reward
    if taught.revise is not None and plan.online:
        reward = taught.revise.reward
        found = {"offline_last": judge(reward, test), "scenes_last": taught.revise.judged}
    if last and plan.reward != "ground_truth":  # empty in a run that had ended before
        found["learner_videos"] = judge(reward, last)
    return found


def main() -> None:
    """Run one reward and seed and write ``results/<name>.json``."""
    plan = parse()
    torch.set_num_threads(1)
    # torchvision crashes when it is first imported after an EGL context was made
    make_extractor(DEFAULT_BACKBONE, RAW_RECIPE)
    began_s, begun_at = time.monotonic(), commit()  # what runs, whatever is committed meanwhile
    pool = make_videos(plan.seed, "demonstrate", plan.pool, plan.work)
    judged = plan.reward != "ground_truth"
    test = make_videos(plan.seed, "test", TEST, plan.work) if judged else []
    taught = teach(plan, pool, test)
    print(plan.name, taught.told, flush=True)
    sac = SacConfig()
    schedule = ScheduleConfig(
        steps=plan.steps,
        evaluate_every=plan.evaluate_every,
        checkpoint_every=0 if plan.online else 5_000,  # what is revised cannot be resumed
    )
    learning_s = time.monotonic()
    curve, last = learn(plan, taught, sac, schedule)
    learning_s = time.monotonic() - learning_s
    result = {
        **{key: getattr(plan, key) for key in ("reward", "seed", "preset", "online")},
        **{key: getattr(plan, key) for key in ("steps", "triplets", "pool")},
        **taught.told,
        **judge_last(plan, taught, test, last),
        "curve": [asdict(point) for point in curve.points],
        "success_last_three": curve.last(3),
        "schedule": asdict(schedule),
        "sac": asdict(sac),
        "learning_s": learning_s,
        "wall_s": time.monotonic() - began_s,
        "commit": begun_at,
        "machine": machine(),
        "versions": versions(),
    }
    plan.results.mkdir(parents=True, exist_ok=True)
    path = plan.results / f"{plan.name}.json"
    path.write_text(json.dumps(result, indent=1, default=str) + "\n")


if __name__ == "__main__":
    main()
