"""Frames per second of an encoder's frozen part, as a table and as JSON.

python experiments/benchmark_encoder.py [--backbone efficientnet_lite0] [--preset paper tuned]

OpenVINO, where installed, is measured beside torch: its speed over torch float32, and the least
cosine between their features on pictures of two scripted videos; the first is what the engine is
checked on when it is taken up, the second is not. The ways to compute take turns, so that a busy
machine slows all of them alike; the figures are medians over the turns.
"""

import argparse
import json
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from rapl_core.analysis.provenance import commit, machine, versions
from rapl_core.demonstrators import collect
from rapl_core.representations import get_preset, make_extractor, preset_names
from rapl_core.representations.engines import EngineError
from rapl_core.representations.extractor import FeatureExtractor
from rapl_core.simulation.simulation import Simulation
from rapl_core.tasks import get_task

TASK = "franka_group"
BATCH_SIZES = (1, 8, 16)
ENCODER_NODE = 16
"""Pictures that the encoder node embeds at once, at most."""

Extract = Callable[[NDArray[np.uint8]], torch.Tensor]


def scripted_videos() -> list[NDArray[np.uint8]]:
    """Two videos of (T, 112, 112, 3)."""
    simulation = Simulation(get_task(TASK))
    videos = [episode.frames[1:] for episode in collect(simulation, 2, seed=0)]
    simulation.close()
    return videos


def frames_per_second(extract: Extract, frames: NDArray[np.uint8], seconds: float) -> float:
    """Pictures through preprocessing, backbone and pooling, one batch after another."""
    extract(frames)
    done, start = 0, time.perf_counter()
    while time.perf_counter() - start < seconds:
        extract(frames)
        done += len(frames)
    return done / (time.perf_counter() - start)


def ways(extractor: FeatureExtractor, compiled: FeatureExtractor | None) -> dict[str, Extract]:
    """Each way to compute features, by name."""
    found: dict[str, Extract] = {
        "torch float32": lambda frames: extractor.extract(frames, "float32"),
        "torch bfloat16": lambda frames: extractor.extract(frames, "bfloat16"),
    }
    if compiled is not None:
        found[f"openvino {compiled.engine_precision}"] = compiled.extract
    return found


def measure(preset: str, options: argparse.Namespace) -> dict[str, Any]:
    """Rates of every way by batch size, and how far their features are from torch's float32."""
    recipe = get_preset(preset).recipe
    extractor, compiled = (
        make_extractor(options.backbone, recipe, options.weights) for _ in range(2)
    )
    videos = scripted_videos()
    for each in (extractor, compiled):
        if each.needs_parts:
            each.find_parts([videos[0]], np.random.default_rng(0))
    engine: FeatureExtractor | None = compiled
    try:
        compiled.use_engine("openvino", options.threads, videos[0])
    except EngineError as error:
        print(error)
        engine = None
    rates: dict[str, dict[int, list[float]]] = defaultdict(lambda: defaultdict(list))
    for _ in range(options.turns):
        for size in BATCH_SIZES:
            for name, extract in ways(extractor, engine).items():
                rate = frames_per_second(extract, videos[1][:size], options.seconds)
                rates[name][size].append(rate)
    expected = extractor.extract(videos[1])
    rows: dict[str, Any] = {}
    for name, extract in ways(extractor, engine).items():
        ratios = np.divide(rates[name][ENCODER_NODE], rates["torch float32"][ENCODER_NODE])
        rows[name] = {
            "frames_per_second": {n: round(float(np.median(r)), 1) for n, r in rates[name].items()},
            "times_torch_float32": round(float(np.median(ratios)), 2),
            "least_cosine": float(torch.cosine_similarity(extract(videos[1]), expected).min()),
        }
    about = {"backbone": options.backbone, "preset": preset, "threads": options.threads}
    return {**about, "rows": rows}


def show(result: dict[str, Any]) -> None:
    """Print a table."""
    print("{backbone}, preset {preset}, 112x112, {threads} thread(s)".format(**result))
    sizes = "".join(f"{f'batch {size}':>10}" for size in BATCH_SIZES)
    print(f"{'frames/s':<16}{sizes}  times float32 at {ENCODER_NODE}  least cosine")
    for name, row in result["rows"].items():
        rates = "".join(f"{rate:>10}" for rate in row["frames_per_second"].values())
        print(f"{name:<16}{rates}{row['times_torch_float32']:>21}{row['least_cosine']:>14.5f}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--backbone", default="efficientnet_lite0")
    parser.add_argument("--preset", nargs="+", default=["paper"], choices=preset_names())
    parser.add_argument("--weights", type=Path, help="file with the backbone's weights")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=0.5, help="per figure and turn")
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--out", type=Path, help="keep the results here as JSON, among others")
    options = parser.parse_args(arguments)
    torch.set_num_threads(options.threads)
    begun_at = commit()
    for preset in options.preset:
        result = measure(preset, options)
        show(result)
        if options.out is not None:
            known = json.loads(options.out.read_text()) if options.out.is_file() else {}
            content = {**result, "machine": machine(), "versions": versions(), "commit": begun_at}
            known[f"{options.backbone}, {preset}"] = content
            options.out.write_text(json.dumps(known, indent=1) + "\n")


if __name__ == "__main__":
    main()
