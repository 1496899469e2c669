"""The graph as the page sees it: services and actions of other nodes, asked from HTTP handlers.

HTTP is served on a thread with asyncio, the graph on the executor's: work crosses over as a
coroutine that the executor runs and a future that the handler awaits.
"""

import asyncio
import io
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import Future as ThreadFuture
from contextlib import suppress
from typing import Any, TypeVar

from PIL import Image as PillowImage
from rapl_msgs.action import Align
from rapl_msgs.srv import GetProgress, GetQuery, SubmitRanking, Undo
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from sensor_msgs.msg import Image
from std_msgs.msg import String

from rapl_core.errors import RaplError
from rapl_core.preferences import Query
from rapl_core.types import Ranking
from rapl_ros import conversions, qos, topics
from rapl_ros.calls import CallError, call, pause
from rapl_ros.conversions.people import (
    progress_from_ros,
    query_from_ros,
    standing_from_ros,
    taken_back_from_ros,
)
from rapl_ros.node import RaplNode
from rapl_ros.web.live import JobView, LiveBoard
from rapl_ros.web.ports import TakenBack
from rapl_ros.web.problems import RefusedError, conflict, unavailable
from rapl_ros.web.schemas import Progress, Standing

ASK_S = 15.0
"""For an answer of the preference node; some strategies think before they ask."""
SWAP_S = 180.0
"""For an encoder to load and to embed its experts; torch alone takes seconds to import."""
POLL_S = 0.2
GONE_S = 6.0
"""A node that was not seen for so long brings no result any more."""
PICTURE_WANTED_S = 5.0
"""After nobody has asked for so long, the camera is unsubscribed."""
JPEG_QUALITY = 88

Result = TypeVar("Result")


