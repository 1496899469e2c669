"""Loaders of public checkpoints, on files of the real layout with made-up numbers."""

import hashlib

import numpy as np
import pytest
import timm
import torch
import torchvision
from published_files import FILES, save, xirl_file

from rapl_core.errors import UnknownNameError, WeightsError
from rapl_core.representations.backbones import load_backbone
from rapl_core.representations.extractor import FeatureRecipe, make_extractor
from rapl_core.representations.pooling import Pooling

SIZE = 64
"""Of the pictures: small, for time; loaders do not depend on it."""


def pictures(size=SIZE):
    return torch.randn(2, 3, size, size, generator=torch.Generator().manual_seed(1))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """(file, network) by backbone, each made when first asked for."""
    folder, known = tmp_path_factory.mktemp("public"), {}

    def make(name):
        if name not in known:
            known[name] = FILES[name][0](folder / f"{name}.pt")
        return known[name]

    make.folder = folder
    return make


@pytest.mark.parametrize("name", FILES)
def test_a_file_of_the_published_layout_gives_what_its_own_network_computes(name, made):
    path, network = made(name)
    x = pictures(224 if name in ("mvp_vit_small", "liv_resnet50") else SIZE)
    if name == "dinov2_vit_small":
        x = pictures(224)
        network = timm.create_model(
            "vit_small_patch14_dinov2", num_classes=0, img_size=518, dynamic_img_size=True
        )
        network.load_state_dict(torch.load(path, weights_only=True), strict=False)
    backbone = load_backbone(name, weights=path)
    with torch.inference_mode():
        (final,) = backbone(x)
        expected = network.eval()(x)
    found = final.mean((-1, -2))
    assert found.shape == (2, FILES[name][1]) == (2, backbone.channels("final"))
    similarity = torch.cosine_similarity(found, expected)
    # CLIP's weights are published in half precision
    assert float(similarity.min()) > (
        0.999 if name in ("liv_resnet50", "dinov2_vit_small") else 0.99999
    )


def test_preprocessing_is_the_publishers_own(made):
    extractor = make_extractor("r3m_resnet18", FeatureRecipe(), made("r3m_resnet18")[0])
    config = extractor.preprocessing
    assert (config.height, config.shorter_side) == (224, 256)
    frames = np.random.default_rng(0).integers(0, 256, (1, 96, 128, 3), dtype=np.uint8)
    assert extractor.extract(frames).shape == (1, 512)


def test_a_transformer_gives_maps_of_patches_too(made):
    recipe = FeatureRecipe(("stride16", "final"), (Pooling("grid", grid=2),), size=(64, 64))
    extractor = make_extractor("mvp_vit_small", recipe, made("mvp_vit_small")[0])
    frames = np.zeros((1, 64, 64, 3), np.uint8)
    assert extractor.extract(frames).shape == (1, 2 * 4 * 384) == (1, extractor.dimension)


def test_a_folder_of_files_serves_several_encoders(made, monkeypatch, tmp_path):
    made("r3m_resnet18"), made("xirl_resnet18")
    assert load_backbone("r3m_resnet18", weights=made.folder).spec.name == "r3m_resnet18"
    assert load_backbone("xirl_resnet18", weights=made.folder).spec.name == "xirl_resnet18"
    assert load_backbone("efficientnet_lite0", weights=made.folder).weights_file == ""
    monkeypatch.setenv("HOME", str(tmp_path))
    with pytest.raises(WeightsError, match="folder .* holds no mvp_vit_base.pt; .*ir413/mvp"):
        load_backbone("mvp_vit_base", weights=made.folder)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("r3m_resnet18", "r3m_18/model.pt.*facebookresearch/r3m"),
        ("mvp_vit_base", "vitb-mae-egosoup.*ir413/mvp"),
        ("vip_resnet50", "facebookresearch/vip"),
        ("liv_resnet50", "penn-pal-lab/LIV"),
        ("dinov2_vit_small", "dinov2_vits14_pretrain.pth"),
        ("mae_vit", "--reward mae_scratch"),
    ],
)
def test_missing_weights_say_where_they_are_and_how_to_give_them(
    name, words, monkeypatch, tmp_path
):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("RAPL_WEIGHTS", str(tmp_path / "weights"))
    with pytest.raises(WeightsError, match=f"(?s){words}.*`weights`"):
        load_backbone(name)


def test_a_file_in_the_users_folder_is_found(made, monkeypatch):
    made("xirl_resnet18")
    monkeypatch.setenv("RAPL_WEIGHTS", str(made.folder))
    assert load_backbone("xirl_resnet18").weights_file == ""


def test_a_checksum_beside_the_file_is_held_against_it(tmp_path):
    path, _ = xirl_file(tmp_path / "xirl.pt")
    beside = tmp_path / "xirl.pt.sha256"
    beside.write_text(f"{hashlib.sha256(path.read_bytes()).hexdigest()}  xirl.pt\n")
    assert load_backbone("xirl_resnet18", weights=path)
    beside.write_text(f"{'0' * 64}  xirl.pt\n")
    with pytest.raises(WeightsError, match="expected 0000.*xirl.pt.sha256"):
        load_backbone("xirl_resnet18", weights=path)
    beside.write_text("nonsense")
    with pytest.raises(WeightsError, match="holds no SHA-256"):
        load_backbone("xirl_resnet18", weights=path)


def test_another_encoders_file_is_refused(made):
    for name, other in (
        ("r3m_resnet18", "xirl_resnet18"),
        ("vip_resnet50", "r3m_resnet18"),
        ("mvp_vit_small", "dinov2_vit_small"),
        ("mvp_vit_base", "mvp_vit_small"),
        ("xirl_resnet18", "mvp_vit_small"),
        ("resnet18", "r3m_resnet18"),
    ):
        with pytest.raises(WeightsError, match="another (layout|architecture)|no dict of named"):
            load_backbone(name, weights=made(other)[0])


@pytest.mark.parametrize("kind", ["convolutional", "transformer"])
def test_random_weights_are_refused(kind, tmp_path):
    if kind == "transformer":
        state = timm.create_model("vit_small_patch16_224", num_classes=0).state_dict()
        path, name = save({"model": state}, tmp_path / "random.pth"), "mvp_vit_small"
    else:
        network = torchvision.models.resnet18(weights=None)
        state = {f"module.convnet.{k}": v for k, v in network.state_dict().items() if "fc" not in k}
        path, name = save({"r3m": state}, tmp_path / "random.pt"), "r3m_resnet18"
    with pytest.raises(WeightsError, match="are random weights"):
        load_backbone(name, weights=path)


def test_a_stage_that_a_network_lacks_names_those_it_has(made):
    with pytest.raises(UnknownNameError, match="stride16.*known: final, stride14"):
        load_backbone("dinov2_vit_small", ("stride16",), made("dinov2_vit_small")[0])
