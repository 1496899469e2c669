"""The node ``encoder``: pictures in, embeddings out, by an encoder that can be swapped."""

import json
import threading
import traceback
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field, replace
from itertools import groupby
from pathlib import Path
from typing import Any, Literal

import numpy as np
import rclpy
import torch
from numpy.typing import NDArray
from rapl_msgs import msg as wire_msg
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from sensor_msgs.msg import CompressedImage, Image

from rapl_core.atomic import write_atomically
from rapl_core.episodes import EpisodeStore
from rapl_core.errors import RaplError, WeightsError
from rapl_core.preferences import RankingStore, expert_set
from rapl_core.preferences.store import RANKINGS_FILE
from rapl_core.representations import Encoder, encoder_names, make_encoder
from rapl_core.streaming.batching import BatchQueue
from rapl_core.streaming.reward_rule import RewardRule
from rapl_core.types import ExpertSet
from rapl_ros import conversions, qos, topics
from rapl_ros.diagnostics import BAD_INPUT_S
from rapl_ros.embedding_again import EmbeddingAgain
from rapl_ros.node import RaplNode, main
from rapl_ros.parameters import ConfigParameters
from rapl_ros.wire import EmbeddedFrame, JoinKey

AT_WORK_FILE = "at_work.json"
"""In ``<run folder>/encoders``: what a restarted node takes up again."""


@dataclass(frozen=True)
class EncoderChoice:
    """Which encoder: may change while the node runs."""

    encoder: str = ""
    """Name of the encoder at work, e.g. rapl or imagenet. Empty: none yet, or after a restart the
    one that was at work in this run folder."""
    weights: str = ""
    """File with the weights of its backbone, or a folder that may hold it as <backbone>.pt, .pth
    or .safetensors; empty: where they are by default. A folder serves every encoder."""


@dataclass(frozen=True)
class EncoderNodeConfig:
    """Parameters that hold until the node is started anew."""

    run_folder: Path = Path(".")
    """Run folder: experts come from its episodes and rankings, encoders from its checkpoints."""
    experts: int = field(default=10, metadata={"minimum": 1, "maximum": 1000})
    """Videos in the expert set of an encoder that brings none of its own."""
    threads: int = field(default=1, metadata={"minimum": 1, "maximum": 64})
    """Threads of torch. More than one on a busy machine is slower, not faster."""
    engine: Literal["torch", "openvino"] = "torch"
    """What computes the features. openvino, where installed, must agree with torch (cosine 0.999)
    when an encoder is loaded; it takes bfloat16 where that holds, else float32."""
    batch_frames: int = field(default=16, metadata={"minimum": 1, "maximum": 256})
    """Pictures embedded at once, at most."""
    linger_s: float = field(default=0.02, metadata={"minimum": 0.0, "maximum": 1.0})
    """Wait so long for the pictures of the other worlds; a batch is faster than its members."""
    queue_frames: int = field(default=2048, metadata={"minimum": 1, "maximum": 100_000})
    """Pictures that may wait; the oldest go, and their episodes are dropped."""
    image_transport: Literal["raw", "compressed"] = "raw"
    """Which form of the pictures to take."""


@dataclass(frozen=True)
class EncoderAtWork:
    """An encoder and all that goes on the wire about it."""

    encoder: Encoder
    rule: RewardRule
    experts: ExpertSet


@dataclass(frozen=True)
class _Picture:
    key: JoinKey
    frame: NDArray[np.uint8]
    """(H, W, 3)"""


