"""Temporal cycle consistency: losses, sampling, augmentation, training and its reward."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from squares import SMALL

from rapl_core.errors import RankingError, ShapeError, UnknownNameError
from rapl_core.representations import load_encoder, save_encoder
from rapl_core.representations.augmentation import Augmentation, augment_video
from rapl_core.representations.extractor import make_extractor
from rapl_core.representations.features import FeatureStore
from rapl_core.representations.presets import PAPER
from rapl_core.representations.tcc import (
    TccConfig,
    alignment_tau,
    draw_frames,
    fit_tcc,
    learn_tcc,
)
from rapl_core.representations.tcc_block import learn_tcc_block
from rapl_core.representations.tcc_loss import TccLossConfig, scaled_similarity, tcc_loss
from rapl_core.types import EmbeddedEpisode

KINDS = ("regression_mse", "regression_mse_var", "regression_huber", "classification")
PLAIN = replace(PAPER, has_projection=True)


def loss_of(z, config, lengths=None):
    frames = torch.arange(z.shape[1]).expand(len(z), -1)
    lengths = torch.full((len(z),), z.shape[1]) if lengths is None else lengths
    return tcc_loss(z, frames, lengths, config, np.random.default_rng(0))


def progress_videos(count, rng, warp=True):
    """Features in which progress runs at another pace in each video, amid other changes.

    :return: (T, F) by name, and the progress (T,) of each.
    """
    mix = rng.normal(size=(40, 30))
    videos, progress = {}, {}
    for number in range(count):
        steps = 40 + 4 * number
        p = np.linspace(0, 1, steps) ** (rng.uniform(0.5, 2.0) if warp else 1.0)
        bumps = np.exp(-np.square((p[:, None] - np.linspace(0, 1, 10)) / 0.15))
        others = rng.normal(size=(steps, 20)) * 0.05 + rng.normal(size=20) * 0.7
        inputs = np.concatenate([bumps, others, np.zeros((steps, 10))], axis=1)
        videos[f"v{number}"] = (inputs @ mix).astype(np.float32)
        progress[f"v{number}"] = p
    return videos, progress


@pytest.mark.parametrize("kind", KINDS)
def test_videos_that_run_alike_cost_next_to_nothing(kind):
    far_apart = torch.eye(8).expand(3, 8, 8) * 30.0
    config = TccLossConfig(kind, label_smoothing=0.0, temperature=0.1, variance_weight=0.0)
    assert float(loss_of(far_apart, config)) == pytest.approx(0.0, abs=1e-5)
    assert float(loss_of(torch.ones(3, 8, 8), config)) > 1e-3


def test_the_deterministic_loss_is_what_a_loop_over_frames_gives():
    rng = np.random.default_rng(0)
    z = torch.from_numpy(rng.normal(size=(3, 5, 4)))
    lengths = torch.tensor([7.0, 9.0, 5.0], dtype=z.dtype)
    total = []
    for i in range(3):
        for j in range(3):
            for k in range(5 if i != j else 0):
                to = torch.softmax(-((z[i, k] - z[j]) ** 2).sum(-1) / 4 / 0.5, 0)
                back = torch.softmax(-((to @ z[j] - z[i]) ** 2).sum(-1) / 4 / 0.5, 0)
                expected = (back * torch.arange(5.0, dtype=z.dtype)).sum() / lengths[i]
                total.append((expected - k / lengths[i]) ** 2)
    found = loss_of(z, TccLossConfig(temperature=0.5), lengths)
    assert float(found) == pytest.approx(float(torch.stack(total).mean()), rel=1e-9)


def test_stochastic_cycles_of_two_videos_estimate_the_deterministic_loss():
    z = torch.from_numpy(np.random.default_rng(1).normal(size=(4, 6, 3)))
    whole = float(loss_of(z, TccLossConfig()))
    drawn = float(loss_of(z, TccLossConfig(stochastic=True, cycles=20_000)))
    assert drawn == pytest.approx(whole, rel=0.05)
    longer = float(loss_of(z, TccLossConfig(stochastic=True, cycle_length=4)))
    assert math.isfinite(longer) and longer != drawn


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("stochastic", [False, True])
def test_gradients_match_finite_differences(kind, stochastic):
    z = torch.from_numpy(np.random.default_rng(2).normal(size=(2, 4, 3))).requires_grad_()
    config = TccLossConfig(kind, stochastic=stochastic, cycles=5)
    assert torch.autograd.gradcheck(lambda v: loss_of(v, config), (z,))


def test_similarities_are_of_the_documented_kind():
    x = torch.from_numpy(np.random.default_rng(3).normal(size=(2, 3, 4)))
    l2 = scaled_similarity(x[0], x[1], TccLossConfig(temperature=2.0))
    assert float(l2[0, 1]) == pytest.approx(-float((x[0, 0] - x[1, 1]).square().sum()) / 4 / 2)
    cosine = scaled_similarity(x[0], x[1], TccLossConfig(similarity="cosine"))
    assert float(cosine[2, 0]) == pytest.approx(float(x[0, 2] @ x[1, 0]) / 4)


@pytest.mark.parametrize("kind", KINDS)
def test_a_known_alignment_is_recovered(kind):
    rng = np.random.default_rng(4)
    videos, progress = progress_videos(8, rng)
    pair = ("v6", "v7")
    raw = alignment_tau(videos["v6"], videos["v7"])
    loss = TccLossConfig(kind, temperature=0.1)
    config = TccConfig(loss, iterations=300, learning_rate=2e-2, views=0)
    embedder, _ = fit_tcc(videos, 16, PLAIN, config, rng)
    with torch.no_grad():
        z, other = (embedder(torch.from_numpy(videos[name])).numpy() for name in pair)
    tau = alignment_tau(z, other)
    assert tau > 0.95 and raw < 0.9
    nearest = np.square(z[:, None] - other[None]).sum(-1).argmin(1)
    # not the order alone: the progress of the frame found is that of the frame asked about
    assert np.abs(progress["v7"][nearest] - progress["v6"]).mean() < 0.05


def test_frames_are_drawn_in_order_and_repeat_only_in_short_videos():
    rng, config = np.random.default_rng(0), TccConfig(frames=8)
    rows = draw_frames(20, config, rng).numpy()
    assert len(set(rows)) == 8 and list(rows) == sorted(rows)
    assert len(draw_frames(5, config, rng)) == 8
    assert list(draw_frames(15, replace(config, sampling="even"), rng)) == [*range(0, 15, 2)]


def test_every_frame_of_a_video_is_changed_alike():
    frame = np.random.default_rng(5).integers(0, 256, (1, 32, 48, 3), dtype=np.uint8)
    video = np.repeat(frame, 3, axis=0)
    changed = augment_video(video, Augmentation(), np.random.default_rng(6))
    assert changed.shape == video.shape and changed.dtype == np.uint8
    assert (changed == changed[:1]).all() and not (changed == video).all()
    nothing = Augmentation(1.0, 1.0, jitter_share=0, grey_share=0, blur_share=0)
    assert (augment_video(video, nothing, np.random.default_rng(7)) == video).all()


@pytest.fixture(scope="module")
def learnt(features, extractor, pool):
    """An encoder of tcc from the five preferred videos and a changed copy of each."""
    rng = np.random.default_rng(8)
    store = FeatureStore(extractor)
    for name in pool.expert_ids:
        store.add(name, pool.videos[name])
        store.add(f"{name}-view0", augment_video(pool.videos[name], Augmentation(), rng))
    config = TccConfig(frames=8, iterations=60)
    return learn_tcc(store, pool.expert_ids, SMALL, config, rng)


def test_its_reward_is_the_distance_to_the_mean_goal(learnt, pool):
    encoder, report = learnt
    experts = [encoder.embed_expert(i, pool.videos[i]) for i in encoder.expert_ids]
    assert encoder.reward_kind == "goal" and all(len(e.values) == 1 for e in experts)
    z = encoder.embed(pool.videos[pool.names[7]])
    goal = np.mean([encoder.embed(pool.videos[i][-1:])[0] for i in encoder.expert_ids], axis=0)
    trace = encoder.reward(z, experts)
    expected = -report.reward_scale * np.linalg.norm(z - goal, axis=1)
    np.testing.assert_allclose(trace.values, expected, rtol=1e-5)
    assert report.demonstrations == 5 and report.last_loss < report.first_loss
    with pytest.raises(ShapeError, match="no expert video"):
        encoder.reward(z, [])
    with pytest.raises(ShapeError, match=r"expected \(S, 32\)"):
        encoder.reward(z, [EmbeddedEpisode("e", np.zeros((1, 3), np.float32))])


def test_the_last_block_learns_and_goes_into_the_checkpoint(pool, tmp_path):
    rng = np.random.default_rng(9)
    videos = {name: pool.videos[name] for name in pool.expert_ids[:3]}
    config = TccConfig(frames=4, videos=2, iterations=3, trained="last_block")
    encoder, _ = learn_tcc_block(
        videos, pool.expert_ids[:3], "efficientnet_lite0", SMALL, config, rng, tmp_path, None,
        "tcc_ot",
    )  # fmt: skip
    before = make_extractor("efficientnet_lite0", SMALL.recipe)
    assert encoder.card.backbone_sha256 != before.backbone.weights_sha256
    changed = {
        name
        for (name, a), (_, b) in zip(
            encoder.extractor.backbone.network.named_parameters(),
            before.backbone.network.named_parameters(),
            strict=True,
        )
        if not torch.equal(a, b)
    }
    assert changed and all(
        name.startswith("blocks.2") for name in changed
    )  # what stride 8 ends with
    folder = save_encoder(encoder, tmp_path / "saved")
    for file in tmp_path.glob("*.safetensors"):
        file.unlink()
    again = load_encoder(folder)
    frames = videos[pool.expert_ids[0]]
    np.testing.assert_array_equal(again.embed(frames), encoder.embed(frames))


def test_bad_requests_are_refused_by_name(features):
    with pytest.raises(UnknownNameError, match="magic.*regression_huber"):
        TccLossConfig("magic")  # type: ignore[arg-type]
    with pytest.raises(ShapeError, match="temperature 0"):
        TccLossConfig(temperature=0)
    with pytest.raises(ShapeError, match="expected.*3"):
        loss_of(torch.zeros(2, 4, 3), TccLossConfig(stochastic=True, cycle_length=3))
    with pytest.raises(RankingError, match="two demonstrations or more, got 1"):
        one = {"only": next(iter(features.values()))}
        fit_tcc(one, 4, PAPER, TccConfig(), np.random.default_rng(0))
    with pytest.raises(UnknownNameError, match="first_block.*last_block"):
        TccConfig(trained="first_block")  # type: ignore[arg-type]
