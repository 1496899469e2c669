"""Having another node do what takes long, from a coroutine: actions and parameters."""

import time
from collections.abc import Callable
from typing import Any

from action_msgs.srv import CancelGoal
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient

from rapl_ros.calls import CallError, pause
from rapl_ros.node import RaplNode

POLL_S = 0.1
"""Short beside a person's patience, long beside a callback."""


RETRY_S = 1.0
ANSWER_S = 8.0
"""So long without an answer, a request is sent again. A node that was killed looks ready for up to
20 s, so that what is meant for its successor may have gone to nobody."""
PATIENCE_S = 2.0
"""A wait shorter than this is not worth telling."""


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
        self._cancel = node.create_client(CancelGoal, f"{name}/_action/cancel_goal")

    async def run(
        self,
        goal: Any,
        on_feedback: Callable[[Any], None],
        deadline_s: float = 60.0,
        on_wait: Callable[[], None] = lambda: None,
    ) -> Any:
        """Send ``goal`` and return its result.

        The work itself has no deadline: the peer's heartbeat says whether it goes on.

        :param deadline_s: for the server to appear, and again for it to accept.
        :param on_wait: called several times a second while the work goes on.
        :raises PeerRestartedError: if the process that worked on it has been replaced.
        :raises CallError: if there is no server or it goes on refusing the goal.
        """
        await self._appear(deadline_s)
        incarnation = self._node.peers[self._peer].incarnation
        handle = await self._accepted(goal, on_feedback, incarnation, deadline_s)
        answer = handle.get_result_async()
        said, since_s = "", time.monotonic()
        while not answer.done():
            self._check(incarnation)
            lack = self._lack()
            if lack == said:
                since_s = time.monotonic()
            elif not lack or time.monotonic() - since_s > PATIENCE_S:
                said = lack
                self._say(lack)
            on_wait()
            await pause(self._node, POLL_S)
        return answer.result().result

    async def _accepted(
        self, goal: Any, on_feedback: Callable[[Any], None], incarnation: str, deadline_s: float
    ) -> Any:
        """Send the goal until it is taken; a goal that somebody who died has left is cancelled."""
        began_s = time.monotonic()
        while True:
            sent = self._client.send_goal_async(
                goal, feedback_callback=lambda message: on_feedback(message.feedback)
            )
            sent_s = time.monotonic()
            while not sent.done() and time.monotonic() - sent_s < ANSWER_S:
                self._check(incarnation)
                if time.monotonic() - began_s > deadline_s:
                    raise CallError(f"{self._name} did not take the goal within {deadline_s:g} s")
                await pause(self._node, POLL_S)
            if not sent.done():
                continue  # taken all the same, it is refused now and cancelled below
            handle = sent.result()
            if handle.accepted:
                self._say("")
                return handle
            if time.monotonic() - began_s > deadline_s:
                raise CallError(f"{self._name} refused the goal: it is busy with another")
            self._say(f"for {self._peer} to leave an earlier goal")
            self._cancel.call_async(CancelGoal.Request())  # zeros: whichever there is
            await pause(self._node, RETRY_S)

    def _lack(self) -> str:
        """What the work waits for by the peer's own word; empty while it goes on."""
        peer = self._node.peers[self._peer]
        if not peer.alive:
            return f"for {self._peer}, which is gone"
        return peer.detail if peer.status == "waiting" else ""

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


class ParameterPort:
    """The parameters of one peer.

    :param node: must watch ``peer``.
    :param say: told what is waited for; empty when the wait is over.
    """

    def __init__(self, node: RaplNode, peer: str, say: Callable[[str], None]) -> None:
        self._node, self._peer, self._say = node, peer, say
        self._client = node.create_client(SetParameters, f"{peer}/set_parameters")

    async def set(self, name: str, value: str | int, deadline_s: float) -> None:
        """Set a parameter.

        :raises PeerRestartedError: if another process has taken the peer's place meanwhile.
        :raises CallError: if the peer refuses, or neither appears nor answers in time.
        """
        peer = self._node.peers[self._peer]
        what = f"parameter {name} of {self._peer}"
        began_s = time.monotonic()
        while not (peer.alive and self._client.service_is_ready()):
            if time.monotonic() - began_s > deadline_s:
                raise CallError(f"{self._peer} is not there; waited {deadline_s:g} s")
            self._say(f"for {self._peer}")
            await pause(self._node, POLL_S)
        self._say("")
        incarnation, began_s = peer.incarnation, time.monotonic()
        future, sent_s = self._client.call_async(_request(name, value)), began_s
        told = False
        while not future.done():
            if not told and time.monotonic() - began_s > PATIENCE_S:
                told = True
                self._say(f"for {self._peer} to take up {value}")
            late = time.monotonic() - began_s > deadline_s
            # Where setting takes long, the peer's executor is at it and beats no heart meanwhile.
            lost = peer.heard_s - sent_s > ANSWER_S
            if late or lost or peer.incarnation != incarnation:
                self._client.remove_pending_request(future)
                if late:
                    raise CallError(f"{what} was not set within {deadline_s:g} s")
                if not lost:
                    raise PeerRestartedError(f"{self._peer} restarted while {name} was set")
                future, sent_s = self._client.call_async(_request(name, value)), time.monotonic()
            await pause(self._node, POLL_S)
        self._say("")
        result = future.result().results[0]
        if not result.successful:
            raise CallError(f"{self._peer} refuses {name} = {value!r}: {result.reason}")


def _request(name: str, value: str | int) -> SetParameters.Request:
    if isinstance(value, str):
        wire = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)
    else:
        wire = ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=value)
    return SetParameters.Request(parameters=[Parameter(name=name, value=wire)])
