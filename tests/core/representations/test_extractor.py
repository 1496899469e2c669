"""Feature extraction: order of its parts, versions, precision."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from squares import SMALL

from rapl_core.errors import ShapeError, UnknownNameError
from rapl_core.representations.extractor import FeatureExtractor, FeatureRecipe
from rapl_core.representations.pooling import Pooling
from rapl_core.representations.preprocessing import preprocess


def test_features_are_the_pooled_maps_of_the_stages(extractor, pool):
    frames = pool.videos[pool.names[0]]
    (maps,) = extractor.backbone(preprocess(frames, extractor.preprocessing))
    expected = torch.nn.functional.adaptive_avg_pool2d(maps, 4).flatten(1)
    features = extractor.extract(frames)
    torch.testing.assert_close(features, expected)
    assert features.shape == (8, extractor.dimension) == (8, 40 * 16)


def test_several_poolings_stand_one_after_another(extractor, pool):
    frames = pool.videos[pool.names[0]]
    recipe = replace(SMALL.recipe, poolings=(Pooling("gap"), Pooling("moments")))
    both = FeatureExtractor(extractor.backbone, recipe)
    features = both.extract(frames)
    assert features.shape == (8, both.dimension) == (8, 40 + 120)
    gap = FeatureExtractor(extractor.backbone, replace(recipe, poolings=(Pooling("gap"),)))
    torch.testing.assert_close(features[:, :40], gap.extract(frames))
    assert len({extractor.version, both.version, gap.version}) == 3


def test_the_batch_size_does_not_change_features_beyond_rounding(extractor, pool):
    frames = pool.videos[pool.names[1]]
    one, many = extractor.extract(frames, batch_size=1), extractor.extract(frames, batch_size=8)
    torch.testing.assert_close(one, many, atol=1e-4, rtol=1e-4)


def test_bfloat16_is_close_to_float32(extractor, pool):
    frames = pool.videos[pool.names[1]]
    exact, quick = extractor.extract(frames), extractor.extract(frames, "bfloat16")
    cosine = torch.nn.functional.cosine_similarity(exact, quick)
    assert quick.dtype == torch.float32
    assert 0.99 < float(cosine.min()) and not torch.equal(exact, quick)


def test_bad_input_is_refused_by_name(extractor):
    with pytest.raises(UnknownNameError, match="float8.*bfloat16, float32"):
        extractor.extract(np.zeros((1, 8, 8, 3), np.uint8), "float8")
    with pytest.raises(ShapeError, match="not empty"):
        extractor.extract(np.zeros((0, 8, 8, 3), np.uint8))
    with pytest.raises(ShapeError, match="at least one stage"):
        FeatureRecipe(stages=())
