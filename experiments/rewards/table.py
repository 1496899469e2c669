"""Every reward of the paper on one pool, one set of rankings and one evaluation.

    python experiments/rewards/table.py --seeds 20 21 22 23 24     # everything, then the table
    python experiments/rewards/table.py --seeds 20 --presets paper --rewards rapl tcc clock
    python experiments/rewards/table.py --table                    # the table of what there is

Seed s gives a pool of 300 scripted videos, 150 rankings and 100 test videos from a seed stream of
their own; TCC learns from 500 preferred demonstrations beside. The network from scratch is
pre-trained once for all seeds, on videos of a seed of its own, as a published one would be. One
JSON a seed, preset and reward lies in ``results``; what is there is not made again. Rewards whose
published weights are not given (``--weights FOLDER``) are left out and named. Writes ``table.md``
and ``landscape.png``.
"""

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import landscapes
import torch
from study import Study
from summary import ORACLE, load, summary

from rapl_core.analysis.provenance import commit, machine, versions
from rapl_core.analysis.stages import plain
from rapl_core.errors import WeightsError
from rapl_core.representations import get_preset, make_extractor, preset_names
from rapl_core.representations.masked import MaskedConfig
from rapl_core.representations.methods import DEFAULT_BACKBONE, get_method, method_names

HERE = Path(__file__).parent


def main() -> None:
    """Make what is missing, then the table and the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[20, 21, 22, 23, 24])
    parser.add_argument("--presets", nargs="+", default=preset_names(), choices=preset_names())
    rows = [ORACLE, *method_names()]
    parser.add_argument("--rewards", nargs="+", default=rows, choices=rows)
    parser.add_argument("--demonstrations", type=int, default=500, help="of TCC; 0: the pool's own")
    parser.add_argument("--views", type=int, default=1, help="changed copies of each for TCC")
    parser.add_argument("--masked-iterations", type=int, default=MaskedConfig.iterations)
    parser.add_argument("--lora-iterations", type=int, default=500, help="of mvp_finetuned")
    parser.add_argument("--weights", type=Path, help="folder with published weights")
    parser.add_argument("--work", type=Path, default=Path("runs/study"), help="videos, features")
    parser.add_argument("--results", type=Path, default=HERE / "results")
    parser.add_argument("--table", action="store_true", help="only the table of what there is")
    options = parser.parse_args()
    torch.set_num_threads(1)
    begun_at = commit()  # what runs, whatever is committed meanwhile
    for folder in (options.work, options.results):
        folder.mkdir(parents=True, exist_ok=True)
    for seed in [] if options.table else options.seeds:
        run_seed(seed, options, begun_at)
    results = load(options.results)
    text = summary(results)
    (options.results / "table.md").write_text(text)
    landscapes.picture(results, options.results / "landscape.png")
    print(text)


def run_seed(seed: int, options: argparse.Namespace, begun_at: str) -> None:
    """Every row of a seed that is missing."""
    wanted = [(name, preset) for preset in options.presets for name in options.rewards]
    paths = {row: options.results / f"{row[0]}-{row[1]}-{seed}.json" for row in wanted}
    paths |= {(ORACLE, p): options.results / f"{ORACLE}-{seed}.json" for p in options.presets}
    missing = [row for row in wanted if not paths[row].is_file()]
    if not missing:
        return
    make_extractor(DEFAULT_BACKBONE, get_preset("paper").recipe)  # before a GL context
    study = Study(
        seed, options.work, options.weights, options.demonstrations, options.views,
        MaskedConfig(iterations=options.masked_iterations), options.lora_iterations,
        [get_preset(name) for name in options.presets],
    )  # fmt: skip
    left_out: set[str] = set()
    for name, preset_name in missing:
        path = paths[name, preset_name]
        if name in left_out or path.is_file():
            continue
        before = dict(study.spent.cpu)
        try:
            content = row(study, name, preset_name) | {"commit": begun_at}
        except WeightsError as error:
            left_out.add(name)
            print(f"{name}: left out: {error}", flush=True)
            continue
        spent = {k: v - before.get(k, 0.0) for k, v in study.spent.cpu.items()}
        content["cpu_s"] = {k: round(v, 1) for k, v in spent.items() if v > 0.05}
        path.write_text(json.dumps(plain(content), indent=1, default=str) + "\n")
        found = content["measures"]
        shown = {k: round(found[k], 3) for k in ("step", "concordance", "episode", "arm_only")}
        print(f"{name} {preset_name} {seed}: {shown}, seconds {content['cpu_s']}", flush=True)
    print(f"seed {seed}: {study.spent}", flush=True)


def row(study: Study, name: str, preset_name: str) -> dict[str, Any]:
    """One reward and preset.

    :raises WeightsError: if its weights are not to be had.
    """
    content: dict[str, Any] = {"reward": name, "seed": study.seed}
    if name == ORACLE:
        content |= {"preset": "", "measures": study.truth()}
    else:
        method, preset = get_method(name), get_preset(preset_name)
        made, found = study.row(method, preset)
        content |= {
            "preset": preset_name,
            "measures": found,
            "made": made.told,
            "backbone": made.encoder.card.backbone,
            "preset_settings": asdict(study.preset_for(method, preset)),
        }
    return {**content, "machine": machine(), "versions": versions()}


if __name__ == "__main__":
    main()
