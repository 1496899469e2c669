"""Calls with a deadline, for coroutines on the executor."""

import time
from collections.abc import Callable
from typing import Any

from rclpy.client import Client

from rapl_core.errors import RaplError
from rapl_ros.background import wakeable_future
from rapl_ros.node import RaplNode

DEADLINE_S = 5.0
_POLL_S = 0.05


class CallError(RaplError):
    """A service did not answer in time."""


async def pause(node: RaplNode, seconds: float) -> None:
    """Let other callbacks run for so long."""
    over = wakeable_future(node)

    def wake() -> None:
        if not over.done():
            over.set_result(None)

    timer = node.steady_timer(seconds, wake)
    try:
        await over
    finally:
        node.destroy_timer(timer)


async def call(node: RaplNode, client: Client, request: Any, deadline_s: float = DEADLINE_S) -> Any:
    """Return the answer of a service.

    :raises CallError: if the service does not exist or does not answer within the deadline.
    """
    waited_s = 0.0
    while not client.service_is_ready():
        if waited_s >= deadline_s:
            raise CallError(f"{client.srv_name} is not there; waited {deadline_s:g} s")
        await pause(node, _POLL_S)
        waited_s += _POLL_S
    answer = wakeable_future(node)
    future = client.call_async(request)

    def settle(_: Any = None) -> None:
        if not answer.done():
            answer.set_result(None)

    future.add_done_callback(settle)
    timer = node.steady_timer(deadline_s, settle)
    try:
        await answer
    finally:
        node.destroy_timer(timer)
    if not future.done():
        client.remove_pending_request(future)
        raise CallError(f"{client.srv_name} gave no answer within {deadline_s:g} s")
    return future.result()


async def call_peer(
    node: RaplNode,
    client: Client,
    request: Any,
    peer: str,
    deadline_s: float,
    check: Callable[[], None] = lambda: None,
) -> Any:
    """Return the answer of a service of a peer, for requests that take long: that the peer died is
    noticed by its heartbeat.

    :param peer: its name; ``node`` must watch it.
    :param check: called several times a second; what it raises ends the waiting.
    :raises CallError: if the peer is not there, dies meanwhile, or gives no answer in time.
    """
    watched = node.peers[peer]
    if not (watched.alive and client.service_is_ready()):
        raise CallError(f"{peer} is not there")
    incarnation, began_s = watched.incarnation, time.monotonic()
    future = client.call_async(request)
    try:
        while not future.done():
            if not watched.alive or watched.incarnation != incarnation:
                raise CallError(f"{peer} died meanwhile")
            if time.monotonic() - began_s > deadline_s:
                raise CallError(f"{peer} gave no answer within {deadline_s:g} s")
            check()
            await pause(node, _POLL_S)
    finally:
        if not future.done():
            client.remove_pending_request(future)
    return future.result()