class WebGraph:
    """Implements :class:`~rapl_ros.web.ports.PreferencePort` and ``SystemPort`` on a node.

    :param node: must watch ``preference``.
    :param board: told how alignment and swap get on.
    :param method: encoder that an alignment trains.
    :param preset: its settings.
    """

    def __init__(self, node: RaplNode, board: LiveBoard, method: str, preset: str) -> None:
        self._node, self._board = node, board
        self._method, self._preset = method, preset
        self._get_query, self._submit, self._undo, self._get_progress = (
            node.create_client(kind, topics.of_node(name, topics.PREFERENCE))
            for kind, name in (
                (GetQuery, topics.GET_QUERY),
                (SubmitRanking, topics.SUBMIT_RANKING),
                (Undo, topics.UNDO),
                (GetProgress, topics.GET_PROGRESS),
            )
        )
        self._align = ActionClient(node, Align, topics.of_node(topics.ALIGN, topics.PREFERENCE))
        self._set_encoder = node.create_client(SetParameters, f"{topics.ENCODER}/set_parameters")
        self._unreadable = node.publish_to(String, topics.UNREADABLE_EPISODE, qos.event())
        self._wanted: int | None = None
        self._image: Image | None = None
        self._asked_s = float("-inf")

    # PreferencePort

    async def get_query(self, annotator: str, held: list[str]) -> Query:
        """Lease a query; see the port."""
        request = GetQuery.Request(annotator=annotator, resume=True, held=held)
        response = await self._call(self._get_query, request)
        if not response.success:
            code = "no_query" if response.message.startswith("no query") else "refused"
            raise unavailable(code, _sentence(response.message))
        return _read(query_from_ros, response.query)

    async def submit(self, ranking: Ranking) -> Standing:
        """Store a ranking; see the port."""
        request = SubmitRanking.Request(ranking=conversions.ranking_to_ros(ranking))
        response = await self._call(self._submit, request)
        if not response.success:
            raise conflict("refused", _sentence(response.message))
        return await self._with_wanted(standing_from_ros(response))

    async def undo(self, annotator: str, withdrawal_id: str, ranking_id: str) -> TakenBack:
        """Take back a ranking; see the port."""
        request = Undo.Request(
            annotator=annotator, withdrawal_id=withdrawal_id, ranking_id=ranking_id
        )
        response = await self._call(self._undo, request)
        if not response.success:
            raise conflict("nothing_to_undo", _sentence(response.message))
        taken = _read(taken_back_from_ros, response)
        return TakenBack(taken.ranking, taken.query, await self._with_wanted(taken.standing))

    async def progress(self) -> Progress:
        """How far the rankings are; see the port."""
        response = await self._call(self._get_progress, GetProgress.Request())
        if not response.success:
            raise unavailable("refused", _sentence(response.message))
        progress = progress_from_ros(response)
        self._wanted = progress.standing.wanted
        return progress

    def report_unreadable(self, episode_id: str, reason: str) -> None:
        """Tell that a video cannot be shown; see the port."""
        self._spawn(self._report, episode_id, reason)

    # SystemPort

    async def align(self) -> str:
        """Begin an alignment; see the port."""
        if self._board.align.state == "running":
            raise conflict("busy", "An alignment is under way already.")
        self._board.align = JobView(state="running", message="begins")
        try:
            handle = await self._ask(self._send_goal)
        except RaplError as error:
            self._board.align = JobView(state="failed", message=str(error))
            raise
        self._spawn(self._follow, handle)
        return f"{self._method}, preset {self._preset}, is being trained"

    async def swap(self, encoder: str) -> str:
        """Begin to put an encoder to work; see the port."""
        if self._board.swap.state == "running":
            raise conflict("busy", "An encoder is being loaded already.")
        before = self._board.swap
        self._board.swap = JobView(state="running", message=f"{encoder} is being loaded")
        try:
            if not await self._ask(self._encoder_is_there):
                raise unavailable("no_encoder", "The encoder node is not running.")
        except RaplError:
            self._board.swap = before
            raise
        self._spawn(self._set, encoder)
        return f"{encoder} is asked for"

    async def picture(self) -> bytes | None:
        """The camera's newest picture; see the port."""
        self._asked_s = time.monotonic()
        image = self._image
        return None if image is None else await asyncio.to_thread(_jpeg, image)

    # For the node

    @property
    def wants_pictures(self) -> bool:
        """Whether somebody looks at the camera's pictures now."""
        return time.monotonic() - self._asked_s < PICTURE_WANTED_S

    def show(self, image: Image | None) -> None:
        """Take the newest picture; None: there is none any more."""
        self._image = image
        self._board.has_picture = image is not None

    # Crossing over

    def _spawn(self, work: Callable[..., Awaitable[None]], *arguments: Any) -> None:
        """Have the executor run ``work``, which must be a coroutine function: it would call a
        lambda and never await what that returns."""
        assert self._node.executor is not None
        self._node.executor.create_task(work, *arguments)

    async def _ask(self, work: Callable[[], Awaitable[Result]]) -> Result:
        """Have the executor do ``work``."""
        done: ThreadFuture[Result] = ThreadFuture()
        done.set_running_or_notify_cancel()  # it is not cancelled half-way

        async def job() -> None:
            try:
                result = await work()
            except Exception as error:
                done.set_exception(error)
            else:
                done.set_result(result)

        self._spawn(job)
        try:
            return await asyncio.wrap_future(done)
        except CallError as error:
            raise unavailable("no_answer", _sentence(str(error))) from error

    async def _call(self, client: Any, request: Any) -> Any:
        return await self._ask(lambda: call(self._node, client, request, ASK_S))

    async def _with_wanted(self, standing: Standing) -> Standing:
        """An answer says how many are needed still; how many are wanted follows, if any are."""
        if standing.needed:
            self._wanted = standing.given + standing.needed
        elif self._wanted is None:  # nobody has asked since this node began
            with suppress(RefusedError):  # the answer is on disk all the same
                await self.progress()
        wanted = self._wanted or 0
        return Standing(given=standing.given, needed=standing.needed, wanted=wanted)

    # On the executor

    async def _report(self, episode_id: str, reason: str) -> None:
        self._unreadable.publish(String(data=episode_id))
        self._node.diagnostics.warn(f"video {episode_id}", f"cannot be shown: {reason}")

    async def _send_goal(self) -> Any:
        goal = Align.Goal(encoder=self._method, preset=self._preset)
        began_s = time.monotonic()
        while not self._align.server_is_ready():
            await self._wait(began_s)
        sent = self._align.send_goal_async(goal, feedback_callback=self._on_feedback)
        while not sent.done():
            await self._wait(began_s)
        handle = sent.result()
        if not handle.accepted:
            raise conflict("busy", "An alignment is under way already.")
        return handle

    async def _wait(self, began_s: float) -> None:
        if time.monotonic() - began_s > ASK_S:
            raise CallError(f"{topics.PREFERENCE} does not answer; waited {ASK_S:g} s")
        await pause(self._node, POLL_S)

    def _on_feedback(self, message: Any) -> None:
        feedback = message.feedback
        if feedback.epochs and self._board.align.state == "running":  # it may overtake the result
            words = f"epoch {feedback.epoch} of {feedback.epochs}"
            share = feedback.epoch / feedback.epochs
            self._board.align = JobView(state="running", share=share, message=words)

    async def _follow(self, handle: Any) -> None:
        peer = self._node.peers[topics.PREFERENCE]
        incarnation, seen_s = peer.incarnation, time.monotonic()
        answer = handle.get_result_async()
        while not answer.done():
            await pause(self._node, POLL_S)
            seen_s = time.monotonic() if peer.alive else seen_s
            if peer.incarnation != incarnation or time.monotonic() - seen_s > GONE_S:
                became = "has restarted" if peer.alive else "is gone"
                self._board.align = JobView(state="failed", message=f"{peer.name} {became}.")
                return
            if peer.detail.startswith("reads") and self._board.align.share is None:
                self._board.align = JobView(state="running", message=peer.detail)
        result = answer.result().result
        if not result.success:
            self._board.align = JobView(state="failed", message=_sentence(result.message))
            return
        name = result.uri.rpartition("/")[2]
        words = f"{name}: {result.held_out_accuracy:.0%} of held-out triplets ordered right."
        self._board.align = JobView(state="done", message=f"{words} Swap to put it to work.")

    async def _encoder_is_there(self) -> bool:
        return bool(self._set_encoder.service_is_ready())

    async def _set(self, encoder: str) -> None:
        value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=encoder)
        request = SetParameters.Request(parameters=[Parameter(name="encoder", value=value)])
        try:
            response = await call(self._node, self._set_encoder, request, SWAP_S)
        except CallError as error:
            self._board.swap = JobView(state="failed", message=_sentence(str(error)))
            return
        result = response.results[0]
        if result.successful:
            self._board.swap = JobView(state="done", message=f"{encoder} is at work.")
        else:
            self._board.swap = JobView(state="failed", message=_sentence(result.reason))


def _read(convert: Callable[[Any], Result], message: Any) -> Result:
    try:
        return convert(message)
    except RaplError as error:
        raise unavailable(
            "bad_answer", f"{topics.PREFERENCE} gave a bad answer: {error}"
        ) from error


def _jpeg(image: Image) -> bytes | None:
    try:
        frame = conversions.image_from_ros(image)  # (H, W, 3)
    except RaplError:
        return None
    buffer = io.BytesIO()
    PillowImage.fromarray(frame).save(buffer, "JPEG", quality=JPEG_QUALITY)
    return buffer.getvalue()


def _sentence(message: str) -> str:
    """What another node said, as people read it."""
    message = message.strip() or "refused without a reason"
    return f"{message[0].upper()}{message[1:]}{'' if message[-1] in '.!?' else '.'}"
