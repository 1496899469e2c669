"""What ``rapl encoders`` says."""

import math
import time
from collections.abc import Sequence
from pathlib import Path

from rapl_core.analysis.encoder_measures import EncoderMeasures, HumanMeasures, RankingMeasure
from rapl_core.representations.alignment_job import AlignmentOrder, AlignmentOutcome
from rapl_core.representations.availability import WeightsPlace, find_weights
from rapl_core.representations.backbones import backbone_names, backbone_spec
from rapl_core.representations.encoder import Encoder
from rapl_core.representations.exported import ExportedFile
from rapl_core.representations.masked_architecture import MAE_BACKBONE
from rapl_core.representations.methods import get_method, method_names
from rapl_core.representations.public_checkpoints import weights_folder
from rapl_core.representations.registry import SavedEncoder
from rapl_core.representations.training import EpochProgress

LESSONS = {
    "rankings": "rankings",
    "demonstrations": "demonstrations",
    "frames": "the frames alone",
    "truth": "the human's reward",
    "nothing": "nothing",
}
REWARDS = {
    "ot": "optimal transport",
    "scalar": "a number of its own",
    "goal": "distance to the goal",
    "clock": "the frame's index",
}
SWAP = "ros2 param set /rapl/encoder encoder"


def methods(weights: Path | None) -> str:
    """Every method, and the weights of every backbone.

    :param weights: where to look for them too.
    """
    places = {name: find_weights(name, weights) for name in backbone_names()}
    rows = [("METHOD", "WHAT IT IS", "LEARNS FROM", "REWARD", "BACKBONE", "ITS WEIGHTS")]
    for name in method_names():
        method = get_method(name)
        title = f"control: {method.title}" if method.is_control else method.title
        place, backbone = _place(places[method.backbone]), method.backbone
        rows.append((name, title, LESSONS[method.lesson], REWARDS[method.reward], backbone, place))
    weight_rows = [("BACKBONE", "WHAT IT IS", "WEIGHTS")]
    for name, found in places.items():
        weight_rows.append((name, backbone_spec(name).title, _place_in_full(found)))
    return f"{_table(rows)}\n\n{_table(weight_rows)}\n\n{_how_to_give()}"


def _place(place: WeightsPlace) -> str:
    if place.path is not None:
        return "here"
    if place.backbone == MAE_BACKBONE:
        return "made in training"
    return "fetched" if backbone_spec(place.backbone).url else "not here"


def _place_in_full(place: WeightsPlace) -> str:
    spec = backbone_spec(place.backbone)
    if place.path is not None:
        return f"here: {place.path}"
    if place.backbone == MAE_BACKBONE:
        return "made in training: of mae_scratch, or of mvp_finetuned with --backbone mae_vit"
    return place.advice if spec.url or not spec.origin else f"not here: {spec.origin}"


def _how_to_give() -> str:
    return (
        f"Weights that are not here: fetch the file, then give it with --weights FILE (to the node "
        f"encoder: its parameter weights), or put it into {weights_folder()} as BACKBONE.pt"
    )


def saved(encoder: SavedEncoder, run: Path) -> str:
    """One encoder of a run."""
    card, report = encoder.card, encoder.report
    made = time.strftime("%Y-%m-%d %H:%M", time.localtime(encoder.made_s))
    accuracy, triplets = report.get("held_out_accuracy"), report.get("held_out_triplets")
    lines = [
        f"  {encoder.name}",
        f"    made {made}, preset {card.preset}, {card.backbone}, {card.dimension}-d, reward: "
        f"{REWARDS[card.reward_kind]}, scale {card.reward_scale:.4g}, "
        f"{len(card.expert_ids)} experts",
        f"    {_files(encoder.path, run)}",
    ]
    if accuracy is not None and triplets:
        lines.insert(2, f"    ordered {accuracy:.0%} of {triplets} held-out triplets right")
    return "\n".join(lines)


def _files(path: Path, run: Path) -> str:
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    return f"{path.relative_to(run)}: " + ", ".join(
        f"{file.name} ({_size(file.stat().st_size)})" for file in files
    )


def order(made: AlignmentOrder) -> str:
    """What is about to be made."""
    method = get_method(made.method)
    backbone = made.backbone or method.backbone
    rankings = f", the first {made.rankings} rankings" if made.rankings else ""
    return f"{method.title}, preset {made.preset}, on {backbone}, seed {made.seed}{rankings}"


