"""The learning curve of a policy: what each evaluation found."""

import csv
import io
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Self

from rapl_core.atomic import write_atomically
from rapl_core.errors import CorruptFileError, RaplError
from rapl_core.policies.evaluation import Evaluation


@dataclass(frozen=True)
class CurvePoint:
    """One evaluation with the deterministic policy."""

    steps: int
    """World steps of training before it."""
    success_rate: float
    """Share of episodes with true success; NaN where the truth is unknown."""
    human_return_mean: float
    """NaN where the truth is unknown."""
    reward_mean: float
    """Mean return of the learnt-from reward; NaN where it was not computed."""
    episodes: int
    wall_s: float
    """Since learning began, pauses between resumes left out."""


@dataclass(frozen=True)
class LearningCurve:
    """All evaluations of one run, in order."""

    points: tuple[CurvePoint, ...] = ()

    def with_evaluation(self, steps: int, evaluation: Evaluation, wall_s: float) -> Self:
        """Return the curve with one more point: what an evaluation found.

        :param steps: world steps of training before it.
        :param wall_s: since learning began, pauses between resumes left out.
        """
        point = CurvePoint(
            steps=steps,
            success_rate=evaluation.success_rate,
            human_return_mean=evaluation.human_return_mean,
            reward_mean=evaluation.reward_mean,
            episodes=evaluation.episodes,
            wall_s=wall_s,
        )
        return type(self)((*self.points, point))

    def last(self, count: int = 3) -> float:
        """Return the mean success rate of the last ``count`` evaluations.

        :raises RaplError: if there were fewer.
        """
        if len(self.points) < count:
            raise RaplError(f"the curve has {len(self.points)} evaluations, expected {count}")
        return sum(point.success_rate for point in self.points[-count:]) / count

    def save(self, path: Path | str) -> None:
        """Write the curve as ``.json`` or ``.csv``, as the name ends; atomic.

        :raises RaplError: if the name ends otherwise or cannot be written.
        """
        path = Path(path)
        rows = [_row(point) for point in self.points]
        file = io.StringIO(newline="")
        if path.suffix == ".json":
            json.dump({"points": rows}, file, indent=1)
        elif path.suffix == ".csv":
            writer = csv.DictWriter(file, [f.name for f in fields(CurvePoint)])
            writer.writeheader()
            writer.writerows(rows)
        else:
            raise RaplError(f"a curve is saved as .json or .csv, not {path.name}")
        write_atomically(path, file.getvalue(), "the curve")

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Return the curve in a ``.json`` or ``.csv`` file.

        :raises CorruptFileError: if it cannot be read.
        """
        path = Path(path)
        try:
            text = path.read_text(encoding="utf-8")
            rows = (
                json.loads(text)["points"]
                if path.suffix == ".json"
                else list(csv.DictReader(text.splitlines()))
            )
            return cls.from_rows(rows)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise CorruptFileError(f"{path} is no learning curve: {error!r}") from error

    def rows(self) -> list[dict[str, float | int | None]]:
        """Return the points as JSON: what is unknown is null."""
        return [_row(point) for point in self.points]

    @classmethod
    def from_rows(cls, rows: Sequence[dict[str, object]]) -> Self:
        """Return the curve of :meth:`rows`; an empty cell is unknown."""
        return cls(
            tuple(
                CurvePoint(
                    steps=int(str(row["steps"])),
                    success_rate=_number(row["success_rate"]),
                    human_return_mean=_number(row["human_return_mean"]),
                    reward_mean=_number(row["reward_mean"]),
                    episodes=int(str(row["episodes"])),
                    wall_s=_number(row["wall_s"]),
                )
                for row in rows
            )
        )


def _row(point: CurvePoint) -> dict[str, float | int | None]:
    return {
        name: None if isinstance(value, float) and math.isnan(value) else value
        for name, value in asdict(point).items()
    }


def _number(value: object) -> float:
    return math.nan if value is None or value == "" else float(str(value))
