"""The simulator as others see it."""

import signal
import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rapl_msgs.msg import Action, Heartbeat, State, WorldInfo
from rapl_msgs.srv import Reset
from ros_harness import DISCOVERY_S, NodeProcess, Probe
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState

from rapl_core.tasks import get_task
from rapl_ros import conversions, qos, topics
from rapl_ros.wire import answer

MODULE = "rapl_ros.simulator_node"
TASK = get_task("franka_group")
RESET = topics.of_node(topics.RESET, topics.SIMULATOR)


class Controller:
    """Answers states with a constant push, as ``learner``."""

    def __init__(self, probe: Probe) -> None:
        self.probe = probe
        self.obeys = True
        self.publisher = probe.node.create_publisher(Action, topics.ACTION, qos.stream())
        self.states = probe.listen(State, topics.STATE, qos.stream(), self._on_state)

    def _on_state(self, msg: State) -> None:
        if self.obeys and not msg.is_last:
            self.send(msg)

    def send(self, msg: State, **changes) -> None:
        action = conversions.action_to_ros(answer(conversions.state_from_ros(msg), [0.5, 0.1]))
        for name, value in changes.items():
            setattr(action, name, value)
        self.publisher.publish(action)

    def reset(self, **fields) -> Reset.Response:
        values = dict(purpose="train", controller=topics.LEARNER, episodes=1, seed=5) | fields
        return self.probe.call(Reset, RESET, Reset.Request(**values))

    def until(self, condition, deadline_s, what):
        return self.probe.until(condition, deadline_s, what)


@pytest.fixture
def controller(probe):
    probe.listen(DiagnosticArray, topics.DIAGNOSTICS, qos.diagnostics())
    return Controller(probe)


@pytest.fixture
def start_simulator(start, probe, controller, tmp_path):
    """Start the simulator and wait until its topics are matched."""

    def start_it(**parameters) -> NodeProcess:
        values = dict(worlds=2, clock_file=tmp_path / "clock.json") | parameters
        node = start(MODULE, **values)
        probe.until(
            lambda: (
                controller.publisher.get_subscription_count() > 0
                and probe.node.count_publishers(topics.STATE) > 0
            ),
            DISCOVERY_S,
            "the simulator is discovered",
        )
        return node

    return start_it


def test_an_episode_is_a_join_of_states_images_and_joints(probe, controller, start_simulator):
    images = [
        probe.listen(Image, topics.world_topic(topics.CAMERA_IMAGE, w), qos.stream())
        for w in (0, 1)
    ]
    infos = probe.listen(CameraInfo, "env_1/camera/camera_info", qos.stream())
    joints = probe.listen(JointState, topics.JOINT_STATES, qos.stream())
    clocks = probe.listen(Clock, topics.CLOCK, qos.clock())
    start_simulator()
    response = controller.reset()
    assert response.success and len(response.episode_ids) == 2
    states = controller.states
    probe.until(lambda: sum(s.is_last for s in states) == 2, 60.0, "both episodes end")
    for world in (0, 1):
        own = {s.step: s for s in states if s.world == world}
        assert sorted(own) == list(range(TASK.horizon + 1))
        assert {s.episode_id for s in own.values()} == {response.episode_ids[world]}
        stamps = [conversions.time_from_ros(own[step].header.stamp) for step in sorted(own)]
        assert set(np.diff(stamps)) == {round(TASK.period_s * 1e9)}
        shown = {conversions.key_from_ros(image.header): image for image in images[world]}
        for state in own.values():
            image = shown[conversions.key_from_ros(state.image)]
            assert (image.width, image.height, image.encoding) == (112, 112, "rgb8")
            assert image.header.frame_id == f"env_{world}/camera_optical_frame"
        assert all(s.has_truth and len(s.values) == 18 for s in own.values())
        truth = TASK.human_reward(np.array(own[7].values))
        assert own[7].human_reward == pytest.approx(truth, abs=1e-12)
        assert not np.array_equal(
            conversions.image_from_ros(images[world][0]),
            conversions.image_from_ros(images[world][-1]),
        )
    assert infos[0].width == 112 and infos[0].k[0] > 100
    assert list(joints[0].name) == list(TASK.joint_names) and len(joints[0].position) == 9
    seconds = [conversions.time_from_ros(clock.clock) for clock in clocks]
    assert np.all(np.diff(seconds) >= 0)


