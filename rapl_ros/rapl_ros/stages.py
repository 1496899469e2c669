"""The stages of the main job: what each asks of which node, and how it goes on after a stop."""

import math
import os
import re
import subprocess
import sys
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from rapl_msgs.action import Align, Collect, Evaluate, Train
from rapl_msgs.srv import GetProgress

from rapl_core.episodes import EpisodeStore
from rapl_core.tasks import get_task
from rapl_ros import topics
from rapl_ros.calls import CallError, call, pause
from rapl_ros.goals import ActionPort, ParameterPort
from rapl_ros.node import RaplNode
from rapl_ros.progress import count_in
from rapl_ros.run_config import RunConfig

SWAP_DEADLINE_S = 900.0
"""For an encoder to load and to embed its experts: seconds on a quiet machine, minutes on one with
twenty processes a core. That it died meanwhile is noticed at once, by its heartbeat."""
HUMAN_DEADLINE_S = 30.0
"""For the simulated human to appear, or to answer."""
DRAWN_NOISE = -1.0
"""Asks the demonstrator to draw each episode's noise."""

Result = Mapping[str, Any]


class ShowProgress(Protocol):
    """Takes how far the stage under way is."""

    def __call__(self, done: int, total: int, unit: str, detail: str = "") -> None: ...


class StageContext:
    """What the stages work with.

    :param node: whose clients are used.
    :param show: takes progress.
    :param say: takes what is waited for; empty when the wait is over.
    """

    def __init__(
        self,
        node: RaplNode,
        run: RunConfig,
        folder: Path,
        show: ShowProgress,
        say: Callable[[str], None],
    ) -> None:
        def port(kind: type, name: str, peer: str) -> ActionPort:
            return ActionPort(node, kind, topics.of_node(name, peer), peer, say)

        self.node, self.run, self.folder, self.show, self.say = node, run, folder, show, say
        self.collect = port(Collect, topics.COLLECT, topics.DEMONSTRATOR)
        self.align = port(Align, topics.ALIGN, topics.PREFERENCE)
        self.train = port(Train, topics.TRAIN, topics.LEARNER)
        self.evaluate = port(Evaluate, topics.EVALUATE, topics.LEARNER)
        self.progress = node.create_client(
            GetProgress, topics.of_node(topics.GET_PROGRESS, topics.PREFERENCE)
        )
        self.encoder = ParameterPort(node, topics.ENCODER, say)
        self.human = ParameterPort(node, topics.SIMULATED_HUMAN, say)


@dataclass(frozen=True)
class Stage:
    """One stage of the main job."""

    name: str
    perform: Callable[[StageContext], Awaitable[Result]]
    """Does what is still to do; called again after an interruption."""
    summary: Callable[[Result], str]
    """What the result is in a few words."""
    is_needed: Callable[[RunConfig], bool] = lambda run: True
    is_stale: Callable[[RunConfig, Result], bool] = lambda run, result: False
    """Whether it must run again although it is done, with this result."""


async def collect(context: StageContext) -> Result:
    """Fill the pool of videos; what is on disk counts."""
    run, wanted = context.run, context.run.pool_episodes
    pool = _pool(context.folder)
    have = len(pool)
    dropped = 0
    if have < wanted:
        goal = Collect.Goal(
            episodes=wanted - have,
            noise=DRAWN_NOISE,
            purpose="demonstrate",
            seed=run.seed,
            # Beyond every number used so far, whichever world recorded how many.
            first_episode=_next_number(pool),
        )
        result = await context.collect.run(
            goal, lambda feedback: context.show(have + feedback.done, wanted, "videos")
        )
        _check(result, "collect")
        dropped = result.dropped
    context.show(wanted, wanted, "videos")
    return {"videos": len(_pool(context.folder)), "dropped": dropped}


async def rank(context: StageContext) -> Result:
    """Wait until the human, simulated or not, has given the rankings wanted."""
    wanted = context.run.triplets
    if context.run.asks_people:
        return await _wait_for_people(context, wanted)
    human = context.node.peers[topics.SIMULATED_HUMAN]
    asked = ""
    while True:
        if human.incarnation != asked:  # a human that restarted has forgotten how many are wanted
            await context.human.set("rankings", wanted, HUMAN_DEADLINE_S)
            asked = human.incarnation
        given = await _given(context)
        lack = human.detail if human.status == "waiting" and "until" in human.detail else ""
        context.show(min(given, wanted), wanted, "rankings", lack)
        if given >= wanted:
            return {"rankings": given}
        await pause(context.node, 0.2)


async def _wait_for_people(context: StageContext, wanted: int) -> Result:
    """People take their time: only what counts is counted, and there is no deadline."""
    while True:
        given = await _given(context)
        context.show(min(given, wanted), wanted, "rankings", "people rank on the page")
        if given >= wanted:
            return {"rankings": given}
        await pause(context.node, 0.5)


async def _given(context: StageContext) -> int:
    """How many rankings count; a preference node that is busy or gone is waited for.

    :raises CallError: if it answers that it cannot say.
    """
    while True:
        try:
            response = await call(context.node, context.progress, GetProgress.Request())
        except CallError as error:
            context.say(f"for {topics.PREFERENCE}: {error}")
            await pause(context.node, 1.0)
            continue
        context.say("")
        _check(response, "rank")
        return int(response.given)


