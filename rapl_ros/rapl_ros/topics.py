"""Every name on the wire. All are relative: the nodes live in the namespace ``rapl``."""

from typing import Final

NAMESPACE: Final = "rapl"

# Nodes
SIMULATOR: Final = "simulator"
ENCODER: Final = "encoder"
OT_REWARD: Final = "ot_reward"
LEARNER: Final = "learner"
RECORDER: Final = "recorder"
PREFERENCE: Final = "preference"
SIMULATED_HUMAN: Final = "simulated_human"
DEMONSTRATOR: Final = "demonstrator"
CONDUCTOR: Final = "conductor"
WEB: Final = "web"

# Topics
CAMERA_IMAGE: Final = "camera/image_raw"
CAMERA_COMPRESSED: Final = "camera/image_raw/compressed"
CAMERA_INFO: Final = "camera/camera_info"
JOINT_STATES: Final = "joint_states"
STATE: Final = "state"
ACTION: Final = "action"
WORLD_INFO: Final = "world_info"
CLOCK: Final = "/clock"
EMBEDDING: Final = "embedding"
ENCODER_INFO: Final = "encoder_info"
EXPERTS: Final = "experts"
REWARD: Final = "reward"
METRICS: Final = "metrics"
POLICY_INFO: Final = "policy_info"
EPISODE: Final = "episode"
UNREADABLE_EPISODE: Final = "unreadable_episode"
PROGRESS: Final = "progress"
DIAGNOSTICS: Final = "/diagnostics"

# Services and actions, private to the node that serves them
RESET: Final = "~/reset"
EMBED_EPISODES: Final = "~/embed_episodes"
REWARD_AGAIN: Final = "~/reward_again"
SAVE: Final = "~/save"
GET_QUERY: Final = "~/get_query"
SUBMIT_RANKING: Final = "~/submit_ranking"
LIST_RANKINGS: Final = "~/list_rankings"
UNDO: Final = "~/undo"
GET_PROGRESS: Final = "~/get_progress"
TRAIN: Final = "~/train"
EVALUATE: Final = "~/evaluate"
ALIGN: Final = "~/align"
COLLECT: Final = "~/collect"
HEARTBEAT: Final = "~/heartbeat"


def world_topic(name: str, world: int) -> str:
    """Name of a camera or joint topic: bare for world 0, ``env_<i>/...`` for the others."""
    return name if world == 0 else f"env_{world}/{name}"


def world_frame(world: int) -> str:
    """tf frame in which the positions of a world are given."""
    return f"env_{world}/world"


def camera_frame(world: int) -> str:
    """tf frame of a world's camera, z forward (REP-103)."""
    return f"env_{world}/camera_optical_frame"


def of_node(private_name: str, node: str) -> str:
    """Name by which others reach what ``node`` serves, e.g. ``~/reset`` -> ``simulator/reset``."""
    return private_name.replace("~", node, 1)
