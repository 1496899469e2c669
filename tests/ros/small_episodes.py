"""Episodes just large enough for nodes that read them."""

from typing import Any

import numpy as np

from rapl_core.types import Episode


def small_episode(name: str, frames: np.ndarray, **more: Any) -> Episode:
    """A demonstration of pictures (T + 1, H, W, 3) whose states and actions are zero.

    :param more: fields of the episode besides.
    """
    steps = len(frames) - 1
    fields: dict[str, Any] = {
        "task": "franka_group",
        "world": 0,
        "purpose": "demonstrate",
        "controller": "demonstrator",
        "states": np.zeros((steps + 1, 2)),
        "actions": np.zeros((steps, 2)),
        "stamps_ns": np.arange(1, steps + 2, dtype=np.int64),
    }
    return Episode(episode_id=name, frames=frames, **(fields | more))
