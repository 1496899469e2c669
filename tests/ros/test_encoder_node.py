"""The node encoder with real weights: parity with rapl_core, bad pictures, swap, restart."""

import io
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from PIL import Image as PillowImage
from rapl_msgs import msg as wire_msg
from rapl_msgs.srv import EmbedEpisodes
from ros_harness import DISCOVERY_S, NodeProcess, Probe
from sensor_msgs.msg import CompressedImage, Image
from small_episodes import small_episode

from rapl_core.episodes import EpisodeStore
from rapl_core.preferences import RankingStore
from rapl_core.representations import (
    Encoder,
    FeatureStore,
    checkpoint_folder,
    make_encoder,
    make_extractor,
    raw_encoder_from,
    save_encoder,
)
from rapl_core.representations.exported import export_encoder
from rapl_core.representations.pretrained import RAW_RECIPE
from rapl_core.representations.registry import DEFAULT_BACKBONE
from rapl_core.types import EmbeddedEpisode, Ranking
from rapl_ros import conversions, qos, topics
from rapl_ros.encoder_node import AT_WORK_FILE
from rapl_ros.wire import JoinKey

pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]

SIZE = 64
EXPERTS = 3
START_S = 90.0
"""torch, timm and the weights take seconds, many on a busy machine."""


def pictures(seed: int, count: int) -> np.ndarray:
    """Smooth pictures, as cameras give: (count, H, W, 3)."""
    coarse = np.random.default_rng(seed).integers(0, 256, (count, 8, 8, 3), dtype=np.uint8)
    return coarse.repeat(SIZE // 8, axis=1).repeat(SIZE // 8, axis=2)


def make_run(folder: Path) -> None:
    """A run with four videos and one ranking of three of them."""
    store = EpisodeStore(folder / "episodes")
    for number in range(4):
        store.add(small_episode(f"video-{number}", pictures(number, 5)))
    with RankingStore(folder / "rankings.sqlite") as rankings:
        shown = ("video-0", "video-1", "video-2")
        rankings.add(Ranking("r0", "test", shown, (1, 2, 3)))


def save_second(folder: Path) -> Encoder:
    """A checkpoint: the same features with experts and a reward scale."""
    features = FeatureStore(make_extractor(DEFAULT_BACKBONE, RAW_RECIPE))
    store = EpisodeStore(folder / "episodes")
    for episode_id in store.ids():
        features.add(episode_id, store.frames(episode_id)[1:])
    encoder = raw_encoder_from(features, ["video-3", "video-1"], np.random.default_rng(0))
    save_encoder(encoder, checkpoint_folder(folder, encoder))
    return encoder


class Camera:
    """Publishes pictures and keeps what the encoder says."""

    def __init__(self, probe: Probe, worlds: int) -> None:
        self.probe = probe
        names = [topics.world_topic(topics.CAMERA_IMAGE, world) for world in range(worlds)]
        self.images = [probe.node.create_publisher(Image, name, qos.stream()) for name in names]
        self.worlds = probe.node.create_publisher(
            wire_msg.WorldInfo, topics.WORLD_INFO, qos.latched()
        )
        self.worlds.publish(wire_msg.WorldInfo(task="franka_group", worlds=worlds))
        self.embeddings = probe.listen(wire_msg.Embedding, topics.EMBEDDING, qos.stream())
        self.infos = probe.listen(wire_msg.EncoderInfo, topics.ENCODER_INFO, qos.latched())
        self.experts = probe.listen(wire_msg.ExpertSet, topics.EXPERTS, qos.latched())
        self.diagnostics = probe.listen(DiagnosticArray, topics.DIAGNOSTICS, qos.diagnostics())
        self._stamp_ns = 0

    def wait_for_encoder(self) -> None:
        self.probe.until(
            lambda: (
                self.infos
                and self.experts
                and all(image.get_subscription_count() for image in self.images)
            ),
            START_S,
            "the encoder works",
        )

    def key(self, world: int = 0) -> JoinKey:
        self._stamp_ns += 1_000
        return JoinKey(topics.camera_frame(world), self._stamp_ns)

    def show(self, frame: np.ndarray, world: int = 0) -> JoinKey:
        key = self.key(world)
        self.images[world].publish(conversions.image_to_ros(frame, key))
        return key

    def embedding(self, key: JoinKey, deadline_s: float = 20.0) -> wire_msg.Embedding:
        def found() -> wire_msg.Embedding | None:
            same = (e for e in self.embeddings if conversions.key_from_ros(e.header) == key)
            return next(same, None)

        return self.probe.until(found, deadline_s, f"an embedding of {key}")

    def set_encoder(self, name: str) -> tuple[bool, str]:
        return self.probe.set_parameter(topics.ENCODER, "encoder", name, START_S)


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    make_run(folder)
    return folder


@pytest.fixture(scope="module")
def node(run_folder: Path) -> Iterator[NodeProcess]:
    process = NodeProcess(
        "rapl_ros.encoder_node",
        run_folder / "log",
        run_folder=run_folder,
        encoder="imagenet",
        experts=EXPERTS,
    )
    yield process
    process.stop()


@pytest.fixture(scope="module")
def camera(node: NodeProcess, rclpy_context: None) -> Iterator[Camera]:
    probe = Probe("camera")
    camera = Camera(probe, worlds=2)
    camera.wait_for_encoder()
    yield camera
    probe.close()


@pytest.fixture(scope="module")
def reference() -> Encoder:
    return make_encoder("imagenet")


def cosine(a: np.ndarray, b: np.ndarray) -> float:
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    return float(a @ b / np.linalg.norm(a) / np.linalg.norm(b))


def test_embeddings_are_those_of_rapl_core_whatever_the_batch(
    camera: Camera, reference: Encoder
) -> None:
    frames = pictures(50, 24)
    keys = [camera.show(frame, world=i % 2) for i, frame in enumerate(frames)]
    expected = reference.embed(frames, batch_size=7)
    for key, z in zip(keys, expected, strict=True):
        msg = camera.embedding(key)
        assert conversions.key_from_ros(msg.header) == key
        assert (msg.encoder, msg.version) == ("imagenet", reference.info.version)
        assert cosine(msg.values, z) >= 0.99999
        np.testing.assert_allclose(msg.values, z, rtol=1e-3, atol=1e-4)


def test_experts_are_the_most_preferred_videos_by_the_rankings_alone(
    camera: Camera, reference: Encoder, run_folder: Path
) -> None:
    experts = conversions.experts_from_ros(camera.experts[-1])
    assert [expert.episode_id for expert in experts.experts] == ["video-0", "video-1", "video-2"]
    assert experts.version == camera.infos[-1].version == reference.info.version
    frames = EpisodeStore(run_folder / "episodes").frames("video-0")[1:]
    np.testing.assert_allclose(
        experts.experts[0].values, reference.embed(frames), rtol=1e-3, atol=1e-4
    )
    rule = conversions.reward_rule_from_ros(camera.infos[-1])
    assert rule.transport == reference.transport


def test_recorded_episodes_are_embedded_as_live_pictures_are(
    camera: Camera, reference: Encoder, run_folder: Path
) -> None:
    ids = ["video-2", "video-9", "video-0"]
    name = topics.of_node(topics.EMBED_EPISODES, topics.ENCODER)
    before = len(list((run_folder / "features").rglob("*.safetensors")))
    for _ in range(2):  # the second time from the features on disk
        request = EmbedEpisodes.Request(episode_ids=ids)
        response = camera.probe.call(EmbedEpisodes, name, request, START_S)
        assert response.success, response.message
        again = conversions.embeddings_again_from_ros(response)
        assert (again.encoder, again.version) == ("imagenet", reference.info.version)
        assert again.missing == {"video-9": "not recorded"}
        assert [record.episode_id for record, _ in again.episodes] == ["video-2", "video-0"]
        for record, embedded in again.episodes:
            frames = EpisodeStore(run_folder / "episodes").frames(record.episode_id)
            expected = reference.embed(frames[1:])
            np.testing.assert_allclose(embedded.values, expected, rtol=1e-3, atol=1e-4)
            assert (record.steps, record.key.stamp_ns, record.purpose) == (4, 5, "demonstrate")
    assert len(list((run_folder / "features").rglob("*.safetensors"))) == before + 2
    request = EmbedEpisodes.Request(episode_ids=[f"e{i}" for i in range(65)])
    response = camera.probe.call(EmbedEpisodes, name, request)
    assert not response.success and "expected 64 at most" in response.message


def test_grey_and_bgr_pictures_are_accepted(camera: Camera, reference: Encoder) -> None:
    frame = pictures(60, 1)[0]
    key = camera.key()
    bgr = conversions.image_to_ros(np.ascontiguousarray(frame[:, :, ::-1]), key)
    bgr.encoding = "bgr8"
    camera.images[0].publish(bgr)
    assert cosine(camera.embedding(key).values, reference.embed(frame[None])[0]) >= 0.99999
    grey_key, grey = camera.key(), np.ascontiguousarray(frame[:, :, 0])
    mono = Image(
        header=conversions.header_to_ros(grey_key),
        height=SIZE,
        width=SIZE,
        encoding="mono8",
        step=SIZE,
        data=conversions.bytes_to_ros(grey),
    )
    camera.images[0].publish(mono)
    expected = reference.embed(np.repeat(grey[None, :, :, None], 3, axis=3))[0]
    assert cosine(camera.embedding(grey_key).values, expected) >= 0.99999


def test_a_corrupt_picture_is_told_and_the_next_one_is_embedded(camera: Camera) -> None:
    key = camera.key()
    msg = conversions.image_to_ros(pictures(61, 1)[0], key)
    msg.height = SIZE + 1
    camera.images[0].publish(msg)
    assert list(camera.embedding(key).values) == []
    camera.probe.until(
        lambda: "corrupt image" in camera.probe.status_of(topics.ENCODER),
        5.0,
        "a diagnostic",
    )
    status = camera.probe.status_of(topics.ENCODER)
    assert f"expected height * step = {(SIZE + 1) * SIZE * 3} bytes" in status["corrupt image"]
    assert len(camera.embedding(camera.show(pictures(62, 1)[0])).values) > 0


def test_a_bad_encoder_is_refused_by_name_and_the_old_one_goes_on(
    camera: Camera, reference: Encoder
) -> None:
    accepted, reason = camera.set_encoder("nonsense")
    assert not accepted
    assert "unknown encoder 'nonsense'" in reason and "rapl, rlhf" in reason
    accepted, reason = camera.set_encoder("rapl")
    assert not accepted and "no checkpoint of encoder 'rapl'" in reason
    msg = camera.embedding(camera.show(pictures(63, 1)[0]))
    assert msg.version == reference.info.version
    assert camera.infos[-1].version == reference.info.version


def test_a_swap_that_cannot_be_remembered_is_a_warning_and_holds(
    camera: Camera, run_folder: Path
) -> None:
    path = run_folder / "encoders" / AT_WORK_FILE
    kept = path.rename(path.with_name("kept.json"))
    path.mkdir()  # as on a full disk, the file cannot be written
    assert camera.set_encoder("imagenet") == (True, "")
    camera.probe.until(
        lambda: "encoder at work" in camera.probe.status_of(topics.ENCODER), 5.0, "a warning"
    )
    warning = camera.probe.status_of(topics.ENCODER)["encoder at work"]
    assert warning.startswith(f"cannot write {path}: Is a directory")
    assert len(camera.embedding(camera.show(pictures(64, 1)[0])).values) > 0
    path.rmdir()
    kept.rename(path)
    assert camera.set_encoder("imagenet") == (True, "")
    camera.probe.until(
        lambda: "encoder at work" not in camera.probe.status_of(topics.ENCODER), 5.0, "it is well"
    )


def test_an_exported_encoder_works_with_the_experts_that_it_brings_and_without_their_videos(
    camera: Camera, reference: Encoder, run_folder: Path
) -> None:
    expert = EmbeddedEpisode("elsewhere-7", reference.embed(pictures(90, 4)))
    card = replace(reference.card, expert_ids=("elsewhere-7",))
    encoder = Encoder(reference.extractor, reference.embedder, card)
    file = run_folder / "encoders" / "from-elsewhere.safetensors"
    export_encoder(encoder, file, (expert,), pictures(91, 2))
    try:
        assert camera.set_encoder("from-elsewhere") == (True, "")
    finally:
        file.unlink()
    msg = camera.embedding(camera.show(pictures(92, 1)[0]))
    assert msg.version == camera.infos[-1].version == encoder.info.version
    (brought,) = conversions.experts_from_ros(camera.experts[-1]).experts
    assert brought.episode_id == "elsewhere-7"
    np.testing.assert_array_equal(brought.values, expert.values)
    assert camera.set_encoder("imagenet") == (True, "")


def test_a_swap_changes_version_and_experts_between_two_pictures_and_survives_a_kill(
    camera: Camera, reference: Encoder, run_folder: Path, node: NodeProcess
) -> None:
    second = save_second(run_folder)
    name = f"imagenet-{second.info.version}"
    before = [camera.show(frame) for frame in pictures(70, 6)]
    assert camera.set_encoder(name) == (True, "")
    after = [camera.show(frame) for frame in pictures(71, 6)]
    versions = [camera.embedding(key).version for key in (*before, *after)]
    assert versions[-6:] == [second.info.version] * 6
    assert set(versions[:6]) <= {reference.info.version, second.info.version}
    assert versions == sorted(versions, key=lambda v: v == second.info.version), "one switch"
    camera.probe.until(
        lambda: camera.infos[-1].version == camera.experts[-1].version == second.info.version,
        5.0,
        "it is told",
    )
    assert [e.episode_id for e in camera.experts[-1].experts] == ["video-3", "video-1"]
    assert camera.infos[-1].reward_scale == pytest.approx(second.info.reward_scale)

    told = len(camera.infos)
    node.kill()
    node._parameters.pop("encoder")  # as a supervisor that knows nothing of the swap starts it
    node.restart()
    camera.probe.until(lambda: len(camera.infos) > told, START_S, "it is back")
    assert camera.infos[-1].version == second.info.version


def test_compressed_pictures(
    run_folder: Path, probe: Probe, start: Callable[..., NodeProcess], tmp_path: Path
) -> None:
    make_run(tmp_path)
    start(
        "rapl_ros.encoder_node",
        run_folder=tmp_path,
        encoder="imagenet",
        experts=EXPERTS,
        image_transport="compressed",
    )
    pixels = pictures(80, 1)[0]
    written = io.BytesIO()
    PillowImage.fromarray(pixels).save(written, "PNG")
    sender = probe.node.create_publisher(CompressedImage, topics.CAMERA_COMPRESSED, qos.stream())
    heard = probe.listen(wire_msg.Embedding, topics.EMBEDDING, qos.stream())
    infos = probe.listen(wire_msg.EncoderInfo, topics.ENCODER_INFO, qos.latched())
    probe.until(lambda: infos and sender.get_subscription_count(), START_S, "it works")
    probe.until(lambda: probe.node.count_publishers(topics.EMBEDDING), DISCOVERY_S, "it speaks")
    msg = CompressedImage(format="png", data=written.getvalue())
    msg.header.frame_id = "cam"
    sender.publish(msg)
    probe.until(lambda: heard, 20.0, "an embedding")
    expected = make_encoder("imagenet").embed(pixels[None])[0]
    assert heard[-1].header.frame_id == "cam"
    assert cosine(heard[-1].values, expected) >= 0.99999
