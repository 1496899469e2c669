"""Rounds: one episode of every world of the simulator, driven by a node's actions."""

import time
from collections import deque
from collections.abc import Sequence
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray
from rapl_msgs import msg as wire_msg
from rapl_msgs.srv import Reset

from rapl_core.errors import RaplError
from rapl_ros import conversions, qos, topics
from rapl_ros.background import wakeable_future
from rapl_ros.calls import CallError, call
from rapl_ros.diagnostics import BAD_INPUT_S
from rapl_ros.node import RaplNode
from rapl_ros.wire import Command, Instant

SILENCE_S: Final = 10.0
"""A simulator repeats what it waits for every second: so long without a state, a round is lost."""

WATCH_S: Final = 1.0
"""Between two looks at how long it has been silent."""

_EARLY: Final = 256


class RoundLostError(RaplError):
    """A round cannot be finished: the simulator restarted, or another node took its worlds."""


class RoundsStoppedError(RaplError):
    """Somebody asked for an end."""


class Player(Protocol):
    """Decides what the worlds do."""

    behaviour: str
    """Names on the wire what chose the actions."""

    def begin(self, episode_ids: Sequence[str]) -> None:
        """A round begins; ids in the order of worlds."""

    def act(self, instants: Sequence[Instant]) -> Sequence[NDArray[np.float64]]:
        """Take the next instant of every world under way, in the order of worlds, and return an
        action (A,) for each of them that is not its last."""

    def acted(self, actions: int) -> None:
        """The actions are on their way; time for what need not precede them."""


class Rounds:
    """Resets the worlds for a round and answers their states until every episode has ended.

    Subscribes ``state``, publishes ``action``, calls ``simulator/reset``. A repeated state gets
    its action again, so that a lost message stalls nothing.

    :param node: its name is the controller's.
    """

    def __init__(self, node: RaplNode) -> None:
        self._node = node
        self._name = node.get_name()
        self._actions = node.publish_to(wire_msg.Action, topics.ACTION, qos.stream())
        node.subscribe_to(wire_msg.State, topics.STATE, self._on_state, qos.stream())
        self._client = node.create_client(Reset, topics.of_node(topics.RESET, topics.SIMULATOR))
        node.steady_timer(WATCH_S, self._watch)
        self._watched_s = time.monotonic()
        self._round: _Round | None = None
        self._early: deque[Instant] | None = None

    async def play(self, player: Player, purpose: str, number: int, seed: int) -> None:
        """Play episode ``number`` of every world.

        :raises CallError: if the simulator does not answer.
        :raises RaplError: if it refuses, or what the player raises.
        :raises RoundLostError: if the round cannot be finished.
        """
        self._early = deque(maxlen=_EARLY)
        try:
            answer = await call(self._node, self._client, self._request(purpose, number, seed))
            if not answer.success:
                raise RaplError(f"the simulator refuses a reset: {answer.message}")
            early, self._early = self._early, None
            done = wakeable_future(self._node)
            self._round = _Round(list(answer.episode_ids), player, self._actions, done)
            player.begin(answer.episode_ids)
            for instant in early:
                self._round.take(instant)
            await done
            if (error := done.exception()) is not None:
                raise error
        finally:
            self._early = self._round = None

    def abandon(self, error: RaplError) -> None:
        """End the round under way, if any: :meth:`play` raises ``error``."""
        if self._round is not None:
            self._round.fail(error)

    def _request(self, purpose: str, number: int, seed: int) -> Reset.Request:
        return Reset.Request(
            worlds=[],
            purpose=purpose,
            controller=self._name,
            episodes=1,
            first_episode=number,
            seed=seed,
        )

    def _on_state(self, msg: wire_msg.State) -> None:
        if msg.controller != self._name or (self._round is None and self._early is None):
            return
        try:
            instant = conversions.state_from_ros(msg)
        except RaplError as error:
            self._node.diagnostics.count("refused_states")
            self._node.diagnostics.error_for(BAD_INPUT_S, "bad state", str(error))
            return
        if self._round is not None:
            self._round.take(instant)
        elif self._early is not None:
            self._early.append(instant)

    def _watch(self) -> None:
        now_s = time.monotonic()
        since_s, self._watched_s = now_s - self._watched_s, now_s
        if self._round is None:
            return
        # Time in which this node itself was busy, with gradient steps say, does not count: what
        # came meanwhile is in its queue.
        self._round.silent_s += min(since_s, WATCH_S)
        silent_s = self._round.silent_s
        alive = topics.SIMULATOR not in self._node.missing_peers()
        if silent_s > SILENCE_S and alive:
            self.abandon(RoundLostError(f"no state for {silent_s:.0f} s: who drives the worlds?"))


class _Round:
    """One episode of every world."""

    def __init__(self, episode_ids: list[str], player: Player, actions: Any, done: Any) -> None:
        self.silent_s = 0.0
        self._under_way = set(episode_ids)
        self._player = player
        self._actions = actions
        self._done = done
        self._pending: dict[str, Instant] = {}
        self._answers: dict[str, Command] = {}

    def fail(self, error: Exception) -> None:
        """End without success."""
        if not self._done.done():
            self._done.set_exception(error)

    def take(self, instant: Instant) -> None:
        """Take a state; when every world under way has its next one, answer them all."""
        if instant.episode_id not in self._under_way or self._done.done():
            return
        self.silent_s = 0.0
        answer = self._answers.get(instant.episode_id)
        if answer is not None and instant.step <= answer.step:
            if instant.step == answer.step:  # its action was lost
                self._actions.publish(conversions.action_to_ros(answer))
            return
        self._pending[instant.episode_id] = instant
        if len(self._pending) == len(self._under_way):
            try:
                self._answer_all()
            except RaplError as error:
                self.fail(error)

    def _answer_all(self) -> None:
        instants = sorted(self._pending.values(), key=lambda instant: instant.world)
        self._pending = {}
        chosen = iter(self._player.act(instants))
        going_on = [instant for instant in instants if not instant.is_last]
        for instant in going_on:
            command = conversions.answer(instant, next(chosen), self._player.behaviour)
            self._answers[instant.episode_id] = command
            self._actions.publish(conversions.action_to_ros(command))
        self._under_way = {instant.episode_id for instant in going_on}
        if going_on:
            self._player.acted(len(going_on))
        else:
            self._done.set_result(None)


__all__ = ["CallError", "Player", "RoundLostError", "Rounds", "RoundsStoppedError"]
