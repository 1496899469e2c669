"""Scenes of franka_group placed by hand or at random: what a reward says of them, beside r*.

No video of a pool shows most of them; the robot, which tries everything, meets them all. A
landscape costs seconds and shows what correlations on videos hide.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rapl_core.analysis.measures import Wishes, spearman, wishes
from rapl_core.representations import Encoder
from rapl_core.simulation.simulation import Simulation
from rapl_core.tasks import get_task
from rapl_core.tasks.tabletop import TabletopDynamics
from rapl_core.types import EmbeddedEpisode

TASK = "franka_group"
Point = tuple[float, float]
Scene = tuple[Point, Point, Point]
"""Gripper, red cube, green cube; x and y in m."""

PATH = np.linspace(-0.05, 0.28, 9)
LANES = (-0.08, 0.0, 0.08)
RANDOM_SCENES = 600
SLOWED = 7
"""A way through the task is slowed down to a video's length."""
TRUTH = "human's reward r*"

TOGETHER = ("both together, side by side", "both together, in a column")
ALONE = ("red alone", "green alone")
GAP = "gap growing in the goal"
ARM = "arm alone"


def ways(lane: float) -> dict[str, list[Scene]]:
    """Ways through the task, each as scenes in order."""
    y = lane
    return {
        TOGETHER[0]: [((x - 0.07, y), (x, y), (x + 0.02, y + 0.07)) for x in PATH],
        TOGETHER[1]: [((x - 0.07, y), (x, y), (min(x + 0.065, 0.345), y)) for x in PATH],
        ALONE[0]: [((x - 0.07, y), (x, y), (0.04, y + 0.11)) for x in PATH],
        ALONE[1]: [((x - 0.07, y + 0.11), (-0.05, y), (x, y + 0.11)) for x in PATH],
        "green fetched, red in the goal": [
            ((x - 0.07, y + 0.11), (0.28, y), (x, y + 0.11)) for x in PATH
        ],
        GAP: [
            ((0.18, y), (0.26, y - gap / 2), (0.26, y + gap / 2))
            for gap in np.linspace(0.065, 0.35, len(PATH))
        ],
        ARM: [((x - 0.07, y - 0.1), (-0.05, y), (0.04, y + 0.11)) for x in PATH],
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
class Landscape:
    """What a reward says of the scenes."""

    spearman: float
    """Rank correlation with r* over the random scenes; NaN for a reward that is the same in all."""
    ways: Mapping[str, NDArray[np.float64]]
    """By way (N,) values along it, mean over lanes, in the reward's own unit."""

    def scaled(self) -> dict[str, list[float]]:
        """The ways, 0 with the arm alone at rest and 1 with both cubes in the goal."""
        low, high = self.ways[ARM][0], self.ways[TOGETHER[0]][-1]
        return {name: ((way - low) / (high - low)).tolist() for name, way in self.ways.items()}

    def wishes(self) -> Wishes:
        """One number for each wish that a reward of this task must express."""
        together, alone = (
            np.mean([self.ways[name] for name in names], axis=0) for names in (TOGETHER, ALONE)
        )
        return wishes(together, alone, self.ways[GAP], self.ways[ARM])

    def to_json(self) -> dict[str, Any]:
        """``spearman``, and ``ways`` as :meth:`scaled`."""
        return {"spearman": self.spearman, "ways": self.scaled()}


@dataclass(frozen=True)
class Scenes:
    """Pictures and r* of all scenes; those of the ways come first."""

    frames: NDArray[np.uint8]
    """(N, H, W, 3)."""
    human: NDArray[np.float64]
    """(N,) r*."""

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

    def judge(
        self,
        encoder: Encoder,
        experts: Sequence[EmbeddedEpisode],
        embedded: NDArray[np.float32] | None = None,
    ) -> Landscape:
        """What the encoder's reward says.

        :param embedded: (N, D) the scenes through the encoder, where they are known.
        """
        z = encoder.embed(self.frames) if embedded is None else embedded

        def alone(frame: NDArray[np.float32]) -> float:
            # frames that are all alike are transported at one cost, however many they are
            return float(encoder.reward(frame[None], experts).values[0])

        def slowed(way: NDArray[np.float32]) -> NDArray[np.float64]:
            values = encoder.reward(np.repeat(way, SLOWED, 0), experts).values
            return np.asarray(values.reshape(len(way), SLOWED).mean(axis=1))

        at = self._of_ways
        values = [alone(frame) for frame in z[at:]]
        return Landscape(spearman(values, self.human[at:]), self._along_ways(z[:at], slowed))

    def truth(self) -> Landscape:
        """The landscape of r* itself."""
        at = self._of_ways
        return Landscape(1.0, self._along_ways(self.human[:at], lambda values: values))

    @property
    def _of_ways(self) -> int:
        return len(self.frames) - RANDOM_SCENES

    def _along_ways(
        self, each: NDArray[Any], rate: Callable[[NDArray[Any]], NDArray[np.float64]]
    ) -> dict[str, NDArray[np.float64]]:
        names = list(ways(0.0))
        by_lane = each.reshape(len(LANES), len(names), len(PATH), *each.shape[1:])
        return {
            name: np.mean([rate(lane[number]) for lane in by_lane], axis=0)
            for number, name in enumerate(names)
        }


def _draw() -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    simulation = Simulation(get_task(TASK))
    dynamics = simulation.dynamics
    assert isinstance(dynamics, TabletopDynamics)
    frames, human = [], []

    def place(scene: Scene) -> None:
        gripper, red, green = (np.array(point) for point in scene)
        dynamics.place(simulation.data[0], gripper, [red, green])
        frames.append(simulation.render(0))
        state = dynamics.state(simulation.data[0])
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
