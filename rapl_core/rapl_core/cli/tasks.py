"""``rapl list`` and ``rapl gallery``: the tasks, in words and in pictures."""

import argparse
from pathlib import Path
from typing import Any

from rapl_core.errors import RaplError


def add_to(commands: Any) -> None:
    """Declare the commands."""
    listed = commands.add_parser("list", help="name the tasks, their behaviours and the encoders")
    listed.set_defaults(work=_list)
    gallery = commands.add_parser(
        "gallery", help="picture and video of each task: a preferred and a disliked episode"
    )
    gallery.add_argument("tasks", nargs="*", metavar="TASK", help="names of tasks (all)")
    gallery.add_argument(
        "--pictures", type=Path, default=Path("docs/pictures/gallery"), help="(%(default)s)"
    )
    gallery.add_argument("--videos", type=Path, default=Path("runs/gallery"), help="(%(default)s)")
    gallery.set_defaults(work=_gallery)


def _list(_: argparse.Namespace) -> None:
    from rapl_core.demonstrators import behaviour_names
    from rapl_core.representations import encoder_names
    from rapl_core.tasks import get_task, task_names

    for name in task_names():
        task = get_task(name)
        print(f"{name}: {task.title}")
        print(f"  behaviours: {', '.join(behaviour_names(task))}")
    print(f"encoders: {', '.join(encoder_names())}")


def _gallery(arguments: argparse.Namespace) -> None:
    from rapl_core.analysis.gallery import film_pair, write_picture, write_video
    from rapl_core.tasks import get_task, task_names

    failed = []
    for task in [get_task(name) for name in arguments.tasks or task_names()]:
        try:
            pair = film_pair(task)
        except RaplError as error:  # the other tasks can be shown all the same
            failed.append(str(error))
            continue
        picture = arguments.pictures / f"{task.name}.png"
        video = arguments.videos / f"{task.name}.webp"
        write_picture(pair, picture)
        write_video(pair, video)
        print(f"{task.name}, start {pair.start}: {picture}, {video}", flush=True)
    if failed:
        raise RaplError("; ".join(failed))
