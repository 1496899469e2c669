"""The episodes of a run: a folder of bags."""

import shutil
import time
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rapl_core.episodes.joints import JointTrack
from rapl_core.episodes.reading import read_episode, read_frames, read_joints
from rapl_core.episodes.summary import SUMMARY_FILE, EpisodeSummary, read_summary
from rapl_core.episodes.writing import TEMPORARY_PREFIX, write_episode
from rapl_core.errors import UnknownNameError
from rapl_core.types import EPISODE_ID, Episode

_ABANDONED_AFTER_S = 600.0


class EpisodeStore:
    """Episodes in a folder, each complete and on disk; several processes may add to it.

    :param folder: created by the first :meth:`add`.
    """

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)
        self._remove_abandoned()

    def add(
        self, episode: Episode, joints: JointTrack | None = None, terminated: bool = False
    ) -> Path:
        """Write an episode and return its folder; see :func:`write_episode`."""
        return write_episode(self.folder, episode, joints, terminated)

    def ids(self) -> list[str]:
        """Return the ids of all episodes, sorted."""
        if not self.folder.is_dir():
            return []
        return sorted(
            entry.name
            for entry in self.folder.iterdir()
            if EPISODE_ID.fullmatch(entry.name) and (entry / SUMMARY_FILE).is_file()
        )

    def __contains__(self, episode_id: object) -> bool:
        return (
            isinstance(episode_id, str)
            and EPISODE_ID.fullmatch(episode_id) is not None
            and (self.folder / episode_id / SUMMARY_FILE).is_file()
        )

    def __len__(self) -> int:
        return len(self.ids())

    def path(self, episode_id: str) -> Path:
        """Return the folder of an episode.

        :raises UnknownNameError: if there is none of that id.
        """
        if episode_id not in self:
            raise UnknownNameError(f"episode in {self.folder}", episode_id, self.ids())
        return self.folder / episode_id

    def load(self, episode_id: str) -> Episode:
        """Return an episode.

        :raises UnknownNameError: if there is none of that id.
        :raises CorruptFileError: if its files are damaged.
        """
        return read_episode(self.path(episode_id))

    def frames(self, episode_id: str) -> NDArray[np.uint8]:
        """Return the pictures (T + 1, H, W, 3) of an episode; errors as :meth:`load`."""
        return read_frames(self.path(episode_id))

    def first_of(self, episode_ids: Iterable[str]) -> NDArray[np.uint8] | None:
        """Return the pictures of the first of these that is here; None if none is.

        An exported encoder may come without its expert videos.
        """
        here = next((name for name in episode_ids if name in self), None)
        return self.frames(here) if here is not None else None

    def joints(self, episode_id: str) -> JointTrack | None:
        """Return the joints of an episode, None if not recorded; errors as :meth:`load`."""
        return read_joints(self.path(episode_id))

    def summary(self, episode_id: str) -> EpisodeSummary:
        """Return what is known of an episode without its bag; errors as :meth:`load`."""
        return read_summary(self.path(episode_id))

    def summaries(self) -> list[EpisodeSummary]:
        """Return the summaries of all episodes, sorted by id."""
        return [read_summary(self.folder / episode_id) for episode_id in self.ids()]

    def _remove_abandoned(self) -> None:
        """Remove what writers that were killed have left behind, once it is old."""
        for entry in self.folder.glob(f"{TEMPORARY_PREFIX}*"):
            try:
                if time.time() - entry.stat().st_mtime > _ABANDONED_AFTER_S:
                    shutil.rmtree(entry, ignore_errors=True)
            except FileNotFoundError:
                continue  # its writer has just finished
