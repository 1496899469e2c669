"""The SAC of stable-baselines3 without an environment: networks, optimisers, replay buffer."""

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import SAC

from rapl_core.policies.config import SacConfig
from rapl_core.policies.replay import EpisodeReplay


def make_sac(
    observation_size: int,
    action_size: int,
    config: SacConfig,
    torch_seed: int,
    replay_rng: np.random.Generator,
) -> SAC:
    """Return a SAC that is fed from outside and never steps an environment.

    Set up as stable-baselines3 does when it loads a saved one. Its weights follow from
    ``torch_seed``; the process's own random states are left alone.
    """
    automatic = config.entropy_coefficient.startswith("auto")
    model = SAC(
        "MlpPolicy",
        env=None,  # type: ignore[arg-type]
        learning_rate=config.learning_rate,
        buffer_size=config.buffer_size,
        batch_size=config.batch_size,
        tau=config.target_rate,
        gamma=config.discount,
        ent_coef=config.entropy_coefficient if automatic else float(config.entropy_coefficient),
        target_entropy=-float(action_size),
        replay_buffer_class=EpisodeReplay,
        replay_buffer_kwargs={"rng": replay_rng},
        policy_kwargs={
            "net_arch": list(config.hidden),
            # The same Adam in one kernel: a fifth of a gradient step less.
            "optimizer_kwargs": {"fused": True},
        },
        device="cpu",
        seed=None,
        _init_setup_model=False,
    )
    model.observation_space = spaces.Box(-np.inf, np.inf, (observation_size,), np.float32)
    model.action_space = spaces.Box(-1.0, 1.0, (action_size,), np.float32)
    model.n_envs = 1
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(torch_seed)
        model._setup_model()
    model.policy.set_training_mode(True)
    return model
