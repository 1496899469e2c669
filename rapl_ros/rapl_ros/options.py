"""What the person who types ``./run_all.sh TASK`` can ask for."""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NoReturn

from rapl_core.errors import RaplError
from rapl_core.preferences.own_videos import online_alignments
from rapl_core.preferences.simulated_human import HumanKnobs
from rapl_core.preferences.strategies import STRATEGIES
from rapl_core.preferences.wishes import wish_names
from rapl_ros.run_config import CONFIG_FILE, RESULTS_FILE, RunConfig, load_config
from rapl_ros.run_lock import is_running
from rapl_ros.settings import (
    ENGINES,
    HUMANS,
    NOISES,
    PRESETS,
    RANGES,
    REWARDS,
    TRAINED,
    check_name,
    checked,
    continued,
)

KNOBS = tuple(knob.name for knob in fields(HumanKnobs))
FIELDS = {"episodes": "pool_episodes"}
"""Of :class:`RunConfig`, by option, where the names differ."""


@dataclass(frozen=True)
class RunRequest:
    """A parsed command line."""

    config: RunConfig
    folder: Path
    resume: bool
    keep_running: bool
    web_host: str = ""
    """Address on which the page listens; empty: there is no page."""


WEB_HOST = "127.0.0.1"
QUICK = {
    "pool_episodes": 60,
    "triplets": 40,
    "steps": 3_000,
    "random_steps": 500,
    "checkpoint_every": 1_000,
    "evaluate_every": 1_500,
    "evaluate_episodes": 8,
    "final_episodes": 12,
    "demonstrations": 40,
    "tcc_iterations": 300,
    "masked_iterations": 60,
}


class _Parser(argparse.ArgumentParser):
    """An argument parser that names the known options when one is unknown."""

    def error(self, message: str) -> NoReturn:
        known = [option for action in self._actions for option in action.option_strings]
        self.exit(2, f"{self.prog}: {message}\nknown options: {' '.join(known)}\n")


def build_parser(prog: str = "./run_all.sh") -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    default = RunConfig(task="")
    parser = _Parser(
        prog=prog,
        allow_abbrev=False,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Teach a robot what you prefer: collect videos, rank them, learn a\n"
        "representation from the rankings, train the robot by it, evaluate, report.",
        epilog=_epilog(),
    )
    parser.add_argument("task", nargs="?", metavar="TASK", help="what to learn, see --list")
    parser.add_argument("--list", action="store_true", help="name tasks, rewards and presets")
    parser.add_argument("--reward", metavar="NAME", help=f"{' | '.join(REWARDS)} (rapl)")
    parser.add_argument(
        "--encoder",
        metavar="NAME",
        help="encoder that embeds the pictures (the one that --reward implies)",
    )
    parser.add_argument("--preset", metavar="NAME", help=f"{' | '.join(PRESETS)} (tuned)")
    _add_rankings(parser, default)
    _add_learning(parser, default)
    parser.add_argument(
        "--out", type=Path, metavar="FOLDER", help="run folder (runs/TASK/REWARD-PRESET-seedN)"
    )
    parser.add_argument(
        "--resume",
        nargs="?",
        const="",
        metavar="FOLDER",
        help="go on with this run, or with the task's newest unfinished one",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="every stage in miniature, within five minutes: shows that it works, not how well",
    )
    parser.add_argument(
        "--keep-running",
        action="store_true",
        help="leave the graph running after the last stage, until Ctrl-C",
    )
    return parser


