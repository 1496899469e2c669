"""The X-MAGICAL tasks: their numbers follow from the state alone."""

import numpy as np
import pytest

from rapl_core.errors import ShapeError, UnknownNameError
from rapl_core.tasks import get_task, task_names
from rapl_core.tasks.xmagical_bodies import get_body
from rapl_core.tasks.xmagical_dynamics import PlanarScene

XMAGICAL = [name for name in task_names() if name.startswith("xmagical")]


def ride(task, ways):
    """States (T + 1, S) of scenes given as robot (3,) and blocks."""
    opening = 1.0 if task.body.has_fingers else None
    return np.stack(
        [
            task.observe(PlanarScene(np.array(robot), np.array(blocks), opening))
            for robot, blocks in ways
        ]
    )


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("xmagical_avoid", 7),
        ("xmagical_group", 9),
        ("xmagical_progress", 9),
        ("xmagical_avoid_gripper", 8),
        ("xmagical_sweep_shortstick", 16),
        ("xmagical_sweep_gripper", 17),
    ],
)
def test_states_have_the_numbers_of_the_paper_and_of_the_public_package(name, size):
    task = get_task(name)
    assert len(task.state_names) == len(task.state_units) == size
    assert len(set(task.state_names)) == size


@pytest.mark.parametrize("name", XMAGICAL)
def test_policy_features_are_finite_and_of_unit_size(name):
    task = get_task(name)
    start = task.draw_start(np.random.default_rng(0))
    state = ride(task, [(start.robot, start.blocks)])[0]
    features = task.policy_features(state)
    assert features.dtype == np.float32 and np.isfinite(features).all()
    assert np.abs(features).max() < 5


def test_features_say_where_a_block_is_as_the_robot_sees_it():
    task = get_task("xmagical_avoid")
    robot = (0.1, -0.2, np.pi / 2)  # looks to the left of the picture
    state = ride(task, [(robot, [(-0.2, -0.1)])])[0]
    ahead, right = task.policy_features(state)[6:8] / 2
    assert (ahead, right) == (pytest.approx(0.3), pytest.approx(0.1))


def test_a_state_of_another_shape_is_refused_by_name():
    with pytest.raises(ShapeError, match=r"xmagical_avoid.*\(7,\)"):
        get_task("xmagical_avoid").human_reward(np.zeros(9), np.zeros(9))
    with pytest.raises(UnknownNameError, match="mediumstick"):
        get_body("brick")


def test_the_reward_of_avoiding_is_the_papers():
    task = get_task("xmagical_avoid")
    robot = (0.0, -0.8, 0.0)
    far, near, inside = ride(
        task, [(robot, [(0.5, 0.0)]), (robot, [(0.32, 0.3)]), (robot, [(0.0, 0.3)])]
    )
    top = task.config.goal_near + task.config.block_half
    assert task.human_reward(far, far) == pytest.approx(-top)
    assert task.human_reward(near, far) == pytest.approx(-(top - 0.3) - 2)
    assert task.human_reward(inside, far) == pytest.approx(-(top - 0.3) - 2)
    assert task.zone_distance(np.array([0.18 + 0.3, 0.6 + 0.4])) == pytest.approx(0.5)


def test_success_in_avoiding_wants_the_way_clean_and_the_end_in_the_strip():
    task = get_task("xmagical_avoid")
    low, away = (0.0, -0.8, 0.0), (0.6, -0.2, 0.0)
    start, beside, goal = [(0.1, -0.4)], [(0.5, 0.3)], [(0.5, 0.9)]
    assert task.success(ride(task, [(low, start), (away, beside), (away, goal)]))
    assert not task.success(ride(task, [(low, start), (low, [(0.1, 0.3)]), (low, goal)])), "through"
    assert not task.success(ride(task, [(low, start), (low, [(0.27, 0.3)]), (low, goal)])), "corner"
    within = (0.0, 0.3, 0.0)
    assert not task.success(ride(task, [(low, start), (within, beside), (away, goal)])), "robot"
    assert task.success(ride(task, [(low, start), (away, beside), (away, goal), (within, goal)])), (
        "the robot may go where it likes once the block is in the strip"
    )
    assert not task.success(ride(task, [(low, start), (away, beside)])), "never arrived"


