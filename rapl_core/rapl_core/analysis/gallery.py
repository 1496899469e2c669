"""What each task looks like: a preferred and a disliked episode from the same start."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from rapl_core.analysis.visibility import cut_objects
from rapl_core.demonstrators import Behaviour, behaviours_of, make_demonstrator
from rapl_core.errors import RaplError
from rapl_core.simulation.simulation import Simulation, Snapshot, episode_rng
from rapl_core.tasks.base import Task

STARTS = 30
"""How many starts are tried until one tells the two behaviours apart."""
PICTURES = 8
GAP = 4
LABEL = 20
"""Pixels above each row."""
COLOURS = 128
"""Of the palette: a third of the bytes, and no difference to the eye."""
VIDEO_SCALE = 2
HOLD_MS = 1500
"""How long a video stays on its last picture."""
INK, PAPER = (30, 30, 30), (255, 255, 255)


@dataclass(frozen=True)
class Film:
    """One filmed episode."""

    behaviour: str
    success: bool
    frames: NDArray[np.uint8]
    """(T + 1, H, W, 3) RGB."""


@dataclass(frozen=True)
class Pair:
    """A preferred and a disliked episode of one task from the same start."""

    task: Task
    start: int
    """Number of the start in the stream of demonstrations, seed 0."""
    preferred: Film
    disliked: Film


def film_pair(task: Task) -> Pair:
    """Return the task's telling behaviours from the first start where both are what they are.

    A start from which the preferred one leaves all objects within the picture goes before others.
    Where the telling preferred one never succeeds, another preferred one takes its place.

    :raises RaplError: if no start of :data:`STARTS` shows one succeed and the disliked one fail.
    """
    simulation = Simulation(task)
    disliked = _telling_first(task, preferred=False)[0]
    try:
        for liked in _telling_first(task, preferred=True):
            start = _find_start(simulation, liked, disliked)
            if start is not None:
                films = [_film(simulation, behaviour, start) for behaviour in (liked, disliked)]
                return Pair(task, start, films[0], films[1])
    finally:
        simulation.close()
    raise RaplError(
        f"none of {STARTS} starts of {task.name} shows a preferred behaviour succeed and "
        f"{disliked.name} fail: look at its scripts"
    )


def _find_start(simulation: Simulation, liked: Behaviour, disliked: Behaviour) -> int | None:
    second_best = None
    for start in range(STARTS):
        # in this order: it is the preferred one's end that is looked at
        failed = not _play(simulation, disliked, start)
        if failed and _play(simulation, liked, start):
            if not cut_objects(simulation):
                return start
            second_best = start if second_best is None else second_best
    return second_best


def _telling_first(task: Task, preferred: bool) -> list[Behaviour]:
    of_kind = [b for b in behaviours_of(task).values() if b.preferred is preferred]
    return sorted(of_kind, key=lambda behaviour: not behaviour.telling)


def _play(
    simulation: Simulation,
    behaviour: Behaviour,
    start: int,
    frames: list[NDArray[np.uint8]] | None = None,
) -> bool:
    """Play an episode and return its success; add its pictures to ``frames`` if given."""
    demonstrator = make_demonstrator(simulation.task, behaviour.name, np.random.default_rng(start))
    snapshot: Snapshot = simulation.reset(0, episode_rng(0, "demonstrate", 0, start))
    while True:
        if frames is not None:
            frames.append(simulation.render(0))
        if snapshot.is_last:
            return snapshot.success
        snapshot = simulation.step(0, demonstrator.act(snapshot.state, snapshot.step))


def _film(simulation: Simulation, behaviour: Behaviour, start: int) -> Film:
    frames: list[NDArray[np.uint8]] = []
    success = _play(simulation, behaviour, start, frames)
    return Film(behaviour.name, success, np.stack(frames))


def draw_picture(pair: Pair) -> Image.Image:
    """Return two labelled rows of frames as the robot sees them, evenly spaced in time."""
    size = pair.task.image_size
    width = PICTURES * size + (PICTURES - 1) * GAP
    page = Image.new("RGB", (width, 2 * (LABEL + size)), PAPER)
    draw = ImageDraw.Draw(page)
    font = ImageFont.load_default(size=13)
    for row, (word, film) in enumerate(_captioned(pair)):
        top = row * (LABEL + size)
        draw.text((2, top + 2), word, fill=INK, font=font)
        chosen = np.linspace(0, len(film.frames) - 1, PICTURES).round().astype(int)
        for column, frame in enumerate(film.frames[chosen]):
            page.paste(Image.fromarray(frame), (column * (size + GAP), top + LABEL))
    return page.quantize(COLOURS, dither=Image.Dither.NONE)


def _captioned(pair: Pair) -> list[tuple[str, Film]]:
    return [
        (f"{word}: {film.behaviour.replace('_', ' ')}", film)
        for word, film in (("preferred", pair.preferred), ("disliked", pair.disliked))
    ]


def write_picture(pair: Pair, path: Path) -> None:
    """Write :func:`draw_picture` as a small PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draw_picture(pair).save(path, optimize=True)


def write_video(pair: Pair, path: Path) -> None:
    """Write both episodes side by side, in their own time, as an animated WebP."""
    both = np.concatenate([pair.preferred.frames, pair.disliked.frames], axis=2)  # (T + 1, H, 2 W)
    shape = (both.shape[2] * VIDEO_SCALE, both.shape[1] * VIDEO_SCALE)
    images = [Image.fromarray(f).resize(shape, Image.Resampling.NEAREST) for f in both]
    period_ms = round(1000 * pair.task.period_s)
    path.parent.mkdir(parents=True, exist_ok=True)
    images[0].save(
        path,
        save_all=True,
        append_images=images[1:],
        duration=[period_ms] * (len(images) - 1) + [HOLD_MS],
        loop=0,
        quality=80,
    )
