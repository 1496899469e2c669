"""Where the success curves of runs lie."""

from pathlib import Path

from rapl_core.policies.learning_curve import LearningCurve

CURVE_FILE = Path("policies") / "curve.json"


def curve_of(run_folder: Path) -> LearningCurve | None:
    """Return the curve of a run; None before its first checkpoint.

    :raises CorruptFileError: if it cannot be read.
    """
    path = run_folder / CURVE_FILE
    return LearningCurve.load(path) if path.exists() else None


def oracle_curve(run_folder: Path) -> LearningCurve | None:
    """Return the success of a run with ``--reward ground_truth`` beside ``run_folder``, if any.

    The one with the most evaluations is taken.
    """
    found = [
        curve
        for folder in sorted(run_folder.resolve().parent.glob("ground_truth*"))
        if folder != run_folder.resolve()
        and (curve := curve_of(folder)) is not None
        and curve.points
    ]
    return max(found, key=lambda curve: len(curve.points), default=None)