def test_a_pending_state_and_its_image_are_repeated_every_second(
    probe, controller, start_simulator
):
    images = probe.listen(Image, topics.CAMERA_IMAGE, qos.stream())
    start_simulator()
    controller.obeys = False
    controller.reset(worlds=[0])
    states = controller.states
    probe.until(lambda: len(states) >= 4, 8.0, "the state comes again and again")
    assert {(s.episode_id, s.step) for s in states} == {(states[0].episode_id, 0)}
    assert len({conversions.key_from_ros(s.header) for s in states}) == 1
    probe.until(lambda: len(images) >= 3, 8.0, "its image too")
    assert len({conversions.key_from_ros(image.header) for image in images}) == 1
    assert images[0].data == images[-1].data
    probe.until(
        lambda: "repeated_instants" in probe.status_of("simulator"), 3.0, "repeats are counted"
    )
    # One answer, however late, and the world goes on.
    controller.send(states[-1])
    probe.until(lambda: states[-1].step == 1, 5.0, "the world steps")


def test_a_lost_answer_stalls_nobody(probe, controller, start_simulator):
    start_simulator()
    controller.obeys = False
    controller.reset()
    states = controller.states
    probe.until(lambda: {s.world for s in states} == {0, 1}, 5.0, "both worlds begin")
    controller.send(next(s for s in states if s.world == 0))  # world 1's answer is "lost"
    count = len(states)
    probe.until(lambda: len(states) > count, 5.0, "something is repeated")
    assert {s.world for s in states[count:]} == {1}  # only what lacks its answer
    controller.obeys = True
    probe.until(lambda: any(s.step == 3 for s in states), 5.0, "both go on")


@pytest.mark.parametrize(
    "changes",
    [{"step": 9}, {"episode_id": "train-other"}, {"controller": "demonstrator"}, {"world": 3}],
)
def test_an_action_that_is_no_answer_is_ignored_and_counted(
    probe, controller, start_simulator, changes
):
    start_simulator()
    controller.obeys = False
    controller.reset(worlds=[0])
    probe.until(lambda: controller.states, 5.0, "a state")
    for _ in range(3):
        controller.send(controller.states[0], **changes)
    probe.until(
        lambda: probe.status_of("simulator").get("ignored_actions") == "3", 5.0, "three counted"
    )
    assert {s.step for s in controller.states} == {0}


def test_an_action_with_nan_is_ignored_with_a_warning(probe, controller, start_simulator):
    node = start_simulator()
    controller.obeys = False
    controller.reset(worlds=[0])
    probe.until(lambda: controller.states, 5.0, "a state")
    controller.send(controller.states[0], values=[float("nan"), 0.0])
    probe.until(
        lambda: "NaN" in probe.status_of("simulator").get("message", ""), 5.0, "a warning"
    )
    assert node.process.poll() is None
    controller.send(controller.states[0])
    probe.until(lambda: controller.states[-1].step == 1, 5.0, "a good one counts")


def test_stamps_go_on_after_a_kill_though_it_ran_ahead_of_the_wall_clock(
    probe, controller, start_simulator
):
    node = start_simulator()
    controller.reset(episodes=0)
    states = controller.states
    probe.until(lambda: len(states) > 300, 60.0, "some episodes")
    node.kill()
    before = {w: max(s.header.stamp.sec for s in states if s.world == w) for w in (0, 1)}
    assert before[0] > time.time() + 2  # faster than real time
    states.clear()
    node.restart()
    assert controller.reset(episodes=0).success
    probe.until(lambda: {s.world for s in states} == {0, 1}, 30.0, "new states")
    for state in states:
        assert state.header.stamp.sec > before[state.world]


