"""Every method that learns from no rankings, from the videos of a run to a reward on the wire."""

from pathlib import Path

import numpy as np
import pytest
import torch
import torchvision
from torch import nn

from rapl_core.episodes import EpisodeStore
from rapl_core.errors import RankingError, UnknownNameError, WeightsError
from rapl_core.representations import (
    Encoder,
    checkpoint_folder,
    encoder_names,
    make_encoder,
    save_encoder,
)
from rapl_core.representations.masked import MaskedConfig
from rapl_core.representations.methods import get_method, method_names
from rapl_core.representations.tcc import TccConfig
from rapl_core.representations.workshop import Product, Workshop, WorkshopConfig
from rapl_core.streaming.reward_rule import RewardRule
from rapl_core.types import Episode

STEPS, SIZE = 4, 32
EXPERTS = ("v-0", "v-1", "v-2")
SHORT_TCC = TccConfig(frames=4, videos=2, iterations=2)
SHORT_MASKED = MaskedConfig(iterations=1, batch_size=2)


def nothing(*_: object) -> None:
    """Neither progress nor an end is asked for."""


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    store = EpisodeStore(folder / "episodes")
    rng = np.random.default_rng(0)
    for i in range(6):
        store.add(
            Episode(
                episode_id=f"v-{i}",
                task="franka_group",
                world=0,
                purpose="demonstrate",
                controller="scripted",
                frames=rng.integers(0, 256, (STEPS + 1, SIZE, SIZE, 3), dtype=np.uint8),
                states=np.zeros((STEPS + 1, 18)),
                actions=np.zeros((STEPS, 2)),
                stamps_ns=np.arange(STEPS + 1) + 1,
                human_rewards=rng.uniform(-1, 0, STEPS + 1),
                success=i < 2,
                behaviour="together_from_behind" if i in (1, 3, 4) else "mime",
            )
        )
    return folder


@pytest.fixture(scope="module")
def r3m_weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a file of R3M's layout and made-up numbers."""
    network = torchvision.models.resnet18(weights=None)
    network.fc = nn.Identity()
    for name, tensor in network.state_dict().items():
        if name.endswith("running_mean"):
            tensor.fill_(0.01)
    folder = tmp_path_factory.mktemp("weights")
    state = {f"module.convnet.{k}": v for k, v in network.state_dict().items()}
    torch.save({"r3m": state}, folder / "r3m_resnet18.pt")
    return folder


def make(run_folder: Path, method: str, **more: object) -> Product:
    config = WorkshopConfig(
        run_folder, method, "paper", seed=0, tcc=SHORT_TCC, masked=SHORT_MASKED, **more
    )  # type: ignore[arg-type]
    return Workshop(config, nothing, nothing).make(EXPERTS, np.random.default_rng(0))


def reward_on_both_sides(encoder: Encoder, store: EpisodeStore) -> None:
    """What the streaming node computes from what goes on the wire is the encoder's own reward."""
    experts = [encoder.embed_expert(i, store.frames(i)) for i in encoder.expert_ids]
    z = encoder.embed(store.frames("v-5")[1:])
    rule = RewardRule(encoder.reward_kind, encoder.info.reward_scale, encoder.transport)
    assert rule.needs_experts == encoder.needs_experts
    values = encoder.reward(z, experts).values
    assert values.shape == (STEPS,) and np.isfinite(values).all()
    np.testing.assert_allclose(rule.reward(z, experts).values, values, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    ("method", "kind", "experts"),
    [
        ("imagenet", "ot", EXPERTS),
        ("clock", "clock", EXPERTS),
        ("mean_distance", "ot", EXPERTS),
        ("tcc", "goal", ("v-1", "v-3", "v-4")),
        ("tcc_ot", "ot", EXPERTS),
        ("supervised_probe", "scalar", EXPERTS),
        ("mae_scratch", "ot", EXPERTS),
        ("mvp_finetuned", "ot", EXPERTS),
        ("r3m", "ot", EXPERTS),
    ],
)
def test_a_method_makes_a_checkpoint_that_is_swapped_in_by_its_name(
    run_folder: Path, r3m_weights: Path, method: str, kind: str, experts: tuple[str, ...]
) -> None:
    more = {"backbone": "mae_vit"} if method == "mvp_finetuned" else {}
    weights = r3m_weights if method == "r3m" else None
    encoder = make(run_folder, method, weights=weights, **more).encoder
    assert (encoder.info.name, encoder.reward_kind) == (method, kind)
    assert set(encoder.expert_ids) == set(experts)
    save_encoder(encoder, checkpoint_folder(run_folder, encoder))
    again = make_encoder(method, run_folder)
    assert again.info == encoder.info
    reward_on_both_sides(again, EpisodeStore(run_folder / "episodes"))


def test_both_rewards_of_tcc_read_one_representation(run_folder: Path) -> None:
    goal, matched = (make(run_folder, method) for method in ("tcc", "tcc_ot"))
    assert set(matched.encoder.expert_ids) - set(goal.encoder.expert_ids)  # not demonstrations
    frames = EpisodeStore(run_folder / "episodes").frames(EXPERTS[0])
    np.testing.assert_array_equal(goal.encoder.embed(frames), matched.encoder.embed(frames))
    assert goal.report and matched.report
    assert goal.report["demonstrations"] == matched.report["demonstrations"] == 3


def test_a_folder_of_weights_serves_a_swap_without_a_checkpoint(
    r3m_weights: Path, tmp_path: Path
) -> None:
    for method, dimension in (("r3m", 512), ("imagenet", 1280), ("r3m", 512)):
        encoder = make_encoder(method, tmp_path, weights=r3m_weights)
        assert (encoder.info.name, encoder.info.dimension) == (method, dimension)


def test_the_clock_sees_nothing_and_rises(run_folder: Path) -> None:
    encoder = make(run_folder, "clock").encoder
    frames = np.zeros((4, SIZE, SIZE, 3), np.uint8)
    values = encoder.reward(encoder.embed(frames), []).values
    np.testing.assert_allclose(np.diff(values), values[1] - values[0])
    assert values[0] < values[-1] == 0


def test_what_cannot_be_made_says_why(run_folder: Path, tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="'magic'; known: clock, "):
        make(run_folder, "magic")
    with pytest.raises(UnknownNameError, match="'vgg'; known: .*mae_vit"):
        make(run_folder, "imagenet", backbone="vgg")
    with pytest.raises(RankingError, match="learns from rankings"):
        make(run_folder, "rapl")
    with pytest.raises(WeightsError, match="no weights file"):
        make(run_folder, "r3m", weights=tmp_path / "none.pt")
    with pytest.raises(RankingError, match="r.*, got 0"):
        make(tmp_path, "supervised_probe")


def test_every_row_of_the_tables_has_a_name_that_fits_the_wire() -> None:
    assert {"rapl", "rlhf", "tcc", "tcc_ot", "imagenet", "r3m", "mvp", "mvp_finetuned", "vip",
            "liv", "dinov2", "mae_scratch", "clock", "mean_distance",
            "supervised_probe"} == set(method_names())  # fmt: skip
    assert all(len(name) <= 32 and get_method(name).title for name in method_names())
    assert set(method_names()) <= set(encoder_names())
