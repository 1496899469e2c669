"""The last lines of a run: its stages and their times, what came out, where things lie."""

from pathlib import Path

from rapl_core.analysis.curves import CURVE_FILE, read_curve
from rapl_core.analysis.stages import StageRecord, read_stages
from rapl_ros.console import clock, table

PLACES = (
    ("report", "report.html"),
    ("results", "results.json"),
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
    curve = read_curve(folder / CURVE_FILE)
    if curve is not None and curve.points:
        lines.append("Success by step")
        lines.append(table([(f"{p.steps}", f"{p.success_rate:.0%}") for p in curve.points]))
    success = _result(stages, "evaluate", "success_rate")
    if success is not None:
        episodes = _result(stages, "evaluate", "episodes")
        lines.append(f"Success at the end: {success:.0%} of {episodes:.0f} episodes")
    found = [(name, str(folder / path)) for name, path in PLACES if (folder / path).exists()]
    if found:
        lines += ["Where things lie", table(found)]
    return "\n".join(lines)


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
