r"""One gradient step of SAC on the networks and optimisers of stable-baselines3.

The same mathematics as ``stable_baselines3.SAC.train``, to which a test compares it, with the
gradients written out, which takes about half the time on a CPU; ``experiments/benchmark_sac.py``
says exactly. With :math:`u = \mu + \sigma\epsilon,\ a = \tanh u`, per dimension,

.. math::
    \log\pi = -\tfrac12\epsilon^2 - \log\sigma - \tfrac12\log 2\pi - \log(1 - a^2 + c), \quad
    \frac{\partial\log\pi}{\partial u} = \frac{2a(1 - a^2)}{1 - a^2 + c}.
"""

import math
from typing import NamedTuple

import torch
from stable_baselines3 import SAC
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stable_baselines3.sac.policies import LOG_STD_MAX, LOG_STD_MIN
from torch import Tensor, nn

from rapl_core.policies.dense_stack import DenseLayer, DenseStack, dense_layers

_HALF_LOG_2_PI = 0.5 * math.log(2 * math.pi)
_SQUASH_EPSILON = 1e-6
"""c, of stable-baselines3's SquashedDiagGaussianDistribution."""


class StepLosses(NamedTuple):
    """What a gradient step saw."""

    actor: Tensor
    critic: Tensor
    entropy: Tensor
    """Loss of the entropy coefficient; 0 when it is fixed."""
    entropy_coefficient: Tensor


class _Sample(NamedTuple):
    """Actions drawn from the actor, and what their gradient needs."""

    actions: Tensor
    """(B, A)."""
    log_prob: Tensor
    """(B, 1)."""
    noise: Tensor
    """(B, A) epsilon."""
    deviation: Tensor
    """(B, A) sigma."""
    free: Tensor
    """(B, A) whether log sigma is within its limits, so that it has a gradient."""


class GradientStep:
    """Takes gradient steps for one SAC.

    :param noise: where the actions' noise comes from.
    """

    def __init__(self, model: SAC, noise: torch.Generator) -> None:
        self._model = model
        self._noise = noise
        self._trunk = DenseStack(dense_layers(model.actor.latent_pi), linear_end=False)
        self._mean = DenseStack([_single(model.actor.mu)], linear_end=True)
        self._log_std = DenseStack([_single(model.actor.log_std)], linear_end=True)
        self._critics = [
            DenseStack(dense_layers(q), linear_end=True) for q in model.critic.q_networks
        ]
        self._targets = [
            DenseStack(dense_layers(q), linear_end=True) for q in model.critic_target.q_networks
        ]
        self._critic_weights: list[Tensor] = list(model.critic.parameters())
        self._target_weights: list[Tensor] = list(model.critic_target.parameters())

    @torch.no_grad()
    def __call__(self, batch: ReplayBufferSamples) -> StepLosses:
        """Step the entropy coefficient, the critics, the actor, then the target critics."""
        # The actor's backward run needs what its last forward run left, so the sample that has a
        # gradient comes last. The noise is drawn in stable-baselines3's order.
        shape = batch.actions.shape
        noise = torch.empty(shape).normal_(generator=self._noise)
        next_noise = torch.empty(shape).normal_(generator=self._noise)
        following = self._sample(batch.next_observations, next_noise)
        sample = self._sample(batch.observations, noise)
        coefficient, entropy_loss = self._step_entropy(sample.log_prob)
        critic_loss = self._step_critics(batch, self.target_values(batch, following, coefficient))
        actor_loss = self._step_actor(batch.observations, sample, coefficient)
        torch._foreach_lerp_(self._target_weights, self._critic_weights, self._model.tau)
        return StepLosses(actor_loss, critic_loss, entropy_loss, coefficient)

    def _sample(self, observations: Tensor, noise: Tensor) -> _Sample:
        hidden = self._trunk.forward(observations)
        raw = self._log_std.forward(hidden)
        log_std = raw.clamp(LOG_STD_MIN, LOG_STD_MAX)
        deviation = log_std.exp()
        actions = torch.tanh(self._mean.forward(hidden) + deviation * noise)
        gaussian = -0.5 * noise.square() - log_std - _HALF_LOG_2_PI
        squashed = torch.log(1 - actions.square() + _SQUASH_EPSILON)
        log_prob = (gaussian - squashed).sum(dim=1, keepdim=True)
        return _Sample(actions, log_prob, noise, deviation, raw == log_std)

    def target_values(
        self, batch: ReplayBufferSamples, following: _Sample, coefficient: Tensor
    ) -> Tensor:
        """Bootstrapped values (B, 1); only a task that ended stops the bootstrapping."""
        inputs = torch.cat([batch.next_observations, following.actions], dim=1)
        values = torch.cat([target.forward(inputs) for target in self._targets], dim=1)
        value = values.amin(dim=1, keepdim=True) - coefficient * following.log_prob
        return batch.rewards + (1 - batch.dones) * self._model.gamma * value

    def _step_entropy(self, log_prob: Tensor) -> tuple[Tensor, Tensor]:
        """The entropy coefficient before its step, and the loss of the step."""
        model = self._model
        if model.ent_coef_optimizer is None or model.log_ent_coef is None:
            return model.ent_coef_tensor, torch.zeros(())
        coefficient = model.log_ent_coef.exp()
        gradient = -(log_prob + float(model.target_entropy)).mean().reshape(1)
        loss = model.log_ent_coef * gradient
        model.log_ent_coef.grad = gradient
        model.ent_coef_optimizer.step()
        return coefficient, loss

    def _step_critics(self, batch: ReplayBufferSamples, target: Tensor) -> Tensor:
        """Half the sum of the critics' mean squared errors, before the step."""
        inputs = torch.cat([batch.observations, batch.actions], dim=1)
        loss = torch.zeros(())
        for critic in self._critics:
            error = critic.forward(inputs) - target  # (B, 1)
            loss += 0.5 * error.square().mean()
            critic.backward(error / len(error), weights=True, first_input=None)
        self._model.critic.optimizer.step()
        return loss

    def _step_actor(self, observations: Tensor, sample: _Sample, coefficient: Tensor) -> Tensor:
        """The mean of coefficient * log pi - min Q, before the step."""
        size = len(observations)
        inputs = torch.cat([observations, sample.actions], dim=1)
        values = torch.cat([critic.forward(inputs) for critic in self._critics], dim=1)  # (B, 2)
        least, which = values.min(dim=1, keepdim=True)  # (B, 1)
        by_action = torch.zeros_like(sample.actions)  # d loss / d a
        for number, critic in enumerate(self._critics):
            chosen = (which == number).to(values.dtype) / -size
            gradient = critic.backward(chosen, weights=False, first_input=observations.shape[1])
            assert gradient is not None
            by_action += gradient
        slope = 1 - sample.actions.square()  # d a / d u
        entropy = coefficient / size
        by_mean = by_action * slope + entropy * 2 * sample.actions * slope / (
            slope + _SQUASH_EPSILON
        )
        by_log_std = (by_mean * sample.deviation * sample.noise - entropy) * sample.free
        by_hidden = self._mean.backward(by_mean, weights=True, first_input=0)
        other = self._log_std.backward(by_log_std, weights=True, first_input=0)
        assert by_hidden is not None and other is not None
        self._trunk.backward(by_hidden.add_(other), weights=True, first_input=None)
        self._model.actor.optimizer.step()
        return (coefficient * sample.log_prob - least).mean()


def _single(layer: object) -> DenseLayer:
    assert isinstance(layer, nn.Linear)
    return DenseLayer(layer)
