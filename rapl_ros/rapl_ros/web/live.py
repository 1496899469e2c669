"""What the page about the running system shows: the newest of everything, free of ROS."""

import json
import math
import threading
import time
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import BaseModel

from rapl_ros.progress import StageProgress
from rapl_ros.wire import LearnerMetrics

REWARDS_KEPT = 60
METRICS_KEPT = 400
CURVE_PERIOD_S = 2.0
LEARNERS_PURPOSES = ("train", "evaluate")

Health = Literal["ok", "warning", "error", "gone", "absent"]


class StageView(BaseModel):
    """One stage of the main job."""

    name: str
    index: int
    status: str
    done: int
    total: int
    unit: str
    remaining_s: float | None
    detail: str


class RewardView(BaseModel):
    """The reward of one episode."""

    episode_id: str
    purpose: str
    valid: bool
    reason: str
    total: float | None
    version: str


class PointView(BaseModel):
    """How learning stood after some steps."""

    steps: int
    success_rate: float | None
    reward_mean: float | None


class EncoderView(BaseModel):
    """The encoder at work."""

    name: str
    version: str
    backbone: str
    preset: str
    dimension: int


class NodeView(BaseModel):
    """How one node is."""

    name: str
    health: Health
    status: str
    detail: str


class JobView(BaseModel):
    """What a button of this page has begun."""

    state: Literal["idle", "running", "done", "failed"] = "idle"
    share: float | None = None
    message: str = ""


class LiveView(BaseModel):
    """The whole page."""

    task: str
    run: str
    stages: list[StageView]
    stages_total: int
    metrics: list[PointView]
    evaluations: list[PointView]
    steps_per_s: float | None
    episodes: int
    rewards: list[RewardView]
    encoder: EncoderView | None
    encoders: list[str]
    nodes: list[NodeView]
    camera: bool
    align: JobView
    swap: JobView


@dataclass
class NodeState:
    """What is known of a node; written by whoever listens to it."""

    seen: bool = False
    alive: bool = False
    status: str = ""
    detail: str = ""
    level: int = 0
    complaint: str = ""

    def view(self, name: str) -> NodeView:
        """Return it for the page."""
        if not self.seen:
            return NodeView(name=name, health="absent", status="not started", detail="")
        if not self.alive:
            return NodeView(name=name, health="gone", status="gone", detail="")
        health: Health = ("ok", "warning", "error")[min(self.level, 2)]  # type: ignore[assignment]
        detail = self.complaint if self.level else self.detail
        return NodeView(name=name, health=health, status=self.status, detail=detail)


