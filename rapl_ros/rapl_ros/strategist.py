"""Keeps the selectors of queries up to date behind the service calls, on a thread of its own."""

import threading
import traceback
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import numpy as np

from rapl_core.episodes import EpisodeStore
from rapl_core.errors import RaplError
from rapl_core.preferences import ContestQueries, RankingStore
from rapl_core.preferences.queries import QuerySelector
from rapl_core.preferences.strategies import LearningSelector, make_selector

SETTLE_S = 0.05
"""After an answer: more of them may come at once."""


class Strategist:
    """Learns from each answer which queries to ask next; until then the asking is uniform.

    The first request for a strategy other than ``uniform`` starts the thread, which reads the
    features of the pool once (minutes for 300 videos; kept on disk, and alignment reads the same).

    :param store: the rankings.
    :param run_folder: has the videos and keeps the features.
    :param pool: gives the videos that there are now.
    :param preset: whose features are read, and with whose loss ``transport`` learns.
    :param precision: of the features.
    :param seed: of candidates and ensembles.
    :param backbone: network that features are read from; empty: the default one.
    :param weights: its weights, a file or a folder; None: where they are usually.
    """

    def __init__(
        self,
        store: RankingStore,
        run_folder: Path,
        pool: Callable[[], Collection[str]],
        preset: str,
        precision: str,
        seed: int,
        backbone: str = "",
        weights: Path | None = None,
    ) -> None:
        self._store, self._folder, self._pool = store, run_folder, pool
        self._preset, self._precision, self._seed = preset, precision, seed
        self._backbone, self._weights = backbone, weights
        self._wanted: set[tuple[str, int]] = set()
        self._ready: dict[tuple[str, int], LearningSelector] = {}
        self._detail: dict[str, str] = {}
        self._videos: tuple[str, ...] = ()
        self._features: Any = None
        self._woken = threading.Event()
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    def selector(self, strategy: str, size: int, wanted: int = 0) -> QuerySelector | None:
        """The selector of a strategy; None while it is not ready: ask uniformly then.

        :param wanted: rankings wanted in all, for ``contest``; 0: not known.
        """
        if strategy == "uniform":
            return None
        if strategy == "contest":
            return self._contest(size, wanted)
        key = strategy, size
        if key not in self._wanted:
            self._wanted.add(key)
            self._detail.setdefault(strategy, "uniform until the videos' features are read")
            self._start()
        return self._ready.get(key)

    def _contest(self, size: int, wanted: int) -> QuerySelector:
        unknown = "" if wanted else "uniform, for how many rankings are wanted is not known"
        self._detail["contest"] = unknown
        with self._store.reading() as ledger:
            rankings, queries = list(ledger.effective()), ledger.queries
        rng = np.random.default_rng([self._seed, 402, queries])  # a restart goes on, not back
        return ContestQueries(rng, rankings, wanted, size)

    def detail(self, strategy: str) -> str:
        """Why a strategy is not at work; empty when it is."""
        return self._detail.get(strategy, "")

    def notice(self) -> None:
        """Rankings or videos have come: learn anew."""
        if self._thread is not None:
            self._woken.set()

    def close(self, timeout_s: float = 1.0) -> None:
        """End the thread; the work of a moment may be lost."""
        self._closing.set()
        self._woken.set()
        if self._thread is not None:
            self._thread.join(timeout_s)

    # On the thread

    def _start(self) -> None:
        self._woken.set()
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="strategist", daemon=True)
            self._thread.start()

    def _work(self) -> None:
        while self._woken.wait() and not self._closing.wait(SETTLE_S):
            self._woken.clear()
            for key in sorted(self._wanted):
                try:
                    self._learn(*key)
                    self._detail[key[0]] = ""
                except RaplError as error:
                    self._detail[key[0]] = f"uniform, for {error}"
                except Exception as error:  # the asking goes on, and the thread
                    traceback.print_exception(error)
                    self._detail[key[0]] = f"uniform, for {type(error).__name__}: {error}"

    def _learn(self, strategy: str, size: int) -> None:
        videos = tuple(sorted(self._pool()))
        if videos != self._videos:
            self._read(videos, strategy)
        if (strategy, size) not in self._ready:
            self._ready[strategy, size] = self._make(strategy, size)
        with self._store.reading() as ledger:
            rankings = list(ledger.effective())
            asked = ledger.asked(0)
        self._ready[strategy, size].update(rankings, asked)

    def _read(self, videos: tuple[str, ...], strategy: str) -> None:
        # Here, for torch takes seconds and 250 MiB, and uniform asking needs none of it.
        from rapl_core.representations import FeatureStore, find_parts, get_preset, make_extractor
        from rapl_core.representations.registry import DEFAULT_BACKBONE

        episodes = EpisodeStore(self._folder / "episodes")
        if self._features is None:
            preset = get_preset(self._preset)
            extractor = make_extractor(
                self._backbone or DEFAULT_BACKBONE, preset.recipe, self._weights
            )
            find_parts(extractor, videos, lambda name: episodes.frames(name)[1:], self._seed)
            folder = self._folder / "features"
            self._features = FeatureStore(extractor, folder, self._precision)  # type: ignore[arg-type]
        for done, episode_id in enumerate(videos):
            if self._closing.is_set():
                return
            self._detail[strategy] = f"uniform until features are read: {done} of {len(videos)}"
            if episode_id not in self._features:
                self._features.add(episode_id, episodes.frames(episode_id)[1:])
        self._videos = videos
        self._ready.clear()

    def _make(self, strategy: str, size: int) -> LearningSelector:
        from rapl_core.preferences.video_features import summarise
        from rapl_core.representations import get_preset
        from rapl_core.representations.query_ensemble import TransportEnsemble

        rng = np.random.default_rng([self._seed, 401, len(self._videos)])
        features = {name: self._features[name] for name in self._videos}
        ensemble = TransportEnsemble(features, self._videos, get_preset(self._preset), rng)
        return make_selector(strategy, rng, summarise(features), ensemble, size)