def epoch(progress: EpochProgress) -> str:
    """How training goes."""
    words = f"loss {progress.loss:.3f}"
    if math.isfinite(progress.held_out_accuracy):
        words += f", {progress.held_out_accuracy:.0%} of the held-out triplets right"
    return words


def trained(done: AlignmentOutcome, method: str, seconds: float) -> str:
    """What was made, a group of people who agree on a line."""
    lines = []
    for group in done.groups:
        who = f" for {', '.join(group.lesson.annotators)}" if len(done.groups) > 1 else ""
        used = len(group.lesson.triplets)
        lines.append(f"{group.uri}{who}, from {used} triplets, in {seconds:.1f} s")
        if math.isfinite(group.held_out_accuracy):
            measure = RankingMeasure(
                group.held_out_accuracy,
                group.held_out_interval,
                group.held_out_triplets,
                chose_epoch=True,
            )
            lines.append(f"orders {_ordered(measure)}")
    lines += [done.findings, f"put it to work in a graph on this run: {SWAP} {method}"]
    return "\n".join(lines)


def measures(found: EncoderMeasures) -> str:
    """One line a measure."""
    info = found.encoder
    lines = [
        f"{info.name}-{info.version}: preset {info.preset}, {info.backbone}, {info.dimension}-d, "
        f"reward: {REWARDS[found.reward_kind]}",
        f"measured on {found.measured_on}",
    ]
    if found.human is None:
        lines.append("  no human reward in these videos: rankings alone")
    else:
        mix = ", ".join(f"{count} {name}" for name, count in found.human.video_mix.items())
        lines += [f"  {mix}", *_human_lines(found.human)]
    if found.rankings is None:
        lines.append(_line("rankings", math.nan, "there are none that it did not learn from"))
    else:
        lines.append(_line("rankings", found.rankings.accuracy, _ordered(found.rankings)))
    return "\n".join(lines)


def _human_lines(human: HumanMeasures) -> list[str]:
    def undefined(count: int) -> str:
        return f"; undefined in {count} of {human.videos}" if count else ""

    return [
        _line(
            "step",
            human.step,
            "Spearman's correlation with r* over a video's steps, mean"
            + undefined(human.step_undefined),
        ),
        _line(
            "step given time",
            human.step_given_time,
            "the same without what a clock explains" + undefined(human.step_given_time_undefined),
        ),
        _line(
            "concordance",
            human.concordance,
            "pairs of frames over 2 cm apart in r*: share ordered right less share ordered wrong",
        ),
        _line("episode", human.episode, "rank correlation of the videos' sums with those of r*"),
        _line(
            "arm only",
            human.arm_only,
            "what mimes earn of the gain of successes, 0 is best"
            if math.isfinite(human.arm_only)
            else "there are no mimes or no successes among these, or the latter gain nothing",
        ),
    ]


def _ordered(measure: RankingMeasure) -> str:
    low, high = measure.interval
    words = (
        f"{measure.accuracy:.0%} of {measure.triplets} held-out triplets right "
        f"(95 %: {low:.0%} to {high:.0%})"
    )
    return words + ("; they chose the best epoch, so it flatters" if measure.chose_epoch else "")


def exported(done: ExportedFile, encoder: Encoder) -> str:
    """What was written and what to do with it."""
    info = encoder.info
    backbone = (
        "with its backbone"
        if done.has_backbone
        else f"without the weights of {info.backbone}, which must be there too"
    )
    name = done.path.name.removesuffix(done.path.suffix)
    return (
        f"{done.path}: {info.name}-{info.version}, {_size(done.size_bytes)}, {done.experts} expert "
        f"videos embedded, {backbone}; read back and compared\n"
        f"put it into a run's folder encoders/, then: {SWAP} {name}"
    )


def _line(name: str, value: float, words: str) -> str:
    shown = f"{value:6.2f}" if math.isfinite(value) else "     –"
    return f"  {name:16}{shown}  {words}"


def _size(size: int) -> str:
    return f"{size / 1e6:.1f} MB" if size >= 100_000 else f"{max(1, round(size / 1000))} kB"


def _table(rows: Sequence[tuple[str, ...]]) -> str:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]) - 1)]
    return "\n".join(
        "  ".join([*(f"{cell:{w}}" for cell, w in zip(row, widths, strict=False)), row[-1]])
        for row in rows
    )
