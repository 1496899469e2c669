"""Images whose state has not come, kept for a while and within bounds."""

from collections import OrderedDict

import numpy as np
from numpy.typing import NDArray

from rapl_ros.wire import JoinKey


class SpareImages:
    """The newest images by their key.

    A camera that runs free gives many images that no state ever names: the oldest go first, by
    count, by bytes and by age.

    :param count: images kept at most.
    :param megabytes: of them all.
    :param age_s: since each came.
    """

    def __init__(self, count: int, megabytes: int, age_s: float) -> None:
        self._count, self._bytes, self._age_s = count, megabytes * 1_000_000, age_s
        self._frames: OrderedDict[JoinKey, tuple[NDArray[np.uint8], float]] = OrderedDict()
        self._held_bytes = 0

    def __len__(self) -> int:
        return len(self._frames)

    def keep(self, key: JoinKey, frame: NDArray[np.uint8], now_s: float) -> None:
        """Keep an image (H, W, 3) as the newest; time is the caller's steady clock."""
        self.pop(key)
        self._frames[key] = (frame, now_s)
        self._held_bytes += frame.nbytes
        while len(self._frames) > self._count or self._held_bytes > self._bytes:
            self.pop(next(iter(self._frames)))
        self.expire(now_s)

    def pop(self, key: JoinKey) -> NDArray[np.uint8] | None:
        """Take an image out; None if it is not there."""
        frame, _ = self._frames.pop(key, (None, 0.0))
        if frame is not None:
            self._held_bytes -= frame.nbytes
        return frame

    def expire(self, now_s: float) -> None:
        """Let go of what is too old."""
        while self._frames:
            key, (_, came_s) = next(iter(self._frames.items()))
            if now_s - came_s <= self._age_s:
                return
            self.pop(key)
