"""Recorded episodes through an encoder, with the backbone's part of the work kept on disk."""

from pathlib import Path

from rapl_core.episodes import EpisodeStore
from rapl_core.representations.encoder import Encoder
from rapl_core.representations.features import FeatureStore
from rapl_core.types import EmbeddedEpisode


class EpisodeEmbedder:
    """Embeds recorded episodes exactly as :meth:`Encoder.embed_episode` does.

    Encoders that are aligned one after the other in a run share backbone and pooling and differ in
    their heads: what the backbone gives is kept in ``<run folder>/features`` in float32, and only
    the head is applied when an episode is embedded again. Alignment's own features there are of
    bfloat16 or in float16 and no use for rewards.

    :param run_folder: has the episodes and keeps the features.
    """

    def __init__(self, encoder: Encoder, run_folder: Path) -> None:
        self.encoder = encoder
        self._episodes = EpisodeStore(run_folder / "episodes")
        self._features = FeatureStore(
            encoder.extractor, run_folder / "features", "float32", "float32"
        )

    @property
    def computed(self) -> int:
        """Videos that went through the backbone; the others were found on disk."""
        return self._features.computed

    def embed(self, episode_id: str) -> EmbeddedEpisode:
        """Embed frames 1..T of an episode.

        :raises UnknownNameError: if it is not recorded.
        :raises CorruptFileError: if its files are damaged.
        """
        frames = self._episodes.frames(episode_id)[1:]
        features = self._features.look_up(episode_id, frames)
        return EmbeddedEpisode(episode_id, self.encoder.embed_features(features))
