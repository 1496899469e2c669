"""Long work off the executor's thread, behind a bounded queue."""

import queue
import threading
import time
from collections.abc import Callable
from typing import Any, Final

from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.task import Future

from rapl_core.errors import RaplError


class QueueFullError(RaplError):
    """A worker has as much work waiting as it may have."""


class Worker:
    """One thread that does jobs in order.

    ``submit`` gives a rclpy Future that an async callback may await: the executor is woken when the
    job ends, and callbacks run on the executor's thread.

    :param node: whose executor the futures belong to; the node must have been added to one before
        the first job.
    :param name: of the thread, in messages.
    :param capacity: jobs that may wait.
    """

    def __init__(self, node: Node, name: str, capacity: int) -> None:
        self._node = node
        self._name = name
        self._queue: queue.Queue[tuple[Callable[[], Any], Future] | None] = queue.Queue(capacity)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Jobs not begun."""
        return self._queue.qsize()

    def submit(
        self, job: Callable[[], Any], on_done: Callable[[Future], None] | None = None
    ) -> Future:
        """Queue ``job``; its result or error is the future's.

        :param on_done: called on the executor's thread with the future; must fetch its result or
            exception.
        :raises QueueFullError: if ``capacity`` jobs wait already; never blocks.
        """
        future = future_of(self._node)
        # A done callback, even an idle one, is what wakes the executor for an awaiting coroutine.
        future.add_done_callback(on_done or _idle)
        try:
            self._queue.put_nowait((job, future))
        except queue.Full:
            raise QueueFullError(
                f"{self._name} has {self._queue.maxsize} jobs waiting, no room for more"
            ) from None
        return future

    def close(self, timeout_s: float = 2.0) -> bool:
        """Let the running job end, drop those that wait; return whether the thread ended."""
        self._closing.set()
        try:
            self._queue.put_nowait(None)
        except queue.Full:
            pass  # the thread sees _closing after its present job
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def finish(self, timeout_s: float) -> bool:
        """Do all that waits, then end; return whether that came to pass within the time."""
        deadline_s = time.monotonic() + timeout_s
        try:
            self._queue.put(None, timeout=timeout_s)
        except queue.Full:
            return False
        self._thread.join(max(0.0, deadline_s - time.monotonic()))
        return not self._thread.is_alive()

    def _work(self) -> None:
        while not self._closing.is_set():
            item = self._queue.get()
            if item is None or self._closing.is_set():
                return
            job, future = item
            try:
                result = job()
            except Exception as error:  # handed to whoever awaits the future
                future.set_exception(error)
            else:
                future.set_result(result)


def future_of(node: Node) -> Future:
    """A future whose callbacks run on the node's executor.

    :raises RaplError: if the node is on no executor yet.
    """
    executor: Final[Executor | None] = node.executor
    if executor is None:
        raise RaplError(f"node {node.get_name()} is on no executor yet: add it before it works")
    return Future(executor=executor)


def wakeable_future(node: Node) -> Future:
    """A future that a coroutine awaits and any callback or thread may resolve."""
    future = future_of(node)
    future.add_done_callback(_idle)
    return future


def _idle(_: Future) -> None:
    return None
