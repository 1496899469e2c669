"""The recorder with cameras and states that are not the simulator's."""

import io
import threading
from types import SimpleNamespace

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from PIL import Image as PillowImage
from rapl_msgs.msg import Action, EpisodeInfo, Heartbeat, State, WorldInfo
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_harness import DISCOVERY_S
from sensor_msgs.msg import CompressedImage, Image

from rapl_core.episodes.store import EpisodeStore
from rapl_core.errors import RaplError
from rapl_ros import conversions, qos, recorder_node, topics
from rapl_ros.recorder_node import RecorderNode
from rapl_ros.wire import Instant, JoinKey, World, answer

STEPS = 3
FRAME = "camera_optical_frame"


class Robot:
    """Plays a robot with a camera: the truth is unknown, the image has a stamp of its own."""

    def __init__(self, probe, kind=Image, camera_qos=None):
        self.probe = probe
        node = probe.node
        topic = topics.CAMERA_IMAGE if kind is Image else topics.CAMERA_COMPRESSED
        self.camera = node.create_publisher(kind, topic, camera_qos or qos.stream())
        self.states = node.create_publisher(State, topics.STATE, qos.stream())
        self.actions = node.create_publisher(Action, topics.ACTION, qos.stream())
        self.worlds = node.create_publisher(WorldInfo, topics.WORLD_INFO, qos.latched())
        names = ("x", "y")
        world = World("kitchen", 1, 0.1, STEPS, False, names, ("m", "m"), names, (FRAME,), 0)
        self.worlds.publish(conversions.world_to_ros(world, 1))
        probe.listen(DiagnosticArray, topics.DIAGNOSTICS, qos.diagnostics())
        self.beats = probe.listen(Heartbeat, "recorder/heartbeat", qos.heartbeat())
        self.episodes = probe.listen(EpisodeInfo, topics.EPISODE, qos.event())

    def wait_for_recorder(self):
        self.probe.until(
            lambda: (
                self.beats
                and self.beats[-1].status == "active"
                and min(
                    p.get_subscription_count() for p in (self.camera, self.states, self.actions)
                )
                > 0
            ),
            DISCOVERY_S,
            "the recorder is ready",
        )

    def play(self, name, make_image, first_ns, purpose="demonstrate"):
        for step in range(STEPS + 1):
            key = JoinKey(FRAME, first_ns + 10 * step)
            image = make_image(step)
            image.header = conversions.header_to_ros(key)
            self.camera.publish(image)
            instant = Instant(
                key=JoinKey("base", first_ns + 10 * step + 3),
                image=key,
                world=0,
                episode_id=name,
                purpose=purpose,
                controller="teleop",
                step=step,
                is_last=step == STEPS,
                terminated=step == STEPS,
                values=np.array([0.1 * step, 0.0]),
            )
            self.states.publish(conversions.state_to_ros(instant))
            if step < STEPS:
                self.actions.publish(conversions.action_to_ros(answer(instant, [0.5, -0.5])))


def bgr(step):
    pixels = np.zeros((4, 5, 3), np.uint8)
    pixels[..., 2] = 10 * step + 1  # red is last
    return Image(height=4, width=5, step=15, encoding="bgr8", data=pixels.tobytes())


def compressed(step):
    data = io.BytesIO()
    PillowImage.new("RGB", (5, 4), (10 * step + 1, 0, 0)).save(data, "png")
    return CompressedImage(format="png", data=data.getvalue())


def stored(tmp_path, name):
    return EpisodeStore(tmp_path / "episodes").load(name)


def test_a_real_robots_episode_has_no_truth_and_its_bgr_images_are_rgb(probe, start, tmp_path):
    robot = Robot(probe)
    start("rapl_ros.recorder_node", run_folder=tmp_path)
    robot.wait_for_recorder()
    robot.play("real-1", bgr, 1000)
    probe.until(lambda: robot.episodes, 10.0, "it is recorded")
    info = robot.episodes[0]
    assert (info.episode_id, info.task, info.has_truth) == ("real-1", "kitchen", False)
    episode = stored(tmp_path, "real-1")
    assert episode.human_rewards is None and episode.success is None
    assert episode.frames[:, 0, 0].tolist() == [[10 * s + 1, 0, 0] for s in range(STEPS + 1)]
    assert EpisodeStore(tmp_path / "episodes").summary("real-1").terminated


def test_compressed_images_are_recorded(probe, start, tmp_path):
    robot = Robot(probe, CompressedImage)
    start("rapl_ros.recorder_node", run_folder=tmp_path, image_transport="compressed")
    robot.wait_for_recorder()
    robot.play("real-2", compressed, 1000)
    probe.until(lambda: robot.episodes, 10.0, "it is recorded")
    assert stored(tmp_path, "real-2").frames[2, 0, 0].tolist() == [21, 0, 0]