def _add_rankings(parser: _Parser, default: RunConfig) -> None:
    """Who ranks what, and how many."""
    parser.add_argument(
        "--human", metavar="NAME", help=f"who ranks: {' | '.join(HUMANS)} (simulated)"
    )
    parser.add_argument(
        "--web",
        nargs="?",
        const=WEB_HOST,
        metavar="HOST",
        help="show the page, on which people watch and rank; HOST other than this machine's own "
        f"address ({WEB_HOST}) lets others in who have the token that is printed",
    )
    parser.add_argument(
        "--strategy",
        metavar="NAME",
        help=f"which videos to ask about next: {' | '.join(STRATEGIES)} "
        "(contest with preset tuned, else uniform)",
    )
    parser.add_argument(
        "--noise",
        metavar="NAME",
        help=f"what to make of wrong answers: {' | '.join(NOISES)} (plain)",
    )
    _add_number(
        parser,
        "groups",
        "representations, one a group of people who agree; 0: as many as needed (1)",
    )
    parser.add_argument(
        "--people",
        metavar="NAME:WISH,...",
        help=f"simulated people; wishes: {' | '.join(wish_names())} (one who wants the task)",
    )
    parser.add_argument(
        "--knobs",
        metavar="KNOB=VALUE,...",
        help=f"how simulated people err: {' | '.join(KNOBS)} (never)",
    )
    _add_number(parser, "triplets", f"rankings of three videos in all ({default.triplets})")
    _add_number(
        parser,
        "online",
        "alignments while the robot learns, from rankings of its own videos too "
        f"({online_alignments(default.preset)} with rapl or rlhf and preset {default.preset}, "
        "else 0)",
    )
    _add_number(
        parser,
        "online-triplets",
        "of the rankings, kept for each of them (half of all, shared out)",
    )
    _add_number(parser, "episodes", f"videos to collect and rank ({default.pool_episodes})")


def _add_learning(parser: _Parser, default: RunConfig) -> None:
    """What the encoder is made from, and how long the robot learns."""
    _add_number(
        parser,
        "demonstrations",
        f"preferred demonstrations, for tcc and tcc_ot ({default.demonstrations})",
    )
    parser.add_argument(
        "--backbone",
        metavar="NAME",
        help="network that the encoder is made on (the one that --reward names)",
    )
    parser.add_argument(
        "--weights",
        metavar="PATH",
        help="its weights: a file, or a folder that holds it as NAME.pt (where they are usually)",
    )
    parser.add_argument(
        "--engine",
        metavar="NAME",
        help=f"what computes its features: {' | '.join(ENGINES)} ({default.engine})",
    )
    parser.add_argument(
        "--trained",
        metavar="NAME",
        help=f"what alignment trains: {' | '.join(TRAINED)}; the block takes minutes, with tcc an "
        "hour, and the robot learns without alignments in between (head)",
    )
    _add_number(parser, "steps", f"world steps of learning ({default.steps})")
    _add_number(parser, "worlds", f"worlds simulated side by side ({default.worlds})")
    _add_number(parser, "seed", "of everything random (0)")


def _add_number(parser: _Parser, name: str, meaning: str) -> None:
    """An option with a whole number in the range of its setting."""
    setting = FIELDS.get(name, name.replace("-", "_"))
    parser.add_argument(f"--{name}", type=_whole(*RANGES[setting]), metavar="N", help=meaning)


def parse(argv: Sequence[str], tasks: Sequence[str], runs: Path) -> RunRequest:
    """Return what the command line asks for; exits with 2 and an explanation when it cannot.

    :param tasks: names of the known tasks.
    :param runs: folder of the runs, normally ``runs``.
    """
    parser = build_parser()
    arguments = parser.parse_args(list(argv))
    try:
        if arguments.resume is not None:
            return _resumed(arguments, tasks, runs)
        return _fresh(arguments, tasks, runs)
    except RaplError as error:
        parser.exit(2, f"{parser.prog}: {error}\n")


def _fresh(arguments: argparse.Namespace, tasks: Sequence[str], runs: Path) -> RunRequest:
    if arguments.task is None:
        raise RaplError(f"a task is missing; known: {', '.join(sorted(tasks))}")
    values = {**(QUICK if arguments.quick else {}), **_given(arguments)}
    config = RunConfig(task=arguments.task, quick=arguments.quick, **values)
    config = checked(config, tasks)
    folder = arguments.out or _free_folder(runs / config.task / _run_name(config))
    if (folder / CONFIG_FILE).exists():
        raise RaplError(f"{folder} holds a run already; continue it with --resume {folder}")
    return RunRequest(
        config,
        folder,
        resume=False,
        keep_running=arguments.keep_running,
        web_host=_web_host(arguments, config),
    )


