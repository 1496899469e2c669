"""``rapl encoders``: what there is, train one, measure it, hand it on."""

import argparse
import json
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from rapl_core.cli.progress import Progress
from rapl_core.errors import CorruptFileError
from rapl_core.representations.methods import Trained

if TYPE_CHECKING:
    from rapl_core.representations.alignment_job import AlignmentOrder
    from rapl_core.representations.training import EpochProgress


def add_to(commands: Any) -> None:
    """Declare the command and its verbs."""
    encoders = commands.add_parser("encoders", help="list, train, evaluate and export encoders")
    verbs = encoders.add_subparsers(dest="verb", required=True)
    _add_list(verbs)
    _add_train(verbs)
    evaluate = verbs.add_parser(
        "evaluate",
        help="measure an encoder on the run's test episodes, or on videos of the pool and rankings "
        "that it did not learn from",
    )
    _add_named(evaluate)
    evaluate.add_argument("--json", action="store_true", help="print the measures as JSON")
    evaluate.set_defaults(work=_evaluate)
    export = verbs.add_parser(
        "export",
        help="write an encoder with its expert videos' embeddings to one file for another machine, "
        "and check that it embeds the same there",
    )
    _add_named(export)
    export.add_argument("file", type=Path, metavar="FILE", help="file to write, *.safetensors")
    export.add_argument(
        "--with-backbone",
        action="store_true",
        help="take the backbone's weights along although they were not trained here",
    )
    export.add_argument("--force", action="store_true", help="replace the file if it exists")
    export.set_defaults(work=_export)


