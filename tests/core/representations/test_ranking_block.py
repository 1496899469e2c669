"""RAPL and RLHF with the backbone's last block: what changes, what is kept, what comes out."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from squares import SMALL

from rapl_core.errors import RankingError, ShapeError, UnknownNameError
from rapl_core.representations import load_encoder, make_extractor, save_encoder
from rapl_core.representations.alignment import Lesson
from rapl_core.representations.extractor import FeatureRecipe
from rapl_core.representations.features import FeatureStore
from rapl_core.representations.pooling import Pooling
from rapl_core.representations.presets import PAPER
from rapl_core.representations.ranking_block import BlockConfig, learn_block
from rapl_core.representations.report import wilson_interval
from rapl_core.representations.trainable import TrainableBackbone
from rapl_core.transport import ot_distance

CONFIG = BlockConfig(epochs=2, frames=4)
PRESET = replace(SMALL, epochs=20)


@pytest.fixture(scope="module", params=["rapl", "rlhf"])
def learnt(request, features, pool, tmp_path_factory):
    """(Encoder, AlignmentReport, folder of the weights, epochs told)."""
    folder, told = tmp_path_factory.mktemp("backbones"), []
    lesson = Lesson(pool.triplets, pool.expert_ids)
    encoder, report = learn_block(
        request.param, features, pool.videos.__getitem__, lesson, PRESET, CONFIG,
        np.random.default_rng(3), folder, None, told.append,
    )  # fmt: skip
    return encoder, report, folder, told


def parameters(extractor):
    return dict(extractor.backbone.network.named_parameters())


def test_the_last_block_changes_and_nothing_else(learnt, extractor):
    encoder, report, _, _ = learnt
    assert report.best_epoch > PRESET.epochs  # else the block would be as it was
    now, before = parameters(encoder.extractor), parameters(extractor)
    changed = {name for name in before if not torch.equal(now[name], before[name])}
    assert changed and all(name.startswith("blocks.2") for name in changed)  # stride 8 ends there
    assert encoder.card.backbone_sha256 != extractor.backbone.weights_sha256


def test_the_block_makes_held_out_triplets_likelier(learnt):
    _, report, _, told = learnt
    assert list(report.history) == told
    assert [e.epoch for e in told] == [*range(1, 23)] and {e.epochs for e in told} == {22}
    best = report.history[report.best_epoch - 1]
    assert best.held_out_loss < min(e.held_out_loss for e in told[:20])
    assert report.held_out_accuracy == best.held_out_accuracy


def test_unseen_triplets_are_ordered_better_than_chance(learnt, unseen):
    encoder, _, _, _ = learnt
    z = {name: torch.from_numpy(encoder.embed(v)) for name, v in unseen.videos.items()}
    if encoder.reward_kind == "scalar":
        right = [bool(z[t.middle].sum() > z[t.worst].sum()) for t in unseen.triplets]
    else:
        far = SMALL.training
        right = [
            bool(ot_distance(z[t.best], z[t.middle], far) < ot_distance(z[t.best], z[t.worst], far))
            for t in unseen.triplets
        ]
    assert wilson_interval(float(np.mean(right)), len(right))[0] > 0.5


def test_the_checkpoint_holds_the_block(learnt, pool, tmp_path):
    encoder, report, folder, _ = learnt
    assert encoder.card.has_own_backbone
    saved = save_encoder(encoder, tmp_path / "saved", report.to_json())
    moved = [file.rename(tmp_path / file.name) for file in folder.glob("*.safetensors")]
    try:
        again = load_encoder(saved)
    finally:
        for file in moved:
            file.rename(folder / file.name)
    assert len(moved) == 1 and again.info == encoder.info
    frames = pool.videos[pool.names[9]]
    np.testing.assert_array_equal(again.embed(frames), encoder.embed(frames))
    experts = [again.embed_expert(i, pool.videos[i]) for i in again.expert_ids]
    assert np.isfinite(again.reward(again.embed(frames), experts).values).all()


@pytest.mark.parametrize(
    "recipe, cached",
    [
        (FeatureRecipe(size=(64, 64)), True),
        (FeatureRecipe(("stride16",), (Pooling("grid"), Pooling()), (64, 64)), True),
        (SMALL.recipe, False),  # the maps before it are larger than pictures
        (FeatureRecipe(("stride16", "final"), size=(64, 64)), False),
    ],
)
def test_what_is_kept_of_a_picture_gives_its_features(recipe, cached, pool):
    extractor = make_extractor("efficientnet_lite0", recipe)
    backbone = TrainableBackbone(extractor)
    frames = pool.videos[pool.names[0]][:3]
    start = backbone.trunk(frames)
    assert (start.dtype == np.float32) == cached and start.nbytes <= 3 * 64 * 64 * len(start)
    features = backbone.tail(torch.from_numpy(start))
    expected = extractor.extract(frames)
    assert torch.allclose(features, expected, atol=1e-4 * float(expected.abs().max()))
    features.sum().backward()
    moving = [p for p in backbone.free_parameters() if p.grad is not None and p.grad.abs().sum()]
    assert moving and all(p.grad is None for p in backbone.parameters() if not p.requires_grad)


def test_a_block_that_makes_nothing_better_leaves_the_head_as_it_was(features, pool, tmp_path):
    lesson = Lesson(pool.triplets[:20], pool.expert_ids)
    preset = replace(PRESET, epochs=3, batch_size=20)
    config = replace(CONFIG, epochs=1, learning_rate=100.0)
    encoder, report = learn_block(
        "rapl", features, pool.videos.__getitem__, lesson, preset, config,
        np.random.default_rng(3), tmp_path,
    )  # fmt: skip
    assert report.best_epoch <= 3 and len(report.history) == 4
    now, before = parameters(encoder.extractor), parameters(features.extractor)
    assert all(torch.equal(now[name], before[name]) for name in before)


def test_mirrored_twins_are_learnt_from(extractor, pool, tmp_path):
    preset = replace(PRESET, mirror=True, epochs=2, batch_size=20)
    store = FeatureStore(extractor, mirror=True)
    for name in pool.names[:12]:
        store.add(name, pool.videos[name])
    triplets = [t for t in pool.triplets if {t.best, t.middle, t.worst} <= set(pool.names[:20])]
    for triplet in triplets:
        for name in (triplet.best, triplet.middle, triplet.worst):
            store.add(name, pool.videos[name])
    encoder, report = learn_block(
        "rapl", store, pool.videos.__getitem__, Lesson(triplets, pool.expert_ids), preset,
        replace(CONFIG, epochs=1), np.random.default_rng(3), tmp_path,
    )  # fmt: skip
    assert encoder.card.has_own_backbone and report.statistics_videos > len(pool.names[:12])


def test_bad_requests_are_refused_by_name(features, pool, tmp_path):
    def learn(method="rapl", triplets=pool.triplets, preset=PRESET):
        lesson = Lesson(triplets, pool.expert_ids)
        rng = np.random.default_rng(0)
        learn_block(
            method, features, pool.videos.__getitem__, lesson, preset, CONFIG, rng, tmp_path
        )

    with pytest.raises(UnknownNameError, match="'tcc'; known: rapl, rlhf"):
        learn("tcc")
    with pytest.raises(RankingError, match="no triplet"):
        learn(triplets=[])
    with pytest.raises(ShapeError, match="preset paper expects"):
        learn(preset=PAPER)
    for wrong in ({"epochs": 0}, {"frames": 1}, {"learning_rate": 0.0}, {"slow_pairs": 0}):
        with pytest.raises(ShapeError, match=f"{next(iter(wrong))} is"):
            BlockConfig(**wrong)
    assert not list(tmp_path.iterdir())
