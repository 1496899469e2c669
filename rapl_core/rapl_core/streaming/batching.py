"""A bounded queue whose reader takes what belongs together at once."""

import threading
import time
from collections import deque
from typing import Generic, TypeVar

Item = TypeVar("Item")


class BatchQueue(Generic[Item]):
    """Hands items over in order, in batches; the oldest go when it is full.

    A batch is twice to four times as fast per frame as single frames, so the reader lingers for a
    moment when fewer than ``wanted`` items are there, e.g. the frames of one step of all worlds.

    :param capacity: items kept at most.
    """

    def __init__(self, capacity: int) -> None:
        self._items: deque[Item] = deque()
        self._capacity = capacity
        self._changed = threading.Condition()
        self._closed = False
        self.overflowed = 0
        """Items lost because the queue was full."""

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: Item) -> None:
        """Append an item; never blocks."""
        with self._changed:
            if len(self._items) >= self._capacity:
                self._items.popleft()
                self.overflowed += 1
            self._items.append(item)
            self._changed.notify()

    def take(self, most: int, wanted: int, linger_s: float) -> list[Item]:
        """Wait for an item and return up to ``most`` of them, oldest first.

        :param wanted: with fewer than these, wait up to ``linger_s`` for more.
        :return: empty only after ``close``.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._items or self._closed)
            deadline = time.monotonic() + linger_s
            while len(self._items) < min(wanted, most) and not self._closed:
                left_s = deadline - time.monotonic()
                if left_s <= 0 or not self._changed.wait(left_s):
                    break
            if self._closed:
                return []
            return [self._items.popleft() for _ in range(min(most, len(self._items)))]

    def close(self) -> None:
        """Let every reader return; what waits is dropped."""
        with self._changed:
            self._closed = True
            self._items.clear()
            self._changed.notify_all()
