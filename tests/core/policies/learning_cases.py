"""Episodes and trainers for the tests of learning."""

import numpy as np

from rapl_core.policies import EpisodeTransitions, SacConfig, SacTrainer

F, A = 5, 2

SMALL = SacConfig(hidden=(32, 32), batch_size=32, buffer_size=1000)


def transitions(
    number: int, world: int = 0, steps: int = 10, terminated: bool = False
) -> EpisodeTransitions:
    """An episode that follows from its number and world."""
    rng = np.random.default_rng([number, world])
    return EpisodeTransitions(
        episode_id=f"w{world}-{number}",
        number=number,
        world=world,
        observations=rng.normal(size=(steps + 1, F)).astype(np.float32),
        actions=rng.uniform(-1, 1, (steps, A)).astype(np.float32),
        rewards=rng.normal(-2, 1, steps),
        terminated=terminated,
    )


def filled_trainer(config: SacConfig = SMALL, seed: int = 0, episodes: int = 12) -> SacTrainer:
    """A trainer with some episodes to learn from, the last of which terminated."""
    trainer = SacTrainer(F, A, config, seed)
    for number in range(episodes):
        trainer.add_episode(transitions(number, terminated=number == episodes - 1))
    return trainer