def test_the_same_seed_gives_the_same_episode_and_another_run_another_id(
    probe, controller, start_simulator
):
    images = probe.listen(Image, topics.CAMERA_IMAGE, qos.stream())
    start_simulator()
    runs = []
    for _ in range(2):
        controller.states.clear()
        images.clear()
        (episode_id,) = controller.reset(worlds=[0], seed=11).episode_ids
        probe.until(lambda: any(s.is_last for s in controller.states), 60.0, "it ends")
        probe.until(lambda: len(images) > TASK.horizon, 5.0, "images")
        own = [s for s in controller.states if s.episode_id == episode_id]
        pictures = np.stack([conversions.image_from_ros(image) for image in images])
        runs.append((episode_id, np.array([s.values for s in own]), pictures))
    (one, states, pictures), (other, states_again, pictures_again) = runs
    assert one != other
    np.testing.assert_array_equal(states, states_again)
    np.testing.assert_array_equal(pictures, pictures_again)


def test_resets_that_make_no_sense_are_refused_with_the_reason(controller, start_simulator):
    start_simulator()
    refused = controller.reset(purpose="play")
    assert not refused.success and "known: demonstrate, evaluate, test, train" in refused.message
    refused = controller.reset(worlds=[2])
    assert not refused.success and "worlds are 0 to 1" in refused.message
    assert controller.reset().success


def test_a_controller_that_does_not_answer_is_named(probe, controller, start_simulator):
    start_simulator()
    controller.obeys = False
    controller.reset(controller="nobody_home")
    beats = probe.listen(Heartbeat, "simulator/heartbeat", qos.heartbeat())
    probe.until(
        lambda: beats and beats[-1].detail == "for actions of nobody_home",
        5.0,
        "the heartbeat says whom it waits for",
    )
    assert beats[-1].status == "waiting"


def test_world_info_reaches_who_comes_late(probe, controller, start_simulator):
    start_simulator()
    controller.reset()
    infos = probe.listen(WorldInfo, topics.WORLD_INFO, qos.latched())
    probe.until(lambda: infos, 10.0, "the latched message")
    world = conversions.world_from_ros(infos[0])
    assert (world.task, world.worlds, world.max_steps) == ("franka_group", 2, TASK.horizon)
    assert world.state_names == TASK.state_names and world.action_names == TASK.action_names
    assert world.camera_frames == ("env_0/camera_optical_frame", "env_1/camera_optical_frame")


def test_real_time_is_kept_when_asked_for(probe, controller, start_simulator):
    start_simulator(real_time_factor=2.0)
    controller.reset()
    probe.until(lambda: any(s.step == 1 for s in controller.states), 10.0, "it begins")
    begin = time.monotonic()
    probe.until(lambda: any(s.step == 31 for s in controller.states), 30.0, "30 steps")
    took = time.monotonic() - begin
    assert took > 0.95 * 30 * TASK.period_s / 2.0


def test_without_rendering_there_are_states_and_no_images(probe, controller, start_simulator):
    images = probe.listen(Image, topics.CAMERA_IMAGE, qos.stream())
    start_simulator(render=False)
    controller.reset()
    probe.until(lambda: any(s.is_last for s in controller.states), 30.0, "an episode")
    assert images == []


@pytest.mark.parametrize(
    ("parameters", "complaint"),
    [
        ({"task": "dishes"}, "unknown task 'dishes'; known: "),
        ({"worlds": 900}, "take fewer worlds"),
        ({"worlds": 0}, "worlds"),
        ({"clock_file": "/dev/null/clock"}, "/dev/null/clock"),
    ],
)
def test_bad_parameters_end_it_with_one_clear_line(start, tmp_path, parameters, complaint):
    values = dict(worlds=1, clock_file=tmp_path / "clock.json") | parameters
    node = start(MODULE, **values)
    assert node.process.wait(timeout=30) == 1
    assert complaint in node.text() and "Traceback" not in node.text()


def test_it_ends_cleanly_while_it_steps(probe, controller, start_simulator):
    node = start_simulator()
    controller.reset(episodes=0)
    probe.until(lambda: len(controller.states) > 50, 30.0, "it steps")
    begin = time.monotonic()
    node.process.send_signal(signal.SIGINT)
    code = node.process.wait(timeout=10)
    assert code == 0 and time.monotonic() - begin < 5.0
    assert "Traceback" not in node.text()
