"""What more than one stage does: gathering rankings, aligning, going over to an encoder."""

import math
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from rapl_msgs.action import Align
from rapl_msgs.srv import GetProgress

from rapl_ros import topics
from rapl_ros.calls import CallError, call, pause
from rapl_ros.progress import count_in
from rapl_ros.stage_context import StageContext

Result = Mapping[str, Any]

SWAP_DEADLINE_S = 900.0
"""For an encoder to load and to embed its experts: seconds on a quiet machine, minutes on one with
twenty processes a core. That it died meanwhile is noticed at once, by its heartbeat."""
PARAMETER_DEADLINE_S = 30.0
"""For a node to appear, or to answer, where setting takes no time."""
PEOPLE_S = 0.5
SIMULATED_S = 0.2
"""Between two looks at how many rankings there are."""


async def _nothing() -> None:
    return


async def given(context: StageContext) -> int:
    """How many rankings count; a preference node that is busy or gone is waited for.

    :raises CallError: if it answers that it cannot say.
    """
    waited = False
    while True:
        try:
            response = await call(context.node, context.progress, GetProgress.Request())
        except CallError as error:
            waited = True
            context.say(f"for {topics.PREFERENCE}: {error}")
            await pause(context.node, 1.0)
            continue
        if waited:
            context.say("")
        check(response, "rank")
        return int(response.given)


async def gather_rankings(
    context: StageContext,
    wanted: int,
    prepare: Callable[[], Awaitable[None]] = _nothing,
    is_over: Callable[[], bool] = lambda: False,
    words: str = "",
) -> int:
    """Wait until so many rankings are given in all; returns how many there are.

    People take their time: only what counts is counted, and there is no deadline.

    :param prepare: done first, and again when the preference node or the simulated human has been
        replaced, for what restarts has forgotten it.
    :param is_over: ends the waiting.
    :param words: what goes on, for the progress.
    """
    peers, asks_people = context.node.peers, context.run.asks_people
    names = [topics.PREFERENCE] if asks_people else [topics.PREFERENCE, topics.SIMULATED_HUMAN]
    prepared: list[str] | None = None
    while True:
        present = [peers[name].incarnation for name in names]
        if present != prepared:
            await prepare()
            if not asks_people:
                await context.human.set("rankings", wanted, PARAMETER_DEADLINE_S)
            prepared = [peers[name].incarnation for name in names]
        have = await given(context)
        detail = words
        if asks_people:
            detail = words or "people rank on the page"
        elif (human := peers[topics.SIMULATED_HUMAN]).status == "waiting":
            detail = human.detail if "until" in human.detail else words
        context.show(min(have, wanted), wanted, "rankings", detail)
        if have >= wanted or is_over():
            return have
        await pause(context.node, PEOPLE_S if asks_people else SIMULATED_S)


async def align_and_swap(context: StageContext, rankings: int) -> Result:
    """Train the encoder and put it to work.

    :param rankings: the first so many; 0: all.
    """
    run = context.run
    preference = context.node.peers[topics.PREFERENCE]
    epochs = 0

    def show(feedback: Align.Feedback) -> None:
        nonlocal epochs
        epochs = feedback.epochs
        accuracy = feedback.held_out_accuracy
        known = f"held-out accuracy {accuracy:.0%}" if math.isfinite(accuracy) else ""
        context.show(feedback.epoch, feedback.epochs, "epochs", known)

    def show_reading() -> None:
        # It reads the videos' features first, and says so on its heartbeat.
        count = count_in(preference.detail)
        if count and not epochs:
            what, done, total, unit = count
            context.show(done, total, unit, what)

    goal = Align.Goal(encoder=run.reward, preset=run.preset, triplets=rankings, seed=run.seed)
    result = await context.align.run(goal, show, on_wait=show_reading)
    check(result, "align")
    await context.encoder.set("encoder", run.reward_encoder, SWAP_DEADLINE_S)
    return {
        "held_out_accuracy": float(result.held_out_accuracy),
        "triplets": int(result.triplets),
        "version": result.version,
        "uri": result.uri,
        "people": result.findings,
    }


def check(result: Any, what: str) -> None:
    """
    :raises CallError: if an action did not succeed.
    """
    if not result.success:
        raise CallError(f"{what}: {result.message}")
