"""What the settings of a run may be, for the command line and for the launch file."""

import importlib.util
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, get_args

from rapl_core.errors import RaplError, UnknownNameError
from rapl_core.preferences.simulated_human import knobs_from
from rapl_core.preferences.strategies import STRATEGIES
from rapl_core.preferences.wishes import persons_from
from rapl_core.representations.methods import Trained
from rapl_core.types import Noise
from rapl_ros.run_config import RunConfig

REWARDS = {
    "rapl": "optimal transport to the preferred videos, in the representation learnt from rankings",
    "ground_truth": "the simulated human's own reward r*: the oracle, an upper bound",
    "imagenet": "optimal transport in the raw ImageNet features: what rankings are worth",
    "rlhf": "a reward network learnt from the same rankings, without transport",
    "tcc": "distance to the goal of preferred demonstrations, after temporal cycle consistency",
    "tcc_ot": "optimal transport in the same representation",
    "r3m": "optimal transport in R3M's features; its weights must be given",
    "mvp": "optimal transport in MVP's features; its weights must be given",
    "mvp_finetuned": "MVP adapted to the videos by LoRA; --backbone mae_vit needs no weights",
    "mae_scratch": "a masked autoencoder pre-trained on the videos themselves, optimal transport",
    "vip": "optimal transport in VIP's features; its weights must be given",
    "liv": "optimal transport in LIV's features; its weights must be given",
    "dinov2": "optimal transport in DINOv2's features; its weights must be given",
    "clock": "a control: the frame's index alone",
    "mean_distance": "a control: mean distance to all expert frames, raw ImageNet features",
}
ENGINES = ("torch", "openvino")
HUMANS = {
    "simulated": "ranks by its own reward r*, at once",
    "web": "people rank on a page in the browser; the run waits for them",
}
NEVER_FOR_LEARNING = {"supervised_probe"}
NOISES = get_args(Noise)
TRAINED = get_args(Trained)
PRESETS = {
    "tuned": "our best settings, which depart from the paper where docs/paper_notes.md says so",
    "paper": "the paper's text; what it leaves open is in docs/paper_notes.md",
    "authors_code": "what the authors' published code does",
}

RANGES: Final[Mapping[str, tuple[int, int | None]]] = {
    "seed": (0, None),
    "worlds": (1, 16),
    "pool_episodes": (12, None),
    "triplets": (1, None),
    "demonstrations": (2, None),
    "groups": (0, 4),
    "online": (0, 50),
    "online_triplets": (0, None),
    "steps": (1, None),
    "random_steps": (0, None),
    "checkpoint_every": (0, None),
    "evaluate_every": (0, None),
    "evaluate_episodes": (0, None),
    "final_episodes": (1, None),
    "tcc_iterations": (1, None),
    "masked_iterations": (1, None),
}
"""Least and greatest value of each number; None: no greatest."""

CHANGEABLE: Final = ("steps", "human")
"""What may differ when a run goes on; all else would make it another run."""


def checked(config: RunConfig, tasks: Sequence[str]) -> RunConfig:
    """Return the settings of a new run as they can be carried out: a short run explores less.

    :param tasks: names of the known tasks.
    :raises RaplError: if one is not acceptable; names it and what is.
    """
    _check_numbers(config)
    check_name(config.task, "task", tasks)
    if config.reward in NEVER_FOR_LEARNING:
        raise RaplError(
            f"'{config.reward}' is fitted to the human's own reward: a ceiling in tables, never "
            f"for learning; rewards: {', '.join(sorted(REWARDS))}"
        )
    check_name(config.reward, "reward", REWARDS)
    check_name(config.preset, "preset", PRESETS)
    check_name(config.human, "human", HUMANS)
    if config.backbone:
        from rapl_core.representations import backbone_names  # imports torch: seconds

        check_name(config.backbone, "backbone", backbone_names())
    if config.weights and not Path(config.weights).exists():
        raise RaplError(f"no weights at {config.weights}; give a file, or a folder of them")
    check_name(config.engine, "inference engine", ENGINES)
    if config.engine == "openvino" and importlib.util.find_spec("openvino") is None:
        raise RaplError("--engine openvino needs the Python package openvino: not installed here")
    check_name(config.trained, "part to train", TRAINED)
    config.check_trained()
    config.check_online()
    check_name(config.query_strategy, "query strategy", STRATEGIES)
    check_name(config.noise, "treatment of noise", NOISES)
    persons_from(config.people), knobs_from(config.knobs)  # refused here rather than in a node
    if config.encoder:
        from rapl_core.representations import encoder_names  # imports torch: seconds

        check_name(config.encoder, "encoder", encoder_names())
    return replace(
        config,
        random_steps=min(config.random_steps, config.steps // 4),
        # As resolved: what a preset does may change, what a run does must not.
        online=config.online_alignments,
        online_triplets=config.online_share,
    )


def continued(config: RunConfig, asked: Mapping[str, Any], folder: Path) -> RunConfig:
    """Return the settings with which the run in ``folder`` goes on.

    :param config: with which it was started.
    :param asked: what is asked for by name, nothing else.
    :raises RaplError: if that differs in what may not change, or is not acceptable.
    """
    for name, value in asked.items():
        if name not in CHANGEABLE and getattr(config, name) != value:
            raise RaplError(
                f"{folder} was started with {name} {getattr(config, name)!r}, not {value!r}; "
                f"a run that goes on may only change {' and '.join(CHANGEABLE)}"
            )
    config = replace(config, **{name: asked[name] for name in CHANGEABLE if name in asked})
    _check_numbers(config)
    check_name(config.human, "human", HUMANS)
    config.check_online()
    return config


def check_name(name: str, kind: str, known: Iterable[str]) -> None:
    """
    :raises UnknownNameError: if ``name`` is not among those known.
    """
    known = tuple(known)
    if name not in known:
        raise UnknownNameError(kind, name, known)


def _check_numbers(config: RunConfig) -> None:
    for name, (least, most) in RANGES.items():
        value = getattr(config, name)
        if value is not None and (value < least or (most is not None and value > most)):
            allowed = f"{least} to {most}" if most is not None else f"{least} or more"
            raise RaplError(f"{name} is {value}, expected {allowed}")
