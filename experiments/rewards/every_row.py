"""``./run_all.sh franka_group --reward NAME --quick`` for every reward, one after another.

    python experiments/rewards/every_row.py                      # all rows
    python experiments/rewards/every_row.py --rows r3m mvp       # these
    python experiments/rewards/every_row.py --weights FOLDER     # published weights, if it has them
    python experiments/rewards/every_row.py --rows liv --engine openvino   # large networks, sooner

Published weights that are not given are made up: files of the published layout, as the loaders'
tests make them, which show that the whole way works and nothing more. Writes ``every_row.json``:
for each row its command, weights, exit status, seconds and stages. What is there with exit status 0
is not run again; ``--again`` forgets it.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rapl_core.analysis.provenance import commit, machine
from rapl_core.analysis.stages import read_stages
from rapl_core.representations.backbones import backbone_spec
from rapl_core.representations.methods import get_method, method_names
from rapl_core.representations.public_checkpoints import PUBLIC
from rapl_core.representations.weights import weights_in

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
LIMIT_S = 3600.0
MADE_UP = "made up, of the published layout"
FROM_SCRATCH = "pre-trained from scratch on the run's own videos"
ORACLE = "ground_truth"
SCRATCH = "mvp_finetuned on mae_vit"
"""The row without a download: its backbone is pre-trained on the run's own videos first."""
REFUSED = "supervised_probe"
"""Fitted to r*: a ceiling in tables, so that learning from it is refused."""
ROWS = sorted([ORACLE, SCRATCH, *method_names()])


@dataclass(frozen=True)
class Row:
    """One command line and what the encoder's weights are."""

    name: str
    options: tuple[str, ...]
    weights: str


def row_of(name: str, given: Path | None, made: Path) -> Row:
    """The command line of a row.

    :param given: folder with published weights.
    :param made: where made-up ones go.
    """
    if name == ORACLE:
        return Row(name, ("--reward", name), "none needed")
    if name == SCRATCH:
        options = ("--reward", "mvp_finetuned", "--backbone", "mae_vit")
        return Row(name, options, FROM_SCRATCH)
    method = get_method(name)
    if method.backbone not in {spec.name for spec in PUBLIC}:
        scratch = method.name == "mae_scratch"
        words = FROM_SCRATCH if scratch else backbone_spec(method.backbone).title
        return Row(name, ("--reward", name), words)
    found = weights_in(given, method.backbone) if given else None
    file = found or make_up(method.backbone, made)
    words = "published" if found else MADE_UP
    return Row(name, ("--reward", name, "--weights", str(file)), f"{method.backbone}, {words}")


def make_up(backbone: str, folder: Path) -> Path:
    """A file of the published layout, as the loaders' tests make it."""
    sys.path.append(str(ROOT / "tests" / "core" / "representations"))
    from published_files import FILES

    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{backbone}.pt"
    if not path.is_file():
        FILES[backbone][0](path)
    return path


def run(row: Row, out: Path, program: list[str]) -> dict[str, Any]:
    """Run a row and say what became of it."""
    folder = out / row.name.replace(" ", "-")
    command = [*program, "franka_group", *row.options, "--quick", "--out", str(folder)]
    began, begun_at = time.monotonic(), commit()  # what runs, whatever is committed meanwhile
    log = out / f"{folder.name}.log"
    with log.open("w") as file:
        process = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT, cwd=ROOT)
        try:
            status: int | None = process.wait(LIMIT_S)
        except subprocess.TimeoutExpired:
            process.terminate()
            process.wait()
            status = None
    results = folder / "results.json"
    found = json.loads(results.read_text()) if results.is_file() else {}
    lines = log.read_text().strip().splitlines()
    return {
        "row": row.name,
        "command": " ".join(["./run_all.sh franka_group", *_shown(row.options), "--quick"]),
        "weights": row.weights,
        "exit_status": status,
        "last_line": "" if status == 0 or not lines else lines[-1],
        "seconds": round(time.monotonic() - began, 1),
        "stages": {s.name: [s.status, round(s.seconds, 1)] for s in read_stages(folder)},
        "encoder": found.get("encoder"),
        "episodes_evaluated": found.get("success", {}).get("final_episodes"),
        "commit": begun_at,
    }


def _shown(options: tuple[str, ...]) -> list[str]:
    """Options without the machine's own folders."""
    return [Path(o).name if os.sep in o else o for o in options]


def main() -> None:
    """Run what is missing and keep the table of it after each row."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", nargs="+", default=ROWS, choices=ROWS)
    parser.add_argument("--weights", type=Path, help="folder with published weights")
    parser.add_argument("--engine", help="what computes features; the run's own default")
    parser.add_argument("--out", type=Path, default=Path("runs/every_row"), help="run folders")
    parser.add_argument("--results", type=Path, default=HERE / "every_row.json")
    parser.add_argument("--again", action="store_true", help="run them all again")
    parser.add_argument("--no-setup", action="store_true", help="by this very Python, no set-up")
    options = parser.parse_args()
    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    program = [sys.executable, "-m", "rapl_ros.run_all"] if options.no_setup else ["./run_all.sh"]
    known: dict[str, Any] = {}
    if options.results.is_file():
        known = {row["row"]: row for row in json.loads(options.results.read_text())["rows"]}
    for name in options.rows:
        if not options.again and known.get(name, {}).get("exit_status") == expected(name):
            continue
        row = row_of(name, options.weights, out / "weights")
        if options.engine:
            row = replace(row, options=(*row.options, "--engine", options.engine))
        found = run(row, out, program)
        print(found["row"], found["exit_status"], found["seconds"], found["last_line"], flush=True)
        known[name] = found
        content = {"machine": machine(), "rows": [known[n] for n in ROWS if n in known]}
        options.results.write_text(json.dumps(content, indent=1) + "\n")
    bad = [name for name, row in known.items() if row["exit_status"] != expected(name)]
    sys.exit(f"not as expected: {', '.join(bad)}" if bad else 0)


def expected(name: str) -> int:
    """The exit status that a row should have."""
    return 2 if name == REFUSED else 0


if __name__ == "__main__":
    main()
