"""The report of a run: ``report.html``, which needs nothing beside it, and ``results.json``."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import yaml

from rapl_core.analysis import figures, provenance
from rapl_core.analysis.annotators import people_of
from rapl_core.analysis.curves import curve_of, oracle_curve
from rapl_core.analysis.findings import Findings, find, results
from rapl_core.analysis.online import OnlineAlignment
from rapl_core.analysis.record import RunRecord, pool_composition, read_run
from rapl_core.analysis.scoring import RewardingEncoder, ScoredVideo, Scorer
from rapl_core.analysis.strips import picture_uri, strip
from rapl_core.atomic import write_atomically
from rapl_core.policies.learning_curve import LearningCurve
from rapl_core.preferences.own_videos import videos_to_learn_from

REPORT_FILE = "report.html"
RESULTS_FILE = "results.json"

REWARD_WORDS = {
    "rapl": "RAPL, learnt from rankings",
    "rlhf": "RLHF, learnt from rankings",
    "imagenet": "optimal transport in raw ImageNet features",
    "ground_truth": "the human's own reward (oracle)",
    "tcc": "TCC, distance to the goal",
    "tcc_ot": "TCC, optimal transport",
    "clock": "the frame's index alone (control)",
    "mean_distance": "mean distance to expert frames (control)",
}


def write_report(
    folder: Path, encoder: RewardingEncoder | None, oracle: LearningCurve | None = None
) -> Path:
    """Write ``report.html`` and ``results.json`` of the run in ``folder``.

    :param encoder: the reward's; None: r* was the reward.
    :param oracle: success of a run with ``--reward ground_truth``; None: that of a run beside this
        one, if there is one.
    :return: path of the report.
    :raises RaplError: if a file cannot be written.
    """
    record = read_run(folder)
    experts = (encoder.expert_ids or record.expert_ids()) if encoder else ()
    scorer = Scorer(record.store, encoder, experts)
    findings = find(record, scorer)
    curve = curve_of(folder)
    found = results(record, findings, curve, encoder)
    page = _render(record, findings, scorer, curve, oracle or oracle_curve(folder), found)
    path = write_atomically(folder / REPORT_FILE, page)
    write_atomically(folder / RESULTS_FILE, json.dumps(found, indent=1) + "\n")
    return path


def _render(
    record: RunRecord,
    findings: Findings,
    scorer: Scorer,
    curve: LearningCurve | None,
    oracle: LearningCurve | None,
    found: Mapping[str, Any],
) -> str:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("rapl_core.analysis", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
    )
    environment.filters |= {"num": _number, "percent": _percent, "clock": _clock}
    reward = str(record.settings["reward"])
    pool = pool_composition(record)
    return environment.get_template("report.html").render(
        title=f"{record.task}: {REWARD_WORDS.get(reward, reward)}",
        subtitle=_subtitle(record, found),
        quick=bool(record.settings.get("quick")),
        facts=_facts(record, found),
        **_success(curve, oracle, reward, record.online),
        online=record.online,
        **_videos(findings, reward),
        **_plans(findings, scorer),
        agreement=() if reward == "ground_truth" else findings.agreement,
        arm_share=_arm_words(findings.arm_share) if reward != "ground_truth" else "",
        people=people_of(record),
        pool=pool,
        pool_figure=figures.bars_figure(
            [b.behaviour for b in pool], [b.videos for b in pool], [b.strength for b in pool]
        )
        if pool
        else "",
        pool_caption="Preference is the Bradley-Terry strength from the rankings alone (mean 0). "
        "Success is measured, and used neither for the rankings nor for learning.",
        stages=[_stage_row(stage) for stage in record.stages if stage.name != "report"],
        provenance=_provenance(found),
        configuration=yaml.safe_dump(dict(record.config), sort_keys=False, allow_unicode=True),
    )


def _subtitle(record: RunRecord, found: Mapping[str, Any]) -> str:
    settings, encoder = record.settings, found["encoder"]
    parts = [f"seed {settings['seed']}", f"{settings['steps']} world steps"]
    if settings["reward"] in ("rapl", "rlhf"):
        parts.insert(0, f"preset {settings['preset']}")
    if encoder:
        parts.append(f"encoder {encoder['name']} {encoder['version']} on {encoder['backbone']}")
    return ", ".join(parts)


def _facts(record: RunRecord, found: Mapping[str, Any]) -> list[tuple[str, str]]:
    success = found["success"]
    facts = [
        (_percent(success["final"]), f"success over {success['final_episodes'] or 0} episodes"),
    ]
    if success["mean_of_last_three"] is not None:
        facts.append(
            (_percent(success["mean_of_last_three"]), "success, mean of the last three evaluations")
        )
    if record.rankings:
        videos = videos_to_learn_from((e.episode_id for e in record.pool), record.rankings)
        facts.append((str(found["triplets"]), f"triplets from {len(videos)} videos"))
    if found["triplet_accuracy_held_out"] is not None:
        facts.append(
            (_percent(found["triplet_accuracy_held_out"]), "of held-out triplets ordered right")
        )
    return [*facts, (_clock(found["wall_time_s"]), "wall time, all stages")]


def _success(
    curve: LearningCurve | None,
    oracle: LearningCurve | None,
    reward: str,
    online: Sequence[OnlineAlignment] = (),
) -> dict[str, str]:
    named = []
    for label, what, dashed in ((reward, curve, False), ("oracle (r* as reward)", oracle, True)):
        if what is not None and what.points:
            steps = np.array([p.steps for p in what.points], dtype=np.float64)
            rates = np.array([p.success_rate for p in what.points])
            named.append(figures.NamedCurve(label, steps, rates, dashed))
    caption = "Deterministic policy on starts that are seen nowhere else."
    if oracle is None and reward != "ground_truth":
        caption += " For the oracle's curve beside it, run the task with --reward ground_truth."
    marks = [(entry.steps, entry.version[:8]) for entry in online if entry.is_done]
    if marks:
        caption += " Dotted: from there on another version of the encoder gives the reward."
    return {
        "success": figures.success_figure(named, marks=marks) if named else "",
        "success_caption": caption,
    }


def _videos(findings: Findings, reward: str) -> dict[str, Any]:
    groups = (
        ("preferred", "preferred", findings.preferred),
        ("disliked", "disliked", findings.disliked),
        ("robot", "the robot, after learning", findings.robot),
    )
    strips: list[dict[str, str]] = []
    rows = []
    for kind, label, videos in groups:
        for video in videos:
            letter = chr(ord("A") + len(strips))
            strips.append(
                {
                    "letter": letter,
                    "kind": kind,
                    "label": label,
                    "words": _video_words(video),
                    "uri": picture_uri(strip(video.episode.frames)),
                }
            )
            rows.append((f"{letter} {label}", video.reward, video.human))
    return {
        "strips": strips,
        "traces": figures.traces_figure(rows, reward) if rows else "",
        "traces_caption": "Left: the reward that the robot gets, step by step. Right: what the "
        "human feels about the same videos; no learning ever sees it.",
    }


def _video_words(video: ScoredVideo) -> str:
    outcome = {True: "success", False: "no success", None: ""}[video.episode.success]
    parts = [video.episode.behaviour, outcome, f"sum of reward {video.reward.sum():.1f}"]
    if video.human is not None:
        parts.append(f"of r* {video.human.sum():.1f}")
    return ", ".join(part for part in parts if part)


def _plans(findings: Findings, scorer: Scorer) -> dict[str, Any]:
    plans, solver = [], ""
    labelled = [("preferred", v) for v in findings.preferred]
    labelled += [("disliked", v) for v in findings.disliked]
    for number, (label, video) in enumerate(labelled):
        if scorer.has_plans:
            plan, _, solver = scorer.plan(video)
            letter = chr(ord("A") + number)
            plans.append({"svg": figures.plan_figure(plan, f"{letter}, {label}")})
    return {
        "plans": plans,
        "plans_caption": "Which frame of the video is matched with which frame of its closest "
        "preferred video, in multiples of the uniform coupling. A bright diagonal says that the "
        f"two go through the same motions. Solver: {solver}.",
    }


def _arm_words(share: float) -> str:
    if not math.isfinite(share):
        return ""
    return (
        f"Videos in which the arm moves as in the preferred ones and nothing else does earn "
        f"{share:.0%} of their gain: 0 % is a reward that looks at the objects alone."
    )


def _stage_row(stage: Any) -> dict[str, Any]:
    found = ", ".join(
        f"{name.replace('_', ' ')} {_number(value) if isinstance(value, float) else value}"
        for name, value in stage.result.items()
        if isinstance(value, int | float | str) and value != ""
    )
    return {
        "name": stage.name,
        "status": stage.status,
        "seconds": stage.seconds,
        "attempts": stage.attempts,
        "detail": stage.detail,
        "found": found,
    }


def _provenance(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    versions = ", ".join(f"{name} {version}" for name, version in found["versions"].items())
    return [
        ("commit", found["commit"] or "unknown"),
        ("versions", versions),
        *((name, str(value)) for name, value in provenance.machine().items()),
    ]


def _number(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{value:.3g}"


def _percent(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{100 * value:.0f} %"


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
