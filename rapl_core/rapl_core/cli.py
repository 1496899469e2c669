"""The command ``rapl``: looks at tasks and runs without a ROS graph."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rapl_core.errors import RaplError


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="rapl", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", help="name the tasks, their behaviours and the encoders")
    report = commands.add_parser("report", help="write report.html and results.json of a run")
    report.add_argument(
        "run", type=Path, help="run folder, e.g. runs/franka_group/rapl-tuned-seed0"
    )
    report.add_argument(
        "--oracle",
        type=Path,
        metavar="JSON",
        help="success curve of a run with the true reward, to draw beside (the one of a run in "
        "the same folder)",
    )
    gallery = commands.add_parser(
        "gallery", help="picture and video of each task: a preferred and a disliked episode"
    )
    gallery.add_argument("tasks", nargs="*", metavar="TASK", help="names of tasks (all)")
    gallery.add_argument(
        "--pictures", type=Path, default=Path("docs/pictures/gallery"), help="(%(default)s)"
    )
    gallery.add_argument("--videos", type=Path, default=Path("runs/gallery"), help="(%(default)s)")
    _add_rankings(commands)
    arguments = parser.parse_args(argv)
    try:
        if arguments.command == "list":
            _list()
        elif arguments.command == "gallery":
            _gallery(arguments.tasks, arguments.pictures, arguments.videos)
        elif arguments.command == "rankings":
            _rankings(arguments)
        else:
            _report(arguments.run, arguments.oracle)
    except RaplError as error:
        print(f"rapl: {error}", file=sys.stderr)
        return 1
    return 0


def _add_rankings(commands: Any) -> None:
    rankings = commands.add_parser("rankings", help="hand on a run's rankings, or take some in")
    verbs = rankings.add_subparsers(dest="verb", required=True)
    out = verbs.add_parser("export", help="write all rankings, corrected and withdrawn ones too")
    out.add_argument("run", type=Path, help="run folder")
    out.add_argument("out", type=Path, help="folder to write to")
    out.add_argument("--format", choices=("jsonl", "parquet"), default="jsonl")
    out.add_argument("--bags", action="store_true", help="with the bags of the ranked episodes")
    into = verbs.add_parser("import", help="add the rankings that a run lacks, and their bags")
    into.add_argument("run", type=Path, help="run folder")
    into.add_argument("source", type=Path, help="folder of an export, or a .jsonl or .parquet file")


def _rankings(arguments: argparse.Namespace) -> None:
    from rapl_core.preferences.package import export_package, import_package

    if arguments.verb == "export":
        done = export_package(arguments.run, arguments.out, arguments.format, arguments.bags)
        print(f"{done.path}: {done.rankings} rankings, {done.episodes} bags copied")
    else:
        done = import_package(arguments.run, arguments.source)
        print(f"{arguments.run}: {done.rankings} rankings added, {done.episodes} bags copied")


def _list() -> None:
    from rapl_core.demonstrators import behaviour_names
    from rapl_core.representations import encoder_names
    from rapl_core.tasks import get_task, task_names

    for name in task_names():
        task = get_task(name)
        print(f"{name}: {task.title}")
        print(f"  behaviours: {', '.join(behaviour_names(task))}")
    print(f"encoders: {', '.join(encoder_names())}")


def _gallery(names: Sequence[str], pictures: Path, videos: Path) -> None:
    from rapl_core.analysis.gallery import film_pair, write_picture, write_video
    from rapl_core.tasks import get_task, task_names

    failed = []
    for task in [get_task(name) for name in names or task_names()]:
        try:
            pair = film_pair(task)
        except RaplError as error:  # the other tasks can be shown all the same
            failed.append(str(error))
            continue
        picture, video = pictures / f"{task.name}.png", videos / f"{task.name}.webp"
        write_picture(pair, picture)
        write_video(pair, video)
        print(f"{task.name}, start {pair.start}: {picture}, {video}", flush=True)
    if failed:
        raise RaplError("; ".join(failed))


def _report(run: Path, oracle: Path | None) -> None:
    from rapl_core.analysis.record import read_run
    from rapl_core.analysis.report import write_report
    from rapl_core.policies.learning_curve import LearningCurve
    from rapl_core.representations import make_encoder

    record = read_run(run)
    settings, reward = record.settings, record.settings["reward"]
    encoder = None
    if reward != "ground_truth":
        encoder = make_encoder(settings.get("encoder") or reward, run)
        if (engine := settings.get("engine", "torch")) != "torch":
            experts = encoder.expert_ids or record.expert_ids()
            pictures = record.store.frames(experts[0]) if experts else None
            encoder.extractor.use_engine(engine, pictures=pictures)
    print(write_report(run, encoder, LearningCurve.load(oracle) if oracle else None))


if __name__ == "__main__":
    sys.exit(main())