class EncoderNode(RaplNode):
    """Embeds every picture; the header is copied, for it is the join key.

    Subscribes ``camera/image_raw`` (sensor_msgs/Image) of world 0 and ``env_<i>/camera/image_raw``
    of the others, ``world_info``. Publishes ``embedding`` (rapl_msgs/Embedding), ``experts``
    (rapl_msgs/ExpertSet, latched) and then ``encoder_info`` (rapl_msgs/EncoderInfo, latched).
    Serves ``~/embed_episodes`` (rapl_msgs/EmbedEpisodes).

    Set the parameter ``encoder`` to swap: the callback loads, checks and embeds the experts (it
    may take seconds and is the one that may), then the worker goes over between two pictures. A
    refusal leaves the old encoder at work.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(topics.ENCODER, **options)
        self.config = ConfigParameters(self, EncoderNodeConfig()).value
        torch.set_num_threads(self.config.threads)
        self._choice = ConfigParameters(
            self, _restored(self.config.run_folder), writable=("encoder", "weights")
        )
        self._at_work: EncoderAtWork | None = None
        self._candidate: tuple[EncoderChoice, EncoderAtWork] | None = None
        self._worlds = 0
        self._queue: BatchQueue[_Picture] = BatchQueue(self.config.queue_frames)
        self._embeddings = self.publish_to(wire_msg.Embedding, topics.EMBEDDING, qos.stream())
        self._experts = self.publish_to(wire_msg.ExpertSet, topics.EXPERTS, qos.latched())
        self._infos = self.publish_to(wire_msg.EncoderInfo, topics.ENCODER_INFO, qos.latched())
        self._watch_worlds(1)
        self.subscribe_to(wire_msg.WorldInfo, topics.WORLD_INFO, self._on_world, qos.latched())
        self.add_on_set_parameters_callback(self._on_set)
        self.add_post_set_parameters_callback(self._after_set)
        self._turn = threading.Lock()
        self._again = EmbeddingAgain(self, self.config.run_folder, self._encoder, self._turn)
        self._thread = threading.Thread(target=self._work, name="embedding", daemon=True)
        self._take_up_first()
        self._thread.start()

    def close(self) -> None:
        """End the workers."""
        self._queue.close()
        self._again.close()
        self._thread.join(2.0)

    def _encoder(self) -> Encoder | None:
        at_work = self._at_work
        return at_work and at_work.encoder

    # Swapping

    def _take_up_first(self) -> None:
        choice = self._choice.value
        if choice.encoder:
            self._switch(choice, load(choice, self.config))
        else:
            self.heartbeat.report("waiting", "for an encoder: set the parameter 'encoder'")

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        mine = {p.name: p.value for p in parameters if p.name in ("encoder", "weights")}
        self._candidate = None
        if not mine:
            return SetParametersResult(successful=True)
        try:
            choice = replace(self._choice.value, **mine)
            self._candidate = (choice, load(choice, self.config))
        except (RaplError, OSError, RuntimeError, TypeError, ValueError) as error:
            self.get_logger().warning(f"refused {mine}: {error}")
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _after_set(self, _: list[Parameter]) -> None:
        candidate, self._candidate = self._candidate, None
        if candidate is not None:
            self._switch(*candidate)

    def _switch(self, choice: EncoderChoice, new: EncoderAtWork) -> None:
        now_ns = self.get_clock().now().nanoseconds
        self._experts.publish(conversions.experts_to_ros(new.experts, now_ns))
        info = new.encoder.info
        self._infos.publish(conversions.encoder_info_to_ros(info, new.rule, now_ns))
        self._at_work = new  # the worker reads it once for each batch
        self._remember(choice)
        what = f"{info.name} version {info.version} on {info.backbone}"
        self.get_logger().info(f"encoder {what}, {len(new.experts.experts)} experts")
        self.heartbeat.report("active", what)

    def _remember(self, choice: EncoderChoice) -> None:
        """The encoder is at work already: that a restarted node will not know it is a warning."""
        try:
            _keep(choice, self.config.run_folder)
        except RaplError as error:
            self.diagnostics.warn("encoder at work", f"{error}; a restarted node would not know it")
        else:
            self.diagnostics.clear("encoder at work")

    # Pictures in

    def _on_world(self, msg: wire_msg.WorldInfo) -> None:
        self._watch_worlds(msg.worlds)

    def _watch_worlds(self, worlds: int) -> None:
        compressed = self.config.image_transport == "compressed"
        name = topics.CAMERA_COMPRESSED if compressed else topics.CAMERA_IMAGE
        for world in range(self._worlds, worlds):
            self.subscribe_to(
                CompressedImage if compressed else Image,
                topics.world_topic(name, world),
                self._on_compressed if compressed else self._on_image,
                qos.stream(),
                overridable=True,
            )
        self._worlds = max(self._worlds, worlds)

    def _on_image(self, msg: Image) -> None:
        self._take(msg, conversions.image_from_ros)

    def _on_compressed(self, msg: CompressedImage) -> None:
        self._take(msg, conversions.compressed_image_from_ros)

    def _take(self, msg: Any, decode: Any) -> None:
        at_work = self._at_work
        if at_work is None:
            self.diagnostics.count("images_without_encoder")
            return
        key = conversions.key_from_ros(msg.header)
        try:
            frame = decode(msg)
        except RaplError as error:
            self.diagnostics.count("corrupt_images")
            self.diagnostics.error_for(BAD_INPUT_S, "corrupt image", f"{key.frame_id}: {error}")
            self._fail(at_work, [key])
            return
        self._queue.put(_Picture(key, frame))
        self.diagnostics.counters["overflowed_images"] = self._queue.overflowed

    # Embeddings out, on the worker's thread

    def _work(self) -> None:
        while pictures := self._queue.take(
            self.config.batch_frames, self._worlds, self.config.linger_s
        ):
            at_work = self._at_work
            if at_work is None:
                continue
            for same in _of_one_size(pictures):
                try:
                    self._embed(at_work, same)
                except Exception:
                    if not rclpy.ok():  # being shut down: nothing can be published
                        return
                    self.diagnostics.count("failed_embeddings", len(same))
                    self.diagnostics.error_for(BAD_INPUT_S, "embedding", traceback.format_exc())
                    self._fail(at_work, [picture.key for picture in same])

    def _embed(self, at_work: EncoderAtWork, pictures: list[_Picture]) -> None:
        info = at_work.encoder.info
        keys = [picture.key for picture in pictures]
        try:
            with self._turn, self.diagnostics.shares.of("encoding"):
                frames = np.stack([picture.frame for picture in pictures])  # (N, H, W, 3)
                values = at_work.encoder.embed(frames, batch_size=len(frames))  # (N, D)
        except (RaplError, RuntimeError) as error:
            self.diagnostics.count("failed_embeddings", len(keys))
            self.diagnostics.error_for(BAD_INPUT_S, "embedding", f"{info.name}: {error}")
            self._fail(at_work, keys)
            return
        with self.diagnostics.shares.of("ros"):
            for key, z in zip(keys, values, strict=True):
                if np.isfinite(z).all():
                    frame = EmbeddedFrame(key, info.name, info.version, z)
                    self._embeddings.publish(conversions.embedding_to_ros(frame))
                else:
                    self.diagnostics.count("nan_embeddings")
                    self.diagnostics.error_for(
                        BAD_INPUT_S, "NaN embedding", f"{info.name}: {key.frame_id}"
                    )
                    self._fail(at_work, [key])
        self.diagnostics.count("embeddings", len(keys))

    def _fail(self, at_work: EncoderAtWork, keys: Iterable[JoinKey]) -> None:
        info = at_work.encoder.info
        for key in keys:
            msg = conversions.failed_embedding_to_ros(key, info.name, info.version)
            self._embeddings.publish(msg)


def load(choice: EncoderChoice, config: EncoderNodeConfig) -> EncoderAtWork:
    """Make the encoder that ``choice`` names, try it, and embed its experts.

    :raises RaplError: if it is unknown (the message names the known ones), has no usable weights,
        gives NaN, or an expert's video is missing.
    """
    if not choice.encoder:
        raise RaplError(f"an encoder needs a name; known: {', '.join(encoder_names())}")
    weights = Path(choice.weights) if choice.weights else None
    encoder = make_encoder(choice.encoder, config.run_folder, weights=weights)
    ids = encoder.expert_ids or _preferred(config)
    episodes = EpisodeStore(config.run_folder / "episodes")
    if config.engine != "torch":
        pictures = episodes.first_of(ids)
        encoder.extractor.use_engine(config.engine, config.threads, pictures)
    _try_out(encoder)
    experts = encoder.experts or tuple(encoder.embed_expert(i, episodes.frames(i)) for i in ids)
    info = encoder.info
    rule = RewardRule(encoder.reward_kind, info.reward_scale, encoder.transport)
    return EncoderAtWork(encoder, rule, ExpertSet(info.name, info.version, experts))


def _try_out(encoder: Encoder) -> None:
    frames = np.random.default_rng(0).integers(0, 256, (2, 64, 64, 3), dtype=np.uint8)
    if not np.isfinite(encoder.embed(frames)).all():
        raise WeightsError(f"encoder {encoder.info.name} gives NaN or infinite embeddings")


def _preferred(config: EncoderNodeConfig) -> list[str]:
    """The most preferred videos, by the rankings alone; none before there are rankings."""
    path = config.run_folder / RANKINGS_FILE
    if not path.is_file():
        return []
    with RankingStore(path) as store:
        rankings = store.effective()
    return expert_set(rankings, config.experts) if rankings else []


def _of_one_size(pictures: list[_Picture]) -> Iterator[list[_Picture]]:
    for _, same in groupby(pictures, key=lambda picture: picture.frame.shape):
        yield list(same)


def _keep(choice: EncoderChoice, run_folder: Path) -> None:
    write_atomically(run_folder / "encoders" / AT_WORK_FILE, json.dumps(asdict(choice)))


def _restored(run_folder: Path) -> EncoderChoice:
    path = run_folder / "encoders" / AT_WORK_FILE
    try:
        return EncoderChoice(**json.loads(path.read_text()))
    except FileNotFoundError:
        return EncoderChoice()
    except (OSError, ValueError, TypeError) as error:
        raise RaplError(f"cannot read {path}: {error}; delete it to start without") from error


if __name__ == "__main__":
    main(EncoderNode)
