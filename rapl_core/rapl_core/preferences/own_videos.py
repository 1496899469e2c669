"""The learner's own videos: which of them are new, and queries about those."""

import json
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from rapl_core.errors import CorruptFileError, RankingError
from rapl_core.preferences.queries import sets_of
from rapl_core.types import Ranking

OWN = "own"
"""Strategy of queries about the learner's own videos."""
OWN_VIDEOS_FILE = "own_videos.json"
"""In the run folder: up to which stamp an alignment knows the learner's videos."""
MOST_NEW = 40
"""Videos asked about at a time, the newest: what the robot makes of the present reward."""

_TRIES = 200


def online_alignments(preset: str) -> int:
    """How often a learner's own videos are asked about unless one says: only ``tuned`` does it."""
    return 9 if preset == "tuned" else 0


def online_steps(steps: int, alignments: int, random_steps: int = 0) -> list[int]:
    """World steps at which alignments begin: evenly from the first steps to the last.

    :param random_steps: while the robot acts at random there is nothing to ask about.
    """
    even = [steps * k // (alignments + 1) for k in range(1, alignments + 1)]
    return [max(mark, random_steps) for mark in even]


def online_share(triplets: int, alignments: int) -> int:
    """Rankings kept for each of the alignments: half of all, shared out."""
    return triplets // (2 * alignments) if alignments else 0


class OwnVideos:
    """The learner's videos that were recorded since the last alignment.

    Stamps tell what is new, for they increase across restarts.

    :param file: keeps up to where an alignment knows them.
    :raises CorruptFileError: if it cannot be read.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._stamps_ns: dict[str, int] = {}
        self._known_ns = _read(file)

    def add(self, episode_id: str, stamp_ns: int) -> None:
        """A video is on disk.

        :param stamp_ns: of its last instant.
        """
        self._stamps_ns[episode_id] = stamp_ns

    def discard(self, episode_id: str) -> None:
        """A video cannot be shown."""
        self._stamps_ns.pop(episode_id, None)

    def __contains__(self, episode_id: object) -> bool:
        return episode_id in self._stamps_ns

    def __iter__(self) -> Iterator[str]:
        """All videos of the learner."""
        return iter(self._stamps_ns)

    def new(self, most: int | None = MOST_NEW) -> tuple[str, ...]:
        """The new videos by age, the newest so many; None: all."""
        fresh = sorted(
            (stamp, name) for name, stamp in self._stamps_ns.items() if stamp > self._known_ns
        )
        return tuple(name for _, name in fresh[-most if most else 0 :])

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest video; 0 without any."""
        return max(self._stamps_ns.values(), default=0)

    def aligned(self, up_to_ns: int) -> None:
        """An alignment is done whose rankings may name videos up to this stamp; on disk at once."""
        if up_to_ns <= self._known_ns:
            return
        self._known_ns = up_to_ns
        beside = self._file.with_name(f".{self._file.name}.{os.getpid()}")
        beside.write_text(json.dumps({"known_ns": up_to_ns}) + "\n")
        beside.replace(self._file)


class OwnQueries:
    """Two of the learner's new videos (more in larger queries) beside one expert video.

    The expert video ties what is new to what was ranked before, so that strengths over all videos
    can be compared.

    :param rng: the order of queries follows from it.
    :param new: the learner's new videos.
    :param experts: the present expert set D+.
    :param size: videos in a query.
    """

    name = OWN

    def __init__(
        self,
        rng: np.random.Generator,
        new: Sequence[str],
        experts: Sequence[str],
        size: int = 3,
    ) -> None:
        if size < 2:
            raise RankingError(f"a query needs two or more videos, got {size}")
        self._rng = rng
        self._new = new
        self._experts = experts
        self._size = size

    def next(
        self, episode_ids: Sequence[str], asked: Iterable[Iterable[str]] = ()
    ) -> tuple[str, ...]:
        """The next query, in random order.

        :param episode_ids: the videos there are.
        :param asked: the videos of each query before, not to be asked again.
        :raises RankingError: if the learner has recorded too few, or all were asked about.
        """
        there, past = set(episode_ids), sets_of(asked)
        new = [name for name in self._new if name in there]
        if len(new) < self._size - 1:
            raise RankingError(
                f"no query: the learner has recorded {len(new)} of {self._size - 1} new videos"
            )
        experts = [name for name in self._experts if name in there and name not in new]
        if not experts:
            raise RankingError("no query: no expert video, for nothing is ranked yet")
        for _ in range(_TRIES):
            own = self._rng.choice(len(new), self._size - 1, replace=False)
            expert = experts[int(self._rng.integers(len(experts)))]
            query = [*(new[int(i)] for i in own), expert]
            if frozenset(query) not in past:
                return tuple(query[int(i)] for i in self._rng.permutation(self._size))
        raise RankingError(f"no query: nearly all about the {len(new)} new videos were asked")


def videos_to_learn_from(pool: Iterable[str], rankings: Iterable[Ranking]) -> list[str]:
    """The pool, and of all other videos those that were ranked, in the order of their rankings.

    The learner records a thousand videos and people rank some hundred of them; the features of the
    others would be read for nothing.
    """
    ranked = (name for ranking in rankings if ranking.ranks for name in ranking.episode_ids)
    return list(dict.fromkeys([*pool, *ranked]))


def _read(file: Path) -> int:
    try:
        return int(json.loads(file.read_text())["known_ns"])
    except FileNotFoundError:
        return 0
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise CorruptFileError(f"cannot read {file}: {error}; delete it to start anew") from error
