"""When learning does what: the one place that decides, with ROS and without."""

from dataclasses import dataclass

from rapl_core.errors import RaplError
from rapl_core.policies.checkpoint import Part
from rapl_core.policies.config import ScheduleConfig


@dataclass(frozen=True)
class Block:
    """What to do at a block boundary, in this order: refresh the acting policy, then update.

    The acting policy is thus that of the block before: the gradient steps of one block may run
    while the worlds go through the next, and the result is the same as one after the other.
    """

    updates: int
    """Gradient steps to take."""


class LearningSchedule:
    """Counts world steps of training and says what is due.

    Nothing else may enter: neither wall time nor the order in which messages arrive, or a run
    would no longer follow from its seed.
    """

    def __init__(self, config: ScheduleConfig) -> None:
        self.config = config
        self._steps = 0
        self._owed = 0.0
        self._updates = 0
        self._next_episode = 0
        self._evaluations = 0
        self._evaluated_at = 0
        self._checkpoint_at = 0

    @property
    def steps(self) -> int:
        """World steps of training so far, all worlds together."""
        return self._steps

    @property
    def updates(self) -> int:
        """Gradient steps ordered so far."""
        return self._updates

    @property
    def next_episode(self) -> int:
        """Number of the next episode of each world; those before have ended."""
        return self._next_episode

    @property
    def finished(self) -> bool:
        """Whether all world steps were made; asked when a round of episodes has ended."""
        return self._steps >= self.config.steps

    @property
    def explores(self) -> bool:
        """Whether the next actions are random."""
        return self._steps < self.config.random_steps

    def advance(self, world_steps: int) -> Block | None:
        """Count world steps and return a block of gradient steps if one is due.

        Random steps earn no gradient steps.
        """
        if world_steps < 1:
            raise RaplError(f"cannot advance by {world_steps} world steps")
        before = self._steps
        self._steps += world_steps
        learnt_from = max(before, self.config.random_steps)
        self._owed += self.config.train_ratio * max(0, self._steps - learnt_from)
        if self._steps // self.config.block_steps == before // self.config.block_steps:
            return None
        updates = int(self._owed + 1e-9)
        self._owed -= updates
        self._updates += updates
        return Block(updates)

    def end_round(self) -> None:
        """Note that episode :attr:`next_episode` of every world has ended."""
        self._next_episode += 1

    def release_before(self, number: int) -> int:
        """Return the last episode number whose reward must be in before episode ``number``.

        Negative: none. Back-pressure follows from it: no world is ever more than
        ``reward_lag + 1`` episodes ahead of its rewards.
        """
        return number - 1 - self.config.reward_lag

    @property
    def evaluation_due(self) -> bool:
        """Whether to evaluate now, at the end of a round."""
        if self.config.evaluate_episodes == 0 or self._evaluated_at == self._steps:
            return False
        return self.finished or _crossed(
            self._evaluated_at, self._steps, self.config.evaluate_every
        )

    @property
    def first_evaluation_episode(self) -> int:
        """Episode number with which the next evaluation begins: each has starts of its own."""
        return self._evaluations * self.evaluation_rounds

    @property
    def evaluation_rounds(self) -> int:
        """Episodes of each world in an evaluation."""
        return -(-self.config.evaluate_episodes // self.config.worlds)

    def evaluated(self) -> None:
        """Note that an evaluation has ended."""
        self._evaluations += 1
        self._evaluated_at = self._steps

    @property
    def checkpoint_due(self) -> bool:
        """Whether to save now, at the end of a round and after an evaluation."""
        if self._checkpoint_at == self._steps:
            return False
        return self.finished or _crossed(
            self._checkpoint_at, self._steps, self.config.checkpoint_every
        )

    def checkpointed(self) -> None:
        """Note that a checkpoint is about to be written; call before :meth:`state`."""
        self._checkpoint_at = self._steps

    def state(self) -> Part:
        """Return what a checkpoint needs."""
        return Part(
            values={
                "steps": self._steps,
                "owed": self._owed,
                "updates": self._updates,
                "next_episode": self._next_episode,
                "evaluations": self._evaluations,
                "evaluated_at": self._evaluated_at,
                "checkpoint_at": self._checkpoint_at,
            }
        )

    def restore(self, part: Part) -> None:
        """Go on where :meth:`state` was taken."""
        values = part.values
        self._steps = int(values["steps"])
        self._owed = float(values["owed"])
        self._updates = int(values["updates"])
        self._next_episode = int(values["next_episode"])
        self._evaluations = int(values["evaluations"])
        self._evaluated_at = int(values["evaluated_at"])
        self._checkpoint_at = int(values["checkpoint_at"])


def _crossed(before: int, now: int, every: int) -> bool:
    """Whether a multiple of ``every`` lies in (before, now]; 0: never."""
    return every > 0 and now // every > before // every
