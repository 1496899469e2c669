"""Recorded episodes are embedded as live ones are, and the backbone sees each only once."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from rapl_core.episodes import EpisodeStore
from rapl_core.errors import UnknownNameError
from rapl_core.representations import EpisodeEmbedder
from rapl_core.representations.alignment import card_for
from rapl_core.representations.encoder import Encoder
from rapl_core.representations.heads import Embedder, linear_head
from rapl_core.representations.presets import PAPER
from rapl_core.representations.pretrained import RAW_RECIPE
from rapl_core.types import Episode


def encoder_with_head(extractor, seed: int) -> Encoder:
    """An encoder as an alignment makes it: the same backbone, another head."""
    head = linear_head(extractor.dimension, 8, np.random.default_rng(seed))
    embedder = Embedder(None, head)
    card = card_for("rapl", extractor, embedder, PAPER, "ot", ())
    return Encoder(extractor, embedder, card)


@pytest.fixture
def episodes(tmp_path: Path) -> EpisodeStore:
    store = EpisodeStore(tmp_path / "episodes")
    for number in range(2):
        frames = np.random.default_rng(number).integers(0, 256, (4, 48, 48, 3), dtype=np.uint8)
        store.add(
            Episode(
                episode_id=f"train-{number}",
                task="franka_group",
                world=0,
                purpose="train",
                controller="learner",
                frames=frames,
                states=np.zeros((4, 2)),
                actions=np.zeros((3, 2)),
                stamps_ns=np.arange(1, 5),
            )
        )
    return store


@pytest.fixture(scope="module")
def raw_extractor():
    from rapl_core.representations import make_extractor

    return make_extractor("efficientnet_lite0", RAW_RECIPE)


def test_a_second_head_on_the_same_backbone_needs_no_backbone(
    raw_extractor, episodes: EpisodeStore, tmp_path: Path
) -> None:
    for seed, computed in ((1, 2), (2, 0)):
        encoder = encoder_with_head(raw_extractor, seed)
        embedder = EpisodeEmbedder(encoder, tmp_path)
        for name in episodes.ids():
            expected = encoder.embed_episode(episodes.load(name))
            found = embedder.embed(name)
            assert found.episode_id == name and found.values.shape == (3, 8)
            np.testing.assert_array_equal(found.values, expected.values)
        assert embedder.computed == computed


@pytest.mark.skipif(find_spec("openvino") is None, reason="openvino is not installed")
def test_features_of_two_engines_are_kept_apart(episodes: EpisodeStore, tmp_path: Path) -> None:
    from rapl_core.representations import make_extractor

    encoder = encoder_with_head(make_extractor("efficientnet_lite0", RAW_RECIPE), 1)
    expected = EpisodeEmbedder(encoder, tmp_path).embed("train-0").values
    encoder.extractor.use_engine("openvino")
    for computed in (1, 0):
        embedder = EpisodeEmbedder(encoder, tmp_path)
        found = embedder.embed("train-0").values
        assert embedder.computed == computed
        np.testing.assert_array_equal(found, encoder.embed_episode(episodes.load("train-0")).values)
    assert not np.array_equal(found, expected)
    np.testing.assert_allclose(found, expected, atol=0.05 * np.abs(expected).max())


def test_an_episode_that_is_not_recorded_is_named(raw_extractor, tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="train-9"):
        EpisodeEmbedder(encoder_with_head(raw_extractor, 1), tmp_path).embed("train-9")
