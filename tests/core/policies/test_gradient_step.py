"""Our gradient step is that of stable-baselines3."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from learning_cases import SMALL, A, F, filled_trainer
from stable_baselines3.common.logger import Logger

from rapl_core.policies import EpisodeTransitions, SacConfig, SacTrainer


def parameters(trainer: SacTrainer) -> dict[str, torch.Tensor]:
    return {name: value.clone() for name, value in trainer.model.policy.state_dict().items()}


def train_with_stable_baselines3(trainer: SacTrainer, steps: int) -> dict[str, float]:
    logger = Logger(None, [])
    trainer.model.set_logger(logger)
    with torch.random.fork_rng(devices=[]):
        torch.set_rng_state(trainer._update_noise.get_state())
        trainer.model.train(steps, trainer.config.batch_size)
    return dict(logger.name_to_value)


@pytest.mark.parametrize(
    "config",
    [
        SMALL,
        replace(SMALL, critic_layer_norm=False),
        SacConfig(hidden=(16,), batch_size=64, buffer_size=500, entropy_coefficient="0.2"),
    ],
    ids=["learnt entropy", "no layer normalisation", "fixed entropy"],
)
def test_twenty_steps_equal_those_of_stable_baselines3(config: SacConfig) -> None:
    ours, theirs = filled_trainer(config), filled_trainer(config)
    before = parameters(ours)
    metrics = ours.update(20)
    logged = train_with_stable_baselines3(theirs, 20)
    for name, value in parameters(theirs).items():
        got = parameters(ours)[name]
        torch.testing.assert_close(got, value, rtol=2e-4, atol=2e-5, msg=name)
        moved = (value - before[name]).abs().max()
        assert moved > 20 * (got - value).abs().max(), f"{name}: {moved}"
    assert metrics.actor_loss == pytest.approx(logged["train/actor_loss"], rel=1e-4)
    assert metrics.critic_loss == pytest.approx(logged["train/critic_loss"], rel=1e-4)
    assert metrics.entropy_coefficient == pytest.approx(logged["train/ent_coef"], rel=1e-4)
    if "train/ent_coef_loss" in logged:
        assert metrics.entropy_loss == pytest.approx(logged["train/ent_coef_loss"], rel=1e-4)


def test_a_bandit_is_solved() -> None:
    # One step, reward -(a - 0.5)^2 per dimension: the policy's mode must come near 0.5.
    config = SacConfig(hidden=(32,), batch_size=64, learning_rate=3e-3, discount=0.0)
    trainer = SacTrainer(F, A, config, 0)
    rng = np.random.default_rng(0)
    for number in range(40):
        actions = rng.uniform(-1, 1, (20, A)).astype(np.float32)
        trainer.add_episode(
            EpisodeTransitions(
                episode_id=f"e{number}",
                number=number,
                world=0,
                observations=np.zeros((21, F), dtype=np.float32),
                actions=actions,
                rewards=-10.0 * ((actions - 0.5) ** 2).sum(axis=1).astype(np.float64),
                terminated=False,
            )
        )
    trainer.update(1500)
    trainer.refresh()
    mode = trainer.act(np.zeros((1, F), dtype=np.float32), deterministic=True)
    assert mode == pytest.approx(0.5, abs=0.12)


def test_only_termination_stops_the_bootstrap() -> None:
    config = SacConfig(hidden=(16,), batch_size=16, entropy_coefficient="0.0")
    trainer = filled_trainer(config, episodes=2)  # the second episode terminated
    replay = trainer.replay
    assert replay.dones[:20, 0].tolist() == [0.0] * 19 + [1.0]
    batch = replay._get_samples(np.array([9, 19]))  # last of each episode
    step = trainer._step
    with torch.no_grad():
        following = step._sample(batch.next_observations, torch.zeros(2, A))
        target = step.target_values(batch, following, torch.tensor(0.0))
    assert target[1, 0] == batch.rewards[1, 0]
    assert target[0, 0] != batch.rewards[0, 0]


def test_learning_leaves_the_global_random_states_alone() -> None:
    torch.manual_seed(3)
    np.random.seed(3)
    before = torch.get_rng_state().clone(), np.random.get_state()[1].copy()  # type: ignore[index]
    trainer = filled_trainer()
    trainer.update(3)
    trainer.refresh()
    trainer.act(np.zeros((2, F), dtype=np.float32))
    assert torch.equal(torch.get_rng_state(), before[0])
    assert np.array_equal(np.random.get_state()[1], before[1])  # type: ignore[index]
