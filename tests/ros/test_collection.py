"""Which episode shows what, and back-pressure; without ROS."""

import numpy as np
import pytest

from rapl_core.errors import RaplError, UnknownNameError
from rapl_core.simulation.simulation import Simulation
from rapl_core.tasks import get_task
from rapl_ros.collection import Batch, Collection, CollectionGoal
from rapl_ros.lockstep import Assignment, Lockstep
from rapl_ros.time_shares import TimeShares

TASK = get_task("franka_group")


class Stage:
    """A collection on real worlds, without wire between them."""

    def __init__(self, worlds=2, **goal):
        self.collection = Collection(TASK, CollectionGoal(**goal), worlds)
        self.lockstep = Lockstep(Simulation(TASK, worlds, render=False), TimeShares(), render=False)
        self.stamp = 0
        self.now_s = 0.0
        self.actions = {}
        self.ended = []
        self.first_states = {}

    def reset(self):
        for batch in self.collection.plan():
            assignment = Assignment(
                "demonstrate", "demonstrator", batch.episodes, batch.first_episode, 7
            )
            scenes = self.lockstep.assign(batch.worlds, assignment, self._tick())
            self.collection.begin(batch, [scene.instant.episode_id for scene in scenes])
            self._show(scenes)

    def run(self, rounds=10_000):
        """Step as long as the demonstrator lets it."""
        for _ in range(rounds):
            if not self.lockstep.is_ready:
                return
            self._show(self.lockstep.advance(self._tick()))

    def record(self, episode_id):
        for command in self.collection.record(episode_id, self.now_s):
            self._send(command)

    def _show(self, scenes):
        for scene in scenes:
            if scene.instant.step == 0:
                self.first_states[scene.instant.episode_id] = scene.instant.values
            if scene.instant.is_last:
                self.ended.append(scene.instant.episode_id)
            command = self.collection.act(scene.instant, self.now_s)
            if command is not None:
                self._send(command)

    def _send(self, command):
        assert self.lockstep.offer(command) == ""
        key = command.episode_id.rpartition("-")[0]
        self.actions.setdefault(key, []).append((command.behaviour, *command.values))

    def _tick(self):
        self.stamp += 1
        return self.stamp


def test_it_collects_as_many_as_asked_for_with_back_pressure():
    stage = Stage(worlds=2, episodes=11)
    stage.reset()
    stage.run()
    # Two episodes a world may lack their recording; the one under way may end.
    assert len(stage.ended) == 6 and stage.collection.must_wait
    while not stage.collection.is_complete:
        assert stage.ended, "the collection has stalled"
        stage.record(stage.ended.pop(0))
        stage.run()
    assert len(stage.collection.recorded) == 11 and stage.collection.dropped == []
    assert not stage.lockstep.pending()


def test_a_repeated_state_gets_the_same_answer():
    stage = Stage(worlds=1, episodes=1, behaviours=("random",), noise=0.4)
    stage.reset()
    instant = stage.lockstep._worlds[0].scene.instant
    first = stage.collection.act(instant, 0.0)
    again = stage.collection.act(instant, 0.0)
    assert first is not None and first is again


def test_a_collection_follows_from_its_seed():
    one, two, other = (Stage(worlds=2, episodes=5, seed=seed, noise=-1.0) for seed in (3, 3, 4))
    for stage in (one, two, other):
        stage.reset()
        stage.run()
    assert one.actions == two.actions and len(one.actions) == 5
    assert one.actions != other.actions


def test_only_the_behaviours_asked_for_are_shown():
    stage = Stage(worlds=2, episodes=4, behaviours=("mime", "scatter"))
    stage.reset()
    stage.run()
    shown = {action[0] for actions in stage.actions.values() for action in actions}
    assert shown == {"mime", "scatter"}


def test_an_episode_that_is_not_recorded_is_replaced_by_another_start():
    stage = Stage(worlds=2, episodes=3)
    stage.reset()
    stage.run()
    assert len(stage.ended) == 3
    stage.record(stage.ended[0])
    stage.record(stage.ended[2])
    assert stage.collection.expire(10.0, deadline_s=15.0) == []
    assert not stage.collection.needs_reset
    stage.collection.expire(16.0, deadline_s=15.0)
    assert stage.collection.dropped == [stage.ended[1]]
    assert stage.collection.needs_reset
    stage.reset()
    stage.run()
    stage.record(stage.ended[3])
    assert stage.collection.is_complete
    starts = np.array(list(stage.first_states.values()))
    assert len(starts) == 4 and len(np.unique(starts, axis=0)) == 4


def test_a_simulator_that_went_away_loses_what_was_under_way_only():
    stage = Stage(worlds=2, episodes=6)
    stage.reset()
    stage.run(rounds=TASK.horizon + 5)  # the second pair is under way
    assert len(stage.ended) == 2
    stage.collection.interrupt()
    assert len(stage.collection.dropped) == 2
    assert not stage.collection.needs_reset  # two may still be recorded
    stage.record(stage.ended[0])
    stage.record(stage.ended[1])
    assert stage.collection.needs_reset
    assert stage.collection.plan() == [Batch((0, 1), 2, 3)]


@pytest.mark.parametrize(
    ("episodes", "worlds", "batches"),
    [
        (8, 4, [Batch((0, 1, 2, 3), 2, 5)]),
        (10, 4, [Batch((0, 1), 3, 5), Batch((2, 3), 2, 5)]),
        (3, 4, [Batch((0, 1, 2), 1, 5)]),
        (1, 1, [Batch((0,), 1, 5)]),
    ],
)
def test_episodes_are_spread_over_the_worlds(episodes, worlds, batches):
    goal = CollectionGoal(episodes=episodes, first_episode=5)
    assert Collection(TASK, goal, worlds).plan() == batches


def test_foreign_episodes_are_not_answered():
    stage = Stage(worlds=1, episodes=1)
    stage.reset()
    instant = stage.lockstep._worlds[0].scene.instant
    object.__setattr__(instant, "episode_id", "demonstrate-of-another-time")
    assert stage.collection.act(instant, 0.0) is None


@pytest.mark.parametrize(
    ("goal", "error", "complaint"),
    [
        ({"behaviours": ("juggle",)}, UnknownNameError, "'juggle'; known: .*mime"),
        ({"purpose": "play"}, UnknownNameError, "unknown purpose 'play'"),
        ({"episodes": 0}, RaplError, "cannot collect 0 episodes"),
        ({"noise": float("nan")}, RaplError, "noise nan"),
    ],
)
def test_a_goal_that_makes_no_sense_is_refused(goal, error, complaint):
    with pytest.raises(error, match=complaint):
        Collection(TASK, CollectionGoal(**({"episodes": 1} | goal)), worlds=2)
