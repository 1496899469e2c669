"""Parts of a task's pictures: found without labels, and their places."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from squares import SMALL, make_pool

from rapl_core.errors import ShapeError, WeightsError
from rapl_core.representations.checkpoints import load_encoder, save_encoder
from rapl_core.representations.extractor import FeatureRecipe, make_extractor
from rapl_core.representations.features import FeatureStore, find_parts
from rapl_core.representations.parts import PartPool
from rapl_core.representations.pooling import Pooling
from rapl_core.representations.rapl import align

RECIPE = FeatureRecipe(("stride4",), (Pooling("parts", parts=12),), size=(64, 64))
BY_PARTS = replace(SMALL, name="by_parts", recipe=RECIPE)


def two_kinds_of_cells(count: int, seed: int) -> tuple[torch.Tensor, np.ndarray]:
    """Maps (N, 2, 8, 8) with one cell of another kind each, and its (x, y)."""
    rng = np.random.default_rng(seed)
    maps = 0.05 * torch.from_numpy(rng.standard_normal((count, 2, 8, 8))).float()
    places = rng.integers(0, 8, (count, 2))
    maps[np.arange(count), 0, places[:, 1], places[:, 0]] += 5.0
    return maps, (places * 2.0 + 1.0) / 8 - 1.0


@pytest.fixture(scope="module")
def by_parts(pool):
    """An extractor that knows the parts of the pool's pictures, and the pool's features."""
    extractor = make_extractor("efficientnet_lite0", RECIPE)
    find_parts(extractor, pool.names, pool.videos.__getitem__, 0)
    store = FeatureStore(extractor)
    for name, frames in pool.videos.items():
        store.add(name, frames)
    return store


def test_a_part_is_where_its_cells_are():
    maps, places = two_kinds_of_cells(200, 0)
    pool = PartPool(2, parts=2, softness=0.3)
    pool.fit(maps, np.random.default_rng(0))
    share, x, y, var_x, var_y = pool(maps).reshape(200, 5, 2).unbind(1)
    rare = int(share.mean(0).argmin())
    np.testing.assert_allclose(share[:, rare], 1 / 64, atol=1e-3)
    # half of the weight is the cell that stands in the middle
    np.testing.assert_allclose(x[:, rare], places[:, 0] / 2, atol=0.02)
    np.testing.assert_allclose(y[:, rare], places[:, 1] / 2, atol=0.02)
    assert float(var_x[:, rare].max()) < float(var_x[:, 1 - rare].min())
    assert torch.isfinite(var_y).all()


def test_the_same_seed_finds_the_same_parts():
    maps, _ = two_kinds_of_cells(50, 1)
    one, two, other = (PartPool(2, 3, 0.3) for _ in range(3))
    for pool, seed in ((one, 0), (two, 0), (other, 1)):
        pool.fit(maps, np.random.default_rng(seed))
    torch.testing.assert_close(one(maps), two(maps), rtol=0, atol=0)
    assert not torch.equal(one(maps), other(maps))


def test_places_of_unseen_videos_are_linear_in_the_features(by_parts, pool):
    unseen = make_pool("unseen", 20, 1, np.random.default_rng(5))

    def red_square(videos: dict[str, np.ndarray]) -> np.ndarray:
        """(N, 2) the centre of what is red."""
        is_red = np.concatenate(list(videos.values()))[..., 0] > 150
        is_red &= np.concatenate(list(videos.values()))[..., 1] < 100
        at = np.arange(64)
        share = is_red.sum((1, 2))[:, None]
        return np.stack([is_red.sum(1) @ at, is_red.sum(2) @ at], 1) / share

    def augmented(features: np.ndarray) -> np.ndarray:
        return np.c_[features, np.ones(len(features))]

    train = augmented(np.concatenate([by_parts[name] for name in pool.names]))
    test = augmented(
        by_parts.extractor.extract(np.concatenate(list(unseen.videos.values()))).numpy()
    )
    truth = red_square({name: pool.videos[name] for name in pool.names})
    ridge = train.T @ train + 1e-3 * np.eye(train.shape[1])
    weights = np.linalg.solve(ridge, train.T @ truth)
    wanted = red_square(unseen.videos)
    error = np.abs(test @ weights - wanted).mean()
    assert error < 0.4 * np.abs(wanted - truth.mean(0)).mean()  # the blue square hides some


def test_an_encoder_with_parts_comes_back_from_its_checkpoint(by_parts, pool, tmp_path):
    rng = np.random.default_rng(2)
    encoder, _ = align(by_parts, pool.triplets, pool.expert_ids, BY_PARTS, rng)
    loaded = load_encoder(save_encoder(encoder, tmp_path / "rapl-parts"))
    frames = pool.videos[pool.names[0]]
    np.testing.assert_array_equal(loaded.embed(frames), encoder.embed(frames))
    assert loaded.info == encoder.info


def test_other_parts_make_another_version(by_parts, pool):
    other = make_extractor("efficientnet_lite0", RECIPE)
    find_parts(other, pool.names, pool.videos.__getitem__, 1)
    assert other.version != by_parts.extractor.version


def test_features_without_parts_are_refused():
    extractor = make_extractor("efficientnet_lite0", RECIPE)
    assert extractor.needs_parts
    with pytest.raises(WeightsError, match="parts"):
        FeatureStore(extractor)
    with pytest.raises(WeightsError, match="parts"):
        extractor.extract(np.zeros((2, 64, 64, 3), np.uint8))


def test_parts_of_too_few_pictures_are_refused():
    with pytest.raises(ShapeError, match=r"\(1, 2, 8, 8\).*2 or more"):
        PartPool(2, 3, 0.3).fit(torch.zeros(1, 2, 8, 8), np.random.default_rng(0))
    with pytest.raises(ShapeError, match="more than 0"):
        Pooling("parts", parts=0)
