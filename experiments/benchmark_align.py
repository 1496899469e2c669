"""Time and memory of aligning RAPL with 150 triplets whose features are cached.

python experiments/benchmark_align.py [--threads 1 2] [--beside FOLDER] [--out results.json]

Features are made up, in the number and shape of franka_group's pool: 300 videos and their mirrored
twins. Every figure is of a process of its own. With ``--beside``, a folder that holds another
version's package ``rapl_core``, both versions take turns, so that a busy machine slows both alike.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

import rapl_core
from rapl_core.analysis.provenance import commit, machine, versions
from rapl_core.representations import get_preset, preset_names
from rapl_core.representations.alignment import Lesson
from rapl_core.representations.features import MIRRORED
from rapl_core.representations.rapl import fit_rapl
from rapl_core.representations.reward_scale import fit_reward_scale
from rapl_core.transport.reward import ot_reward
from rapl_core.types import EmbeddedEpisode, Triplet

OURS = Path(rapl_core.__file__).parents[1]
PARTS = ("until the first epoch", "the other epochs", "reward's scale")


def made_features(
    videos: int, frames: int, width: int, mirror: bool, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """(T, F) by name; videos are as good as their number is small, and the features tell it."""
    direction = rng.normal(size=width)
    found = {}
    for number in range(videos):
        for twin in ("", MIRRORED) if mirror else ("",):
            towards = np.linspace(0, 1 - number / videos, frames)[:, None] * direction
            noise = rng.normal(size=(frames, width))
            found[f"{twin}v{number:03}"] = (towards + noise).astype(np.float32)
    return found


def measure_once(options: argparse.Namespace) -> dict[str, float]:
    """Processor seconds of one alignment and its parts, wall seconds, and peak memory."""
    torch.set_num_threads(options.threads[0])
    preset, rng = get_preset(options.preset), np.random.default_rng(0)
    features = made_features(options.videos, options.frames, options.width, preset.mirror, rng)
    names = sorted(name for name in features if not name.startswith(MIRRORED))
    chosen = [np.sort(rng.choice(len(names), 3, replace=False)) for _ in range(options.triplets)]
    lesson = Lesson([Triplet(*(names[i] for i in three)) for three in chosen], names[:10])
    wall, marks = time.perf_counter(), [time.process_time()]
    fit = fit_rapl(features, lesson, preset, rng, lambda _: marks.append(time.process_time()))
    taught = time.process_time()
    z = {name: fit.embed(features[name]) for name in fit.statistics_videos}
    experts = [EmbeddedEpisode(name, z[name]) for name in lesson.expert_ids]
    fit_reward_scale(z, lambda video: ot_reward(video, experts, preset.reward, 1.0), rng)
    end = time.process_time()
    parts = (marks[1] - marks[0], taught - marks[1], end - taught)
    return {
        "wall_s": time.perf_counter() - wall,
        "processor_s": end - marks[0],
        **dict(zip(PARTS, parts, strict=True)),
        "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "last_loss": fit.history.epochs[-1].loss,
    }


def run_apart(package: Path, threads: int, arguments: Sequence[str]) -> dict[str, float]:
    """Measure in a process of its own, with the ``rapl_core`` that ``package`` holds."""
    path = os.pathsep.join([str(package), os.environ.get("PYTHONPATH", "")])
    printed = subprocess.run(
        [sys.executable, __file__, *arguments, "--once", "--threads", str(threads)],
        env={**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": str(threads)},
        stdout=subprocess.PIPE,
        check=True,
        text=True,
    ).stdout
    return dict(json.loads(printed))


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print a table, write JSON if asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--preset", default="tuned", choices=preset_names())
    parser.add_argument("--triplets", type=int, default=150)
    parser.add_argument("--videos", type=int, default=300)
    parser.add_argument("--frames", type=int, default=50, help="of a video")
    parser.add_argument("--width", type=int, default=160, help="features of a frame")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--rounds", type=int, default=3, help="the least time of so many counts")
    parser.add_argument("--beside", type=Path, help="folder with another version's rapl_core")
    parser.add_argument("--once", action="store_true", help="measure here, print JSON alone")
    parser.add_argument("--out", type=Path, help="write the results here as JSON")
    options = parser.parse_args(arguments)
    if options.once:
        print(json.dumps(measure_once(options)))
        return
    packages = {"ours": OURS} | ({"beside": options.beside} if options.beside else {})
    passed = [f"--preset={options.preset}"]
    passed += [f"--{n}={getattr(options, n)}" for n in ("triplets", "videos", "frames", "width")]
    results: dict[str, dict[str, float]] = {}
    print(f"{'':<20}{'wall s':>8}{'cpu s':>8}{'peak MiB':>10}   share of cpu s: {', '.join(PARTS)}")
    for threads in options.threads:
        runs: dict[str, list[dict[str, float]]] = {name: [] for name in packages}
        for _ in range(options.rounds):
            for name, package in packages.items():
                runs[name].append(run_apart(package, threads, passed))
        for name, found in runs.items():
            row = min(found, key=lambda run: run["processor_s"])
            row |= {"wall_s": min(run["wall_s"] for run in found)}
            shares = ", ".join(f"{row[part] / row['processor_s']:.0%}" for part in PARTS)
            label = f"{name}, {threads} thread{'s' if threads > 1 else ''}"
            print(
                f"{label:<20}{row['wall_s']:>8.2f}{row['processor_s']:>8.2f}"
                f"{row['peak_mib']:>10.0f}   {shares}"
            )
            results[label] = row
        if options.beside:
            ours, other = (min(r["processor_s"] for r in runs[n]) for n in ("ours", "beside"))
            losses = (runs[n][0]["last_loss"] for n in ("ours", "beside"))
            print(f"beside over ours: {other / ours:.2f} in processor time; last losses", *losses)
    if options.out is not None:
        about = {"commit": commit(), "machine": machine(), "versions": versions()}
        document = {"results": results, "options": vars(options), "seed": 0, **about}
        options.out.write_text(json.dumps(document, indent=1, default=str) + "\n")


if __name__ == "__main__":
    main()
