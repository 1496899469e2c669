"""Encoders by name."""

import json
from pathlib import Path

from rapl_core.errors import CorruptFileError, UnknownNameError
from rapl_core.representations.checkpoints import CARD_FILE, load_encoder
from rapl_core.representations.encoder import Encoder
from rapl_core.representations.methods import DEFAULT_BACKBONE, get_method, method_names
from rapl_core.representations.pretrained import raw_encoder

__all__ = ["DEFAULT_BACKBONE", "encoder_names", "make_encoder"]


def encoder_names(run_folder: Path | None = None) -> list[str]:
    """The methods; with a run folder also each checkpoint in it, as ``<method>-<version>``."""
    saved = [path.name for path in _checkpoints(run_folder)]
    return sorted({*method_names(), *saved})


def make_encoder(
    name: str,
    run_folder: Path | None = None,
    backbone: str | None = None,
    weights: Path | None = None,
) -> Encoder:
    """Load an encoder by name.

    :param name: a method (its newest checkpoint in ``run_folder/encoders``), or a checkpoint's
        own name ``<method>-<version>``. A method that learns nothing, such as ``imagenet`` or
        ``r3m``, needs no checkpoint; without one its reward scale is 1.
    :param backbone: for such a method without a checkpoint, None: its own; a checkpoint names its
        own.
    :param weights: the backbone's weights, if not at their default place: a file, or a folder that
        may hold it as ``<backbone>.pt``, ``.pth`` or ``.safetensors``.
    :raises UnknownNameError: naming the known ones.
    :raises CorruptFileError, WeightsError: if the checkpoint or the backbone cannot be loaded,
        or a method that needs one has no checkpoint.
    """
    checkpoints = _checkpoints(run_folder)
    if name not in encoder_names(run_folder):
        raise UnknownNameError("encoder", name, encoder_names(run_folder))
    for path in checkpoints:  # newest first
        if path.name == name or (name in method_names() and _method_of(path) == name):
            return load_encoder(path, weights)
    if name in method_names() and not get_method(name).is_trained:
        return raw_encoder(backbone, weights, name)
    raise CorruptFileError(
        f"no checkpoint of encoder '{name}' in {run_folder or 'no run folder'}; "
        f"there are: {', '.join(path.name for path in checkpoints) or 'none'}"
    )


def _checkpoints(run_folder: Path | None) -> list[Path]:
    """Complete checkpoint folders, newest first."""
    if run_folder is None:
        return []
    cards = (Path(run_folder) / "encoders").glob(f"[!.]*/{CARD_FILE}")
    by_age = sorted(cards, key=lambda card: (card.stat().st_mtime_ns, card.parent.name))
    return [card.parent for card in reversed(by_age)]


def _method_of(path: Path) -> str:
    try:
        return str(json.loads((path / CARD_FILE).read_text()).get("method"))
    except (OSError, ValueError):
        return ""
