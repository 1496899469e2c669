"""Frames per second of an encoder's frozen part, as a table and as JSON.

python experiments/benchmark_encoder.py [--backbone efficientnet_lite0] [--preset paper]

OpenVINO, where installed, is measured beside torch: its speed over torch float32 and the least
cosine between their features.
"""

import argparse
import json
import platform
import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from rapl_core.representations import get_preset, make_extractor, preset_names
from rapl_core.representations.engines import EngineError, flat_scenes
from rapl_core.representations.extractor import FeatureExtractor, Precision

BATCH_SIZES = (1, 8, 16)
PRECISIONS: tuple[Precision, ...] = ("float32", "bfloat16")


def frames_per_second(
    extractor: FeatureExtractor, batch_size: int, precision: Precision, seconds: float
) -> float:
    """Pictures through preprocessing, backbone and pooling, one batch after another."""
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 256, size=(batch_size, 112, 112, 3), dtype=np.uint8)
    for _ in range(3):
        extractor.extract(frames, precision, batch_size)
    done, start = 0, time.perf_counter()
    while time.perf_counter() - start < seconds:
        extractor.extract(frames, precision, batch_size)
        done += batch_size
    return done / (time.perf_counter() - start)


def openvino_beside(
    extractor: FeatureExtractor, expected: torch.Tensor, frames: np.ndarray, seconds: float
) -> dict[str, Any]:
    """Frames per second by batch size, and the least cosine to torch's float32 features."""
    rates = {
        str(size): round(frames_per_second(extractor, size, "float32", seconds), 1)
        for size in BATCH_SIZES
    }
    found = extractor.extract(frames, batch_size=16)
    cosine = float(torch.cosine_similarity(found, expected).min())
    return rates | {"precision": extractor.engine_precision, "least_cosine": cosine}


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--backbone", default="efficientnet_lite0")
    parser.add_argument("--preset", default="paper", choices=preset_names())
    parser.add_argument("--weights", help="file with the backbone's weights")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=1.0, help="per figure")
    options = parser.parse_args(arguments)
    torch.set_num_threads(options.threads)
    extractor = make_extractor(options.backbone, get_preset(options.preset).recipe, options.weights)
    rng = np.random.default_rng(0)
    frames = flat_scenes(32, 112)
    if extractor.needs_parts:
        extractor.find_parts([frames], rng)
    expected = extractor.extract(frames)
    rates = {
        precision: {
            size: round(frames_per_second(extractor, size, precision, options.seconds), 1)
            for size in BATCH_SIZES
        }
        for precision in PRECISIONS
    }
    engine: dict[str, Any] = {}
    try:
        extractor.use_engine("openvino", options.threads)
        engine = openvino_beside(extractor, expected, frames, options.seconds)
        engine["times_torch_float32"] = round(engine["16"] / rates["float32"][16], 2)
    except EngineError as error:
        print(error, file=sys.stderr)
    print(f"{options.backbone}, preset {options.preset}, 112x112, {options.threads} thread(s)")
    print("batch     " + "".join(f"{size:>9}" for size in BATCH_SIZES))
    for precision, by_size in rates.items():
        print(f"{precision:<10}" + "".join(f"{by_size[size]:>9}" for size in BATCH_SIZES))
    if engine:
        print("openvino  " + "".join(f"{engine[str(size)]:>9}" for size in BATCH_SIZES))
        print(
            f"openvino ({engine['precision']}) at batch 16: "
            f"{engine['times_torch_float32']} times torch float32, "
            f"least cosine {engine['least_cosine']:.5f}"
        )
    result = {
        "backbone": options.backbone,
        "preset": options.preset,
        "threads": options.threads,
        "machine": platform.machine(),
        "torch": torch.__version__,
        "frames_per_second": rates,
        "openvino": engine,
    }
    json.dump(result, sys.stdout)
    print()


if __name__ == "__main__":
    main()
