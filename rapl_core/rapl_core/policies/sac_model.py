"""The SAC of stable-baselines3 without an environment: networks, optimisers, replay buffer."""

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import SAC
from stable_baselines3.common.policies import ContinuousCritic
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.sac.policies import SACPolicy
from torch import nn

from rapl_core.policies.config import SacConfig
from rapl_core.policies.replay import EpisodeReplay


class LayerNormPolicy(SACPolicy):
    """Actor and critics of stable-baselines3, the critics with layer normalisation.

    After Ball et al. 2023, "Efficient online reinforcement learning with offline data". Without it
    Q now and then outgrew everything that can be earned, and a policy that had learnt its task lost
    it for ten thousand steps (docs/paper_notes.md, SAC).
    """

    def make_critic(
        self, features_extractor: BaseFeaturesExtractor | None = None
    ) -> ContinuousCritic:
        """Return critics whose hidden layers are normalised before their ReLU."""
        critic = super().make_critic(features_extractor)
        for number, network in enumerate(critic.q_networks):
            layers: list[nn.Module] = []
            for layer in network.children():
                if isinstance(layer, nn.ReLU) and isinstance(layers[-1], nn.Linear):
                    layers.append(nn.LayerNorm(layers[-1].out_features))
                layers.append(layer)
            critic.q_networks[number] = nn.Sequential(*layers)
            setattr(critic, f"qf{number}", critic.q_networks[number])
        return critic


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
        LayerNormPolicy if config.critic_layer_norm else SACPolicy,
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
