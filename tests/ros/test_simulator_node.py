"""The simulator as others see it."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rapl_msgs.msg import Heartbeat, WorldInfo
from rapl_msgs.srv import Reset
from ros_harness import NodeProcess
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState
from state_controller import RESET, Controller, wait_for

from rapl_core.tasks import get_task
from rapl_ros import conversions, qos, topics

MODULE = "rapl_ros.simulator_node"
TASK = get_task("franka_group")


@pytest.fixture(scope="module")
def simulator(tmp_path_factory):
    """A simulator for the tests that leave it as they found it."""
    folder = tmp_path_factory.mktemp("simulator")
    node = NodeProcess(MODULE, folder / "simulator.log", worlds=2, clock_file=folder / "clock.json")
    yield node
    node.stop()


@pytest.fixture
def controller(simulator, probe):
    """A controller that has heard nothing yet, of a simulator whose worlds rest."""
    assert probe.call(Reset, RESET, Reset.Request(controller="")).success
    probe.listen(DiagnosticArray, topics.DIAGNOSTICS, qos.diagnostics())
    made = Controller(probe)
    wait_for(made)
    return made


def test_an_episode_is_a_join_of_states_images_and_joints(probe, controller, simulator):
    images = [
        probe.listen(Image, topics.world_topic(topics.CAMERA_IMAGE, w), qos.stream())
        for w in (0, 1)
    ]
    infos = probe.listen(CameraInfo, "env_1/camera/camera_info", qos.stream())
    joints = probe.listen(JointState, topics.JOINT_STATES, qos.stream())
    clocks = probe.listen(Clock, topics.CLOCK, qos.clock())
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
        truth = TASK.human_reward(np.array(own[7].values), np.array(own[0].values))
        assert own[7].human_reward == pytest.approx(truth, abs=1e-12)
        assert not np.array_equal(
            conversions.image_from_ros(images[world][0]),
            conversions.image_from_ros(images[world][-1]),
        )
    assert infos[0].width == 112 and infos[0].k[0] > 100
    assert list(joints[0].name) == list(TASK.joint_names) and len(joints[0].position) == 9
    seconds = [conversions.time_from_ros(clock.clock) for clock in clocks]
    assert np.all(np.diff(seconds) >= 0)


def test_a_pending_state_and_its_image_are_repeated_every_second(probe, controller, simulator):
    images = probe.listen(Image, topics.CAMERA_IMAGE, qos.stream())
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


def test_a_lost_answer_stalls_nobody(probe, controller, simulator):
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
def test_an_action_that_is_no_answer_is_ignored_and_counted(probe, controller, simulator, changes):
    controller.obeys = False
    controller.reset(worlds=[0])
    probe.until(lambda: controller.states, 5.0, "a state")
    status = probe.until(lambda: probe.status_of("simulator"), 5.0, "diagnostics")
    before = int(status.get("ignored_actions", 0))
    for _ in range(3):
        controller.send(controller.states[0], **changes)
    probe.until(
        lambda: int(probe.status_of("simulator").get("ignored_actions", 0)) == before + 3,
        5.0,
        "three more are counted",
    )
    assert {s.step for s in controller.states} == {0}


def test_an_action_with_nan_is_ignored_with_a_warning(probe, controller, simulator):
    controller.obeys = False
    controller.reset(worlds=[0])
    probe.until(lambda: controller.states, 5.0, "a state")
    controller.send(controller.states[0], values=[float("nan"), 0.0])
    probe.until(lambda: "NaN" in probe.status_of("simulator").get("message", ""), 5.0, "a warning")
    assert simulator.process.poll() is None
    controller.send(controller.states[0])
    probe.until(lambda: controller.states[-1].step == 1, 5.0, "a good one counts")


def test_the_same_seed_gives_the_same_episode_and_another_run_another_id(
    probe, controller, simulator
):
    images = probe.listen(Image, topics.CAMERA_IMAGE, qos.stream())
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


def test_resets_that_make_no_sense_are_refused_with_the_reason(controller, simulator):
    refused = controller.reset(purpose="play")
    assert not refused.success and "known: demonstrate, evaluate, test, train" in refused.message
    refused = controller.reset(worlds=[2])
    assert not refused.success and "worlds are 0 to 1" in refused.message
    assert controller.reset().success


def test_a_controller_that_does_not_answer_is_named(probe, controller, simulator):
    controller.obeys = False
    controller.reset(controller="nobody_home")
    beats = probe.listen(Heartbeat, "simulator/heartbeat", qos.heartbeat())
    probe.until(
        lambda: beats and beats[-1].detail == "for actions of nobody_home",
        5.0,
        "the heartbeat says whom it waits for",
    )
    assert beats[-1].status == "waiting"


def test_world_info_reaches_who_comes_late(probe, controller, simulator):
    controller.reset()
    infos = probe.listen(WorldInfo, topics.WORLD_INFO, qos.latched())
    probe.until(lambda: infos, 10.0, "the latched message")
    world = conversions.world_from_ros(infos[0])
    assert (world.task, world.worlds, world.max_steps) == ("franka_group", 2, TASK.horizon)
    assert world.state_names == TASK.state_names and world.action_names == TASK.action_names
    assert world.camera_frames == ("env_0/camera_optical_frame", "env_1/camera_optical_frame")
