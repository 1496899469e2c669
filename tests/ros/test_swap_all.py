"""Every encoder of the registry at work in a running graph, one after another."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from published_files import FILES
from rapl_msgs import msg as wire_msg
from ros_harness import NodeProcess, Probe
from sensor_msgs.msg import Image
from small_episodes import small_episode

from rapl_core.episodes import EpisodeStore
from rapl_core.preferences import RankingStore
from rapl_core.representations import (
    FeatureStore,
    align,
    checkpoint_folder,
    learn_reward,
    make_encoder,
    make_extractor,
    raw_encoder_from,
    save_encoder,
)
from rapl_core.representations.backbones import backbone_spec
from rapl_core.representations.masked import MaskedConfig, pretrain
from rapl_core.representations.masked_architecture import MAE_BACKBONE
from rapl_core.representations.methods import DEFAULT_BACKBONE, get_method, method_names
from rapl_core.representations.presets import PAPER
from rapl_core.representations.pretrained import RAW_RECIPE
from rapl_core.representations.probe import supervised_probe
from rapl_core.representations.tcc import TccConfig, learn_tcc
from rapl_core.representations.trainable import save_network
from rapl_core.types import Ranking, Triplet
from rapl_ros import conversions, qos, topics
from rapl_ros.wire import Instant, JoinKey

pytestmark = [pytest.mark.ros, pytest.mark.timeout(300)]

SIZE, STEPS, VIDEOS = 64, 4, 6
START_S = 120.0
"""torch, timm and the weights take seconds, many on a busy machine."""
NAMES = [f"video-{number}" for number in range(VIDEOS)]
EXPERTS = NAMES[:3]
PRESET = replace(PAPER, epochs=1, has_projection=True, components=8)
PUBLISHED = "r3m"
"""Comes from a file of the published layout; the others that do, from a checkpoint on the common
network, for time: how each file is read has tests of its own."""
WALK = [
    "rapl", "imagenet", "rlhf", "supervised_probe", "tcc", "tcc_ot", "clock", "r3m", "tcc", "clock",
    "tcc", "rlhf", "clock", "rlhf", "mvp", "mvp_finetuned", "mae_scratch", "vip", "liv", "dinov2",
    "mean_distance", "rapl",
]  # fmt: skip


def pictures(seed: int, count: int = STEPS + 1) -> np.ndarray:
    coarse = np.random.default_rng(seed).integers(0, 256, (count, 8, 8, 3), dtype=np.uint8)
    return coarse.repeat(SIZE // 8, axis=1).repeat(SIZE // 8, axis=2)


def make_run(folder: Path) -> None:
    """A run with videos, a ranking, a checkpoint of each method and a file of published weights."""
    store = EpisodeStore(folder / "episodes")
    for number, name in enumerate(NAMES):
        store.add(small_episode(name, pictures(number)))
    with RankingStore(folder / "rankings.sqlite") as rankings:
        rankings.add(Ranking("r0", "test", tuple(EXPERTS), (1, 2, 3)))
    (folder / "weights").mkdir()
    backbone = get_method(PUBLISHED).backbone
    FILES[backbone][0](folder / "weights" / f"{backbone}.pt")
    rng = np.random.default_rng(0)
    features = features_of(DEFAULT_BACKBONE)
    spec = backbone_spec(MAE_BACKBONE)
    frames = np.concatenate([pictures(number) for number in range(VIDEOS)])
    for name in method_names():
        method = get_method(name)
        if name == PUBLISHED:
            continue
        if method.lesson == "rankings":
            learn = align if name == "rapl" else learn_reward
            triplets = [Triplet(*NAMES[i : i + 3]) for i in range(VIDEOS - 2)]
            encoder, _ = learn(features, triplets, EXPERTS, PRESET, rng)
        elif method.lesson == "demonstrations":
            config = TccConfig(iterations=2, frames=3, views=0)
            encoder, _ = learn_tcc(features, EXPERTS, PRESET, config, rng, name)
        elif method.lesson == "truth":
            truth = {video: rng.normal(size=STEPS) for video in NAMES}
            encoder = supervised_probe(features, truth, EXPERTS, PRESET, rng)
        elif method.lesson == "frames":  # its own network lies in the checkpoint
            fit = pretrain(frames, spec, MaskedConfig(iterations=1, batch_size=4), rng)
            own = save_network(fit.network, MAE_BACKBONE, folder / "backbones")
            seen = features_of(MAE_BACKBONE, own)
            encoder = raw_encoder_from(seen, EXPERTS, rng, name, has_own_backbone=True)
        else:
            encoder = raw_encoder_from(features, EXPERTS, rng, name)
        save_encoder(encoder, checkpoint_folder(folder, encoder))


def features_of(backbone: str, weights: Path | None = None) -> FeatureStore:
    features = FeatureStore(make_extractor(backbone, RAW_RECIPE, weights))
    for number, name in enumerate(NAMES):
        features.add(name, pictures(number)[1:])
    return features


class Graph:
    """A camera and a robot in front of the two nodes, and who sets the parameter."""

    def __init__(self, probe: Probe) -> None:
        self.probe = probe
        self.states = probe.node.create_publisher(wire_msg.State, topics.STATE, qos.stream())
        camera = topics.world_topic(topics.CAMERA_IMAGE, 0)
        self.images = probe.node.create_publisher(Image, camera, qos.stream())
        self.rewards = probe.listen(wire_msg.Reward, topics.REWARD, qos.event())
        self._stamp_ns = 0
        probe.until(
            lambda: (
                self.states.get_subscription_count()
                and self.images.get_subscription_count()
                and probe.node.count_publishers(topics.REWARD)
            ),
            START_S,
            "both nodes are there",
        )

    def set_encoder(self, name: str) -> tuple[bool, str]:
        return self.probe.set_parameter(topics.ENCODER, "encoder", name, START_S)

    def warm_up(self) -> None:
        """Wait until the two nodes have found each other: an episode is rewarded."""
        assert self.set_encoder(WALK[0]) == (True, "")
        tries = (self.play(f"train-first-{n}", pictures(98)) for n in range(20))
        assert any(reward.valid for reward in tries)

    def play(self, episode_id: str, frames: np.ndarray) -> wire_msg.Reward:
        """Show an episode and return its reward."""
        for step, frame in enumerate(frames):
            self._stamp_ns += 1_000_000
            instant = Instant(
                key=JoinKey(topics.world_frame(0), self._stamp_ns),
                image=JoinKey(topics.camera_frame(0), self._stamp_ns),
                world=0,
                episode_id=episode_id,
                purpose="train",
                controller="learner",
                step=step,
                is_last=step == STEPS,
                terminated=False,
                values=np.zeros(2),
                human_reward=0.0,
                success=False,
            )
            self.states.publish(conversions.state_to_ros(instant))
            self.images.publish(conversions.image_to_ros(frame, instant.image))
        return self.probe.until(
            lambda: next((r for r in self.rewards if r.episode_id == episode_id), None),
            30.0,
            f"a reward of {episode_id}",
        )


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    make_run(folder)
    return folder


@pytest.fixture(scope="module")
def graph(run_folder: Path, rclpy_context: None) -> Iterator[Graph]:
    nodes = [
        NodeProcess(
            "rapl_ros.encoder_node",
            run_folder / "encoder.log",
            run_folder=run_folder,
            weights=run_folder / "weights",
            experts=len(EXPERTS),
        ),
        NodeProcess("rapl_ros.ot_reward_node", run_folder / "ot_reward.log"),
    ]
    probe = Probe("swapper")
    graph = Graph(probe)
    graph.warm_up()
    yield graph
    probe.close()
    for node in nodes:
        node.stop()


def test_the_walk_visits_every_encoder_and_crosses_every_two_kinds_of_reward() -> None:
    kinds = [get_method(name).reward for name in WALK]
    assert set(WALK) == set(method_names())
    crossed = {(a, b) for a, b in pairwise(kinds) if a != b}
    assert crossed == {(a, b) for a in set(kinds) for b in set(kinds) if a != b}


def test_after_each_swap_episodes_are_rewarded_by_the_new_encoder(
    graph: Graph, run_folder: Path
) -> None:
    frames = pictures(99)
    versions = {}
    for number, name in enumerate(WALK):
        assert graph.set_encoder(name) == (True, "")
        reward = graph.play(f"train-{number}", frames)
        assert reward.valid, f"{name}: {reward.reason}"
        encoder = make_encoder(name, run_folder, weights=run_folder / "weights")
        assert (reward.encoder, reward.version) == (name, encoder.info.version)
        store = EpisodeStore(run_folder / "episodes")
        ids = encoder.expert_ids or EXPERTS
        experts = [encoder.embed_expert(i, store.frames(i)) for i in ids]
        expected = encoder.reward(encoder.embed(frames[1:]), experts)
        np.testing.assert_allclose(reward.values, expected.values, rtol=2e-3, atol=1e-4)
        versions[name] = encoder.info.version
    assert len(set(versions.values())) == len(versions)
