"""Encoders by name."""

import os
from dataclasses import replace

import numpy as np
import pytest

from rapl_core.errors import CorruptFileError, RankingError, ShapeError, UnknownNameError
from rapl_core.representations import (
    Encoder,
    FeatureStore,
    checkpoint_folder,
    encoder_names,
    make_encoder,
    make_extractor,
    raw_encoder_from,
    save_encoder,
)
from rapl_core.representations.pretrained import RAW_RECIPE


def test_the_newest_checkpoint_of_a_method_is_taken_and_any_by_its_full_name(rapl, tmp_path):
    old = rapl[0]
    new = Encoder(old.extractor, old.embedder, replace(old.card, reward_scale=7.0))
    for age, encoder in enumerate((new, old)):  # written in this order, dated the other way
        folder = save_encoder(encoder, checkpoint_folder(tmp_path, encoder))
        os.utime(folder / "card.json", (1000 - age, 1000 - age))
    assert make_encoder("rapl", tmp_path).info == new.info
    assert make_encoder(f"rapl-{old.info.version}", tmp_path).info == old.info
    assert f"rapl-{old.info.version}" in encoder_names(tmp_path)


def test_an_unfinished_checkpoint_is_not_seen(rapl, tmp_path):
    folder = save_encoder(rapl[0], checkpoint_folder(tmp_path, rapl[0]))
    folder.rename(folder.with_name(f".{folder.name}.17.partial"))
    assert encoder_names(tmp_path) == encoder_names()


def test_unknown_names_are_refused_with_the_known_ones(tmp_path):
    with pytest.raises(UnknownNameError, match="clip.*known: clock, .*imagenet, .*rapl, rlhf"):
        make_encoder("clip", tmp_path)
    with pytest.raises(UnknownNameError, match="vgg.*efficientnet_lite0"):
        make_encoder("imagenet", backbone="vgg")


def test_a_method_without_a_checkpoint_says_what_there_is(rlhf, tmp_path):
    save_encoder(rlhf[0], checkpoint_folder(tmp_path, rlhf[0]))
    with pytest.raises(CorruptFileError, match="'rapl'.*there are: rlhf-"):
        make_encoder("rapl", tmp_path)


def test_raw_features_need_no_checkpoint_and_may_have_one(pool, tmp_path):
    plain = make_encoder("imagenet", tmp_path)
    assert (plain.info.name, plain.info.dimension, plain.info.reward_scale) == ("imagenet", 1280, 1)
    store = FeatureStore(plain.extractor)
    for name in pool.names[:8]:
        store.add(name, pool.videos[name])
    scaled = raw_encoder_from(store, pool.names[:2], np.random.default_rng(0))
    assert scaled.info.reward_scale > 1 and scaled.expert_ids == tuple(pool.names[:2])
    save_encoder(scaled, checkpoint_folder(tmp_path, scaled))
    assert make_encoder("imagenet", tmp_path).info == scaled.info
    with pytest.raises(RankingError, match="such as nobody"):
        raw_encoder_from(store, ["nobody"], np.random.default_rng(0))


def test_raw_features_are_refused_when_read_otherwise(features, pool):
    assert features.extractor.recipe != RAW_RECIPE
    with pytest.raises(ShapeError, match="preset paper expects"):
        raw_encoder_from(features, pool.expert_ids, np.random.default_rng(0))


def test_the_default_backbone_is_the_one_with_packaged_weights():
    assert make_extractor("efficientnet_lite0", RAW_RECIPE).dimension == 1280
