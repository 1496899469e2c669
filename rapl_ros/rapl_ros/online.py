"""While the robot learns: more rankings, about its own videos, and the encoder aligned again."""

from rapl_core.analysis.online import OnlineBook
from rapl_core.errors import RaplError
from rapl_core.preferences.own_videos import OWN
from rapl_ros import topics
from rapl_ros.calls import pause
from rapl_ros.goals import ParameterPort
from rapl_ros.stage_context import StageContext
from rapl_ros.stage_steps import PARAMETER_DEADLINE_S, align_and_swap, gather_rankings, given

ATTEMPTS = 4
RETRY_S = 2.5
LOOK_S = 0.3


class OnlineAlignments:
    """Runs beside the train stage, on the same executor, and never stops the training.

    Each time, at evenly spaced steps: the preference node asks about the learner's newest videos
    until so many more rankings are given, all rankings are aligned, and the encoder goes over to
    the new version. What was begun is in ``online.json``, so a resumed run goes on with it. An
    alignment that fails for good is told and given up; the training goes on.
    """

    def __init__(self, context: StageContext) -> None:
        self._context = StageContext(
            context.node, context.run, context.folder, self._show, self._say
        )
        self._preference = ParameterPort(context.node, topics.PREFERENCE, self._say)
        self._book = OnlineBook(context.folder)
        self._over = False
        self._ended = True
        self.steps = 0
        """World steps of training so far; told by the train stage."""
        self.detail = ""
        """What goes on, in a few words."""
        self.problem = ""
        """Why it was given up."""

    @property
    def done(self) -> int:
        """Alignments that were put to work, those of earlier processes included."""
        return self._book.done

    def begin(self) -> None:
        """Start; returns at once."""
        executor = self._context.node.executor
        assert executor is not None
        self._ended = False
        executor.create_task(self._work)

    async def end(self) -> None:
        """The training is over: no more is asked; an alignment under way is put to work."""
        self._over = True
        while not self._ended:
            await pause(self._context.node, LOOK_S)

    async def _work(self) -> None:
        try:
            for mark in self._context.run.online_steps[self._book.done :]:
                while self._book.under_way is None and (self.steps < mark or self._over):
                    if self._over:
                        return
                    await pause(self._context.node, LOOK_S)
                if not await self._persist():
                    return
                self.detail = ""
        except RaplError as error:
            self.problem = str(error)
            self._context.node.get_logger().error(f"online alignment is given up: {error}")
        finally:
            self.detail = ""
            self._ended = True

    async def _persist(self) -> bool:
        """One alignment, however often a node dies; False: the training was over first."""
        for attempt in range(1, ATTEMPTS + 1):
            try:
                return await self._align_once()
            except RaplError as error:
                if attempt == ATTEMPTS or self._over:
                    raise
                words = f"online alignment, attempt {attempt}: {error}"
                self._context.node.get_logger().warning(words)
                await pause(self._context.node, RETRY_S)
        return False

    async def _align_once(self) -> bool:
        context = self._context
        more = context.run.online_share
        entry = self._book.begin(self.steps, await given(context) + more)

        async def ask_for_more() -> None:
            # In this order, or people who wait would be asked about the pool once more.
            await self._preference.set("strategy", OWN, PARAMETER_DEADLINE_S)
            await self._preference.set("rankings_wanted", entry.wanted, PARAMETER_DEADLINE_S)

        rankings = await gather_rankings(
            context, entry.wanted, ask_for_more, lambda: self._over, "asks about its own videos"
        )
        if rankings < entry.wanted:
            await self._want_no_more(rankings)
        await self._preference.set("strategy", context.run.query_strategy, PARAMETER_DEADLINE_S)
        if rankings < entry.wanted:
            return False
        result = await align_and_swap(context, 0)
        accuracy = float(result["held_out_accuracy"])
        steps = max(self.steps, entry.asked_steps)  # after a restart it is not told at once
        self._book.finish(steps, rankings, str(result["version"]), accuracy)
        context.node.get_logger().info(
            f"after {steps} steps the encoder is {result['version']}, from {rankings} rankings"
        )
        return True

    async def _want_no_more(self, given: int) -> None:
        """Else the others would be given about the pool, when the robot's videos are over."""
        await self._preference.set("rankings_wanted", given, PARAMETER_DEADLINE_S)
        if not self._context.run.asks_people:
            await self._context.human.set("rankings", given, PARAMETER_DEADLINE_S)

    def _show(self, done: int, total: int, unit: str, detail: str = "") -> None:
        words = "aligns again" if unit == "epochs" else detail
        self.detail = f"{words}: {done} of {total} {unit}"

    def _say(self, what: str) -> None:
        self.detail = f"aligns again, waits {what}" if what else ""