def test_a_best_effort_camera_is_an_error_and_an_override_cures_it(probe, start, tmp_path):
    camera_qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    robot = Robot(probe, camera_qos=camera_qos)
    deaf = start("rapl_ros.recorder_node", run_folder=tmp_path)
    probe.until(
        lambda: "incompatible QoS (RELIABILITY)" in probe.status_of("recorder").get("message", ""),
        DISCOVERY_S,
        "the error on /diagnostics",
    )
    deaf.stop()
    override = {"qos_overrides./rapl/camera/image_raw.subscription.reliability": "best_effort"}
    start("rapl_ros.recorder_node", run_folder=tmp_path, **override)
    robot.wait_for_recorder()
    robot.play("real-3", bgr, 1000)
    probe.until(lambda: robot.episodes, 10.0, "it is recorded")


def test_a_corrupt_image_costs_its_episode_and_no_more(probe, start, tmp_path):
    robot = Robot(probe)
    node = start("rapl_ros.recorder_node", run_folder=tmp_path)
    robot.wait_for_recorder()
    faults = [{"data": bytes(59)}, {"step": 7}, {"encoding": "32FC1"}]
    for number, fault in enumerate(faults):

        def spoiled(step, fault=fault):
            image = bgr(step)
            if step == 2:
                for name, value in fault.items():
                    setattr(image, name, value)
            return image

        robot.play(f"bad-{number}", spoiled, 1000 * number)
    robot.play("good", bgr, 9000)
    probe.until(lambda: robot.episodes, 10.0, "the good one is recorded")
    assert robot.episodes[0].episode_id == "good"
    probe.until(
        lambda: probe.status_of("recorder").get("lost_episodes") == "3", 10.0, "three are lost"
    )
    status = probe.status_of("recorder")
    assert status["refused_images"] == "3" and "camera/image_raw" in str(status)
    for number in range(len(faults)):
        lost = f"episode bad-{number} is lost: image missing at step 2 (1 of 4 missing)"
        assert lost in node.text()
    assert EpisodeStore(tmp_path / "episodes").ids() == ["good"]


def test_other_purposes_are_not_recorded(probe, start, tmp_path):
    robot = Robot(probe)
    start("rapl_ros.recorder_node", run_folder=tmp_path)
    robot.wait_for_recorder()
    robot.play("training", bgr, 1000, purpose="train")
    robot.play("judged", bgr, 2000, purpose="evaluate")
    probe.until(lambda: robot.episodes, 10.0, "the evaluation is recorded")
    assert [info.episode_id for info in robot.episodes] == ["judged"]
    assert EpisodeStore(tmp_path / "episodes").ids() == ["judged"]


def test_the_same_episode_twice_is_an_error_and_the_first_stays(probe, start, tmp_path):
    robot = Robot(probe)
    recorder = start("rapl_ros.recorder_node", run_folder=tmp_path)
    robot.wait_for_recorder()
    robot.play("real-4", bgr, 1000)
    probe.until(lambda: robot.episodes, 10.0, "it is recorded")
    before = stored(tmp_path, "real-4").stamps_ns[0]
    recorder.stop()
    recorder.restart()
    robot.beats.clear()
    robot.wait_for_recorder()
    robot.play("real-4", bgr, 5000)
    probe.until(
        lambda: "already stored" in probe.status_of("recorder").get("message", ""), 10.0, "error"
    )
    assert stored(tmp_path, "real-4").stamps_ns[0] == before


def test_episodes_that_were_not_written_in_time_are_named(probe, tmp_path, monkeypatch):
    class SlowDisk(EpisodeStore):
        def add(self, *episode):
            go_on.wait(10.0)
            raise RaplError("too late")

    def complete(name):
        outcome = SimpleNamespace(
            first=SimpleNamespace(episode_id=name),
            latest=SimpleNamespace(terminated=False),
            episode=lambda task: SimpleNamespace(episode_id=name),
            joint_track=lambda: None,
        )
        node._handle([outcome])

    go_on, said = threading.Event(), []
    monkeypatch.setattr(recorder_node, "FINISH_S", 0.2)
    node = RecorderNode(parameter_overrides=[Parameter("run_folder", value=str(tmp_path))])
    try:
        probe.executor.add_node(node)
        node._store = SlowDisk(tmp_path)
        monkeypatch.setattr(node, "get_logger", lambda: SimpleNamespace(error=said.append))
        complete("first")
        complete("second")
        node.close()
        assert said == ["episodes that were not written in time: first, second"]
    finally:
        go_on.set()
        probe.executor.remove_node(node)
        node.destroy_node()
