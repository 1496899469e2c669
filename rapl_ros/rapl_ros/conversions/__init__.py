"""Every ``x_from_ros`` and ``x_to_ros``: pure functions between messages and rapl_core's types.

rclpy does not check field types by default, and a numpy scalar arrives as garbage: everything is
cast here. Sequences go out as ``array.array``, which is microseconds where a numpy array is tenths
of seconds. What comes in is validated and refused with a RaplError.
"""

from rapl_ros.conversions.again import (
    embeddings_again_from_ros,
    fill_embed_episodes,
    fill_reward_again,
    rewards_again_from_ros,
)
from rapl_ros.conversions.encoders import (
    embedded_episode_from_ros,
    embedded_episode_to_ros,
    embedding_from_ros,
    embedding_to_ros,
    encoder_info_from_ros,
    encoder_info_to_ros,
    experts_from_ros,
    experts_to_ros,
    failed_embedding_to_ros,
    reward_rule_from_ros,
)
from rapl_ros.conversions.episodes import (
    VERDICTS,
    episode_record_from_ros,
    episode_record_to_ros,
    query_to_ros,
    ranking_from_ros,
    ranking_to_ros,
)
from rapl_ros.conversions.headers import (
    SECOND_NS,
    bytes_to_ros,
    counts_to_ros,
    floats_to_ros,
    header_to_ros,
    key_from_ros,
    singles_to_ros,
    time_from_ros,
    time_to_ros,
)
from rapl_ros.conversions.images import (
    ENCODINGS,
    camera_info_to_ros,
    compressed_image_from_ros,
    image_from_ros,
    image_to_ros,
)
from rapl_ros.conversions.learning import (
    align_feedback_to_ros,
    fill_align_result,
    metrics_from_ros,
    metrics_to_ros,
    policy_to_ros,
)
from rapl_ros.conversions.preferences import (
    annotator_progress_to_ros,
    fill_progress,
    query_request_from_ros,
)
from rapl_ros.conversions.progress import progress_from_ros, progress_to_ros
from rapl_ros.conversions.rewards import invalid_reward_to_ros, reward_from_ros, reward_to_ros
from rapl_ros.conversions.worlds import (
    action_from_ros,
    action_to_ros,
    joint_state_to_ros,
    state_from_ros,
    state_to_ros,
    world_from_ros,
    world_to_ros,
)
from rapl_ros.wire import answer

__all__ = [
    "ENCODINGS",
    "SECOND_NS",
    "VERDICTS",
    "action_from_ros",
    "action_to_ros",
    "align_feedback_to_ros",
    "annotator_progress_to_ros",
    "answer",
    "bytes_to_ros",
    "camera_info_to_ros",
    "compressed_image_from_ros",
    "counts_to_ros",
    "embedded_episode_from_ros",
    "embedded_episode_to_ros",
    "embedding_from_ros",
    "embedding_to_ros",
    "embeddings_again_from_ros",
    "encoder_info_from_ros",
    "encoder_info_to_ros",
    "episode_record_from_ros",
    "episode_record_to_ros",
    "experts_from_ros",
    "experts_to_ros",
    "failed_embedding_to_ros",
    "fill_align_result",
    "fill_embed_episodes",
    "fill_progress",
    "fill_reward_again",
    "floats_to_ros",
    "header_to_ros",
    "image_from_ros",
    "image_to_ros",
    "invalid_reward_to_ros",
    "joint_state_to_ros",
    "key_from_ros",
    "metrics_from_ros",
    "metrics_to_ros",
    "policy_to_ros",
    "progress_from_ros",
    "progress_to_ros",
    "query_request_from_ros",
    "query_to_ros",
    "ranking_from_ros",
    "ranking_to_ros",
    "reward_from_ros",
    "reward_rule_from_ros",
    "reward_to_ros",
    "rewards_again_from_ros",
    "singles_to_ros",
    "state_from_ros",
    "state_to_ros",
    "time_from_ros",
    "time_to_ros",
    "world_from_ros",
    "world_to_ros",
]
