"""``rapl report``: the report of a run, written again."""

import argparse
from pathlib import Path
from typing import Any


def add_to(commands: Any) -> None:
    """Declare the command."""
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
    report.set_defaults(work=_report)


def _report(arguments: argparse.Namespace) -> None:
    from rapl_core.analysis.record import read_run
    from rapl_core.analysis.report import write_report
    from rapl_core.policies.learning_curve import LearningCurve
    from rapl_core.representations import make_encoder

    run, oracle = arguments.run, arguments.oracle
    record = read_run(run)
    settings, reward = record.settings, record.settings["reward"]
    encoder = None
    if reward != "ground_truth":
        encoder = make_encoder(settings.get("encoder") or reward, run)
        if (engine := settings.get("engine", "torch")) != "torch":
            experts = encoder.expert_ids or record.expert_ids()
            encoder.extractor.use_engine(engine, pictures=record.store.first_of(experts))
    print(write_report(run, encoder, LearningCurve.load(oracle) if oracle else None))
