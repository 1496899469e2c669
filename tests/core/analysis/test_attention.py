"""Attention maps: their mean over places is the embedding; who has none is told so."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from rapl_core.analysis.attention import AttentionError, attention_map, embedding_map
from rapl_core.analysis.attention_picture import seen_part, write_attention
from rapl_core.errors import ShapeError
from rapl_core.representations import Encoder, FeatureRecipe, Pooling, make_extractor
from rapl_core.representations.alignment import card_for
from rapl_core.representations.engines import flat_scenes
from rapl_core.representations.heads import Embedder, linear_head
from rapl_core.representations.preprocessing import Preprocessing
from rapl_core.representations.presets import AUTHORS_CODE, PAPER, TUNED
from rapl_core.representations.projection import Projection

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def frames():
    return np.random.default_rng(0).integers(0, 256, (3, 96, 120, 3), dtype=np.uint8)


def make_encoder(preset, dimension=32, method="rapl", backbone="efficientnet_lite0", weights=None):
    """An encoder whose statistics, components and head are random, as no training leaves them."""
    rng = np.random.default_rng(1)
    extractor = make_extractor(backbone, preset.recipe, weights)
    if extractor.needs_parts:
        extractor.find_parts([flat_scenes()], rng)
    width, projection = extractor.dimension, None
    if preset.has_projection:
        projection = Projection(width, preset.components)
        projection.fit(torch.from_numpy(rng.normal(1, 2, (200, width)).astype(np.float32)), rng)
        width = projection.dimension
    head = linear_head(width, dimension, rng) if dimension else None
    embedder, kind = Embedder(projection, head), "scalar" if dimension == 1 else "ot"
    return Encoder(extractor, embedder, card_for(method, extractor, embedder, preset, kind, ()))


def read(preset, *poolings, stages=("final",), **more):
    return replace(preset, recipe=FeatureRecipe(stages, poolings), **more)


UNEVEN = Pooling("grid", grid=3)  # cells of a 4 x 4 or 7 x 7 map overlap
CASES = {
    "paper": (PAPER, 32),
    "authors_code": (AUTHORS_CODE, 32),
    "a scalar": (PAPER, 1),
    "raw": (PAPER, 0),
    "statistics": (replace(PAPER, has_projection=True), 8),
    "grid and components": (
        read(PAPER, UNEVEN, stages=("stride16",), has_projection=True, components=40), 8,
    ),
    "two poolings": (read(PAPER, Pooling(), Pooling("grid", grid=4), stages=("stride16",)), 8),
    "two stages": (read(PAPER, Pooling("grid", grid=2), stages=("stride32", "stride8")), 8),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_the_mean_over_places_is_the_embedding(case, frames):
    preset, dimension = CASES[case]
    if "stride32" in preset.recipe.stages:  # 128 pixels: maps of 4 and 16 cells a side
        preset = replace(preset, recipe=replace(preset.recipe, size=(128, 128)))
    encoder = make_encoder(preset, dimension)
    z = encoder.embed(frames)
    unit = np.abs(z).max()
    places = embedding_map(encoder, frames, batch_size=2)
    assert places.ndim == 4 and places.shape[1] > 3
    np.testing.assert_allclose(places.mean((1, 2)), z, atol=1e-5 * unit)
    maps = attention_map(encoder, frames)
    np.testing.assert_allclose(maps.mean((1, 2)), z.mean(1), atol=1e-5 * unit)
    assert maps.std() > 1e-3 * unit  # no flat map


def test_each_place_has_the_weights_of_its_cell(frames):
    preset = read(PAPER, Pooling("grid", grid=2), stages=("stride8",))
    preset = replace(preset, recipe=replace(preset.recipe, size=(64, 64)))  # maps of 8 x 8
    encoder = make_encoder(preset)
    weight, channels = encoder.embedder.head.weight, encoder.extractor.backbone.channels("stride8")
    with torch.no_grad():  # of the four cells only the lower left counts, with no bias
        weight.view(-1, channels, 4)[:, :, [0, 1, 3]] = 0
        encoder.embedder.head.bias.zero_()
    seen = attention_map(encoder, frames) != 0
    assert seen[:, 4:, :4].mean() > 0.99
    assert not seen[:, :4].any() and not seen[:, :, 4:].any()


def test_a_network_that_ends_with_its_own_linear_layer_has_one(tmp_path, frames):
    from published_files import xirl_file

    file, _ = xirl_file(tmp_path / "rapl.pt")
    encoder = make_encoder(PAPER, 0, "rapl", "xirl_resnet18", file)
    z = encoder.embed(frames)
    assert z.shape == (3, 32)
    np.testing.assert_allclose(
        embedding_map(encoder, frames).mean((1, 2)), z, atol=1e-5 * np.abs(z).max()
    )


def test_who_has_none_is_told_which_poolings_have_one(frames):
    with pytest.raises(AttentionError, match="rapl.*tuned.*'parts' is not linear.*gap, grid"):
        attention_map(make_encoder(TUNED), frames)
    where = read(PAPER, Pooling(), Pooling("moments"))
    with pytest.raises(AttentionError, match="paper.*'moments' is not linear"):
        attention_map(make_encoder(where), frames)
    uneven = make_encoder(read(PAPER, Pooling(), stages=("stride32", "stride8")), 8)
    with pytest.raises(AttentionError, match="4 x 4 and 14 x 14 do not divide"):
        attention_map(uneven, frames)


def test_a_class_token_has_none(frames, tmp_path):
    import timm
    from published_files import as_if_trained, save

    from rapl_core.representations.backbones import backbone_spec

    spec = backbone_spec("mae_vit")
    network = as_if_trained(timm.create_model(spec.architecture, **spec.options))
    file = save(network.state_dict(), tmp_path / "mae_vit.pt")
    encoder = make_encoder(PAPER, 0, "mae_scratch", "mae_vit", file)
    with pytest.raises(AttentionError, match="mae_scratch.*class token"):
        attention_map(encoder, frames)


def test_the_picture_has_a_row_for_each_encoder(tmp_path):
    frames = flat_scenes(3)
    encoders = {"raw": make_encoder(PAPER, 0), "RLHF": make_encoder(PAPER, 1, "rlhf")}
    path = write_attention(tmp_path / "new" / "a.png", frames, ["a", "b", "c"], encoders)
    picture = np.asarray(Image.open(path).convert("RGB"))
    assert picture.shape[0] > 3 * 80 and picture.shape[1] > 3 * 80
    assert path.stat().st_size < 100_000
    with pytest.raises(ShapeError, match="2 titles for 3 pictures"):
        write_attention(path, frames, ["a", "b"], encoders)


def test_the_overlay_lies_where_the_network_looked():
    assert seen_part(Preprocessing(), 90, 120) == (0, 120, 90, 0)
    cut = Preprocessing(224, 224, shorter_side=256)
    left, right, bottom, top = seen_part(cut, 128, 160)
    assert (right - left, bottom - top) == (112, 112) and (left, top) == (24, 8)


def test_the_notes_say_what_the_study_found():
    results = ROOT / "experiments" / "rewards" / "results"
    found = json.loads((results / "attention.json").read_text())
    notes = (ROOT / "docs" / "paper_notes.md").read_text()
    said = notes[notes.index("(`experiments/rewards/results/attention.png`") :].split("\n**", 1)[0]
    alike, turned = found["correlation"], found["correlation_when_turned"]
    for words in (
        f"(correlation {short(alike['raw ImageNet, RAPL'])}; RLHF and raw",
        f"{short(alike['raw ImageNet, RLHF'])}, RAPL and RLHF {short(alike['RLHF, RAPL'])})",
        f"correlation of {short(turned['RAPL'])} (raw features {short(turned['raw ImageNet'])})",
    ):
        assert words in " ".join(said.split())


def short(value):
    """As the notes write shares: .57, -.12."""
    return f"{value:.2f}".replace("0.", ".")