def test_success_in_grouping_wants_both_together_from_the_moment_one_enters():
    task = get_task("xmagical_group")
    robot = (0.0, -0.6, 0.0)
    apart, close = [(-0.23, 0.0), (0.23, 0.0)], [(-0.1, 0.6), (0.12, 0.6)]
    inside = [(-0.1, 0.9), (0.12, 0.9)]
    one_in = [(-0.1, 0.9), (0.12, 0.3)]
    both = [(robot, apart), (robot, close), (robot, inside)]
    assert task.success(ride(task, both))
    assert not task.success(ride(task, [(robot, apart), (robot, one_in), (robot, inside)])), "apart"
    assert not task.success(ride(task, both[:2])), "never arrived"
    assert not task.success(ride(task, [*both, (robot, close)])), "left again"
    progress = get_task("xmagical_progress")
    assert progress.success(ride(progress, [(robot, apart), (robot, one_in), (robot, inside)]))


def test_blocks_to_be_grouped_start_apart_the_near_one_on_either_side():
    task = get_task("xmagical_group")
    starts = np.stack([task.draw_start(np.random.default_rng(s)).blocks for s in range(60)])
    gaps = np.linalg.norm(starts[:, 0] - starts[:, 1], axis=1)
    assert gaps.min() > task.gap_threshold
    assert (starts[:, 0, 1] < starts[:, 1, 1]).all()
    left = (starts[:, 0, 0] < starts[:, 1, 0]).mean()
    assert 0.3 < left < 0.7


def test_the_rewards_of_grouping_and_of_progress_are_the_papers():
    task, progress = get_task("xmagical_group"), get_task("xmagical_progress")
    way = [((0.0, -0.6, 0.0), [(-0.2, 0.0), (0.2, 0.3)])]
    state = ride(task, way)[0]
    top = task.config.goal_near + task.config.block_half
    assert task.human_reward(state, state) == pytest.approx(-top - 0.5)
    assert progress.human_reward(state, state) == pytest.approx(-(top + top - 0.3) / 2)


def test_sweeping_is_rewarded_as_in_the_public_package():
    task = get_task("xmagical_sweep_shortstick")
    state = ride(task, [((0.0, -0.6, 0.5), [(-0.5, 0.9), (0.0, 0.4), (0.5, 0.0)])])[0]
    assert task.human_reward(state, state) == pytest.approx(-(0.6 + 1.0) / 3)
    assert np.allclose(task.robot_of(state), [0.0, -0.6, 0.5])
    assert not task.success(state[None])
    done = ride(task, [((0.0, -0.6, 0.5), [(-0.5, 0.9), (0.0, 0.89), (0.5, 0.9)])])
    assert task.success(done) and task.human_reward(done[0], state) == 0.0


def test_layout_variants_draw_other_places_and_the_public_start_none():
    fixed, drawn = (get_task(f"xmagical_sweep_longstick{v}") for v in ("", "_layout"))
    starts = [fixed.draw_start(np.random.default_rng(seed)).blocks for seed in range(5)]
    assert all(np.array_equal(start, starts[0]) for start in starts)
    rows = [drawn.draw_start(np.random.default_rng(seed)).blocks for seed in range(20)]
    assert len({tuple(row.ravel()) for row in rows}) == 20
    for row in rows:
        assert np.ptp(row[:, 1]) == 0 and -0.1 <= row[0, 1] <= 0.5
        assert np.abs(np.diff(np.sort(row[:, 0]))).min() >= 0.48 - 1e-9


def test_the_long_stick_has_half_the_time():
    assert get_task("xmagical_sweep_longstick").horizon == 50
    assert get_task("xmagical_sweep_shortstick").horizon == 100
