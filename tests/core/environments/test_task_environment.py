"""Every task is a gymnasium environment that the checkers of gymnasium and of SB3 accept."""

import warnings

import gymnasium
import numpy as np
import pytest
import stable_baselines3.common.env_checker as sb3
from gymnasium.utils.env_checker import check_env

from rapl_core.environments import environment_id, register_environments
from rapl_core.errors import UnknownNameError
from rapl_core.tasks import get_task, task_names

DRAWN = ["franka_clutter", "xmagical_avoid"]
"""One of each family: drawing takes its time, and the wrapper is the same for all."""


def test_every_task_is_registered_under_a_name_of_its_own():
    register_environments()
    ids = {environment_id(name) for name in task_names()}
    assert environment_id("franka_group") == "rapl/FrankaGroup-v0"
    assert len(ids) == len(task_names()) and ids <= set(gymnasium.registry)


@pytest.mark.parametrize("name", task_names())
def test_with_states_it_passes_both_checkers(name):
    env = gymnasium.make(environment_id(name)).unwrapped
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*observation space (min|max)imum.*infinity.*")
        check_env(env, skip_render_check=True)
        sb3.check_env(env)
    env.close()


@pytest.mark.parametrize("name", DRAWN)
def test_with_pixels_it_passes_both_checkers(name):
    env = gymnasium.make(environment_id(name), observations="pixels").unwrapped
    check_env(env, skip_render_check=True)
    sb3.check_env(env)
    env.close()


def test_an_episode_is_that_of_the_task():
    env = gymnasium.make("rapl/FrankaGroup-v0", observations="features").unwrapped
    task = get_task("franka_group")
    first, info = env.reset(seed=5)
    states = [info["state"]]
    assert np.array_equal(first, task.policy_features(states[0]))
    for step in range(1, task.horizon + 1):
        _, reward, terminated, truncated, info = env.step(np.array([1.0, 0.0], np.float32))
        states.append(info["state"])
        assert not terminated and truncated == (step == task.horizon)
        assert reward == task.human_reward(states[-1], states[0])
    assert info["is_success"] == task.success(np.stack(states))
    again, _ = env.reset(seed=5)
    assert np.array_equal(first, again)
    env.close()


def test_it_renders_the_cameras_picture_when_asked():
    env = gymnasium.make("rapl/FrankaGroup-v0", render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (112, 112, 3) and picture.dtype == np.uint8 and picture.std() > 10
    env.close()


def test_an_unknown_observation_names_the_known_ones():
    with pytest.raises(UnknownNameError, match="features, pixels, state"):
        gymnasium.make("rapl/FrankaGroup-v0", observations="sound")
