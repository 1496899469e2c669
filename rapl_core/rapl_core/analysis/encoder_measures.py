"""One encoder of a run, measured on videos and rankings that it did not learn from."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rapl_core.analysis import measures
from rapl_core.analysis.findings import MEASURED_VIDEOS, MIME, spread
from rapl_core.analysis.record import EXPERTS
from rapl_core.analysis.scoring import ScoredVideo, Scorer
from rapl_core.episodes import EpisodeStore
from rapl_core.errors import RefusedError
from rapl_core.preferences import RankingStore, expert_set, triplets_from
from rapl_core.preferences.store import RANKINGS_FILE
from rapl_core.representations.alignment_job import LEARNT_FROM
from rapl_core.representations.encoder import Encoder
from rapl_core.representations.methods import get_method, method_names
from rapl_core.representations.report import wilson_interval
from rapl_core.representations.workshop import demonstrations_in
from rapl_core.types import EncoderInfo, Ranking, Triplet

POOL_PURPOSE, TEST_PURPOSE = "demonstrate", "test"


@dataclass(frozen=True)
class HumanMeasures:
    """How the reward agrees with the human's over some videos."""

    videos: int
    video_mix: dict[str, int]
    """Videos of each behaviour."""
    step: float
    """Mean over videos of Spearman's correlation over the steps; NaN where none is defined, as
    everywhere here."""
    step_undefined: int
    """Videos left out of it: one of the two traces is constant."""
    step_given_time: float
    """The same with the clock's part removed."""
    step_given_time_undefined: int
    concordance: float
    """Over pairs of frames that differ by more than 2 cm in r*."""
    episode: float
    """Rank correlation of the videos' sums."""
    arm_only: float
    """What mimes earn of the gain of successes; NaN unless there are both."""


@dataclass(frozen=True)
class RankingMeasure:
    """How many rankings the reward agrees with."""

    accuracy: float
    """Share of pairs in the right order."""
    interval: tuple[float, float]
    """95 % Wilson interval, over triplets."""
    triplets: int
    chose_epoch: bool
    """Whether training used them to choose its best epoch, so that they flatter a little."""


@dataclass(frozen=True)
class EncoderMeasures:
    """What is known of an encoder."""

    encoder: EncoderInfo
    reward_kind: str
    measured_on: str
    """Which videos, in words."""
    human: HumanMeasures | None
    """None: there are no such videos, or no human reward in them (a real camera has none)."""
    rankings: RankingMeasure | None
    """None: there are none that it did not learn from."""


def measure_encoder(
    run_folder: Path,
    encoder: Encoder,
    report: Mapping[str, Any],
    on_video: Callable[[int, int], None] = lambda done, total: None,
) -> EncoderMeasures:
    """Measure an encoder on the run's test episodes, or else on what it did not learn from.

    :param report: how its training went, as its checkpoint has it.
    :param on_video: told how many videos of how many are scored.
    :raises RefusedError: if there is neither a human reward nor a ranking to go by.
    """
    store = EpisodeStore(run_folder / "episodes")
    rankings = _Rankings(run_folder)
    experts = encoder.expert_ids or rankings.expert_ids()
    taught = {*experts, *rankings.videos, *report.get(LEARNT_FROM, {}).get("videos", ())}
    words, videos = _videos(store, encoder, taught)
    triplets = rankings.unseen(report)
    scorer = Scorer(store, encoder, experts)
    wanted = sorted({*videos, *(name for t in triplets for name in _names(t))})
    scored: dict[str, ScoredVideo] = {}
    for name in wanted:
        on_video(len(scored), len(wanted))
        scored[name] = scorer.score(name)
    on_video(len(scored), len(wanted))
    human = _human([scored[name] for name in videos])
    found = EncoderMeasures(
        encoder.info,
        encoder.reward_kind,
        words,
        human,
        _by_rankings(scored, triplets) or _as_trained(report),
    )
    if human is None and found.rankings is None:
        lacking = "no human reward in these videos" if videos else "no video"
        raise RefusedError(
            f"cannot measure {encoder.info.name}-{encoder.info.version} on {words}: {lacking}, "
            "and no ranking that it did not learn from; record episodes of purpose 'test', or rank"
        )
    return found


