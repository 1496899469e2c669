"""Scenes placed by hand or at random: what a reward says of them, beside the human's own.

No video of the pool shows most of them; the robot, which tries everything, meets them all.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from rapl_core.representations import Encoder
from rapl_core.simulation.simulation import Simulation
from rapl_core.tasks import get_task
from rapl_core.types import EmbeddedEpisode

TASK = "franka_group"
Point = tuple[float, float]
Scene = tuple[Point, Point, Point]
"""Gripper, red cube, green cube; x and y in m."""

PATH = np.linspace(-0.05, 0.28, 9)
LANES = (-0.08, 0.0, 0.08)
RANDOM_SCENES = 600
STILL_FRAMES = 10
"""A scene alone is judged as a video of so many frames alike, as transport wants."""
SLOWED = 7
"""A way through the task is slowed down to a video's length."""
TRUTH = "human's reward r*"


def ways(lane: float) -> dict[str, list[Scene]]:
    """Ways through the task, each as scenes in order."""
    y = lane
    return {
        "both together, side by side": [
            ((x - 0.07, y), (x, y), (x + 0.02, y + 0.07)) for x in PATH
        ],
        "both together, in a column": [
            ((x - 0.07, y), (x, y), (min(x + 0.065, 0.345), y)) for x in PATH
        ],
        "red alone": [((x - 0.07, y), (x, y), (0.04, y + 0.11)) for x in PATH],
        "green alone": [((x - 0.07, y + 0.11), (-0.05, y), (x, y + 0.11)) for x in PATH],
        "green fetched, red in the goal": [
            ((x - 0.07, y + 0.11), (0.28, y), (x, y + 0.11)) for x in PATH
        ],
        "gap growing in the goal": [
            ((0.18, y), (0.26, y - gap / 2), (0.26, y + gap / 2))
            for gap in np.linspace(0.065, 0.35, len(PATH))
        ],
        "arm alone": [((x - 0.07, y - 0.1), (-0.05, y), (0.04, y + 0.11)) for x in PATH],
    }


def random_scene(rng: np.random.Generator) -> Scene:
    """Cubes touching or nearly so in six of ten, else anywhere; the gripper behind both, behind
    the red one, or elsewhere."""
    while True:
        centre = np.array([rng.uniform(0, 0.34), rng.uniform(-0.2, 0.2)])
        gap = rng.uniform(0.062, 0.09) if rng.random() < 0.6 else rng.uniform(0.09, 0.35)
        angle = rng.uniform(0, 2 * np.pi)
        half = gap / 2 * np.array([np.cos(angle), np.sin(angle)])
        red, green = centre + half, centre - half
        both = np.stack([red, green])
        if both[:, 0].max() > 0.36 or both[:, 0].min() < -0.1 or abs(both[:, 1]).max() > 0.28:
            continue
        gripper = (
            (both[:, 0].min() - 0.07, centre[1]),
            (red[0] - 0.07, red[1]),
            (rng.uniform(-0.1, 0.1), rng.uniform(-0.2, 0.2)),
        )[int(rng.integers(3))]
        return gripper, (red[0], red[1]), (green[0], green[1])


@dataclass(frozen=True)
class Scenes:
    """Pictures and r* of all scenes; those of the ways come first.

    :param frames: (N, H, W, 3).
    :param human: (N,) r*.
    """

    frames: NDArray[np.uint8]
    human: NDArray[np.float64]

    @classmethod
    def drawn(cls, work: Path) -> "Scenes":
        """Draw them, or take what was drawn before into ``work``."""
        kept = work / f"scenes-{RANDOM_SCENES}.npz"
        if not kept.is_file():
            frames, human = _draw()
            beside = kept.with_suffix(f".{os.getpid()}.npz")
            np.savez(beside, frames=frames, human=human)
            beside.replace(kept)
        with np.load(kept) as content:
            return cls(content["frames"], content["human"])

    def judge(self, encoder: Encoder, experts: Sequence[EmbeddedEpisode]) -> dict[str, Any]:
        """What the encoder's reward says.

        ``spearman``: rank correlation with r* over the random scenes; ``ways``: values along each
        way, mean over lanes, 0 with the arm alone at rest and 1 with both cubes in the goal.
        """
        embedded = encoder.embed(self.frames)

        def still(z: NDArray[np.float32]) -> float:
            return float(encoder.reward(np.repeat(z[None], STILL_FRAMES, 0), experts).values.mean())

        def slowed(z: NDArray[np.float32]) -> NDArray[np.float64]:
            values = encoder.reward(np.repeat(z, SLOWED, 0), experts).values
            return values.reshape(len(z), SLOWED).mean(axis=1)

        at = self._of_ways
        values = [still(z) for z in embedded[at:]]
        return {
            "spearman": float(spearmanr(values, self.human[at:]).statistic),
            "ways": self._along_ways(embedded[:at], slowed),
        }

    def truth(self) -> dict[str, list[float]]:
        """r* along each way, as :meth:`judge`."""
        return self._along_ways(self.human[: self._of_ways], lambda values: values)

    @property
    def _of_ways(self) -> int:
        return len(self.frames) - RANDOM_SCENES

    def _along_ways(
        self, each: NDArray[Any], rate: Callable[[NDArray[Any]], NDArray[np.float64]]
    ) -> dict[str, list[float]]:
        names = list(ways(0.0))
        by_lane = each.reshape(len(LANES), len(names), len(PATH), *each.shape[1:])
        means = {
            name: np.mean([rate(lane[number]) for lane in by_lane], axis=0)
            for number, name in enumerate(names)
        }
        low, high = means["arm alone"][0], means["both together, side by side"][-1]
        return {name: ((mean - low) / (high - low)).tolist() for name, mean in means.items()}


def _draw() -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    simulation = Simulation(get_task(TASK))
    frames, human = [], []

    def place(scene: Scene) -> None:
        gripper, red, green = (np.array(point) for point in scene)
        simulation.dynamics.place(simulation.data[0], gripper, [red, green])
        frames.append(simulation.render(0))
        state = simulation.dynamics.state(simulation.data[0])
        human.append(simulation.task.human_reward(state, state))

    for lane in LANES:
        for way in ways(lane).values():
            for scene in way:
                place(scene)
    rng, before = np.random.default_rng(0), len(frames)
    while len(frames) < before + RANDOM_SCENES:
        place(random_scene(rng))
    simulation.close()
    return np.stack(frames), np.array(human)
