"""The X-MAGICAL arena: it moves as it should, the same way every time, and is recognisable."""

import mujoco
import numpy as np
import pytest

from rapl_core.simulation.rendering import Renderer
from rapl_core.simulation.simulation import Simulation, episode_rng
from rapl_core.tasks import get_task


def placed(simulation, robot, blocks):
    """Begin an episode and put everything somewhere else."""
    simulation.reset(0, episode_rng(0, "test", 0, 0))
    simulation.dynamics.place(simulation.data[0], np.array(robot), np.array(blocks))
    return simulation


@pytest.fixture(scope="module")
def simulation():
    simulation = Simulation(get_task("xmagical_avoid"), render=False)
    yield simulation
    simulation.close()


@pytest.mark.parametrize("name", ["xmagical_group", "xmagical_avoid_gripper"])
def test_an_episode_is_the_same_to_the_last_bit_after_anything(name):
    task = get_task(name)
    simulation = Simulation(task, worlds=2, render=False)

    def roll(world, seed, episode):
        rng = np.random.default_rng(seed)
        states = [simulation.reset(world, episode_rng(0, "train", 0, episode)).state]
        for _ in range(task.horizon):
            action = rng.uniform(-1, 1, len(task.action_names))
            action[0] = abs(action[0])  # drives into blocks and walls
            states.append(simulation.step(world, action).state)
        return np.stack(states)

    first = roll(0, 1, 5)
    roll(1, 2, 6)
    assert np.array_equal(first, roll(1, 1, 5))


def test_it_drives_where_it_looks_as_fast_as_the_public_one(simulation):
    placed(simulation, (0.0, -0.5, np.pi / 4), [(0.9, -0.9)])
    for _ in range(8):
        state = simulation.step(0, np.array([1.0, 0.0])).state
    way = state[:2] - [0.0, -0.5]
    assert np.hypot(*way) == pytest.approx(0.738, abs=0.01), "0.8 m/s for 1 s, less the start"
    assert np.arctan2(-way[0], way[1]) == pytest.approx(np.pi / 4, abs=0.02)


def test_it_turns_to_the_left_at_most_at_its_rate(simulation):
    placed(simulation, (0.0, 0.0, 0.0), [(0.9, -0.9)])
    for _ in range(4):
        state = simulation.step(0, np.array([0.0, 1.0])).state
    assert state[2] == pytest.approx(4 * 2.5 / 8, abs=0.06)
    assert np.hypot(*state[:2]) < 0.01


def test_a_block_moves_with_what_pushes_it_and_stays_where_it_is_left(simulation):
    placed(simulation, (0.0, -0.3, 0.0), [(0.0, 0.0)])
    for _ in range(8):
        state = simulation.step(0, np.array([0.5, 0.0])).state
    assert state[4] == pytest.approx(state[1] + 0.05 + 0.106, abs=0.01)
    assert abs(state[3]) < 0.01
    simulation.step(0, np.array([-0.8, 0.0]))  # a period in which it may slide on
    left = simulation.step(0, np.array([-0.8, 0.0])).state[3:5]
    for _ in range(5):
        state = simulation.step(0, np.array([-0.3, 0.5])).state
    assert np.abs(state[3:5] - left).max() < 1e-3


@pytest.mark.parametrize("degrees", [0, 22.5, 45, 67.5])
def test_the_floor_holds_a_block_alike_in_every_direction(degrees):
    """Below 1.5 N it creeps, above it slides."""
    task = get_task("xmagical_avoid")
    model = task.build_spec().compile()
    data = mujoco.MjData(model)
    body = model.body("block1").id
    way = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])

    def slides(force):
        task.bind(model).place(data, np.array([0.8, -0.8, 0.0]), np.zeros((1, 2)))
        data.xfrc_applied[body, :2] = force * way
        mujoco.mj_step(model, data, 40)
        return np.hypot(*data.qpos[:2]) > 0.1

    assert not slides(1.4) and slides(1.65)


def test_nothing_leaves_the_arena():
    task = get_task("xmagical_group_gripper")
    simulation = Simulation(task, render=False)
    rng = np.random.default_rng(0)
    for episode in range(3):
        state = simulation.reset(0, episode_rng(0, "train", 0, episode)).state
        turn = rng.uniform(-0.3, 0.3)
        for _ in range(task.horizon):
            state = simulation.step(0, np.array([1.0, turn, rng.uniform(-1, 1)])).state
            assert np.abs(state[[0, 1]]).max() < 1.1 - 0.15
            assert np.abs(state[3:7]).max() < 1.1 - 0.08
    simulation.close()


def test_the_grippers_fingers_close_and_open():
    simulation = placed(
        Simulation(get_task("xmagical_avoid_gripper"), render=False), (0, -0.5, 0), [(0.9, -0.9)]
    )
    for _ in range(5):
        state = simulation.step(0, np.array([0.0, 0.0, 1.0])).state
    assert state[-1] < 0.05
    for _ in range(5):
        state = simulation.step(0, np.array([0.0, 0.0, -1.0])).state
    assert state[-1] > 0.95
    simulation.close()


def test_robot_blocks_goal_and_zone_are_seen_where_they_are():
    task = get_task("xmagical_avoid_gripper")
    simulation = Simulation(task)
    placed(simulation, (-0.5, -0.5, 0.0), [(0.5, -0.3)])
    picture = simulation.render(0).astype(float)
    simulation.close()

    def colour(x, y):
        """Mean colour of the 3 x 3 pixels around a place in m."""
        scale = task.image_size / (2 * task.config.view_half)
        column, row = round((x + 1.122) * scale), round((1.122 - y) * scale)
        return picture[row - 1 : row + 2, column - 1 : column + 2].mean(axis=(0, 1))

    red, pink, blue = colour(0.5, -0.3), colour(0.0, 0.95), colour(0.0, 0.35)
    white, grey = colour(0.6, 0.3), colour(-0.5, -0.55)
    assert white.min() > 250
    assert red[0] > 230 and red[1] < 140
    assert pink[0] > 240 and 180 < pink[1] < 200
    assert blue[2] > 200 and blue[0] < 145
    assert np.ptp(grey) < 20 and grey.mean() < 180
    seen = np.abs(picture - red).max(axis=2) < 12
    assert 9 <= np.ptp(np.nonzero(seen.any(axis=0))[0]) + 1 <= 12


@pytest.mark.parametrize("name", ["xmagical_avoid", "xmagical_group_gripper"])
def test_what_is_saved_in_drawing_is_not_seen(name):
    """Coarse faces and a buffer of the picture's size, beside MuJoCo's own settings."""
    task = get_task(name)
    simulation = Simulation(task)
    simulation.reset(0, episode_rng(0, "test", 0, 0))
    action = np.ones(len(task.action_names))
    for _ in range(10):
        simulation.step(0, action)  # turns, so that no edge lies along the pixels
    picture = simulation.render(0).astype(float)
    simulation.close()
    fine = task.build_spec()
    fine.visual.quality.numquads, fine.visual.quality.numstacks = 4, 16
    renderer = Renderer(fine.compile(), task.camera, task.image_size)
    difference = np.abs(renderer.render(simulation.data[0]) - picture)
    renderer.close()
    assert difference.mean() < 0.01 and (difference.max(axis=2) > 0).sum() <= 10
