"""The table of all results in Markdown: measures, landscape, RAPL against RLHF, what to know."""

import json
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import t

from rapl_core.representations.backbones import backbone_spec
from rapl_core.representations.masked_architecture import MAE_BACKBONE
from rapl_core.representations.methods import get_method, method_names
from rapl_core.representations.public_checkpoints import PUBLIC

ORACLE = "ground_truth"
PAIR = (("tuned", "rapl"), ("tuned", "rlhf"))
LEAST_GAIN = 0.1
"""Below this gain of successful videos, in standard deviations of the reward, a share of it means
nothing."""

_MASKED = {
    "mae_scratch": "Masked autoencoder from scratch, once for all seeds",
    "mvp_finetuned": "Adapted by LoRA to the pool of each seed",
}

Result = dict[str, Any]
Results = dict[tuple[str, str], dict[int, Result]]
"""By preset and reward, by seed."""


def load(folder: Path) -> Results:
    """The results in a folder; the human's own reward first, then by preset."""
    found: Results = {}
    for file in sorted(folder.glob("*-[0-9]*.json")):
        content = json.loads(file.read_text())
        row = found.setdefault((content["preset"], content["reward"]), {})
        row[content["seed"]] = content
    return dict(sorted(found.items()))


def _arm_only(measures: Result) -> float | None:
    gain = measures["success_gain"]
    return measures["arm_only"] if gain is not None and gain >= LEAST_GAIN else None


def _of(name: str) -> Callable[[Result], float | None]:
    return lambda measures: measures[name]


def _wish(name: str) -> Callable[[Result], float | None]:
    return lambda measures: measures["landscape"][name]


MEASURES: dict[str, Callable[[Result], float | None]] = {
    "step": _of("step"),
    "given time": _of("step_given_time"),
    "one at a time": _of("step_one_at_a_time"),
    "concordance": _of("concordance"),
    "episode": _of("episode"),
    "arm alone": _arm_only,
    "test triplets": _of("triplet_accuracy"),
}
LANDSCAPE: dict[str, Callable[[Result], float | None]] = {
    "together to the goal": _wish("rise"),
    "over one alone": _wish("over_alone"),
    "gap growing": _wish("gap"),
    "arm moving alone": _wish("arm"),
    "random scenes": _wish("random"),
}


def summary(results: Results) -> str:
    """All of it."""
    if not results:
        return "There are no results yet.\n"
    parts = [
        "## Measures on test videos",
        table(results, MEASURES),
        _about_videos(results),
        "## Landscape",
        table(results, LANDSCAPE),
        "Of scenes that are placed by hand, in shares of the reward's range over them: rank "
        "correlation with the way gone while both cubes go to the goal together (wanted: 1); what "
        "both together in the goal earn more than one alone (above 0); what a growing gap in the "
        "goal costs (above 0); what the arm alone earns (0). And the rank correlation with r* over "
        "600 scenes placed at random. The first row is r* itself. `landscape.png` draws them.",
        "## RAPL tuned less RLHF tuned",
        paired(results),
        "## What to know",
        _about_rows(results),
    ]
    return "\n\n".join(parts) + "\n"


def table(results: Results, columns: dict[str, Callable[[Result], float | None]]) -> str:
    """Means over seeds with the half width of their 95 % interval."""
    lines = [
        f"| preset | reward | seeds | {' | '.join(columns)} |",
        "|---|---|---|" + "---|" * len(columns),
    ]
    for (preset, _), by_seed in results.items():
        rows = [content["measures"] for content in by_seed.values()]
        cells = [interval([value(row) for row in rows]) for value in columns.values()]
        name = title(next(iter(by_seed.values())))
        lines.append(f"| {preset or '-'} | {name} | {len(rows)} | {' | '.join(cells)} |")
    return "\n".join(lines)


def title(content: Result) -> str:
    """A row's name; what stands for missing weights is named as what it is."""
    if content["reward"] == ORACLE:
        return "ground truth, r*"
    method = get_method(content["reward"])
    if method.name == "mvp_finetuned" and content["backbone"] == MAE_BACKBONE:
        return "masked autoencoder from scratch, LoRA, OT (in place of fine-tuned MVP)"
    return method.title


def interval(values: Sequence[float | None], sign: str = "") -> str:
    """Mean and half width of the 95 % interval (Student's t) of what is defined."""
    known = np.array([v for v in values if v is not None and np.isfinite(v)])
    if not len(known):
        return "-"
    text = f"{known.mean():{sign}.2f}"
    if len(known) > 1:
        half = t.ppf(0.975, len(known) - 1) * known.std(ddof=1) / len(known) ** 0.5
        text += f" ± {half:.2f}"
    return text if len(known) == len(values) else f"{text} ({len(known)} seeds)"


