"""``encoder/embed_episodes``: recorded episodes through the encoder at work."""

import threading
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path

from rapl_msgs.srv import EmbedEpisodes
from rclpy.callback_groups import ReentrantCallbackGroup

from rapl_core.episodes import EpisodeStore
from rapl_core.errors import RaplError, UnknownNameError
from rapl_core.representations import Encoder, EpisodeEmbedder
from rapl_core.types import EmbeddedEpisode
from rapl_ros import conversions, topics
from rapl_ros.background import Worker
from rapl_ros.node import RaplNode
from rapl_ros.wire import EmbeddingsAgain, EpisodeRecord, JoinKey

MOST_EPISODES = 64
WAITING_REQUESTS = 4
GIVE_WAY_S = 0.002
"""Between two videos: a lock that is taken again at once is not given to who waits."""


class EmbeddingAgain:
    """Embeds recorded episodes on a thread of its own, one request after another.

    A video at a time takes turns with the live pictures, so that those wait for one video at most.
    All embeddings of an answer are of one version: that at work when the request's turn came.

    :param encoder: gives the encoder at work; None: none yet.
    :param turn: held while the encoder computes.
    """

    def __init__(
        self,
        node: RaplNode,
        run_folder: Path,
        encoder: Callable[[], Encoder | None],
        turn: threading.Lock,
    ) -> None:
        self._node, self._folder, self._turn = node, run_folder, turn
        self._encoder = encoder
        self._episodes = EpisodeStore(run_folder / "episodes")
        self._embedder: EpisodeEmbedder | None = None
        self._worker = Worker(node, "recorded episodes", WAITING_REQUESTS)
        # Its callback waits; in the node's own group it would stop all others.
        node.create_service(
            EmbedEpisodes,
            topics.EMBED_EPISODES,
            self._on_request,
            callback_group=ReentrantCallbackGroup(),
        )

    def close(self) -> None:
        """End the thread, after the video under way."""
        self._worker.close(1.0)

    async def _on_request(
        self, request: EmbedEpisodes.Request, response: EmbedEpisodes.Response
    ) -> EmbedEpisodes.Response:
        ids = list(request.episode_ids)
        try:
            if len(ids) > MOST_EPISODES:
                raise RaplError(f"{len(ids)} episodes at once, expected {MOST_EPISODES} at most")
            again = await self._worker.submit(lambda: self._embed_all(ids))
        except Exception as error:  # whoever asks is told, and the node goes on
            known = isinstance(error, RaplError | OSError)
            response.message = str(error) if known else f"{type(error).__name__}: {error}"
            if not known:
                self._node.get_logger().error("".join(traceback.format_exception(error)))
            self._node.diagnostics.count("refused_episodes", len(ids))
            return response
        conversions.fill_embed_episodes(response, again)
        self._node.diagnostics.count("episodes_embedded_again", len(again.episodes))
        return response

    # On the worker's thread

    def _embed_all(self, ids: Sequence[str]) -> EmbeddingsAgain:
        encoder = self._encoder()
        if encoder is None:
            raise RaplError("no encoder is at work")
        if self._embedder is None or self._embedder.encoder is not encoder:
            self._embedder = EpisodeEmbedder(encoder, self._folder)
        embedded: list[tuple[EpisodeRecord, EmbeddedEpisode]] = []
        missing: dict[str, str] = {}
        for episode_id in ids:
            try:
                with self._turn:
                    found = self._embedder.embed(episode_id)
                embedded.append((self._record(episode_id), found))
            except UnknownNameError:
                missing[episode_id] = "not recorded"
            except RaplError as error:
                missing[episode_id] = str(error)
            time.sleep(GIVE_WAY_S)
        info = encoder.info
        return EmbeddingsAgain(info.name, info.version, tuple(embedded), missing)

    def _record(self, episode_id: str) -> EpisodeRecord:
        known = self._episodes.summary(episode_id)
        return EpisodeRecord(
            key=JoinKey(topics.world_frame(known.world), known.last_stamp_ns),
            episode_id=episode_id,
            task=known.task,
            world=known.world,
            purpose=known.purpose,
            controller=known.controller,
            behaviour=known.behaviour,
            steps=known.steps,
            uri=str(self._episodes.path(episode_id).relative_to(self._folder)),
            human_return=known.human_return if known.has_truth else None,
            success=known.success if known.has_truth else None,
        )