async def demonstrate(context: StageContext) -> Result:
    """Show how it should be done until there are as many preferred videos as wanted.

    The pool's own preferred ones count. It runs after the ranking, so that what is ranked is the
    same for every reward.
    """
    from rapl_core.demonstrators import preferred_behaviours  # loads the simulator

    run = context.run
    preferred = preferred_behaviours(get_task(run.task))
    have = _shown(context.folder, preferred)
    if have < run.demonstrations:
        goal = Collect.Goal(
            episodes=run.demonstrations - have,
            behaviours=preferred,
            noise=DRAWN_NOISE,
            purpose="demonstrate",
            seed=run.seed,
            first_episode=_next_number(_pool(context.folder)),
        )
        result = await context.collect.run(
            goal,
            lambda feedback: context.show(have + feedback.done, run.demonstrations, "videos"),
        )
        _check(result, "demonstrate")
    context.show(run.demonstrations, run.demonstrations, "videos")
    return {"demonstrations": _shown(context.folder, preferred)}


async def align(context: StageContext) -> Result:
    """Train the encoder from the rankings and put it to work."""
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

    goal = Align.Goal(encoder=run.reward, preset=run.preset, triplets=run.triplets, seed=run.seed)
    result = await context.align.run(goal, show, on_wait=show_reading)
    _check(result, "align")
    await context.encoder.set("encoder", run.reward_encoder, SWAP_DEADLINE_S)
    return {
        "held_out_accuracy": float(result.held_out_accuracy),
        "triplets": int(result.triplets),
        "version": result.version,
        "uri": result.uri,
        "people": result.findings,
    }


async def train(context: StageContext) -> Result:
    """Train the policy up to the wanted number of world steps."""
    wanted = context.run.steps

    def show(feedback: Train.Feedback) -> None:
        metrics = feedback.metrics
        success = metrics.success_rate
        context.show(
            min(metrics.steps, wanted),  # the last round of episodes goes beyond
            wanted,
            "steps",
            f"success {success:.0%}" if math.isfinite(success) else "",
        )

    result = await context.train.run(Train.Goal(steps=wanted, resume=True), show)
    _check(result, "train")
    metrics = result.metrics
    return {
        "steps": int(metrics.steps),
        "updates": int(metrics.updates),
        "episodes": int(metrics.episodes),
        "dropped_episodes": int(metrics.dropped_episodes),
        "policy_id": result.policy_id,
    }


async def evaluate(context: StageContext) -> Result:
    """Let the learnt policy act without exploring, on starts seen nowhere else."""
    wanted = context.run.final_episodes
    result = await context.evaluate.run(
        Evaluate.Goal(episodes=wanted, seed=context.run.seed),
        lambda feedback: context.show(
            feedback.done, wanted, "episodes", f"success {feedback.success_rate:.0%}"
        ),
    )
    _check(result, "evaluate")
    return {
        "success_rate": float(result.success_rate),
        "human_return_mean": float(result.human_return_mean),
        "reward_mean": float(result.reward_mean),
        "episodes": len(result.episode_ids),
        "episode_ids": list(result.episode_ids),
    }


async def report(context: StageContext) -> Result:
    """Write report.html in a process of its own, for it needs torch and this node does not."""
    context.show(0, 1, "report")
    command = [
        sys.executable,
        "-m",
        "rapl_ros.tethered",
        str(os.getpid()),
        "rapl_core.cli",
        "report",
        str(context.folder),
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        while process.poll() is None:
            await pause(context.node, 0.1)
    finally:
        if process.poll() is None:
            process.kill()
        output = process.communicate()[0].strip()
    if process.returncode != 0:
        last = output.splitlines()[-1] if output else f"exit code {process.returncode}"
        context.node.get_logger().error(output)
        raise CallError(f"the report failed: {last}")
    return {"report": "report.html"}


STAGES: tuple[Stage, ...] = (
    Stage(
        "collect",
        collect,
        lambda r: f"{r['videos']} videos",
        is_needed=lambda run: run.uses_rankings,
    ),
    Stage(
        "rank",
        rank,
        lambda r: f"{r['rankings']} rankings",
        is_needed=lambda run: run.uses_rankings,
    ),
    Stage(
        "demonstrate",
        demonstrate,
        lambda r: f"{r['demonstrations']} preferred demonstrations",
        is_needed=lambda run: run.uses_demonstrations,
    ),
    Stage(
        "align",
        align,
        lambda r: _accuracy_words(r["held_out_accuracy"]),
        is_needed=lambda run: run.uses_rankings,
    ),
    Stage(
        "train",
        train,
        lambda r: f"{r['updates']} gradient steps, {r['episodes']} episodes",
        is_stale=lambda run, result: result["steps"] < run.steps,
    ),
    Stage("evaluate", evaluate, lambda r: f"success {r['success_rate']:.0%}"),
    Stage("report", report, lambda r: str(r["report"])),
)


def _pool(folder: Path) -> list[str]:
    store = EpisodeStore(folder / "episodes")
    return [e.episode_id for e in store.summaries() if e.purpose == "demonstrate"]


def _shown(folder: Path, behaviours: Sequence[str]) -> int:
    store = EpisodeStore(folder / "episodes")
    shown = [e for e in store.summaries() if e.purpose == "demonstrate"]
    return sum(e.behaviour in behaviours for e in shown)


def _next_number(episode_ids: Sequence[str]) -> int:
    """Beyond every number within its world; videos that others have brought have none."""
    found = (re.fullmatch(r"\w+-s\d+-w\d+-(\d+)-\w+", name) for name in episode_ids)
    return max((int(match[1]) for match in found if match), default=-1) + 1


def _accuracy_words(accuracy: float) -> str:
    known = math.isfinite(accuracy)
    return (
        f"{accuracy:.0%} of held-out triplets ordered right"
        if known
        else "nothing to learn from rankings"
    )


def _check(result: Any, what: str) -> None:
    if not result.success:
        raise CallError(f"{what}: {result.message}")
