"""What a run has left in its folder, read for the report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from rapl_core.analysis.online import OnlineAlignment, read_online
from rapl_core.analysis.stages import StageRecord, read_stages
from rapl_core.episodes import EpisodeStore
from rapl_core.episodes.summary import EpisodeSummary
from rapl_core.errors import CorruptFileError
from rapl_core.preferences.expert_set import expert_set, strengths
from rapl_core.preferences.store import RANKINGS_FILE, RankingStore
from rapl_core.preferences.triplets import triplets_from
from rapl_core.types import Ranking, Triplet

EPISODES_FOLDER = "episodes"
EXPERTS = 10


@dataclass(frozen=True)
class BehaviourShare:
    """One source of the pool."""

    behaviour: str
    videos: int
    share: float
    """Of the pool."""
    success_rate: float
    """NaN where the truth is unknown."""
    strength: float | None
    """Mean Bradley-Terry strength of its ranked videos; None if none was ranked."""


@dataclass(frozen=True)
class RunRecord:
    """A run as it lies on disk."""

    folder: Path
    settings: Mapping[str, Any]
    """The section ``run`` of config.yaml."""
    config: Mapping[str, Any]
    """All of config.yaml."""
    stages: tuple[StageRecord, ...]
    episodes: tuple[EpisodeSummary, ...]
    rankings: tuple[Ranking, ...]
    online: tuple[OnlineAlignment, ...] = ()
    """Alignments made while the robot learnt."""

    @property
    def task(self) -> str:
        """Name of the task."""
        return str(self.settings["task"])

    @property
    def pool(self) -> tuple[EpisodeSummary, ...]:
        """Demonstrations: what was ranked."""
        return tuple(e for e in self.episodes if e.purpose == "demonstrate")

    @property
    def store(self) -> EpisodeStore:
        """The videos."""
        return EpisodeStore(self.folder / EPISODES_FOLDER)

    def stage(self, name: str) -> StageRecord:
        """Return how stage ``name`` stands; ``waiting`` if it never began."""
        return next((s for s in self.stages if s.name == name), StageRecord(name))

    def strengths(self) -> dict[str, float]:
        """Bradley-Terry strength of every ranked video."""
        return strengths(self.rankings)

    def triplets(self) -> list[Triplet]:
        """The triplets in the rankings."""
        return triplets_from(self.rankings)

    def expert_ids(self) -> list[str]:
        """The expert set, as alignment chooses it; empty without enough rankings."""
        ranked = self.strengths()
        return expert_set(self.rankings, min(EXPERTS, len(ranked))) if ranked else []


def read_config(folder: Path) -> Mapping[str, Any]:
    """All of config.yaml; its section ``run`` is there.

    :raises CorruptFileError: if there is none, or it cannot be read.
    """
    path = folder / "config.yaml"
    try:
        config: Mapping[str, Any] = yaml.safe_load(path.read_text())
        config["run"]
    except FileNotFoundError as error:
        raise CorruptFileError(f"{folder} holds no run: config.yaml is missing") from error
    except (OSError, yaml.YAMLError, TypeError, KeyError) as error:
        raise CorruptFileError(f"cannot read {path}: {error}") from error
    return config


def read_run(folder: Path) -> RunRecord:
    """Read a run.

    :raises CorruptFileError: if ``folder`` holds no run or a file of it cannot be read.
    """
    config = read_config(folder)
    rankings: Sequence[Ranking] = ()
    if (folder / RANKINGS_FILE).exists():
        with RankingStore(folder / RANKINGS_FILE) as store:
            rankings = store.effective()
    return RunRecord(
        folder=folder,
        settings=config["run"],
        config=config,
        stages=read_stages(folder),
        episodes=tuple(EpisodeStore(folder / EPISODES_FOLDER).summaries()),
        rankings=tuple(rankings),
        online=tuple(read_online(folder)),
    )


def pool_composition(record: RunRecord) -> list[BehaviourShare]:
    """Return every source of the pool and its share, the largest first."""
    strength = record.strengths()
    shares = []
    for behaviour in sorted({e.behaviour for e in record.pool}):
        members = [e for e in record.pool if e.behaviour == behaviour]
        known = [bool(e.success) for e in members if e.success is not None]
        ranked = [strength[e.episode_id] for e in members if e.episode_id in strength]
        shares.append(
            BehaviourShare(
                behaviour or "unnamed",
                len(members),
                len(members) / len(record.pool),
                sum(known) / len(known) if known else float("nan"),
                sum(ranked) / len(ranked) if ranked else None,
            )
        )
    return sorted(shares, key=lambda s: -s.videos)
