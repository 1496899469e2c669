"""What an alignment reports."""

import math
from dataclasses import asdict, dataclass
from typing import Any

from rapl_core.representations.training import EpochProgress


@dataclass(frozen=True)
class AlignmentReport:
    """How an encoder was learnt and how well it orders triplets that it did not learn from."""

    method: str
    preset: str
    train_triplets: int
    held_out_triplets: int
    dropped_triplets: int
    """Left out because they share a video with a held-out one."""
    tied_triplets: int
    held_out_accuracy: float
    """Share of held-out triplets in the right order; NaN without any. These triplets chose the
    best epoch, so it flatters a little."""
    held_out_interval: tuple[float, float]
    """95 % Wilson interval of it."""
    statistics_videos: int
    """Videos that mean, deviation and components come from."""
    explained_variance: float
    """Share that the principal components keep; 1 without them."""
    reward_scale: float
    best_epoch: int
    history: tuple[EpochProgress, ...]
    seconds: float
    """Wall time."""

    def to_json(self) -> dict[str, Any]:
        """A JSON object; NaN becomes null."""
        return {name: _without_nan(value) for name, value in asdict(self).items()}


def wilson_interval(share: float, trials: int, z: float = 1.96) -> tuple[float, float]:
    """95 % confidence interval of a share of ``trials``; (0, 1) for none."""
    if trials == 0:
        return 0.0, 1.0
    centre = (share + z * z / (2 * trials)) / (1 + z * z / trials)
    half = z * math.sqrt(share * (1 - share) / trials + z * z / (4 * trials**2))
    half /= 1 + z * z / trials
    return max(0.0, centre - half), min(1.0, centre + half)


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and math.isnan(value) else value
