"""Evaluation: episodes with the deterministic policy and the true success."""

import math
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class EpisodeOutcome:
    """How one evaluation episode went."""

    episode_id: str
    number: int
    world: int
    success: bool | None
    """None where the truth is unknown."""
    human_return: float
    """NaN where the truth is unknown."""
    reward_return: float
    """Sum of the learnt-from reward; NaN where it was not computed."""


@dataclass(frozen=True)
class Evaluation:
    """What an evaluation found."""

    episodes: int
    success_rate: float
    """NaN unless the truth of every episode is known."""
    human_return_mean: float
    reward_mean: float
    episode_ids: tuple[str, ...]


def summarise_evaluation(outcomes: Sequence[EpisodeOutcome], episodes: int) -> Evaluation:
    """Return the means over the first ``episodes`` outcomes in the order of (number, world).

    The worlds make a few episodes too many when their number does not divide ``episodes``.
    """
    counted = sorted(outcomes, key=lambda outcome: (outcome.number, outcome.world))[:episodes]
    return Evaluation(
        episodes=len(counted),
        success_rate=_mean([math.nan if o.success is None else float(o.success) for o in counted]),
        human_return_mean=_mean([o.human_return for o in counted]),
        reward_mean=_mean([o.reward_return for o in counted]),
        episode_ids=tuple(o.episode_id for o in counted),
    )


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values) if values else math.nan
