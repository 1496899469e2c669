"""One gradient step of SAC on the networks and optimisers of stable-baselines3.

The same mathematics as ``stable_baselines3.SAC.train``, to which a test compares it, and
quicker on a CPU: the squashed Gaussian in closed form, no gradients of the critics' weights in
the actor's loss, one kernel for the target critics, no reading back of scalars, noise from a
generator of its own. ``experiments/benchmark_sac.py`` says how much.
"""

import math
from typing import NamedTuple

import torch
import torch.nn.functional as F  # noqa: N812
from stable_baselines3 import SAC
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from torch import Tensor

_HALF_LOG_2_PI = 0.5 * math.log(2 * math.pi)
_SQUASH_EPSILON = 1e-6
"""Of stable-baselines3's SquashedDiagGaussianDistribution."""


class StepLosses(NamedTuple):
    """What a gradient step saw; scalars that are not read yet."""

    actor: Tensor
    critic: Tensor
    entropy: Tensor
    """Loss of the entropy coefficient; 0 when it is fixed."""
    entropy_coefficient: Tensor


class GradientStep:
    """Takes gradient steps for one SAC.

    :param noise: where the actions' noise comes from.
    """

    def __init__(self, model: SAC, noise: torch.Generator) -> None:
        self._model = model
        self._noise = noise
        self._actor: list[Tensor] = list(model.actor.parameters())
        self._critic: list[Tensor] = list(model.critic.parameters())
        self._target: list[Tensor] = list(model.critic_target.parameters())

    def __call__(self, batch: ReplayBufferSamples) -> StepLosses:
        """Step the entropy coefficient, the critics, the actor, then the target critics."""
        model = self._model
        actions, log_prob = self._sample(batch.observations)  # (B, A), (B, 1)
        coefficient, entropy_loss = self._step_entropy(log_prob.detach())

        target = self._target_values(batch, coefficient)  # (B, 1)
        values = model.critic(batch.observations, batch.actions)
        critic_loss = 0.5 * torch.stack([F.mse_loss(value, target) for value in values]).sum()
        _descend(critic_loss, self._critic, model.critic.optimizer)

        least = torch.cat(model.critic(batch.observations, actions), dim=1).amin(1, keepdim=True)
        actor_loss = (coefficient * log_prob - least).mean()
        _descend(actor_loss, self._actor, model.actor.optimizer)

        with torch.no_grad():
            torch._foreach_lerp_(self._target, self._critic, model.tau)
        return StepLosses(actor_loss.detach(), critic_loss.detach(), entropy_loss, coefficient)

    def _sample(self, observations: Tensor) -> tuple[Tensor, Tensor]:
        """Actions (B, A) of the actor and their log-probabilities (B, 1)."""
        mean, log_std, _ = self._model.actor.get_action_dist_params(observations)
        noise = torch.empty_like(mean).normal_(generator=self._noise)  # (B, A)
        actions = torch.tanh(mean + log_std.exp() * noise)
        # log N(u; mean, std) with u = mean + std * noise, minus the log-slope of tanh.
        gaussian = -0.5 * noise.square() - log_std - _HALF_LOG_2_PI
        squashed = torch.log(1 - actions.square() + _SQUASH_EPSILON)
        return actions, (gaussian - squashed).sum(dim=1, keepdim=True)

    def _step_entropy(self, log_prob: Tensor) -> tuple[Tensor, Tensor]:
        """The entropy coefficient before its step, and the loss of the step."""
        model = self._model
        if model.ent_coef_optimizer is None or model.log_ent_coef is None:
            return model.ent_coef_tensor, torch.zeros(())
        coefficient = model.log_ent_coef.detach().exp()
        gradient = -(log_prob + float(model.target_entropy)).mean().reshape(1)
        loss = model.log_ent_coef.detach() * gradient
        model.log_ent_coef.grad = gradient
        model.ent_coef_optimizer.step()
        return coefficient, loss

    @torch.no_grad()
    def _target_values(self, batch: ReplayBufferSamples, coefficient: Tensor) -> Tensor:
        """Bootstrapped values (B, 1); only a task that ended stops the bootstrapping."""
        model = self._model
        actions, log_prob = self._sample(batch.next_observations)
        values = torch.cat(model.critic_target(batch.next_observations, actions), dim=1)
        value = values.amin(dim=1, keepdim=True) - coefficient * log_prob
        return batch.rewards + (1 - batch.dones) * model.gamma * value


def _descend(loss: Tensor, parameters: list[Tensor], optimiser: torch.optim.Optimizer) -> None:
    """Step ``parameters`` down the gradient; no other gradient is computed."""
    for parameter, gradient in zip(parameters, torch.autograd.grad(loss, parameters), strict=True):
        parameter.grad = gradient
    optimiser.step()