def _add_named(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", type=Path, metavar="RUN", help="run folder")
    parser.add_argument(
        "encoder",
        metavar="ENCODER",
        help="method (its newest checkpoint), or a name that `rapl encoders list RUN` gives",
    )
    parser.add_argument("--weights", type=Path, metavar="PATH", help=_WEIGHTS_HELP)


def _add_list(verbs: Any) -> None:
    listed = verbs.add_parser(
        "list", help="the methods and whether their weights are here; the encoders of a run"
    )
    listed.add_argument("run", type=Path, nargs="?", metavar="RUN", help="run folder")
    listed.add_argument("--weights", type=Path, metavar="PATH", help="look for weights there too")
    listed.set_defaults(work=_list)


def _add_train(verbs: Any) -> None:
    train = verbs.add_parser(
        "train",
        help="make an encoder from the videos and rankings of a run, as the action "
        "preference/align does",
    )
    train.add_argument("run", type=Path, metavar="RUN", help="run folder")
    train.add_argument("--method", required=True, metavar="NAME", help="one of the list's methods")
    train.add_argument("--preset", metavar="NAME", help="tuned, paper, authors_code (the run's)")
    train.add_argument("--seed", type=int, metavar="N", help="of everything random (the run's)")
    train.add_argument(
        "--rankings", type=int, default=0, metavar="N", help="learn from the first N alone (all)"
    )
    train.add_argument("--backbone", metavar="NAME", help="network to read (the method's own)")
    train.add_argument("--weights", type=Path, metavar="PATH", help=_WEIGHTS_HELP)
    train.add_argument(
        "--trained",
        choices=get_args(Trained),
        help="the last layer, or the backbone's last block with it, which takes longer (the run's)",
    )
    train.set_defaults(work=_train)


_WEIGHTS_HELP = (
    "the backbone's weights: a file, or a folder that holds it as BACKBONE.pt (the usual places)"
)


def _list(arguments: argparse.Namespace) -> None:
    from rapl_core.cli import encoder_words
    from rapl_core.representations.registry import saved_encoders

    run = arguments.run
    if run is not None and not any((run / name).is_dir() for name in ("encoders", "episodes")):
        raise CorruptFileError(f"{run} holds no run: it has neither 'encoders' nor 'episodes'")
    print(encoder_words.methods(arguments.weights))
    if run is not None:
        found, damaged = saved_encoders(run)
        print(f"\nIn {run}, the newest first:" if found else f"\nThere is no encoder in {run}")
        for saved in found:
            print(encoder_words.saved(saved, run))
        for error in damaged:
            print(f"  damaged: {error}")


def _train(arguments: argparse.Namespace) -> None:
    import torch

    from rapl_core.cli import encoder_words
    from rapl_core.representations.alignment_job import run_alignment

    torch.set_num_threads(1)  # as the preference node does
    run = _run_with_episodes(arguments.run)
    order = _order(run, arguments)
    progress, began_s = Progress(), time.monotonic()

    def on_video(number: int, videos: int) -> None:
        progress.show("features of video", number, videos)

    def on_epoch(epoch: "EpochProgress") -> None:
        progress.show("epoch", epoch.epoch, epoch.epochs, encoder_words.epoch(epoch))

    print(f"{encoder_words.order(order)}, from {run}", file=sys.stderr)
    try:
        done = run_alignment(order, on_video, on_epoch)
    finally:
        progress.end()
    print(encoder_words.trained(done, order.method, time.monotonic() - began_s))


def _order(run: Path, arguments: argparse.Namespace) -> "AlignmentOrder":
    """What the run's own preference node would make, but for what the command line says."""
    from rapl_core.analysis.record import read_config
    from rapl_core.preferences.people import PeopleConfig
    from rapl_core.representations.alignment_job import AlignmentOrder
    from rapl_core.representations.masked import MaskedConfig
    from rapl_core.representations.tcc import TccConfig

    # A folder of videos and rankings alone has none; then the defaults are those of the node.
    config = read_config(run) if (run / "config.yaml").exists() else {}
    settings: Mapping[str, Any] = config.get("run", {})
    node: Mapping[str, Any] = (config.get("nodes") or {}).get("preference") or {}
    given = {key: node[key] for key in ("noise", "smoothing_rate", "groups") if key in node}
    is_the_runs = settings.get("reward") == arguments.method
    backbone = str(settings.get("backbone") or "") if is_the_runs else ""
    weights = Path(settings["weights"]) if settings.get("weights") else None
    if weights is not None and not (is_the_runs or weights.is_dir()):
        weights = None  # a file is of the run's own network; a folder may have any
    seed = settings.get("seed", 0) if arguments.seed is None else arguments.seed
    trained: Trained = arguments.trained or node.get("trained", "head")
    return AlignmentOrder(
        run_folder=run,
        method=arguments.method,
        preset=arguments.preset or str(settings.get("preset") or "tuned"),
        rankings=arguments.rankings,
        seed=int(seed),
        people=PeopleConfig(**given),
        backbone=arguments.backbone or backbone,
        weights=arguments.weights or weights,
        engine=node.get("engine", "torch"),
        trained=trained,
        tcc=TccConfig(
            iterations=int(node.get("tcc_iterations", TccConfig.iterations)), trained=trained
        ),
        masked=MaskedConfig(iterations=int(node.get("masked_iterations", MaskedConfig.iterations))),
    )


def _evaluate(arguments: argparse.Namespace) -> None:
    from rapl_core.analysis.encoder_measures import measure_encoder
    from rapl_core.analysis.stages import plain
    from rapl_core.cli import encoder_words
    from rapl_core.representations import make_encoder
    from rapl_core.representations.registry import report_of

    run = _run_with_episodes(arguments.run)
    encoder = make_encoder(arguments.encoder, run, weights=arguments.weights)
    progress = Progress()
    try:
        found = measure_encoder(
            run, encoder, report_of(encoder, run), lambda n, of: progress.show("video", n, of)
        )
    finally:
        progress.end()
    if arguments.json:
        print(json.dumps(plain(asdict(found)), indent=1))
    else:
        print(encoder_words.measures(found))


def _export(arguments: argparse.Namespace) -> None:
    import numpy as np

    from rapl_core.cli import encoder_words
    from rapl_core.episodes import EpisodeStore
    from rapl_core.representations import make_encoder
    from rapl_core.representations.exported import check_target, export_encoder
    from rapl_core.representations.registry import report_of

    check_target(arguments.file, arguments.force)  # before seconds of work
    encoder = make_encoder(arguments.encoder, arguments.run, weights=arguments.weights)
    videos = EpisodeStore(arguments.run / "episodes")
    experts = encoder.experts
    if encoder.needs_experts and not experts:
        ids = encoder.expert_ids
        experts = tuple(encoder.embed_expert(name, videos.frames(name)) for name in ids)
    shown = [*encoder.expert_ids, *videos.ids()]
    here = next((name for name in shown if name in videos), None)
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 256, (2, 112, 112, 3), dtype=np.uint8)
    done = export_encoder(
        encoder,
        arguments.file,
        experts,
        frames if here is None else videos.frames(here)[::10],
        report_of(encoder, arguments.run),
        arguments.with_backbone,
        arguments.force,
    )
    print(encoder_words.exported(done, encoder))


def _run_with_episodes(run: Path) -> Path:
    """
    :raises CorruptFileError: if there are no videos; a typing error makes no folder.
    """
    if not (run / "episodes").is_dir():
        raise CorruptFileError(f"{run} holds no run: it has no folder 'episodes'")
    return run
