"""Masked autoencoding from scratch, and its adaptation by LoRA."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch

from rapl_core.errors import ShapeError, WeightsError
from rapl_core.representations import load_encoder, make_encoder, save_encoder
from rapl_core.representations.backbones import backbone_spec
from rapl_core.representations.extractor import make_extractor
from rapl_core.representations.features import FeatureStore
from rapl_core.representations.masked import (
    MaskedAutoencoder,
    MaskedConfig,
    fine_tune_lora,
    lora_model,
    pretrain,
)
from rapl_core.representations.masked_architecture import MAE_BACKBONE
from rapl_core.representations.preprocessing import Preprocessing, preprocess
from rapl_core.representations.pretrained import RAW_RECIPE, raw_encoder_from
from rapl_core.representations.trainable import save_network

QUICK = MaskedConfig(iterations=80, batch_size=16, decoder_width=32, decoder_depth=1)
SMALL_VIT = replace(
    backbone_spec(MAE_BACKBONE),
    preprocessing=Preprocessing(32, 32),
    options={"img_size": 32, "patch_size": 8, "embed_dim": 32, "depth": 2, "num_heads": 2,
             "num_classes": 0},
)  # fmt: skip
"""The same network in small, for time."""


@pytest.fixture(scope="module")
def frames(pool):
    return np.concatenate([pool.videos[name] for name in pool.names[:30]])


@pytest.fixture(scope="module")
def scratch(frames):
    return pretrain(frames, SMALL_VIT, QUICK, np.random.default_rng(0))


@pytest.fixture(scope="module")
def weights(frames, tmp_path_factory):
    """Weights of the real size after two steps."""
    short = replace(QUICK, iterations=2, batch_size=2)
    fit = pretrain(frames[:12], backbone_spec(MAE_BACKBONE), short, np.random.default_rng(0))
    return save_network(fit.network, MAE_BACKBONE, tmp_path_factory.mktemp("mae"))


def test_the_loss_on_held_out_frames_falls(scratch):
    first, last = scratch.held_out_losses[0], scratch.held_out_losses[-1]
    assert last < 0.8 * first


def test_only_hidden_patches_count(scratch):
    model = MaskedAutoencoder(scratch.network, QUICK)
    x = torch.randn(2, 3, 32, 32, generator=torch.Generator().manual_seed(0))
    keys = torch.rand(2, 16, generator=torch.Generator().manual_seed(1))
    order = keys.argsort(1)
    with torch.no_grad():
        painted = model._decode(model._encode(x, order[:, :4]), order)
        target = model._patches(x)
        errors = (painted - target).square().mean(-1)  # (N, L)
        hidden = torch.ones(2, 16, dtype=torch.bool).scatter(1, order[:, :4], False)
        assert float(model(x, keys)) == pytest.approx(float(errors[hidden].mean()), rel=1e-5)
        # what is hidden cannot be seen: changing it changes the target alone
        other = x.clone()
        row, column = divmod(int(order[0, -1]), 4)
        other[0, :, row * 8 : row * 8 + 8, column * 8 : column * 8 + 8] += 1.0
        again = model._decode(model._encode(other, order[:, :4]), order)
    torch.testing.assert_close(again, painted)


def test_patches_are_cut_as_the_network_cuts_them(scratch):
    model = MaskedAutoencoder(scratch.network, MaskedConfig(has_normalised_patches=False))
    x = torch.randn(1, 3, 32, 32)
    flat = model._patches(x)  # (1, L, p p 3)
    weight = scratch.network.patch_embed.proj.weight.permute(0, 2, 3, 1).flatten(1)
    with torch.no_grad():
        expected = scratch.network.patch_embed(x)  # (1, L, W)
        found = flat @ weight.T + scratch.network.patch_embed.proj.bias
    torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-4)


def test_pre_training_follows_from_its_seed(frames):
    short = MaskedConfig(iterations=2, batch_size=4)
    one, two = (pretrain(frames[:40], SMALL_VIT, short, np.random.default_rng(3)) for _ in range(2))
    assert one.held_out_losses == two.held_out_losses


def test_it_becomes_an_encoder_whose_checkpoint_holds_the_backbone(weights, pool, tmp_path):
    store = FeatureStore(make_extractor(MAE_BACKBONE, RAW_RECIPE, weights))
    for name in pool.names[:8]:
        store.add(name, pool.videos[name])
    rng = np.random.default_rng(0)
    encoder = raw_encoder_from(store, pool.names[:3], rng, "mae_scratch", has_own_backbone=True)
    assert (encoder.info.name, encoder.info.dimension) == ("mae_scratch", 128)
    folder = save_encoder(encoder, tmp_path / "encoders" / f"mae_scratch-{encoder.info.version}")
    moved = tmp_path / "elsewhere"
    (tmp_path / "encoders").rename(moved)
    again = load_encoder(moved / folder.name)
    frames = pool.videos[pool.names[0]]
    np.testing.assert_array_equal(again.embed(frames), encoder.embed(frames))
    (moved / folder.name / "backbone.safetensors").unlink()
    with pytest.raises(WeightsError, match="no weights file"):
        load_encoder(moved / folder.name)


def test_lora_changes_only_its_own_weights(scratch, frames):
    network = copy.deepcopy(scratch.network)
    before = {k: v.clone() for k, v in network.state_dict().items()}
    rng = np.random.default_rng(1)
    model = lora_model(network, QUICK, rng)
    free = [name for name, p in model.named_parameters() if p.requires_grad]
    assert free and all("lora_" in name for name in free)
    autoencoder = MaskedAutoencoder(network, QUICK)
    updates = {name: p.clone() for name, p in model.named_parameters() if "lora_" in name}
    optimiser = torch.optim.SGD([p for p in autoencoder.parameters() if p.requires_grad], lr=0.5)
    x = preprocess(frames[:4], SMALL_VIT.preprocessing)
    for _ in range(2):  # the first step moves only one of each pair of factors
        optimiser.zero_grad()
        autoencoder(x, torch.rand(4, 16)).backward()
        optimiser.step()
    after = {
        k.removeprefix("base_model.model.").replace(".base_layer", ""): v
        for k, v in model.state_dict().items()
        if "lora_" not in k
    }
    assert after.keys() == before.keys()
    assert all(torch.equal(after[k], before[k]) for k in before)
    changed = {n for n, p in model.named_parameters() if n in updates and (p != updates[n]).any()}
    assert changed == set(updates)


def test_fine_tuning_leaves_its_base_and_returns_a_network_of_the_same_layout(scratch, frames):
    network, spec = scratch.network, SMALL_VIT
    before = {k: v.clone() for k, v in network.state_dict().items()}
    fit = fine_tune_lora(network, frames, spec.preprocessing, QUICK, np.random.default_rng(2))
    assert all(torch.equal(v, before[k]) for k, v in network.state_dict().items())
    tuned = fit.network.state_dict()
    assert tuned.keys() == before.keys()
    changed = {k for k in before if not torch.equal(tuned[k], before[k])}
    assert changed == {f"blocks.{i}.attn.qkv.weight" for i in range(2)}
    assert fit.held_out_losses[-1] < fit.held_out_losses[0]


def test_bad_requests_are_refused_by_name(frames, tmp_path):
    with pytest.raises(ShapeError, match=r"hides 1.0.*within \(0, 1\)"):
        MaskedConfig(hidden=1.0)
    with pytest.raises(ShapeError, match="on 3 frames, expected 8"):
        pretrain(frames[:3], SMALL_VIT, QUICK, np.random.default_rng(0))
    with pytest.raises(WeightsError, match="attn.qkv"):
        lora_model(torch.nn.Linear(2, 2), QUICK, np.random.default_rng(0))
    with pytest.raises(WeightsError, match="mae_vit has no published weights"):
        make_encoder("mvp", tmp_path, backbone=MAE_BACKBONE)
