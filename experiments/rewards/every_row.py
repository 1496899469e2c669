"""``./run_all.sh franka_group --reward NAME --quick`` for every reward, one after another.

    python experiments/rewards/every_row.py                      # all rows
    python experiments/rewards/every_row.py --rows r3m mvp       # these
    python experiments/rewards/every_row.py --weights FOLDER     # published weights, if it has them
    python experiments/rewards/every_row.py --rows liv --engine openvino   # large networks, sooner

Published weights that are not given are made up: files of the published layout, as the loaders'
tests make them, which show that the whole way works and nothing more. Writes ``every_row.json``:
for each row its command, weights, exit status, seconds and stages. What is there and ended as it
should is not run again; ``--again`` forgets it.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))

from quick_runs import ROOT, QuickRun, add_options, run_all

from rapl_core.representations.backbones import backbone_spec
from rapl_core.representations.methods import get_method, method_names
from rapl_core.representations.public_checkpoints import PUBLIC
from rapl_core.representations.weights import weights_in

TASK = "franka_group"
MADE_UP = "made up, of the published layout"
FROM_SCRATCH = "pre-trained from scratch on the run's own videos"
ORACLE = "ground_truth"
SCRATCH = "mvp_finetuned on mae_vit"
"""The row without a download: its backbone is pre-trained on the run's own videos first."""
REFUSED = "supervised_probe"
"""Fitted to r*: a ceiling in tables, so that learning from it is refused."""
ROWS = sorted([ORACLE, SCRATCH, *method_names()])


def row_of(name: str, given: Path | None, made: Path) -> QuickRun:
    """The command line of a row.

    :param given: folder with published weights.
    :param made: where made-up ones go.
    """
    if name == ORACLE:
        return QuickRun(name, TASK, ("--reward", name), "none needed")
    if name == SCRATCH:
        options = ("--reward", "mvp_finetuned", "--backbone", "mae_vit")
        return QuickRun(name, TASK, options, FROM_SCRATCH)
    method = get_method(name)
    if method.backbone not in {spec.name for spec in PUBLIC}:
        scratch = method.name == "mae_scratch"
        words = FROM_SCRATCH if scratch else backbone_spec(method.backbone).title
        return QuickRun(name, TASK, ("--reward", name), words, 2 if name == REFUSED else 0)
    found = weights_in(given, method.backbone) if given else None
    file = found or make_up(method.backbone, made)
    words = f"{method.backbone}, {'published' if found else MADE_UP}"
    return QuickRun(name, TASK, ("--reward", name, "--weights", str(file)), words)


def make_up(backbone: str, folder: Path) -> Path:
    """A file of the published layout, as the loaders' tests make it."""
    sys.path.append(str(ROOT / "tests" / "core" / "representations"))
    from published_files import FILES

    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{backbone}.pt"
    if not path.is_file():
        FILES[backbone][0](path)
    return path


def main() -> None:
    """Run what is missing."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rows", nargs="+", default=ROWS, choices=ROWS)
    parser.add_argument("--weights", type=Path, help="folder with published weights")
    parser.add_argument("--engine", help="what computes features; the run's own default")
    add_options(parser, Path("runs/every_row"), Path(__file__).parent / "every_row.json")
    options = parser.parse_args()

    def of(name: str) -> QuickRun:
        row = row_of(name, options.weights, options.out.resolve() / "weights")
        if options.engine:
            return replace(row, options=(*row.options, "--engine", options.engine))
        return row

    run_all(options.rows, of, options)


if __name__ == "__main__":
    main()
