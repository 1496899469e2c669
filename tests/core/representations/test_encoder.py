"""Encoders: what training saw is what runs, and each reward rule."""

from dataclasses import replace

import numpy as np
import pytest

from rapl_core.errors import ShapeError, WeightsError
from rapl_core.representations.encoder import Encoder, matched_part
from rapl_core.representations.heads import Embedder
from rapl_core.transport import ot_reward
from rapl_core.types import EmbeddedEpisode


def cosine(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(1) / (np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1))


def test_frames_embedded_one_by_one_equal_those_of_a_batch(rapl, pool):
    encoder, _ = rapl
    frames = pool.videos[pool.names[3]]
    batch = encoder.embed(frames)
    stream = np.concatenate([encoder.embed(frame[None]) for frame in frames])
    assert batch.shape == (8, 32) and batch.dtype == np.float32
    assert cosine(batch, stream).min() > 0.99999


def test_the_running_embedding_equals_that_of_the_training_features(rapl, features, pool):
    encoder, _ = rapl
    for name in pool.names[:5]:
        running, training = encoder.embed(pool.videos[name]), encoder.embed_features(features[name])
        assert cosine(running, training).min() > 0.99999


def test_the_reward_is_that_of_its_own_transport_and_scale(rapl, pool):
    encoder, _ = rapl
    experts = [EmbeddedEpisode(n, encoder.embed(pool.videos[n])) for n in encoder.expert_ids]
    z = encoder.embed(pool.videos[pool.names[-1]])
    expected = ot_reward(z, experts, encoder.transport, encoder.info.reward_scale)
    np.testing.assert_array_equal(encoder.reward(z, experts).values, expected.values)


def test_info_describes_it(rapl):
    info = rapl[0].info
    assert (info.name, info.preset, info.backbone) == ("rapl", "small", "efficientnet_lite0")
    assert (info.dimension, info.image_width, info.image_height) == (32, 64, 64)
    assert len(info.version) == 16 and int(info.version, 16) >= 0


def test_the_version_changes_with_weights_and_with_the_card(rapl):
    encoder, _ = rapl
    tensors = dict(encoder.embedder.state_dict())
    versions = {
        encoder.info.version,
        replace(encoder.card, reward_scale=9.0).version(tensors),
        encoder.card.version({**tensors, "head.bias": tensors["head.bias"] + 1e-3}),
    }
    assert len(versions) == 3
    assert replace(encoder.card, weights_file="/elsewhere").version(tensors) in versions


def test_parts_that_do_not_belong_together_are_refused(rapl):
    encoder, _ = rapl
    other = replace(encoder.card, backbone_sha256="0" * 64)
    with pytest.raises(WeightsError, match="000000000000.*efficientnet_lite0"):
        Encoder(encoder.extractor, encoder.embedder, other)


def test_nan_weights_are_refused(rapl):
    encoder, _ = rapl
    projection = encoder.embedder.projection
    head = type(encoder.embedder.head)(64, 32)
    head.weight.data[0, 0] = float("nan")
    with pytest.raises(WeightsError, match=r"head\.weight has NaN"):
        Encoder(encoder.extractor, Embedder(projection, head), encoder.card)


def test_bad_embeddings_are_refused_by_both_rules(rapl, rlhf):
    with pytest.raises(ShapeError, match=r"\(8, 3\), expected \(T, 32\)"):
        rapl[0].reward(np.zeros((8, 3)), ())
    with pytest.raises(ShapeError, match="no expert"):
        rapl[0].reward(np.zeros((8, 32)), ())
    with pytest.raises(ShapeError, match="8 NaN or infinite"):
        rlhf[0].reward(np.full((8, 1), np.nan), ())


def test_only_the_end_of_an_expert_video_is_matched_when_the_card_says_so(rapl, pool):
    encoder, _ = rapl
    frames = pool.videos[pool.names[0]]
    whole = encoder.embed(frames[1:])
    late = Encoder(encoder.extractor, encoder.embedder, replace(encoder.card, expert_from=0.5))
    kept = late.embed_expert(pool.names[0], frames).values
    assert len(kept) == len(whole) - round(0.5 * len(whole))
    np.testing.assert_allclose(kept, whole[-len(kept) :], rtol=1e-4, atol=1e-5)
    assert late.info.version != encoder.info.version


def test_at_least_one_frame_of_an_expert_video_is_matched():
    assert len(matched_part(np.zeros((2, 3)), 0.99)) == 1
