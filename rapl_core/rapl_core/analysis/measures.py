"""How well a reward orders frames and videos as the human's reward does.

Every function takes sequences of per-step traces: ``rewards[i]`` and ``human[i]`` are the (T_i,)
traces of video i, both of the frames arrived in. None of them fits anything.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import rankdata

from rapl_core.errors import ShapeError

FRAME_GAP_M = 0.02
"""Frame pairs closer than this in r* (metres) are not asked about by :func:`concordance`."""

_NOTHING_LEFT = 1e-9

Traces = Sequence[ArrayLike]


@dataclass(frozen=True)
class StepCorrelation:
    """Spearman's correlation between two per-step rewards, a video at a time."""

    mean: float
    """Over the videos where it is defined; NaN when there is none."""
    per_video: NDArray[np.float64]
    """(N,) NaN where one of the two traces is constant."""

    @property
    def undefined(self) -> int:
        """Number of videos where a trace is constant and the correlation does not exist."""
        return int(np.isnan(self.per_video).sum())


@dataclass(frozen=True)
class Concordance:
    """Share of frame pairs that a reward orders as the human does."""

    value: float
    """(concordant - discordant) / pairs, in [-1, 1]; a tie counts as neither; NaN without pairs."""
    pairs: int


def spearman(x: ArrayLike, y: ArrayLike) -> float:
    """Spearman's rank correlation of two (N,) arrays; NaN when one of them is constant."""
    a, b = _pair("x", x, y)
    if len(a) < 2 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return float("nan")
    return float(np.corrcoef(rankdata(a), rankdata(b))[0, 1])


def spearman_per_step(rewards: Traces, human: Traces) -> StepCorrelation:
    """Return Spearman's correlation over the steps of each video (the paper's Spearman table)."""
    per_video = np.array(
        [spearman(r, h) for r, h in zip(rewards, human, strict=True)], dtype=np.float64
    )
    defined = per_video[~np.isnan(per_video)]
    return StepCorrelation(float(defined.mean()) if len(defined) else float("nan"), per_video)


def video_mix(behaviours: Sequence[str]) -> dict[str, int]:
    """Videos of each behaviour: what a mean over videos is a mean of."""
    return {name: behaviours.count(name) for name in sorted(set(behaviours))}


def partial_spearman_given_time(rewards: Traces, human: Traces) -> StepCorrelation:
    """Return Spearman's correlation over the steps of each video with the clock's part removed.

    With ranks of reward r, human h and time t:  (rho_rh - rho_rt rho_ht) /
    sqrt((1 - rho_rt^2) (1 - rho_ht^2)); undefined where a trace is constant or a clock itself.
    """
    per_video = np.full(len(rewards), np.nan)
    for i, (reward, felt) in enumerate(zip(rewards, human, strict=True)):
        time = np.arange(len(np.asarray(felt)))
        both, r_time, h_time = spearman(reward, felt), spearman(reward, time), spearman(felt, time)
        left = (1 - r_time**2) * (1 - h_time**2)
        if left > _NOTHING_LEFT:  # false for NaN too
            per_video[i] = (both - r_time * h_time) / np.sqrt(left)
    defined = per_video[~np.isnan(per_video)]
    return StepCorrelation(float(defined.mean()) if len(defined) else float("nan"), per_video)


def concordance(rewards: Traces, human: Traces, gap: float = FRAME_GAP_M) -> Concordance:
    """Return the concordance over pairs of frames of one video that differ by more than ``gap``.

    Half of all consecutive steps leave r* unchanged, which Spearman's correlation punishes at
    random; this measure asks only about pairs between which something happened.

    :param gap: least difference of r*, in its unit (metres).
    """
    balance, pairs = 0, 0
    for reward_trace, human_trace in zip(rewards, human, strict=True):
        r, h = _pair("rewards", reward_trace, human_trace)
        first, second = np.triu_indices(len(h), k=1)
        difference = h[second] - h[first]
        asked = np.abs(difference) > gap
        balance += int(np.sum(np.sign(r[second] - r[first])[asked] * np.sign(difference)[asked]))
        pairs += int(asked.sum())
    return Concordance(balance / pairs if pairs else float("nan"), pairs)


def episode_rank_correlation(rewards: Traces, human: Traces) -> float:
    """Return Spearman's correlation between the videos' sums of reward; NaN when undefined."""
    return spearman(
        [float(np.sum(np.asarray(r))) for r in rewards],
        [float(np.sum(np.asarray(h))) for h in human],
    )


@dataclass(frozen=True)
class Agreement:
    """How a reward agrees with the human's over a set of videos."""

    videos: int
    step: float
    """Mean Spearman correlation over the steps of a video."""
    step_undefined: int
    """Videos left out of it: one of the two traces is constant."""
    concordance: float
    """Over pairs of frames that differ by more than 2 cm in r*."""
    episode: float
    """Rank correlation of the videos' sums."""


