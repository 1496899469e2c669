"""One vector a video: what query selection and the models of annotators see of it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rapl_core.errors import RankingError, ShapeError

COMPONENTS = 48
LAST_PART = 0.25
"""Of a video: the end says more than the way."""


@dataclass(frozen=True)
class VideoFeatures:
    """Vectors of the videos of a pool."""

    episode_ids: tuple[str, ...]
    values: NDArray[np.float64]
    """(n, d), centred; the first component has unit deviation, the others less."""

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or len(self.values) != len(self.episode_ids):
            raise ShapeError(
                f"features of {len(self.episode_ids)} videos have shape {self.values.shape}, "
                f"expected ({len(self.episode_ids)}, *)"
            )

    @cached_property
    def _rows(self) -> dict[str, int]:
        return {episode_id: i for i, episode_id in enumerate(self.episode_ids)}

    def __contains__(self, episode_id: str) -> bool:
        return episode_id in self._rows

    def rows(self, episode_ids: Iterable[str]) -> NDArray[np.int64]:
        """Row numbers of videos.

        :raises RankingError: naming the videos that have no features.
        """
        episode_ids = list(episode_ids)
        missing = sorted({e for e in episode_ids if e not in self._rows})
        if missing:
            raise RankingError(f"no features of {', '.join(missing[:5])}")
        return np.array([self._rows[e] for e in episode_ids], dtype=np.int64)


def summarise(
    features: Mapping[str, NDArray[np.float32]], components: int = COMPONENTS
) -> VideoFeatures:
    """Return principal components of each video's mean feature and of that of its last quarter.

    The spectrum is kept (nothing is whitened): what varies most in the pool counts most.

    :param features: (T, F) by episode id, e.g. a FeatureStore.
    :param components: d, at most n - 1.
    :raises RankingError: if there are fewer than two videos.
    """
    if len(features) < 2:
        raise RankingError(f"features of {len(features)} videos, expected two or more")
    names = sorted(features)
    rows = []
    for name in names:
        video = np.asarray(features[name], dtype=np.float64)  # (T, F)
        end = video[-max(1, round(LAST_PART * len(video))) :]
        rows.append(np.concatenate([video.mean(axis=0), end.mean(axis=0)]))
    x = np.array(rows)  # (n, 2F)
    x -= x.mean(axis=0)
    deviation = x.std(axis=0)
    x /= np.where(deviation > 0, deviation, 1.0)
    # By the Gram matrix: there are far fewer videos than features.
    values, vectors = np.linalg.eigh(x @ x.T)  # ascending
    kept = min(components, len(names) - 1)
    scores = vectors[:, ::-1][:, :kept] * np.sqrt(np.maximum(values[::-1][:kept], 0.0))
    return VideoFeatures(tuple(names), scores / max(float(scores[:, 0].std()), 1e-12))
