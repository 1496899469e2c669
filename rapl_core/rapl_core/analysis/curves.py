"""Success by step of learning, as runs and studies store it."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rapl_core.errors import CorruptFileError

CURVE_FILE = Path("policies") / "curve.json"


@dataclass(frozen=True)
class SuccessPoint:
    """One evaluation while learning."""

    steps: int
    success_rate: float
    human_return_mean: float = float("nan")
    reward_mean: float = float("nan")


@dataclass(frozen=True)
class SuccessCurve:
    """The evaluations of one run."""

    points: tuple[SuccessPoint, ...]

    def last(self, count: int) -> float:
        """Mean success of the last ``count`` evaluations; NaN without any."""
        rates = [point.success_rate for point in self.points[-count:]]
        return float(np.mean(rates)) if rates else float("nan")


def read_curve(path: Path) -> SuccessCurve | None:
    """Read a curve from a JSON file with a list ``points``; None if there is no such file.

    :raises CorruptFileError: if the file holds something else.
    """
    try:
        entries = json.loads(path.read_text())["points"]
        points = [
            SuccessPoint(
                int(entry["steps"]),
                *(
                    float("nan") if entry.get(name) is None else float(entry[name])
                    for name in ("success_rate", "human_return_mean", "reward_mean")
                ),
            )
            for entry in entries
        ]
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise CorruptFileError(f"{path} is no success curve: {error}") from error
    return SuccessCurve(tuple(sorted(points, key=lambda point: point.steps)))


def oracle_curve(run_folder: Path) -> SuccessCurve | None:
    """Return the success of a run with ``--reward ground_truth`` beside ``run_folder``, if any.

    The one with the most evaluations is taken.
    """
    found = [
        curve
        for folder in sorted(run_folder.resolve().parent.glob("ground_truth*"))
        if folder != run_folder.resolve()
        and (curve := read_curve(folder / CURVE_FILE)) is not None
        and curve.points
    ]
    return max(found, key=lambda curve: len(curve.points), default=None)
