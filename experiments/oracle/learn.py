"""What SAC reaches on a task with the human's own reward r*: the oracle, one task and seed a call.

    python experiments/oracle/learn.py --task xmagical_avoid --seed 0

Goes on where it was cut; stops early when success no longer rises. ``summarise.py`` makes the
table. No pictures are drawn: r* needs none.
"""

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import torch

from rapl_core.analysis.provenance import commit, machine, versions
from rapl_core.policies.config import SacConfig, ScheduleConfig
from rapl_core.policies.in_process import LearningEvent, train_in_process
from rapl_core.policies.learning_curve import LearningCurve
from rapl_core.policies.rewards import GroundTruthReward
from rapl_core.tasks import get_task, task_names

HERE = Path(__file__).parent
WINDOW = 3
"""Evaluations that a success rate in the table is the mean of."""


CEILING = 0.97
"""Mean over WINDOW evaluations that has no room left to rise."""


def is_plateau(success: Sequence[float], patience: int, floor: float = 0.0) -> bool:
    """Return whether the mean over WINDOW evaluations has not risen for ``patience`` of them.

    Nor does it rise any more where the last is at the CEILING. A curve that never left the ground
    has no plateau: learning may begin late.

    :param floor: what the best mean must be above.
    """
    means = [sum(success[end - WINDOW : end]) / WINDOW for end in range(WINDOW, len(success) + 1)]
    if not means:
        return False
    if means[-1] >= CEILING:
        return True
    best = means.index(max(means))
    return means[best] > floor and len(means) - 1 - best >= patience


def main() -> None:
    """Learn and write ``results/<task>-<seed>.json``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task", required=True, choices=task_names(), metavar="TASK")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--steps", type=int, default=200_000, help="world steps at most")
    parser.add_argument("--worlds", type=int, default=4)
    parser.add_argument("--evaluate-every", type=int, default=5_000)
    parser.add_argument("--patience", type=int, default=6, help="evaluations without a rise")
    parser.add_argument("--work", type=Path, default=Path("runs/oracle"), help="checkpoints")
    parser.add_argument("--results", type=Path, default=HERE / "results")
    options = parser.parse_args()
    torch.set_num_threads(1)
    name = f"{options.task}-{options.seed}"
    begun_at = commit()  # what runs, whatever is committed meanwhile
    scale = get_task(options.task).human_reward_scale
    schedule = ScheduleConfig(
        steps=options.steps,
        worlds=options.worlds,
        evaluate_every=options.evaluate_every,
        checkpoint_every=options.evaluate_every,
    )
    sac = SacConfig()

    def tell(event: LearningEvent) -> None:
        if event.evaluation is not None:
            print(
                f"{name} {event.steps} steps: success {event.evaluation.success_rate:.2f}, return "
                f"of r* {event.evaluation.human_return_mean:.1f}, training "
                f"{event.human_return_mean:.1f}, {event.steps_per_s:.0f} steps/s",
                flush=True,
            )

    def stop(curve: LearningCurve) -> bool:
        return is_plateau([point.success_rate for point in curve.points], options.patience)

    curve = train_in_process(
        options.task, GroundTruthReward(scale), sac, schedule, options.seed,
        options.work / name, resume=True, on_event=tell, stop=stop,
    )  # fmt: skip
    result = {
        "task": options.task,
        "seed": options.seed,
        "success_last_three": curve.last(WINDOW),
        "steps": curve.points[-1].steps,
        "stopped_at_plateau": curve.points[-1].steps < options.steps,
        "wall_s": curve.points[-1].wall_s,
        "curve": [asdict(point) for point in curve.points],
        "scale": scale,
        "schedule": asdict(schedule),
        "sac": asdict(sac),
        "commit": begun_at,
        "machine": machine(),
        "versions": versions(),
    }
    options.results.mkdir(parents=True, exist_ok=True)
    path = options.results / f"{name}.json"
    path.write_text(json.dumps(result, indent=1, default=str) + "\n")


if __name__ == "__main__":
    main()