def paired(results: Results) -> str:
    """Differences seed by seed: the same pool, rankings, features and test videos."""
    ours, theirs = (results.get(row, {}) for row in PAIR)
    seeds = sorted(ours.keys() & theirs.keys())
    if not seeds:
        return "There is no seed with both yet."
    lines = ["| measure | difference | seeds |", "|---|---|---|"]
    for name, value in {**MEASURES, **LANDSCAPE}.items():
        pairs = [(value(ours[s]["measures"]), value(theirs[s]["measures"])) for s in seeds]
        both = [(a - b) if a is not None and b is not None else None for a, b in pairs]
        lines.append(f"| {name} | {interval(both, '+')} | {len(seeds)} |")
    lines += [
        "",
        "Of one seed both have the same pool, rankings, features and test videos; mean of the "
        "differences and half width of its 95 % interval over seeds (Student's t).",
    ]
    return "\n".join(lines)


def _about_videos(results: Results) -> str:
    """Video mix, undefined videos and triplets."""
    contents = [c for by_seed in results.values() for c in by_seed.values()]
    mixes = {c["seed"]: c["measures"]["video_mix"] for c in contents}
    total: Counter[str] = sum((Counter(mix) for mix in mixes.values()), Counter())
    count = total.total()
    mix = ", ".join(f"{100 * n / count:.0f} % {name}" for name, n in total.most_common())
    undefined = [c["measures"]["step_undefined"] for c in contents if c["reward"] != ORACLE]
    still = [c["measures"]["step_undefined"] for c in contents if c["reward"] == ORACLE]
    videos, triplets = count // len(mixes), contents[0]["measures"]["triplets"]
    words = (
        f"{videos} test videos a seed, from starts of their own: {mix}. Spearman's correlation is "
        f"not defined for a video in which the reward or r* never changes: {_range(undefined)} of "
        f"{videos} a row and seed are left out of `step`"
    )
    words += f" ({_range(still)} for r* alone). " if still else ". "
    return words + (
        f"Test triplets: {triplets:,} a seed, drawn from test videos only. Arm alone: - where "
        f"successful videos gain less than {LEAST_GAIN} standard deviations of the reward, so that "
        "a share of that gain means nothing."
    )


def _about_rows(results: Results) -> str:
    """What is left out, backbones, demonstrations, commits and machine."""
    contents = [c for by_seed in results.values() for c in by_seed.values()]
    have = {c["reward"] for c in contents}
    lines = []
    missing = [get_method(n) for n in method_names() if n not in have]
    published = {spec.name for spec in PUBLIC}
    out = [m.title for m in missing if m.backbone in published and m.lesson == "nothing"]
    if out:
        lines.append(f"- Left out, for their published weights were not given: {'; '.join(out)}.")
    if others := [m.title for m in missing if m.title not in out]:
        lines.append(f"- Not run: {'; '.join(others)}.")
    backbones: dict[str, set[str]] = {}
    for c in contents:
        if c["reward"] not in (ORACLE, "clock"):
            backbones.setdefault(c["backbone"], set()).add(c["reward"])
    for backbone, rewards in sorted(backbones.items()):
        lines.append(f"- {backbone_spec(backbone).title}: {', '.join(sorted(rewards))}.")
    taught = {
        (c["made"]["demonstrations"], c["made"]["views"])
        for c in contents
        if c["reward"] in ("tcc", "tcc_ot")
    }
    for demonstrations, views in sorted(taught):
        lines.append(
            f"- TCC learnt from {demonstrations} preferred demonstrations and {views} changed "
            "copies of each."
        )
    for reward, words in _MASKED.items():
        counts = {c["made"]["iterations"] for c in contents if c["reward"] == reward}
        for iterations in sorted(counts):
            lines.append(f"- {words}: {iterations:,} iterations of 32 pictures.")
    commits = sorted({c["commit"][:12] for c in contents})
    machines = sorted({", ".join(map(str, c["machine"].values())) for c in contents})
    lines.append(f"- Commits {', '.join(commits)}; {'; '.join(machines)}.")
    return "\n".join(lines)


def _range(numbers: Sequence[int]) -> str:
    low, high = (min(numbers), max(numbers)) if numbers else (0, 0)
    return str(low) if low == high else f"{low} to {high}"
