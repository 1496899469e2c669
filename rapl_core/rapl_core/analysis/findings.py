"""What a run shows: agreement with the human, examples, success; and ``results.json``."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from rapl_core.analysis import provenance
from rapl_core.analysis.measures import Agreement, arm_only_share
from rapl_core.analysis.record import RunRecord, pool_composition
from rapl_core.analysis.scoring import (
    RewardingEncoder,
    ScoredVideo,
    Scorer,
    choose_examples,
)
from rapl_core.analysis.stages import plain
from rapl_core.policies.learning_curve import LearningCurve

MEASURED_VIDEOS = 100
"""Videos of the pool that the reward is compared with the human on, as in the paper."""
QUICKLY_MEASURED_VIDEOS = 20
"""The same in a run with --quick: embedding them takes most of the report's time."""
MIME = "mime"
"""In the name of behaviours in which the arm moves and the objects do not."""


@dataclass(frozen=True)
class Findings:
    """What a report says, before it is put into words and pictures."""

    agreement: tuple[tuple[str, Agreement], ...]
    """(name of the set, agreement) of the pool and of the robot's own videos."""
    arm_share: float
    """Share of the experts' gain that mimes earn; NaN without mimes or experts."""
    preferred: tuple[ScoredVideo, ...]
    disliked: tuple[ScoredVideo, ...]
    robot: tuple[ScoredVideo, ...]


def find(record: RunRecord, scorer: Scorer) -> Findings:
    """Look at the videos of a run: at most MEASURED_VIDEOS of the pool, and of the robot's."""
    measured = QUICKLY_MEASURED_VIDEOS if record.settings.get("quick") else MEASURED_VIDEOS
    experts = record.expert_ids()
    behaviours = {e.episode_id: e.behaviour for e in record.pool}
    preferred, disliked = choose_examples(_liking(record), behaviours, experts)
    pool = spread([e.episode_id for e in record.pool if e.episode_id not in experts], measured)
    latest = _final_evaluation(record)
    sets = [("pool", pool), ("the robot's own, after learning", spread(latest, measured))]
    mimes = [e for e in behaviours if MIME in behaviours[e]]
    return Findings(
        agreement=tuple((name, scorer.agreement(ids)) for name, ids in sets if ids),
        arm_share=arm_only_share(
            [scorer.score(e).reward for e in experts],
            [scorer.score(e).reward for e in spread(mimes, measured // 4)],
        ),
        preferred=tuple(map(scorer.score, preferred)),
        disliked=tuple(map(scorer.score, disliked)),
        robot=tuple(map(scorer.score, _typical(record, latest))),
    )


def results(
    record: RunRecord,
    findings: Findings,
    curve: LearningCurve | None,
    encoder: RewardingEncoder | None,
) -> dict[str, Any]:
    """Return what ``results.json`` holds; what is unknown is null."""
    final = record.stage("evaluate").result
    accuracy = record.stage("align").result.get("held_out_accuracy")
    for later in record.online:
        accuracy = later.held_out_accuracy if later.is_done else accuracy
    found: dict[str, Any] = plain(
        {
            "settings": dict(record.settings),
            "encoder": asdict(encoder.info) if encoder else None,
            "success": {
                "final": final.get("success_rate"),
                "final_episodes": final.get("episodes"),
                "mean_of_last_three": curve.last(3) if curve and len(curve.points) >= 3 else None,
                "human_return": final.get("human_return_mean"),
                "by_step": curve.rows() if curve else [],
            },
            "online": [asdict(entry) for entry in record.online],
            "triplets": len(record.triplets()),
            "triplet_accuracy_held_out": accuracy,
            "agreement": {name: asdict(a) for name, a in findings.agreement},
            "arm_only_share": findings.arm_share,
            "pool": [asdict(share) for share in pool_composition(record)],
            "stages": [asdict(stage) for stage in record.stages],
            "wall_time_s": sum(stage.seconds for stage in record.stages),
            "versions": provenance.versions(),
            "commit": provenance.commit(),
            "machine": provenance.machine(),
        }
    )
    return found


def _liking(record: RunRecord) -> dict[str, float]:
    """Preference of each video: from the rankings, or from r* in a run without rankings."""
    return record.strengths() or {
        e.episode_id: e.human_return for e in record.pool if math.isfinite(e.human_return)
    }


def _final_evaluation(record: RunRecord) -> list[str]:
    """Episodes of the evaluation after learning, as far as they are on disk."""
    known = {e.episode_id for e in record.episodes}
    return [e for e in record.stage("evaluate").result.get("episode_ids", ()) if e in known]


def _typical(record: RunRecord, episode_ids: Sequence[str], most: int = 2) -> list[str]:
    """One of the robot's successes and one of its failures, or what there is."""
    outcome = {e.episode_id: e.success for e in record.episodes}
    kinds = [[e for e in episode_ids if outcome[e] is wanted] for wanted in (True, False)]
    chosen = [kind[len(kind) // 2] for kind in kinds if kind]
    return (chosen or list(episode_ids[:1]))[:most]


def spread(episode_ids: Sequence[str], most: int) -> list[str]:
    """At most ``most`` of the videos, evenly spaced in their order."""
    if len(episode_ids) <= most:
        return list(episode_ids)
    return [episode_ids[i] for i in np.linspace(0, len(episode_ids) - 1, most).round().astype(int)]
