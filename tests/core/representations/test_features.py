"""The feature cache: computed once, found again, never trusted when damaged."""

import numpy as np
import pytest

from rapl_core.errors import ShapeError
from rapl_core.representations.features import MIRRORED, FeatureStore
from rapl_core.types import Episode


def test_features_are_those_of_the_extractor_up_to_the_stored_precision(extractor, pool):
    frames = pool.videos[pool.names[0]]
    expected = extractor.extract(frames).numpy()
    for dtype, tolerance in (("float32", 0.0), ("float16", 1e-3)):
        store = FeatureStore(extractor, dtype=dtype)
        store.add("a", frames)
        np.testing.assert_allclose(store["a"], expected, rtol=tolerance, atol=tolerance)
        assert store["a"].dtype == np.float32


def test_a_second_run_computes_nothing_whatever_the_episode_is_called(extractor, pool, tmp_path):
    frames = pool.videos[pool.names[0]]
    first = FeatureStore(extractor, tmp_path)
    first.add("a", frames)
    second = FeatureStore(extractor, tmp_path)
    second.add("b", frames)
    assert (first.computed, second.computed) == (1, 0)
    np.testing.assert_array_equal(first["a"], second["b"])
    assert list(second) == ["b"] and len(second) == 1


def test_other_frames_and_other_precisions_are_not_confused(extractor, pool, tmp_path):
    frames = pool.videos[pool.names[0]]
    changed = frames.copy()
    changed[0, 0, 0, 0] ^= 1
    FeatureStore(extractor, tmp_path).add("a", frames)
    for store, video in (
        (FeatureStore(extractor, tmp_path), changed),
        (FeatureStore(extractor, tmp_path, precision="bfloat16"), frames),
        (FeatureStore(extractor, tmp_path, dtype="float32"), frames),
    ):
        store.add("a", video)
        assert store.computed == 1


def test_a_damaged_cache_file_is_computed_anew(extractor, pool, tmp_path):
    frames = pool.videos[pool.names[0]]
    FeatureStore(extractor, tmp_path).add("a", frames)
    (file,) = tmp_path.rglob("*.safetensors")
    file.write_bytes(file.read_bytes()[:100])
    store = FeatureStore(extractor, tmp_path)
    store.add("a", frames)
    assert store.computed == 1
    again = FeatureStore(extractor, tmp_path)
    again.add("a", frames)
    assert again.computed == 0


def test_an_episode_gives_the_frames_that_its_transitions_arrive_in(extractor, pool):
    frames = pool.videos[pool.names[0]]
    steps = len(frames) - 1
    episode = Episode(
        "episode-1", "task", 0, "demonstrate", "me", frames, np.zeros((steps + 1, 2)),
        np.zeros((steps, 1)), np.arange(steps + 1),
    )  # fmt: skip
    store = FeatureStore(extractor)
    store.add_episode(episode)
    store.add("by-hand", frames[1:])
    np.testing.assert_array_equal(store["episode-1"], store["by-hand"])


def test_a_malformed_id_is_refused(extractor, pool):
    with pytest.raises(ShapeError, match="Not An Id"):
        FeatureStore(extractor).add("Not An Id", pool.videos[pool.names[0]])


def test_a_mirrored_twin_stands_beside_each_video(extractor, pool, tmp_path):
    name = pool.names[0]
    frames = pool.videos[name]
    store = FeatureStore(extractor, tmp_path, mirror=True)
    store.add(name, frames)
    assert list(store) == [name, MIRRORED + name]
    plain = FeatureStore(extractor)
    plain.add("flipped", frames[:, :, ::-1])
    np.testing.assert_array_equal(store[MIRRORED + name], plain["flipped"])
    again = FeatureStore(extractor, tmp_path, mirror=True)
    again.add(name, frames)
    assert again.computed == 0
