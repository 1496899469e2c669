"""The last lines of a run: its stages and their times, what came out, where things lie."""

import json
from pathlib import Path

from rapl_core.analysis.stages import StageRecord, read_stages
from rapl_ros.console import clock, table
from rapl_ros.run_config import RESULTS_FILE

PLACES = (
    ("report", "report.html"),
    ("results", RESULTS_FILE),
    ("settings", "config.yaml"),
    ("videos", "episodes"),
    ("rankings", "rankings.sqlite"),
    ("encoders", "encoders"),
    ("policies", "policies"),
    ("TensorBoard", "metrics"),
    ("logs", "logs"),
)


def summary(folder: Path) -> str:
    """Return what the terminal shows last about the run in ``folder``."""
    stages = read_stages(folder)
    lines = ["", "Stages"]
    lines.append(table([(stage.name, _stage_words(stage)) for stage in stages] or [("none", "")]))
    accuracy = _result(stages, "align", "held_out_accuracy")
    if accuracy is not None:
        lines.append(f"Triplet accuracy, held out: {accuracy:.0%}")
    by_step = _by_step(folder)
    if by_step:
        lines.append("Success by step")
        lines.append(table([(f"{steps}", f"{rate:.0%}") for steps, rate in by_step]))
    success = _result(stages, "evaluate", "success_rate")
    if success is not None:
        episodes = _result(stages, "evaluate", "episodes")
        lines.append(f"Success at the end: {success:.0%} of {episodes:.0f} episodes")
    found = [(name, str(folder / path)) for name, path in PLACES if (folder / path).exists()]
    if found:
        lines += ["Where things lie", table(found)]
    return "\n".join(lines)


def _by_step(folder: Path) -> list[tuple[int, float]]:
    """Steps and success rate of each evaluation while learning, as far as results.json has them."""
    try:
        points = json.loads((folder / RESULTS_FILE).read_text())["success"]["by_step"]
    except FileNotFoundError:
        return []
    return [(p["steps"], p["success_rate"]) for p in points if p["success_rate"] is not None]


def _stage_words(stage: StageRecord) -> str:
    words = stage.status
    if stage.seconds:
        words += f" {clock(stage.seconds)}"
    return f"{words}  {stage.detail}".rstrip()


def _result(stages: tuple[StageRecord, ...], stage: str, name: str) -> float | None:
    for record in stages:
        if record.name == stage and isinstance(record.result.get(name), int | float):
            return float(record.result[name])
    return None