def agreement(rewards: Traces, human: Traces) -> Agreement:
    """Return how a reward agrees with the human's over a set of videos.

    Of scripted videos that nothing was learnt from it says what a table can; of the videos of a
    learner that was trained on that reward, what the reward is worth where the learner took it.
    """
    step = spearman_per_step(rewards, human)
    return Agreement(
        videos=len(rewards),
        step=step.mean,
        step_undefined=step.undefined,
        concordance=concordance(rewards, human).value,
        episode=episode_rank_correlation(rewards, human),
    )


def arm_only_share(expert_rewards: Traces, mime_rewards: Traces, window: int = 5) -> float:
    """Return how much of the experts' gain a reward gives for the arm's motion alone.

    The gain of a video is its mean reward over the last ``window`` steps minus that over the
    first. A mime moves the arm as an expert does while the objects stay where they are, so a
    reward that looks at the objects gives it nothing (0) and one that watches the arm gives it
    everything (1).

    :param window: steps averaged at either end.
    :return: mean gain of the mimes over mean gain of the experts; NaN when either set is empty or
        the experts gain nothing.
    """
    return gain_share(expert_rewards, mime_rewards, window)


def gain_share(whole: Traces, part: Traces, window: int = 5) -> float:
    """Return the mean gain of some videos over that of others that show all of it.

    :param whole: rewards of videos in which arm and objects move.
    :param part: rewards of the same with only one of the two moving; of objects alone it should
        come out near 1, of the arm alone near 0 (:func:`arm_only_share`).
    :return: NaN when either set is empty or the whole gains nothing.
    """
    gain = mean_gain(whole, window)
    return mean_gain(part, window) / gain if gain > 0 else float("nan")


def mean_gain(rewards: Traces, window: int = 5) -> float:
    """Return the mean over videos of what they gain: reward at their end less that at their start.

    :param window: steps averaged at either end.
    :return: NaN without videos.
    """
    return float(np.mean([_gain(r, window) for r in rewards])) if len(rewards) else float("nan")


@dataclass(frozen=True)
class Wishes:
    """What a landscape says of each thing that a reward must express, one number each.

    In shares of the reward's range over the scenes that were placed by hand, so that the size of a
    reward plays no part, nor whether being done earns more than rest, as it should.
    """

    rise: float
    """Spearman's correlation with the way gone while both go to the goal together; wanted: 1."""
    pit: float
    """How far it falls below an earlier value on that way, at most; wanted: 0."""
    over_alone: float
    """By how much both together in the goal earn more than one alone in it; wanted: above 0."""
    gap: float
    """Lost while a gap grows between objects in the goal; wanted: above 0."""
    arm: float
    """Gained by the arm alone; wanted: 0."""


def wishes(together: ArrayLike, alone: ArrayLike, gap: ArrayLike, arm: ArrayLike) -> Wishes:
    """Return one number for each wish.

    :param together: (N,) rewards along the way of both to the goal.
    :param alone: (N,) along the way of one alone.
    :param gap: (N,) while the gap grows.
    :param arm: (N,) along the way of the arm alone.
    :return: all NaN for a reward that is the same everywhere.
    """
    way, one, wide, bare = (np.asarray(x, dtype=np.float64) for x in (together, alone, gap, arm))
    unit = float(np.ptp(np.concatenate([way, one, wide, bare])))
    if not unit > 0:
        return Wishes(*[float("nan")] * 5)
    return Wishes(
        rise=spearman(way, np.arange(len(way))),
        pit=float((np.maximum.accumulate(way) - way).max()) / unit,
        over_alone=float(way[-1] - one[-1]) / unit,
        gap=float(wide[0] - wide[-1]) / unit,
        arm=float(bare[-1] - bare[0]) / unit,
    )


def triplet_accuracy(returns: dict[str, float], triplets: Sequence[tuple[str, str, str]]) -> float:
    """Return the share of ordered pairs in ``triplets`` that the videos' returns order alike.

    :param returns: return of each video by episode id.
    :param triplets: (best, middle, worst) episode ids; the ones with an unknown id are left out.
    :return: correct pairs over pairs, a tie counting half; NaN without triplets.
    """
    right, pairs = 0.0, 0
    for best, middle, worst in triplets:
        if not {best, middle, worst} <= returns.keys():
            continue
        for better, poorer in ((best, middle), (middle, worst), (best, worst)):
            difference = returns[better] - returns[poorer]
            right += 1.0 if difference > 0 else 0.5 if difference == 0 else 0.0
            pairs += 1
    return right / pairs if pairs else float("nan")


def _gain(trace: ArrayLike, window: int) -> float:
    values = np.asarray(trace, dtype=np.float64)
    width = max(1, min(window, len(values) // 2))
    return float(values[-width:].mean() - values[:width].mean())


def _pair(name: str, x: ArrayLike, y: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    a, b = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if a.shape != b.shape or a.ndim != 1:
        raise ShapeError(f"{name} has shape {a.shape} beside {b.shape}, expected two equal (N,)")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ShapeError(f"{name} has NaN or infinite values")
    return a, b
