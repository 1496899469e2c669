"""What the learner waits for between two rounds: peers, rewards, and whoever cancels."""

from collections.abc import Callable

from rclpy.task import Future

from rapl_ros import topics
from rapl_ros.background import wakeable_future
from rapl_ros.node import RaplNode
from rapl_ros.rounds import RoundsStoppedError

FOR_REWARDS = "for rewards"


class Waiting:
    """Waits of a coroutine; the heartbeat says for what.

    :param node: watches ``simulator`` and ``ot_reward``; calls :meth:`wake` whenever something has
        arrived, and now and then.
    :param is_cancelled: whether the goal under way is to end.
    """

    def __init__(self, node: RaplNode, is_cancelled: Callable[[], bool]) -> None:
        self._node = node
        self._is_cancelled = is_cancelled
        self._change: Future | None = None

    def wake(self) -> None:
        """Have whoever waits look again."""
        if self._change is not None and not self._change.done():
            self._change.set_result(None)

    def check_cancelled(self) -> None:
        """Look whether to go on.

        :raises RoundsStoppedError: if the goal is cancelled.
        """
        if self._is_cancelled():
            raise RoundsStoppedError("cancelled")

    def lack(self) -> str:
        """What is missing to go on, or an empty string."""
        missing = self._node.missing_peers()
        if missing:
            return f"for {', '.join(missing)}"
        ot_reward = self._node.peers[topics.OT_REWARD]
        if ot_reward.status != "active":
            return f"for ot_reward, which waits {ot_reward.detail}"
        return ""

    async def until(self, what: str, condition: Callable[[], bool]) -> None:
        """Wait for ``condition``.

        :raises RoundsStoppedError: if the goal is cancelled meanwhile.
        """
        while not condition():
            self.check_cancelled()
            lack = self.lack()
            if lack or what != FOR_REWARDS:  # rewards are waited for all the time, and briefly
                self._node.heartbeat.report("waiting", lack or what)
            await self.next_change()

    async def until_ready(self, may_begin: Callable[[], bool]) -> None:
        """Wait until nothing is missing and a round may begin.

        :raises RoundsStoppedError: if the goal is cancelled meanwhile.
        """
        while True:
            lack = self.lack()
            if lack:
                await self.until(lack, lambda: not self.lack())
            elif may_begin():
                return
            else:
                await self.until(FOR_REWARDS, lambda: may_begin() or bool(self.lack()))

    async def next_change(self) -> None:
        """Wait until :meth:`wake` is called."""
        self._change = wakeable_future(self._node)
        await self._change
