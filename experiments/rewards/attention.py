"""What raw features, RLHF and RAPL look at: the paper's attention maps, side by side.

    python experiments/rewards/attention.py --seed 12

All three have the paper's preset (global average of the last layer); RLHF and RAPL learn from the
seed's 150 rankings. Draws a preferred and a disliked test video, of which nothing was learnt.
Writes ``attention.png`` and ``attention.json``: for each pair of encoders the correlation of their
maps over the pictures shown, and for each encoder how far its map follows from the axes that its
embedding happens to have: the mean size of the correlation between its map and that of the same
embedding turned at random, which changes no distance.
"""

import argparse
import json
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from study import Study

from rapl_core.analysis.attention import attention_map, embedding_map
from rapl_core.analysis.attention_picture import write_attention
from rapl_core.analysis.provenance import commit, machine, versions
from rapl_core.analysis.stages import plain
from rapl_core.representations import Encoder, get_preset, make_extractor
from rapl_core.representations.methods import DEFAULT_BACKBONE, get_method
from rapl_core.types import Episode

HERE = Path(__file__).parent
PRESET = "paper"
ENCODERS = {"raw ImageNet": "imagenet", "RLHF": "rlhf", "RAPL": "rapl"}
DISLIKED = "one_at_a_time"
SHOWN = (0.1, 0.5, 1.0)
"""Shares of a video at which its pictures are taken."""
TURNS = 100


def main() -> None:
    """Learn, draw, and write down what was drawn."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=12)
    parser.add_argument("--work", type=Path, default=Path("runs/study"), help="videos, features")
    parser.add_argument("--results", type=Path, default=HERE / "results")
    options = parser.parse_args()
    torch.set_num_threads(1)
    begun_at, preset = commit(), get_preset(PRESET)
    for folder in (options.work, options.results):
        folder.mkdir(parents=True, exist_ok=True)
    make_extractor(DEFAULT_BACKBONE, preset.recipe)  # before a GL context
    study = Study(options.seed, options.work, presets=[preset])
    made = {label: study.make(get_method(name), preset) for label, name in ENCODERS.items()}
    encoders = {label: each.encoder for label, each in made.items()}
    preferred = next(v for v in study.test if v.success)
    disliked = next(v for v in study.test if v.behaviour == DISLIKED and not v.success)
    frames, titles = [], []
    for word, video in (("preferred", preferred), ("disliked", disliked)):
        for share in SHOWN:
            step = round(share * (len(video.frames) - 1))
            frames.append(video.frames[step])
            titles.append(f"{word}, step {step}")
    pictures = np.stack(frames)
    write_attention(options.results / "attention.png", pictures, titles, encoders)
    content = {
        "seed": options.seed,
        "preset": PRESET,
        "backbone": next(iter(encoders.values())).card.backbone,
        "videos": {"preferred": told(preferred), "disliked": told(disliked)},
        "made": {label: each.told for label, each in made.items()},
        **compared(encoders, pictures),
        "commit": begun_at,
        "machine": machine(),
        "versions": versions(),
        "cpu_s": {k: round(v, 1) for k, v in study.spent.cpu.items()},
    }
    text = json.dumps(plain(content), indent=1)
    (options.results / "attention.json").write_text(text + "\n")
    print(text)


def told(video: Episode) -> dict[str, Any]:
    """Which video it is."""
    return {"behaviour": video.behaviour, "human_return": video.human_return}


def compared(encoders: dict[str, Encoder], pictures: NDArray[np.uint8]) -> dict[str, Any]:
    """How alike the maps are, and how far each rests on its embedding's axes."""
    maps = {label: attention_map(encoder, pictures) for label, encoder in encoders.items()}
    alike = {
        f"{one}, {other}": correlation(maps[one], maps[other])
        for one, other in combinations(maps, 2)
    }
    turned: dict[str, float] = {}
    for label, encoder in encoders.items():
        if encoder.card.dimension == 1:
            continue
        places = embedding_map(encoder, pictures)  # (N, h, w, D)
        # the mean of turned numbers is a product with a random direction
        ways = np.random.default_rng(0).normal(size=(TURNS, places.shape[-1]))
        turned[label] = float(np.mean([abs(correlation(maps[label], places @ w)) for w in ways]))
    return {
        "cells": maps[next(iter(maps))].shape[1:],
        "correlation": alike,
        "correlation_when_turned": turned,
    }


def correlation(one: NDArray[Any], other: NDArray[Any]) -> float:
    """Pearson's, over all places of all pictures."""
    return float(np.corrcoef(one.ravel(), other.ravel())[0, 1])


if __name__ == "__main__":
    main()