class _Rankings:
    """Those of a run; none where nobody ranked."""

    def __init__(self, run_folder: Path) -> None:
        self.all: list[Ranking] = []
        self.effective: list[Ranking] = []
        if (run_folder / RANKINGS_FILE).is_file():
            with RankingStore(run_folder / RANKINGS_FILE) as store:
                self.all, self.effective = store.all(), store.effective()

    @property
    def videos(self) -> set[str]:
        """Every video that was ever ranked."""
        return {name for ranking in self.all for name in ranking.episode_ids}

    def expert_ids(self) -> tuple[str, ...]:
        """The most preferred videos, as the encoder node chooses them."""
        ranked = {name for r in self.effective if r.ranks for name in r.episode_ids}
        return tuple(expert_set(self.effective, min(EXPERTS, len(ranked)))) if ranked else ()

    def unseen(self, report: Mapping[str, Any]) -> list[Triplet]:
        """Triplets of rankings about other videos than any that an encoder learnt from; none
        where its report does not say which those were."""
        if LEARNT_FROM not in report:
            return []
        learnt = set(report[LEARNT_FROM]["rankings"])
        asked = {frozenset(r.episode_ids) for r in self.all if r.ranking_id in learnt}
        return triplets_from(r for r in self.effective if frozenset(r.episode_ids) not in asked)


def _videos(store: EpisodeStore, encoder: Encoder, taught: set[str]) -> tuple[str, list[str]]:
    """In words and by id, MEASURED_VIDEOS at most.

    :param taught: what was ranked, and experts.
    """
    episodes = store.summaries()
    tests = [e.episode_id for e in episodes if e.purpose == TEST_PURPOSE]
    if tests:
        chosen = spread(tests, MEASURED_VIDEOS)
        return f"{len(chosen)} of {len(tests)} test episodes", chosen
    pool = [e for e in episodes if e.purpose == POOL_PURPOSE]
    why = "in no ranking and no expert set"
    name = encoder.info.name
    lesson = get_method(name).lesson if name in method_names() else ""
    if lesson == "demonstrations":
        taught |= set(demonstrations_in(pool))
        why += ", and no demonstrations that it learnt from"
    elif lesson == "truth":
        taught |= {e.episode_id for e in pool}
        why += ", for it learnt from the human reward of all"
    rest = [e.episode_id for e in pool if e.episode_id not in taught]
    chosen = spread(rest, MEASURED_VIDEOS)
    return f"{len(chosen)} of {len(pool)} videos of the pool, held out: {why}", chosen


def _human(videos: Sequence[ScoredVideo]) -> HumanMeasures | None:
    known = [v for v in videos if v.human is not None]
    if not known:
        return None
    rewards = [v.reward for v in known]
    felt = [v.human for v in known if v.human is not None]
    agreement = measures.agreement(rewards, felt)
    given_time = measures.partial_spearman_given_time(rewards, felt)
    return HumanMeasures(
        videos=len(known),
        video_mix=measures.video_mix([v.episode.behaviour for v in known]),
        step=agreement.step,
        step_undefined=agreement.step_undefined,
        step_given_time=given_time.mean,
        step_given_time_undefined=given_time.undefined,
        concordance=agreement.concordance,
        episode=agreement.episode,
        arm_only=measures.arm_only_share(
            [v.reward for v in known if v.episode.success],
            [v.reward for v in known if MIME in v.episode.behaviour],
        ),
    )


def _by_rankings(
    scored: Mapping[str, ScoredVideo], triplets: Sequence[Triplet]
) -> RankingMeasure | None:
    if not triplets:
        return None
    returns = {name: float(video.reward.sum()) for name, video in scored.items()}
    accuracy = measures.triplet_accuracy(returns, [_names(t) for t in triplets])
    interval = wilson_interval(accuracy, len(triplets))
    return RankingMeasure(accuracy, interval, len(triplets), chose_epoch=False)


def _as_trained(report: Mapping[str, Any]) -> RankingMeasure | None:
    """What training found on the triplets that it held out."""
    accuracy, triplets = report.get("held_out_accuracy"), int(report.get("held_out_triplets") or 0)
    if accuracy is None or not math.isfinite(accuracy) or not triplets:
        return None
    interval = wilson_interval(accuracy, triplets)
    return RankingMeasure(float(accuracy), interval, triplets, chose_epoch=True)


def _names(triplet: Triplet) -> tuple[str, str, str]:
    return triplet.best, triplet.middle, triplet.worst
