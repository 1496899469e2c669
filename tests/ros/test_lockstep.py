"""Who drives which world, and when they step."""

import numpy as np
import pytest

from rapl_core.errors import RaplError, UnknownNameError
from rapl_core.simulation.simulation import Simulation
from rapl_core.tasks import get_task
from rapl_ros.lockstep import Assignment, Lockstep
from rapl_ros.time_shares import TimeShares
from rapl_ros.wire import answer

TASK = get_task("franka_group")
PUSH = [1.0, 0.0]


class Driver:
    """A lockstep of real worlds, and the stamps it is given."""

    def __init__(self, worlds: int) -> None:
        self.lockstep = Lockstep(Simulation(TASK, worlds, render=False), TimeShares(), render=False)
        self.stamp = 1000
        self.scenes = {}

    def tick(self) -> int:
        self.stamp += 80
        return self.stamp

    def assign(self, worlds=(), **changes):
        values = dict(purpose="train", controller="learner", episodes=0, first_episode=0, seed=1)
        scenes = self.lockstep.assign(worlds, Assignment(**(values | changes)), self.tick())
        return self.keep(scenes)

    def keep(self, scenes):
        instants = [scene.instant for scene in scenes]
        self.scenes |= {instant.world: instant for instant in instants}
        return instants

    def offer(self, world, values=PUSH, /, **changes):
        command = answer(self.scenes[world], values)
        for name, value in changes.items():
            object.__setattr__(command, name, value)
        return self.lockstep.offer(command)

    def advance(self):
        return self.keep(self.lockstep.advance(self.tick()))

    def finish_episode(self):
        """Answer all until every world is at its last instant."""
        while not all(instant.is_last for instant in self.scenes.values()):
            for world in self.scenes:
                assert self.offer(world) == ""
            self.advance()


@pytest.fixture
def driver():
    return Driver(2)


def test_a_reset_begins_an_episode_in_every_world(driver):
    instants = driver.assign(purpose="evaluate", controller="learner", seed=4)
    assert [instant.world for instant in instants] == [0, 1]
    assert {instant.step for instant in instants} == {0}
    assert {(i.purpose, i.controller) for i in instants} == {("evaluate", "learner")}
    assert len({instant.episode_id for instant in instants}) == 2


def test_worlds_step_only_when_each_has_its_action(driver):
    driver.assign()
    assert not driver.lockstep.is_ready
    assert driver.offer(0) == ""
    assert not driver.lockstep.is_ready
    assert [scene.instant.world for scene in driver.lockstep.pending()] == [1]
    assert driver.offer(1) == ""
    assert driver.lockstep.is_ready
    assert [instant.step for instant in driver.advance()] == [1, 1]
    assert not driver.lockstep.is_ready


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"step": 1}, "other step"),
        ({"episode_id": "train-s1-w0-000000-other"}, "other episode"),
        ({"controller": "demonstrator"}, "other controller"),
        ({"world": 7}, "unknown world"),
        ({"values": np.zeros(3)}, "wrong size"),
    ],
)
def test_an_action_that_answers_something_else_is_ignored_with_its_reason(driver, changes, reason):
    driver.assign()
    assert driver.offer(0, **changes) == reason
    assert len(driver.lockstep.pending()) == 2


def test_a_second_answer_is_ignored(driver):
    driver.assign()
    assert driver.offer(0) == ""
    assert driver.offer(0, [-1.0, 0.0]) == "answered already"


def test_an_answer_to_the_last_state_is_ignored(driver):
    driver.assign()
    driver.finish_episode()
    assert driver.offer(0) == "episode is over"


def test_an_episode_has_the_horizons_steps_and_the_next_begins_by_itself(driver):
    first = {instant.episode_id for instant in driver.assign()}
    driver.finish_episode()
    assert {instant.step for instant in driver.scenes.values()} == {TASK.horizon}
    assert not any(instant.terminated for instant in driver.scenes.values())
    assert driver.lockstep.is_ready  # no action is needed for what follows
    second = driver.advance()
    assert {instant.step for instant in second} == {0}
    assert first.isdisjoint(instant.episode_id for instant in second)


def test_worlds_rest_after_as_many_episodes_as_asked_for(driver):
    driver.assign([0], episodes=1)
    driver.assign([1], episodes=2)
    driver.finish_episode()
    assert driver.lockstep.controllers == {"learner"}
    assert [(i.world, i.step) for i in driver.advance()] == [(1, 0)]  # world 0 rests
    assert driver.offer(0) == "world rests"
    while not driver.scenes[1].is_last:
        assert driver.offer(1) == ""
        driver.advance()
    assert not driver.lockstep.is_ready and not driver.lockstep.pending()
    assert driver.lockstep.controllers == set()


def test_stamps_increase_strictly_in_every_world_across_resets(driver):
    stamps = {0: [], 1: []}
    for _ in range(2):
        for instant in driver.assign():
            stamps[instant.world].append(instant.stamp_ns)
        for _ in range(5):
            driver.offer(0)
            driver.offer(1)
            for instant in driver.advance():
                stamps[instant.world].append(instant.stamp_ns)
                assert instant.image.stamp_ns == instant.stamp_ns
    for of_world in stamps.values():
        assert len(of_world) == 12 and np.all(np.diff(of_world) > 0)


def test_a_reset_in_the_middle_begins_another_episode_and_forgets_the_action(driver):
    before = driver.assign()[0].episode_id
    driver.offer(0)
    after = driver.assign([0])[0].episode_id
    assert before != after
    assert [scene.instant.world for scene in driver.lockstep.pending()] == [0, 1]


def test_a_start_follows_from_purpose_seed_world_and_number_alone():
    one, other = Driver(2), Driver(2)
    first = one.assign()
    one.finish_episode()
    second = one.advance()
    again = other.assign([1], first_episode=1)
    np.testing.assert_array_equal(second[1].values, again[0].values)
    starts = [
        tuple(instant.values[10:16])
        for instants in (first, second, other.assign(seed=2), other.assign(purpose="evaluate"))
        for instant in instants
    ]
    assert len(set(starts)) == len(starts)


def test_ids_sort_in_an_order_that_follows_from_the_seed_and_never_repeat(driver):
    one = Assignment("demonstrate", "demonstrator", 0, 0, 3)
    two = Assignment("demonstrate", "demonstrator", 0, 0, 3)
    assert one.episode_id(0, 9) < one.episode_id(0, 10) < one.episode_id(1, 0)
    assert one.episode_id(0, 0) != two.episode_id(0, 0)


def test_without_assignment_worlds_rest(driver):
    driver.assign()
    assert driver.lockstep.assign([], None, driver.tick()) == []
    assert driver.lockstep.controllers == set() and not driver.lockstep.pending()
    assert driver.offer(0) == "world rests"


def test_an_unknown_purpose_world_or_nobody_in_control_is_refused(driver):
    with pytest.raises(UnknownNameError, match="unknown purpose 'play'; known: demonstrate"):
        driver.assign(purpose="play")
    with pytest.raises(RaplError, match="world 5 does not exist: worlds are 0 to 1"):
        driver.assign([5])
    with pytest.raises(RaplError, match="nobody"):
        driver.assign(controller="")
