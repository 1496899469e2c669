"""What there is to choose about learning: the optimisation and its schedule."""

import math
from dataclasses import dataclass, field, fields

from rapl_core.errors import RaplError


@dataclass(frozen=True)
class SacConfig:
    """Soft actor-critic (Haarnoja et al. 2018) as stable-baselines3 has it."""

    hidden: tuple[int, ...] = (256, 256)
    """Sizes of the hidden layers of actor and critics."""
    batch_size: int = field(default=256, metadata={"minimum": 1})
    """Transitions a gradient step."""
    discount: float = field(default=0.98, metadata={"minimum": 0.0, "maximum": 1.0})
    """gamma, a control period."""
    learning_rate: float = field(default=4e-4, metadata={"minimum": 0.0, "maximum": 1.0})
    """Of actor, critics and entropy coefficient (Adam)."""
    target_rate: float = field(default=0.005, metadata={"minimum": 0.0, "maximum": 1.0})
    """tau: share of the critics that moves into the target critics a gradient step."""
    entropy_coefficient: str = "auto_0.1"
    """``auto``: learnt from 1; ``auto_0.1``: learnt from 0.1; a number: fixed."""
    buffer_size: int = field(default=200_000, metadata={"minimum": 1})
    """Transitions kept for replay."""
    critic_layer_norm: bool = True
    """Layer normalisation in the critics (Ball et al. 2023), not in stable-baselines3: bounds what
    they make of actions never tried."""

    def __post_init__(self) -> None:
        _check_positive(self, "batch_size", "learning_rate", "target_rate", "buffer_size")
        if not 0 <= self.discount < 1:
            raise RaplError(f"discount is {self.discount}, expected 0 <= discount < 1")
        if not self.hidden or min(self.hidden) < 1:
            raise RaplError(f"hidden is {self.hidden}, expected one or more sizes above 0")
        if self.entropy_coefficient != "auto" and not _is_coefficient(self.entropy_coefficient):
            raise RaplError(
                f"entropy_coefficient is '{self.entropy_coefficient}', expected auto, auto_0.1 or "
                "a number, 0 or more"
            )


@dataclass(frozen=True)
class ScheduleConfig:
    """When the learner acts at random, takes gradient steps, evaluates and saves."""

    steps: int = field(default=40_000, metadata={"minimum": 1})
    """World steps of all worlds together, after which learning ends."""
    worlds: int = field(default=4, metadata={"minimum": 1})
    """Worlds stepped in lockstep."""
    random_steps: int = field(default=2_000, metadata={"minimum": 0})
    """World steps with uniformly random actions, before the first gradient step."""
    block_steps: int = field(default=64, metadata={"minimum": 1})
    """World steps between two blocks of gradient steps."""
    train_ratio: float = field(default=1.0, metadata={"minimum": 0.0})
    """Gradient steps a world step."""
    reward_lag: int = field(default=1, metadata={"minimum": 0})
    """Before episode n begins, the rewards of episodes up to n - 1 - lag are in the buffer."""
    evaluate_every: int = field(default=5_000, metadata={"minimum": 0})
    """World steps between evaluations; 0: only at the end."""
    evaluate_episodes: int = field(default=50, metadata={"minimum": 0})
    """Episodes an evaluation; 0: never evaluate."""
    checkpoint_every: int = field(default=5_000, metadata={"minimum": 0})
    """World steps between checkpoints; 0: only at the end."""

    def __post_init__(self) -> None:
        _check_positive(self, "steps", "worlds", "block_steps")
        for name in (
            "random_steps",
            "train_ratio",
            "reward_lag",
            "evaluate_every",
            "evaluate_episodes",
            "checkpoint_every",
        ):
            if not 0 <= getattr(self, name) < math.inf:
                raise RaplError(f"{name} is {getattr(self, name)}, expected 0 or more")


def config_differences(mine: object, other: object) -> list[str]:
    """Return ``name: mine != other`` for each field in which two configs of a kind differ."""
    return [
        f"{field.name}: {getattr(mine, field.name)} != {getattr(other, field.name)}"
        for field in fields(mine)  # type: ignore[arg-type]
        if getattr(mine, field.name) != getattr(other, field.name)
    ]


def _check_positive(config: object, *names: str) -> None:
    for name in names:
        if not 0 < getattr(config, name) < math.inf:
            raise RaplError(f"{name} is {getattr(config, name)}, expected more than 0")


def _is_coefficient(text: str) -> bool:
    try:
        start = float(text.removeprefix("auto_"))
    except ValueError:
        return False
    return 0 <= start < math.inf and (start > 0 or not text.startswith("auto_"))
