"""Progress of stages."""

from rapl_msgs import msg as wire_msg
from std_msgs.msg import Header

from rapl_ros.conversions.headers import time_to_ros
from rapl_ros.progress import StageProgress


def progress_to_ros(progress: StageProgress, stamp_ns: int) -> wire_msg.Progress:
    """How far a stage is, at wall time ``stamp_ns``."""
    return wire_msg.Progress(
        header=Header(stamp=time_to_ros(stamp_ns)),
        stage=progress.stage,
        stage_index=int(progress.index),
        stages=int(progress.stages),
        status=progress.status,
        done=int(progress.done),
        total=int(progress.total),
        unit=progress.unit,
        rate_hz=float(progress.rate_hz),
        remaining_s=float(progress.remaining_s),
        detail=progress.detail,
    )


def progress_from_ros(msg: wire_msg.Progress) -> StageProgress:
    """How far a stage is."""
    return StageProgress(
        stage=msg.stage,
        index=msg.stage_index,
        stages=msg.stages,
        status=msg.status,
        done=msg.done,
        total=msg.total,
        unit=msg.unit,
        rate_hz=msg.rate_hz,
        remaining_s=msg.remaining_s,
        detail=msg.detail,
    )
