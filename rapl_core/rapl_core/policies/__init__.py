"""Learning a policy: SAC on whole episodes whose rewards arrive after they have ended.

``in_process`` is not imported here: it needs the simulation, which a learner node does not.
"""

from rapl_core.policies.checkpoint import CheckpointFolder, Part, read_checkpoint, write_checkpoint
from rapl_core.policies.config import SacConfig, ScheduleConfig
from rapl_core.policies.evaluation import EpisodeOutcome, Evaluation, summarise_evaluation
from rapl_core.policies.learning import Learning
from rapl_core.policies.learning_curve import CurvePoint, LearningCurve
from rapl_core.policies.metrics_log import MetricsLog
from rapl_core.policies.relabelling import Relabelling, RewardLabels
from rapl_core.policies.rewards import (
    EncoderReward,
    EpisodeReward,
    GroundTruthReward,
    RewardSource,
    fit_scale,
)
from rapl_core.policies.sac_trainer import SacTrainer, UpdateMetrics
from rapl_core.policies.schedule import Block, LearningSchedule
from rapl_core.policies.staging import EpisodeStager
from rapl_core.policies.transitions import EpisodeTransitions

__all__ = [
    "Block",
    "CheckpointFolder",
    "CurvePoint",
    "EncoderReward",
    "EpisodeOutcome",
    "EpisodeReward",
    "EpisodeStager",
    "EpisodeTransitions",
    "Evaluation",
    "GroundTruthReward",
    "Learning",
    "LearningCurve",
    "LearningSchedule",
    "MetricsLog",
    "Part",
    "Relabelling",
    "RewardLabels",
    "RewardSource",
    "SacConfig",
    "SacTrainer",
    "ScheduleConfig",
    "UpdateMetrics",
    "fit_scale",
    "read_checkpoint",
    "summarise_evaluation",
    "write_checkpoint",
]
