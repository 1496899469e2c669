"""Metrics of learning, the policy at hand, progress of an alignment."""

from typing import TYPE_CHECKING

from rapl_msgs import msg as wire_msg
from rapl_msgs.action import Align
from std_msgs.msg import Header

from rapl_ros.conversions.headers import time_to_ros
from rapl_ros.wire import LearnerMetrics, PolicyRecord

if TYPE_CHECKING:
    from rapl_core.representations import EpochProgress
    from rapl_core.representations.alignment_job import AlignmentOutcome


def metrics_to_ros(metrics: LearnerMetrics, stamp_ns: int) -> wire_msg.Metrics:
    """LearnerMetrics to Metrics."""
    return wire_msg.Metrics(
        header=Header(stamp=time_to_ros(stamp_ns)),
        steps=int(metrics.steps),
        updates=int(metrics.updates),
        episodes=int(metrics.episodes),
        dropped_episodes=int(metrics.dropped_episodes),
        unrewarded_episodes=int(metrics.unrewarded_episodes),
        steps_per_s=float(metrics.steps_per_s),
        reward_mean=float(metrics.reward_mean),
        human_return_mean=float(metrics.human_return_mean),
        success_rate=float(metrics.success_rate),
        actor_loss=float(metrics.actor_loss),
        critic_loss=float(metrics.critic_loss),
        entropy_coefficient=float(metrics.entropy_coefficient),
    )


def metrics_from_ros(msg: wire_msg.Metrics) -> LearnerMetrics:
    """Metrics to LearnerMetrics."""
    return LearnerMetrics(
        steps=msg.steps,
        updates=msg.updates,
        episodes=msg.episodes,
        dropped_episodes=msg.dropped_episodes,
        unrewarded_episodes=msg.unrewarded_episodes,
        steps_per_s=msg.steps_per_s,
        reward_mean=msg.reward_mean,
        human_return_mean=msg.human_return_mean,
        success_rate=msg.success_rate,
        actor_loss=msg.actor_loss,
        critic_loss=msg.critic_loss,
        entropy_coefficient=msg.entropy_coefficient,
    )


def policy_to_ros(policy: PolicyRecord, stamp_ns: int) -> wire_msg.PolicyInfo:
    """PolicyRecord to PolicyInfo."""
    return wire_msg.PolicyInfo(
        header=Header(stamp=time_to_ros(stamp_ns)),
        policy_id=policy.policy_id,
        uri=policy.uri,
        steps=int(policy.steps),
        success_rate=float(policy.success_rate),
    )


def align_feedback_to_ros(progress: "EpochProgress") -> Align.Feedback:
    """EpochProgress to the feedback of Align."""
    return Align.Feedback(
        epoch=int(progress.epoch),
        epochs=int(progress.epochs),
        loss=float(progress.loss),
        held_out_accuracy=float(progress.held_out_accuracy),
    )


def fill_align_result(result: Align.Result, outcome: "AlignmentOutcome") -> None:
    """Put AlignmentOutcome into the result of Align."""
    first = outcome.groups[0]
    result.version, result.uri = first.version, first.uri
    result.held_out_accuracy = float(first.held_out_accuracy)
    result.mistakes = float(first.mistakes)
    result.triplets = int(outcome.triplets)
    result.findings = outcome.findings
    result.groups = [
        wire_msg.AnnotatorGroup(
            annotators=list(group.lesson.annotators),
            rankings=len(group.lesson.rankings),
            version=group.version,
            uri=group.uri,
            held_out_accuracy=float(group.held_out_accuracy),
            mistakes=float(group.mistakes),
        )
        for group in outcome.groups
    ]