class LiveBoard:
    """Takes what arrives on the graph's thread and shows it on the server's.

    :param run_folder: has the learning curve and the encoders' checkpoints.
    :param task: name of the task; empty if unknown.
    :param nodes: names of the nodes, in the order in which to show them.
    :param conductor: the one that ends with the last stage.
    """

    def __init__(
        self, run_folder: Path, task: str, nodes: Iterable[str], conductor: str = ""
    ) -> None:
        self._folder, self._task, self._conductor = run_folder, task, conductor
        self._lock = threading.Lock()
        self._stages: dict[int, StageProgress] = {}
        self._metrics: list[LearnerMetrics] = []
        self._rewards: deque[RewardView] = deque(maxlen=REWARDS_KEPT)
        self._curve: list[PointView] = []
        self._curve_read_s = -math.inf
        self.nodes = {name: NodeState() for name in nodes}
        self.encoder: EncoderView | None = None
        self.has_picture = False
        self.align, self.swap = JobView(), JobView()

    def add_progress(self, progress: StageProgress) -> None:
        """A stage has come further."""
        with self._lock:
            self._stages[progress.index] = progress

    def add_metrics(self, metrics: LearnerMetrics) -> None:
        """The learner has told how it stands; older ones are thinned out evenly."""
        with self._lock:
            if self._metrics and metrics.steps < self._metrics[-1].steps:
                self._metrics.clear()  # another training
            self._metrics.append(metrics)
            if len(self._metrics) > METRICS_KEPT:
                del self._metrics[1:-1:2]

    def add_reward(self, reward: RewardView) -> None:
        """An episode has its reward; a later one for the same episode replaces it.

        Demonstrations are passed over: nothing learns from their reward, and before there is an
        encoder they have none.
        """
        if reward.purpose not in LEARNERS_PURPOSES:
            return
        with self._lock:
            for index, held in enumerate(self._rewards):
                if held.episode_id == reward.episode_id:
                    self._rewards[index] = reward
                    return
            self._rewards.append(reward)

    @property
    def stage(self) -> str:
        """Stage that the run is in; ``over`` after the last one, empty while none is known."""
        with self._lock:
            if not self._stages:
                return ""
            newest = self._stages[max(self._stages)]
        is_over = newest.status == "done" and newest.index == newest.stages
        return "over" if is_over else newest.stage

    def view(self) -> LiveView:
        """Return the page's content."""
        curve, nodes = self._evaluations(), self._node_views()
        with self._lock:
            last = self._metrics[-1] if self._metrics else None
            return LiveView(
                task=self._task,
                run=self._folder.resolve().name,
                stages=[_stage_view(self._stages[index]) for index in sorted(self._stages)],
                stages_total=max((stage.stages for stage in self._stages.values()), default=0),
                metrics=[_point_view(metrics) for metrics in self._metrics],
                evaluations=curve,
                steps_per_s=_known(last.steps_per_s) if last else None,
                episodes=last.episodes if last else 0,
                rewards=list(self._rewards),
                encoder=self.encoder,
                encoders=known_encoders(self._folder),
                nodes=nodes,
                camera=self.has_picture,
                align=self.align,
                swap=self.swap,
            )

    def _node_views(self) -> list[NodeView]:
        views = [state.view(name) for name, state in self.nodes.items()]
        if self.stage == "over":
            done = NodeView(name=self._conductor, health="absent", status="done", detail="")
            views = [
                done if view.name == self._conductor and view.health == "gone" else view
                for view in views
            ]
        return views

    def _evaluations(self) -> list[PointView]:
        """The learning curve on disk, read again every few seconds."""
        now_s = time.monotonic()
        if now_s - self._curve_read_s > CURVE_PERIOD_S:
            self._curve_read_s = now_s
            self._curve = _read_curve(self._folder / "policies" / "curve.json")
        return self._curve


def _read_curve(path: Path) -> list[PointView]:
    """Points of a learning curve; none while there is no file.

    Reads the file rather than asking rapl_core.policies, which would load torch.
    """
    try:
        points = json.loads(path.read_text())["points"]
        return [
            PointView(
                steps=point["steps"],
                success_rate=_known(point["success_rate"]),
                reward_mean=_known(point["reward_mean"]),
            )
            for point in points
        ]
    except (OSError, ValueError, KeyError, TypeError):
        return []


def known_encoders(run_folder: Path) -> list[str]:
    """Names that the encoder node takes: the raw one and the run's checkpoints, newest first.

    Lists folders rather than asking rapl_core.representations, which would load torch.
    """
    cards = (run_folder / "encoders").glob("[!.]*/card.json")
    found = sorted(cards, key=lambda card: card.stat().st_mtime_ns, reverse=True)
    return [*(card.parent.name for card in found), "imagenet"]


def _stage_view(progress: StageProgress) -> StageView:
    return StageView(
        name=progress.stage,
        index=progress.index,
        status=progress.status,
        done=progress.done,
        total=progress.total,
        unit=progress.unit,
        remaining_s=_known(progress.remaining_s),
        detail=progress.detail,
    )


def _point_view(metrics: LearnerMetrics) -> PointView:
    return PointView(
        steps=metrics.steps,
        success_rate=_known(metrics.success_rate),
        reward_mean=_known(metrics.reward_mean),
    )


def _known(value: float | None) -> float | None:
    """JSON has no NaN."""
    return value if value is not None and math.isfinite(value) else None
