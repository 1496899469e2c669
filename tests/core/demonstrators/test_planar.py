"""People-like ways in the X-MAGICAL arena: what they bring about, told by the tasks themselves."""

import numpy as np
import pytest

from rapl_core.demonstrators import behaviour_names, draw_behaviours, make_demonstrator
from rapl_core.demonstrators.demonstrator import behaviours_of
from rapl_core.simulation.simulation import Simulation, episode_rng
from rapl_core.tasks import get_task, task_names

XMAGICAL = [name for name in task_names() if name.startswith("xmagical")]


def play(name, behaviour, episodes):
    """States (T + 1, S) and success of some episodes."""
    simulation = Simulation(get_task(name), render=False)
    played = []
    for episode in range(episodes):
        demonstrator = make_demonstrator(
            simulation.task, behaviour, np.random.default_rng([7, episode])
        )
        snapshot = simulation.reset(0, episode_rng(0, "demonstrate", 0, episode))
        states = [snapshot.state]
        while not snapshot.is_last:
            snapshot = simulation.step(0, demonstrator.act(snapshot.state, snapshot.step))
            states.append(snapshot.state)
        played.append((np.stack(states), snapshot.success))
    simulation.close()
    return played


@pytest.mark.parametrize(
    ("name", "behaviour"),
    [
        ("xmagical_avoid", "around_near"),
        ("xmagical_avoid", "around_far"),
        ("xmagical_avoid", "around_wide"),
        ("xmagical_avoid_gripper", "around_near"),
        ("xmagical_group", "together_straight"),
        ("xmagical_group", "together_side_by_side"),
        ("xmagical_group", "together_in_column"),
        ("xmagical_group_gripper", "together_straight"),
        ("xmagical_group_mediumstick", "together_side_by_side"),
        ("xmagical_group_longstick", "together_straight"),
        ("xmagical_progress", "one_at_a_time"),
        ("xmagical_sweep_shortstick", "sweep_all"),
        ("xmagical_sweep_longstick", "sweep_all"),
    ],
)
def test_preferred_ways_mostly_succeed(name, behaviour):
    assert behaviours_of(get_task(name))[behaviour].preferred
    assert np.mean([success for _, success in play(name, behaviour, 10)]) >= 0.6


def test_through_the_zone_arrives_and_still_fails():
    task = get_task("xmagical_avoid")
    played = play("xmagical_avoid", "through", 12)
    assert np.mean([task.in_goal(states)[-1].all() for states, _ in played]) >= 0.8
    assert np.mean([success for _, success in played]) <= 0.1


@pytest.mark.parametrize("body", ["", "_mediumstick", "_gripper"])
def test_one_at_a_time_arrives_and_mostly_fails_for_want_of_grouping(body):
    task = get_task(f"xmagical_group{body}")
    played = play(task.name, "one_at_a_time", 12)
    assert np.mean([task.in_goal(states)[-1].all() for states, _ in played]) >= 0.8
    assert np.mean([success for _, success in played]) <= 0.2


@pytest.mark.parametrize(("name", "mime"), [("xmagical_avoid", "mime_around"),
                                            ("xmagical_group", "mime")])  # fmt: skip
def test_a_mime_moves_the_robot_and_no_block(name, mime):
    task = get_task(name)
    for states, _ in play(name, mime, 6):
        assert np.ptp(task.robot_of(states)[:, 1]) > 0.8
        assert np.abs(task.blocks_of(states) - task.blocks_of(states[0])).max() < 0.02


@pytest.mark.parametrize("name", XMAGICAL)
def test_every_task_has_preferred_and_disliked_ways_in_their_shares(name):
    task = get_task(name)
    known = behaviours_of(task)
    assert sum(b.share for b in known.values()) == pytest.approx(1.0)
    telling = [b.preferred for b in known.values() if b.telling]
    assert sorted(telling) in ([False, True], [True, True])
    assert any(b.preferred for b in known.values())
    shown = draw_behaviours(task, 200, np.random.default_rng(0))
    assert set(shown) == set(behaviour_names(task))