def _resumed(arguments: argparse.Namespace, tasks: Sequence[str], runs: Path) -> RunRequest:
    folder = _folder_to_resume(arguments, tasks, runs)
    config = load_config(folder)
    asked = _given(arguments)
    if arguments.task is not None:
        asked["task"] = arguments.task
    config = continued(config, asked, folder)
    return RunRequest(
        config,
        folder,
        resume=True,
        keep_running=arguments.keep_running,
        web_host=_web_host(arguments, config),
    )


def _web_host(arguments: argparse.Namespace, config: RunConfig) -> str:
    return arguments.web or (WEB_HOST if config.asks_people else "")


def _folder_to_resume(arguments: argparse.Namespace, tasks: Sequence[str], runs: Path) -> Path:
    if arguments.resume in tasks and arguments.task is None:
        arguments.task, arguments.resume = arguments.resume, ""  # ``--resume franka_group``
    if arguments.resume or arguments.out:
        return Path(arguments.resume or arguments.out)
    if arguments.task is None:
        raise RaplError("--resume needs a run folder or a task")
    check_name(arguments.task, "task", tasks)
    found = [
        path.parent
        for path in (runs / arguments.task).glob(f"*/{CONFIG_FILE}")
        if not (path.parent / RESULTS_FILE).exists()
    ]
    idle = [folder for folder in found if not is_running(folder)]
    if not idle:
        busy = f" but {len(found)} at work now" if found else ""
        raise RaplError(f"no unfinished run of {arguments.task} in {runs / arguments.task}{busy}")
    return max(idle, key=lambda folder: (folder / CONFIG_FILE).stat().st_mtime)


def _given(arguments: argparse.Namespace) -> dict[str, Any]:
    names = {field.name: field.name for field in fields(RunConfig)} | FIELDS
    return {
        names[key]: value
        for key, value in vars(arguments).items()
        if key in names and key not in ("task", "quick") and value is not None
    }


def _run_name(config: RunConfig) -> str:
    preset = f"-{config.preset}" if config.aligns else ""
    own = replace(config, online=None).online_alignments
    online = f"-online{config.online}" if config.online != own else ""
    trained = f"-{config.trained}" if config.trained != "head" else ""
    kind = f"{config.reward}{preset}{trained}{online}"
    return f"{kind}-seed{config.seed}{'-quick' if config.quick else ''}"


def _free_folder(folder: Path) -> Path:
    candidate, number = folder, 2
    while candidate.exists():
        candidate, number = folder.with_name(f"{folder.name}-{number}"), number + 1
    return candidate


def _whole(least: int, most: int | None = None) -> Callable[[str], int]:
    def read(text: str) -> int:
        allowed = f"{least} to {most}" if most is not None else f"{least} or more"
        try:
            value = int(text.replace("_", ""))
        except ValueError:
            value = least - 1
        if value < least or (most is not None and value > most):
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number, {allowed}")
        return value

    return read


def _epilog() -> str:
    lines = ["rewards:"]
    lines += [f"  {name:13} {text}" for name, text in REWARDS.items()]
    lines += ["humans:"]
    lines += [f"  {name:13} {text}" for name, text in HUMANS.items()]
    lines += ["presets:"]
    lines += [f"  {name:13} {text}" for name, text in PRESETS.items()]
    lines += [
        "environment:",
        "  ROS_DOMAIN_ID, ROS_AUTOMATIC_DISCOVERY_RANGE   used when set; else a domain of the",
        "                run's own and LOCALHOST: nothing is visible beyond this machine",
    ]
    return "\n".join(lines)


def listing(tasks: dict[str, str]) -> str:
    """Return what ``--list`` prints.

    :param tasks: title of each task by name.
    """
    sections = {"tasks": tasks, "rewards (--reward)": REWARDS, "presets (--preset)": PRESETS}
    lines = []
    for title, entries in sections.items():
        lines.append(f"{title}:")
        lines += [f"  {name:13} {text}" for name, text in entries.items()]
    return "\n".join(lines)
