"""Having another node do an action, from a coroutine, however long it takes."""

import time
from collections.abc import Callable
from typing import Any

from rclpy.action import ActionClient

from rapl_ros.calls import CallError, pause
from rapl_ros.node import RaplNode

POLL_S = 0.1
"""Short beside a person's patience, long beside a callback."""


class PeerRestartedError(CallError):
    """Another process has taken the place of the node that was at work."""


class ActionPort:
    """One action of one peer.

    :param node: must watch ``peer``.
    :param name: of the action, as seen from ``node``.
    :param say: told what is waited for; empty when the wait is over.
    """

    def __init__(
        self, node: RaplNode, kind: type, name: str, peer: str, say: Callable[[str], None]
    ) -> None:
        self._node, self._name, self._say = node, name, say
        self._peer = peer
        self._client = ActionClient(node, kind, name)

    async def run(
        self, goal: Any, on_feedback: Callable[[Any], None], deadline_s: float = 60.0
    ) -> Any:
        """Send ``goal`` and return its result.

        The work itself has no deadline: the peer's heartbeat says whether it goes on.

        :param deadline_s: for the server to appear, and again for it to accept.
        :raises PeerRestartedError: if the process that worked on it has been replaced.
        :raises CallError: if there is no server or it refuses the goal.
        """
        await self._appear(deadline_s)
        incarnation = self._node.peers[self._peer].incarnation
        sent = self._client.send_goal_async(
            goal, feedback_callback=lambda message: on_feedback(message.feedback)
        )
        sent_s = time.monotonic()
        while not sent.done():
            self._check(incarnation)
            if time.monotonic() - sent_s > deadline_s:
                raise CallError(f"{self._name} did not take the goal within {deadline_s:g} s")
            await pause(self._node, POLL_S)
        handle = sent.result()
        if not handle.accepted:
            raise CallError(f"{self._name} refused the goal: it is busy")
        answer = handle.get_result_async()
        gone = False
        while not answer.done():
            self._check(incarnation)
            if self._node.peers[self._peer].alive == gone:
                gone = not gone
                self._say(f"for {self._peer}, which is gone" if gone else "")
            await pause(self._node, POLL_S)
        return answer.result().result

    def _check(self, incarnation: str) -> None:
        if self._node.peers[self._peer].incarnation != incarnation:
            raise PeerRestartedError(f"{self._peer} restarted during {self._name}")

    async def _appear(self, deadline_s: float) -> None:
        peer = self._node.peers[self._peer]
        began_s = time.monotonic()
        while not (peer.alive and self._client.server_is_ready()):
            if time.monotonic() - began_s > deadline_s:
                raise CallError(f"{self._name} is not there; waited {deadline_s:g} s")
            self._say(f"for {self._peer}")
            await pause(self._node, POLL_S)
        self._say("")
