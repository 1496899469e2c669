"""The picture of the README: a preferred push and a disliked one, from the same start.

python experiments/franka_group/picture.py            # writes docs/pictures/franka_group.png

Each row is one scripted episode through the camera that the robot learns from, at twice its
resolution. Behaviour and start are named here; what is drawn is whatever then happens, and the
script refuses to label a push by an outcome that it did not have.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from rapl_core.demonstrators import make_demonstrator
from rapl_core.errors import RaplError
from rapl_core.simulation.simulation import Simulation, episode_rng
from rapl_core.tasks import get_task
from rapl_core.tasks.tabletop import TabletopGroup

START = 9
"""Number of the start in the stream of demonstrations, seed 0."""
ROWS = (
    ("together_side_by_side", True, "Preferred: both cubes come to the goal together."),
    ("one_at_a_time", False, "Disliked: both come to the goal too, but one at a time."),
)
"""Behaviour, whether it must succeed, label."""
PICTURES = 8
SCALE = 2
GAP = 4
LABEL = 34
"""Pixels above each row."""
COLOURS = 160
"""Of the palette: half the bytes, and no difference to the eye."""
INK, PAPER = (30, 30, 30), (255, 255, 255)


def push(simulation: Simulation, behaviour: str, must_succeed: bool) -> NDArray[np.uint8]:
    """Return all frames (T + 1, H, W, 3) of one episode.

    :raises RaplError: if it does not end as the label says.
    """
    task = simulation.task
    demonstrator = make_demonstrator(task, behaviour, np.random.default_rng(0))
    snapshot = simulation.reset(0, episode_rng(0, "demonstrate", 0, START))
    frames = [simulation.render(0)]
    while not snapshot.is_last:
        action = demonstrator.act(snapshot.state, snapshot.step)
        snapshot = simulation.step(0, action)
        frames.append(simulation.render(0))
    assert isinstance(task, TabletopGroup)
    arrived = max(snapshot.state[16:18]) == 0.0
    if snapshot.success != must_succeed or not arrived:
        raise RaplError(
            f"{behaviour} from start {START}: success {snapshot.success}, both cubes in the goal "
            f"{arrived}; expected {must_succeed} and True: choose another START"
        )
    return np.stack(frames)


def compose(rows: list[tuple[str, NDArray[np.uint8]]]) -> Image.Image:
    """Return labelled rows of ``PICTURES`` frames, evenly spaced in time.

    :param rows: label and frames (N, H, W, 3).
    """
    size = rows[0][1].shape[1]
    width = PICTURES * size + (PICTURES - 1) * GAP
    page = Image.new("RGB", (width, len(rows) * (LABEL + size)), PAPER)
    draw = ImageDraw.Draw(page)
    font = ImageFont.load_default(size=22)
    for index, (label, frames) in enumerate(rows):
        top = index * (LABEL + size)
        draw.text((4, top + 4), label, fill=INK, font=font)
        chosen = np.linspace(0, len(frames) - 1, PICTURES).round().astype(int)
        for column, frame in enumerate(frames[chosen]):
            page.paste(Image.fromarray(frame), (column * (size + GAP), top + LABEL))
    return page


def main() -> None:
    """Draw and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("docs/pictures/franka_group.png"))
    arguments = parser.parse_args()
    task = get_task("franka_group")
    assert isinstance(task, TabletopGroup)
    larger = replace(task, config=replace(task.config, image_size=SCALE * task.image_size))
    simulation = Simulation(larger)
    page = compose([(label, push(simulation, behaviour, good)) for behaviour, good, label in ROWS])
    simulation.close()
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    page.quantize(COLOURS, dither=Image.Dither.NONE).save(arguments.out, optimize=True)
    print(f"{arguments.out}: {page.width} x {page.height}, {arguments.out.stat().st_size} bytes")


if __name__ == "__main__":
    main()
