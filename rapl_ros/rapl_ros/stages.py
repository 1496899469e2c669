"""The stages of the main job: what each asks of which node, and how it goes on after a stop."""

import math
import os
import re
import subprocess
import sys
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rapl_msgs.action import Collect, Evaluate, Train

from rapl_core.episodes import EpisodeStore
from rapl_core.tasks import get_task
from rapl_ros.calls import CallError, pause
from rapl_ros.online import OnlineAlignments
from rapl_ros.run_config import RunConfig
from rapl_ros.stage_context import StageContext
from rapl_ros.stage_steps import Result, align_and_swap, check, gather_rankings

DRAWN_NOISE = -1.0
"""Asks the demonstrator to draw each episode's noise."""


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
        check(result, "collect")
        dropped = result.dropped
    context.show(wanted, wanted, "videos")
    return {"videos": len(_pool(context.folder)), "dropped": dropped}


async def rank(context: StageContext) -> Result:
    """Wait until the human, simulated or not, has given the rankings wanted."""
    return {"rankings": await gather_rankings(context, context.run.pool_triplets)}


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
        check(result, "demonstrate")
    context.show(run.demonstrations, run.demonstrations, "videos")
    return {"demonstrations": _shown(context.folder, preferred)}


async def align(context: StageContext) -> Result:
    """Train the encoder from the rankings and put it to work."""
    return await align_and_swap(context, context.run.pool_triplets)


async def train(context: StageContext) -> Result:
    """Train the policy up to the wanted number of world steps; align again meanwhile, if asked."""
    wanted = context.run.steps
    online = OnlineAlignments(context) if context.run.online_alignments else None

    def show(feedback: Train.Feedback) -> None:
        metrics = feedback.metrics
        success = metrics.success_rate
        details = [f"success {success:.0%}"] if math.isfinite(success) else []
        if online is not None:
            online.steps = int(metrics.steps)
            details += [online.detail] if online.detail else []
        # The last round of episodes goes beyond.
        context.show(min(metrics.steps, wanted), wanted, "steps", ", ".join(details))

    if online is not None:
        online.begin()
    try:
        result = await context.train.run(Train.Goal(steps=wanted, resume=True), show)
    finally:
        if online is not None:
            await online.end()
    check(result, "train")
    metrics = result.metrics
    found: dict[str, Any] = {
        "steps": int(metrics.steps),
        "updates": int(metrics.updates),
        "episodes": int(metrics.episodes),
        "dropped_episodes": int(metrics.dropped_episodes),
        "policy_id": result.policy_id,
    }
    if online is not None:
        found |= {
            "online_alignments": online.done,
            "online_wanted": context.run.online_alignments,
            "online_problem": online.problem,
        }
    return found


async def evaluate(context: StageContext) -> Result:
    """Let the learnt policy act without exploring, on starts seen nowhere else."""
    wanted = context.run.final_episodes
    result = await context.evaluate.run(
        Evaluate.Goal(episodes=wanted, seed=context.run.seed),
        lambda feedback: context.show(
            feedback.done, wanted, "episodes", f"success {feedback.success_rate:.0%}"
        ),
    )
    check(result, "evaluate")
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
        lambda r: f"{r['updates']} gradient steps, {r['episodes']} episodes" + _online_words(r),
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


def _online_words(result: Result) -> str:
    done, wanted = result.get("online_alignments"), result.get("online_wanted")
    return "" if done is None else f", aligned again {done} of {wanted} times"


def _accuracy_words(accuracy: float) -> str:
    known = math.isfinite(accuracy)
    return (
        f"{accuracy:.0%} of held-out triplets ordered right"
        if known
        else "nothing to learn from rankings"
    )
