"""The table of rewards: intervals, paired differences, what is left out, one row for one thing."""

import importlib
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from rapl_core.analysis.scenes import ways
from rapl_core.representations import get_preset, preset_names
from rapl_core.representations.methods import get_method, method_names

FOLDER = Path(__file__).parents[3] / "experiments" / "rewards"


@pytest.fixture(scope="module")
def scripts() -> Iterator[dict[str, ModuleType]]:
    """The study's modules, which import each other by their bare names, as tests' helpers do."""
    names = ("judging", "study", "summary", "landscapes")
    before, modules = list(sys.path), dict(sys.modules)
    sys.path[:0] = [str(FOLDER), str(FOLDER.parent / "franka_group")]
    for name in (*names, "videos"):
        sys.modules.pop(name, None)
    yield {name: importlib.import_module(name) for name in names}
    sys.path[:] = before
    for name in (*names, "videos"):
        sys.modules.pop(name, None)
        if name in modules:
            sys.modules[name] = modules[name]


def result(preset: str, reward: str, seed: int, **measures: Any) -> dict[str, Any]:
    """What a study's file holds, with made-up numbers."""
    known = {
        "step": 0.5, "step_undefined": 2, "step_given_time": 0.4, "step_one_at_a_time": 0.3,
        "concordance": 0.6, "episode": 0.7, "arm_only": 0.2, "success_gain": 1.0,
        "triplets": 1000, "triplet_accuracy": 0.8, "video_mix": {"mime": 20, "push": 80},
        "landscape": {
            "rise": 1.0, "pit": 0.0, "over_alone": 0.5, "gap": 0.3, "arm": 0.0, "random": 0.6,
            "ways": {name: list(np.linspace(0, 1, 9)) for name in ways(0.0)},
        },
    }  # fmt: skip
    return {
        "preset": preset, "reward": reward, "seed": seed, "measures": {**known, **measures},
        "backbone": "mae_vit" if reward == "mvp_finetuned" else "efficientnet_lite0",
        "made": {"demonstrations": 500, "views": 1, "iterations": 1500},
        "commit": "0" * 40, "machine": {"cores": "2"},
    }  # fmt: skip


def test_differences_are_taken_seed_by_seed(scripts: dict[str, ModuleType]) -> None:
    levels = (0.2, 0.5, 0.8)  # seeds differ far more than the two rewards do
    ours = {s: result("tuned", "rapl", s, step=v + 0.1) for s, v in enumerate(levels)}
    theirs = {s: result("tuned", "rlhf", s, step=v) for s, v in enumerate(levels)}
    theirs[7] = result("tuned", "rlhf", 7, step=0.0)  # no partner: plays no part
    text = scripts["summary"].paired({("tuned", "rapl"): ours, ("tuned", "rlhf"): theirs})
    assert "| step | +0.10 ± 0.00 | 3 |" in text
    assert "no seed with both" in scripts["summary"].paired({("tuned", "rapl"): ours})


def test_an_interval_is_students(scripts: dict[str, ModuleType]) -> None:
    interval = scripts["summary"].interval
    assert interval([1.0, 2.0, 3.0]) == "2.00 ± 2.48"  # 4.303 / sqrt(3)
    assert interval([1.0]) == "1.00" and interval([None, float("nan")]) == "-"
    assert interval([1.0, 1.0, None]) == "1.00 ± 0.00 (2 seeds)"


def test_the_summary_names_what_is_left_out_and_what_stands_for_it(
    scripts: dict[str, ModuleType],
) -> None:
    rows = [("", "ground_truth"), ("paper", "rapl"), ("paper", "mvp_finetuned"), ("paper", "tcc")]
    results = {row: {3: result(*row, 3)} for row in rows}
    results["paper", "rapl"][3]["measures"]["success_gain"] = 0.01
    text = scripts["summary"].summary(results)
    assert "| - | ground truth, r* | 1 |" in text
    assert "masked autoencoder from scratch, LoRA, OT (in place of fine-tuned MVP)" in text
    assert "published weights were not given: DINOv2-OT; LIV-OT; MVP-OT; R3M-OT; VIP-OT." in text
    assert "- Not run: " in text and "; masked autoencoder from scratch, OT; " in text
    assert "80 % push, 20 % mime" in text and "1,000 a seed" in text
    assert "500 preferred demonstrations and 1 changed" in text
    (rapl,) = [line for line in text.splitlines() if line.startswith("| paper | RAPL | 1 | 0.50")]
    assert rapl.split("|")[9].strip() == "-", "a share of next to no gain says nothing"
    assert scripts["summary"].summary({}) == "There are no results yet.\n"


def test_the_landscape_of_every_reward_is_drawn(
    scripts: dict[str, ModuleType], tmp_path: Path
) -> None:
    rows = [("", "ground_truth"), ("paper", "rapl"), ("tuned", "rapl"), ("tuned", "clock")]
    path = tmp_path / "landscape.png"
    scripts["landscapes"].picture({row: {3: result(*row, 3)} for row in rows}, path)
    assert path.stat().st_size > 10_000
    scaled = scripts["landscapes"].scaled({name: [1.0, 3.0] for name in ways(0.0)})
    assert scaled["arm alone"].tolist() == [0.0, 1.0]


def test_presets_share_a_row_only_where_nothing_in_it_depends_on_them(
    scripts: dict[str, ModuleType],
) -> None:
    def distinct(name: str) -> int:
        presets = map(get_preset, preset_names())
        return len({scripts["study"].what_matters(get_method(name), p) for p in presets})

    # paper and authors_code read pictures alike, and reward by another transport
    expected = {"clock": 1, "mean_distance": 2, "supervised_probe": 2, "tcc": 2}
    assert {n: distinct(n) for n in method_names()} == {
        n: expected.get(n, 3) for n in method_names()
    }
    paper = get_preset("paper")
    renamed = replace(paper, name="mine")
    rapl, what_matters = get_method("rapl"), scripts["study"].what_matters
    assert what_matters(rapl, paper) == what_matters(rapl, renamed)
    assert what_matters(rapl, paper) != what_matters(rapl, replace(paper, epochs=7))


def test_test_triplets_are_distinct_and_in_order(scripts: dict[str, ModuleType]) -> None:
    class Video:
        def __init__(self, number: int) -> None:
            self.episode_id, self.human_return = f"v{number}", -float(number)

    drawn = scripts["judging"].draw_triplets(
        [Video(n) for n in range(40)], np.random.default_rng(0)
    )
    assert len(set(drawn)) == len(drawn) == 1000
    assert all(int(a[1:]) < int(b[1:]) < int(c[1:]) for a, b, c in drawn)
