"""A SAC policy that acts, takes complete episodes, learns, and goes on where it stopped."""

import copy
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from rapl_core.errors import CorruptFileError, RaplError
from rapl_core.policies.checkpoint import Part, read_checkpoint, write_checkpoint
from rapl_core.policies.config import SacConfig, config_differences
from rapl_core.policies.gradient_step import GradientStep, StepLosses
from rapl_core.policies.replay import EpisodeReplay
from rapl_core.policies.sac_model import make_sac
from rapl_core.policies.transitions import EpisodeTransitions
from rapl_core.types import check_shape

_REPLAY = "replay."


@dataclass(frozen=True)
class UpdateMetrics:
    """Means over the gradient steps of one call."""

    updates: int
    """Gradient steps ever taken."""
    actor_loss: float
    critic_loss: float
    entropy_loss: float
    entropy_coefficient: float


class SacTrainer:
    """Everything that learns, and all of its random states.

    The policy that acts is a copy of the actor, as of the last :meth:`refresh`; so
    :meth:`update` may run on another thread while :meth:`act` is called. What follows, follows
    from the seed and the order of calls alone. :meth:`act` takes all worlds at once, in order.

    :param observation_size: F.
    :param action_size: A.
    """

    def __init__(
        self, observation_size: int, action_size: int, config: SacConfig, seed: int
    ) -> None:
        self.config = config
        self.observation_size = observation_size
        self.action_size = action_size
        streams = np.random.SeedSequence([seed, 0x5AC]).spawn(5)
        torch_seeds = [int(stream.generate_state(1, np.uint64)[0] >> 1) for stream in streams[:3]]
        self.model = make_sac(
            observation_size, action_size, config, torch_seeds[0], np.random.default_rng(streams[3])
        )
        self._update_noise = torch.Generator().manual_seed(torch_seeds[1])
        self._acting_noise = torch.Generator().manual_seed(torch_seeds[2])
        self._exploration = np.random.default_rng(streams[4])
        self._step = GradientStep(self.model, self._update_noise)
        self._acting = copy.deepcopy(self.model.actor).requires_grad_(False)
        self._updates = 0

    @property
    def replay(self) -> EpisodeReplay:
        """The transitions learnt from."""
        assert isinstance(self.model.replay_buffer, EpisodeReplay)
        return self.model.replay_buffer

    @property
    def updates(self) -> int:
        """Gradient steps ever taken."""
        return self._updates

    def act(
        self, observations: NDArray[np.float32], deterministic: bool = False
    ) -> NDArray[np.float64]:
        """Return the acting policy's actions (W, A), each in [-1, 1].

        :param observations: (W, F), all worlds in order.
        :param deterministic: the most likely action, without noise; for evaluation.
        :raises ShapeError: if the shape is another.
        """
        check_shape("observations", observations, (None, self.observation_size))
        with torch.no_grad():
            given = torch.as_tensor(np.ascontiguousarray(observations, dtype=np.float32))
            mean, log_std, _ = self._acting.get_action_dist_params(given)
            if not deterministic:
                noise = torch.empty_like(mean).normal_(generator=self._acting_noise)
                mean = mean + log_std.exp() * noise
            actions: NDArray[np.float64] = torch.tanh(mean).numpy().astype(np.float64)
        return actions

    def random_actions(self, worlds: int) -> NDArray[np.float64]:
        """Return uniformly random actions (W, A), for exploration before learning."""
        return self._exploration.uniform(-1.0, 1.0, size=(worlds, self.action_size))

    def refresh(self) -> None:
        """Act as learnt up to now; not while :meth:`update` runs."""
        self._acting.load_state_dict(self.model.actor.state_dict())

    def add_episode(self, episode: EpisodeTransitions) -> None:
        """Learn from an episode henceforth; not while :meth:`update` runs."""
        self.replay.extend(episode)

    def relabel(self, rewards: Mapping[str, NDArray[np.float64]]) -> int:
        """Give held episodes new rewards (T,) by id, drop the others, return how many are left."""
        return self.replay.relabel(rewards)

    def clear_buffer(self) -> None:
        """Forget all transitions, e.g. when the reward has become another."""
        self.replay.clear()

    @property
    def can_update(self) -> bool:
        """Whether there is a batch to learn from."""
        return self.replay.size() >= self.config.batch_size

    def update(self, steps: int) -> UpdateMetrics:
        """Take gradient steps.

        :raises RaplError: if ``steps`` is not positive or there is no batch to learn from.
        """
        if steps < 1 or not self.can_update:
            raise RaplError(
                f"cannot take {steps} gradient steps with {self.replay.size()} transitions; "
                f"a batch has {self.config.batch_size}"
            )
        sums = np.zeros(4)
        for _ in range(steps):
            losses: StepLosses = self._step(self.replay.sample(self.config.batch_size))
            sums += [loss.item() for loss in losses]
        self._updates += steps
        actor, critic, entropy, coefficient = (sums / steps).tolist()
        if not np.isfinite(sums).all():
            raise RaplError(f"SAC diverged after {self._updates} gradient steps: losses {sums}")
        return UpdateMetrics(self._updates, actor, critic, entropy, coefficient)

    def save(self, folder: Path | str) -> Path:
        """Write a checkpoint to ``folder``, which must not exist; atomic."""
        return write_checkpoint(folder, {"trainer": self.state()})

    def load(self, folder: Path | str) -> None:
        """Go on where the checkpoint in ``folder`` was written, equal to the last bit.

        :raises CorruptFileError: if it is damaged, or of other sizes or another config.
        """
        parts = read_checkpoint(folder)
        if "trainer" not in parts:
            raise CorruptFileError(f"{folder} has no trainer, only {', '.join(parts) or 'nothing'}")
        self.restore(parts["trainer"])

    def state(self) -> Part:
        """Return what a checkpoint needs."""
        replay = self.replay.state()
        arrays: dict[str, NDArray[Any]] = {_REPLAY + k: v for k, v in replay.arrays.items()}
        for name, tensor in self._weights().items():
            arrays[name] = tensor.detach().numpy().copy()
        for name, optimiser in self._optimisers().items():
            arrays |= _moments(name, optimiser)
        arrays["update_noise"] = self._update_noise.get_state().numpy()
        arrays["acting_noise"] = self._acting_noise.get_state().numpy()
        return Part(
            arrays=arrays,
            values={
                "sizes": [self.observation_size, self.action_size],
                "config": asdict(self.config),
                "updates": self._updates,
                "exploration": self._exploration.bit_generator.state,
                "replay": dict(replay.values),
            },
        )

    def restore(self, part: Part) -> None:
        """Go on where :meth:`state` was taken.

        :raises CorruptFileError: if it is of other sizes or another config.
        """
        self._check_fits(part)
        weights = self._weights()
        missing = sorted(set(weights) - set(part.arrays))
        if missing:
            raise CorruptFileError(f"the checkpoint lacks {', '.join(missing)}")
        with torch.no_grad():
            for name, tensor in weights.items():
                tensor.copy_(torch.from_numpy(part.arrays[name].copy()))
        for name, optimiser in self._optimisers().items():
            _restore_moments(name, optimiser, part.arrays)
        self._update_noise.set_state(torch.from_numpy(part.arrays["update_noise"].copy()))
        self._acting_noise.set_state(torch.from_numpy(part.arrays["acting_noise"].copy()))
        self._exploration.bit_generator.state = part.values["exploration"]
        self._updates = int(part.values["updates"])
        arrays = {
            name.removeprefix(_REPLAY): array
            for name, array in part.arrays.items()
            if name.startswith(_REPLAY)
        }
        self.replay.restore(Part(arrays=arrays, values=part.values["replay"]))

    def _check_fits(self, part: Part) -> None:
        sizes = [self.observation_size, self.action_size]
        if part.values["sizes"] != sizes:
            raise CorruptFileError(
                f"the checkpoint is for observation and action sizes {part.values['sizes']}, "
                f"expected {sizes}"
            )
        stored = dict(part.values["config"])
        stored["hidden"] = tuple(stored["hidden"])
        stored.setdefault("critic_layer_norm", False)  # written before there was a choice
        differences = config_differences(SacConfig(**stored), self.config)
        if differences:
            raise CorruptFileError(
                f"the checkpoint was written with another config: {'; '.join(differences)}"
            )

    def _optimisers(self) -> dict[str, torch.optim.Optimizer]:
        optimisers = {"actor": self.model.actor.optimizer, "critic": self.model.critic.optimizer}
        if self.model.ent_coef_optimizer is not None:
            optimisers["entropy"] = self.model.ent_coef_optimizer
        return optimisers

    def _weights(self) -> dict[str, torch.Tensor]:
        """Every tensor that learning changes, by name; the optimisers' moments apart."""
        weights = {f"policy.{k}": v for k, v in self.model.policy.state_dict().items()}
        weights |= {f"acting.{k}": v for k, v in self._acting.state_dict().items()}
        if self.model.log_ent_coef is not None:
            weights["log_entropy_coefficient"] = self.model.log_ent_coef
        return weights


def _moments(name: str, optimiser: torch.optim.Optimizer) -> dict[str, NDArray[Any]]:
    """Adam's moments by ``optimiser.<name>.<parameter>.<moment>``; none before its first step."""
    return {
        f"optimiser.{name}.{number}.{moment}": value.numpy().copy()
        for number, moments in optimiser.state_dict()["state"].items()
        for moment, value in moments.items()
    }


def _restore_moments(
    name: str, optimiser: torch.optim.Optimizer, arrays: Mapping[str, NDArray[Any]]
) -> None:
    state: dict[int, dict[str, torch.Tensor]] = {}
    for key, array in arrays.items():
        if key.startswith(f"optimiser.{name}."):
            _, _, number, moment = key.split(".")
            state.setdefault(int(number), {})[moment] = torch.from_numpy(array.copy())
    groups = optimiser.state_dict()["param_groups"]
    optimiser.load_state_dict({"state": state, "param_groups": groups})
