"""An encoder in one file, for another machine.

A safetensors file: the card in its metadata; below ``encoder/`` the encoder's own tensors, below
``experts/`` the embedded expert videos, below ``backbone/`` the backbone where it belongs to the
encoder or was asked for. Lying in a run's ``encoders`` folder it is an encoder of that run, by the
file's name without its suffix.
"""

import json
import uuid
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save
from torch import Tensor, from_numpy

from rapl_core.atomic import write_atomically
from rapl_core.errors import CorruptFileError, RefusedError
from rapl_core.representations.backbones import load_network
from rapl_core.representations.card import EncoderCard
from rapl_core.representations.checkpoints import assemble, check_version
from rapl_core.representations.encoder import Encoder
from rapl_core.representations.weights import StateDict, tensors_sha256
from rapl_core.types import EmbeddedEpisode

SUFFIX = ".safetensors"
FORMAT = "rapl encoder 1"

_ENCODER, _EXPERTS, _BACKBONE = "encoder/", "experts/", "backbone/"


@dataclass(frozen=True)
class ExportedFile:
    """What was written."""

    path: Path
    size_bytes: int
    experts: int
    has_backbone: bool
    """False: the other machine must have the backbone's weights."""


def export_encoder(
    encoder: Encoder,
    file: Path,
    experts: tuple[EmbeddedEpisode, ...],
    frames: NDArray[np.uint8],
    report: Mapping[str, Any] | None = None,
    with_backbone: bool = False,
    force: bool = False,
) -> ExportedFile:
    """Write an encoder to one file, which appears complete and checked or not at all.

    It is read back before it appears, and must then embed ``frames`` as before, bit by bit.

    :param file: its name must end in ``.safetensors``.
    :param experts: D+ through this encoder, so that rewards need no videos there.
    :param frames: (N, H, W, 3) uint8 RGB.
    :param report: how its training went.
    :param with_backbone: whether to take the backbone along although it was not trained here.
    :param force: whether to replace a file.
    :raises RefusedError: if the file exists, or has another suffix.
    :raises CorruptFileError: if it cannot be written, or reads back as another encoder.
    """
    check_target(file, force)
    card = replace(encoder.card, weights_file="")
    tensors = {_ENCODER + k: t for k, t in encoder.tensors.items()}
    tensors |= {_EXPERTS + e.episode_id: from_numpy(e.values.copy()) for e in experts}
    given = Path(encoder.extractor.backbone.weights_file or encoder.card.weights_file)
    has_backbone = encoder.card.has_own_backbone or with_backbone
    if has_backbone:
        network = load_network(card.backbone, given if given.is_file() else None)[1]
        tensors |= {_BACKBONE + k: t for k, t in network.state_dict().items()}
    tensors = {k: t.detach().contiguous() for k, t in tensors.items()}
    metadata = {
        "format": FORMAT,
        "card": json.dumps({**card.to_json(), "version": encoder.info.version}),
        "report": json.dumps(dict(report or {})),
        "sha256": tensors_sha256(tensors),
    }
    beside = file.with_name(f".{file.stem}.{uuid.uuid4().hex}{SUFFIX}")
    try:
        write_atomically(beside, save(tensors, metadata), error=CorruptFileError)
        again = load_exported(beside, given if given.is_file() else None)
        _compare(encoder, again, experts, frames, file)
        check_target(file, force)  # somebody may have made it meanwhile
        beside.replace(file)
    except OSError as error:
        raise CorruptFileError(f"cannot write {file}: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            beside.unlink(missing_ok=True)
    return ExportedFile(file, file.stat().st_size, len(experts), has_backbone)


def load_exported(file: Path, weights: Path | None = None) -> Encoder:
    """Read an encoder that :func:`export_encoder` wrote; runs no code from the file.

    :param weights: the backbone's weights, where the file has none and they are not at their
        default place.
    :raises CorruptFileError: if the file is damaged, changed or something else.
    :raises WeightsError: if tensors are of another architecture, or the backbone's weights are
        missing or others than at training.
    """
    content = read_exported_card(file)
    version = content.pop("version", None)
    card = EncoderCard.from_json(content, str(file))
    tensors = _read_tensors(file)
    backbone = _below(_BACKBONE, tensors)
    if card.has_own_backbone and not backbone:
        raise CorruptFileError(f"{file} lacks the backbone that encoder {version} was made with")
    experts = [
        EmbeddedEpisode(name, values.numpy()) for name, values in _below(_EXPERTS, tensors).items()
    ]
    experts.sort(key=lambda e: (*card.expert_ids, e.episode_id).index(e.episode_id))
    encoder = assemble(card, _below(_ENCODER, tensors), backbone or weights, str(file))
    encoder = Encoder(encoder.extractor, encoder.embedder, card, experts)
    check_version(encoder, version, file)
    return encoder


def read_exported_card(file: Path) -> dict[str, Any]:
    """What the card says, unchecked, and under ``version`` whose it is; reads the head alone.

    :raises CorruptFileError: if the file is no exported encoder.
    """
    return _object(file, "card")


def read_exported_report(file: Path) -> dict[str, Any]:
    """How its training went; empty where that is not told. Errors as of the card."""
    return _object(file, "report")


def _object(file: Path, key: str) -> dict[str, Any]:
    try:
        content = json.loads(_metadata(file).get(key, ""))
    except ValueError as error:
        raise CorruptFileError(f"{file} has no {key} of an encoder: {error}") from error
    if not isinstance(content, dict):
        raise CorruptFileError(f"{file} has no {key} of an encoder")
    return content


def _metadata(file: Path) -> dict[str, str]:
    try:
        with safe_open(file, framework="pt") as opened:
            metadata = opened.metadata() or {}
    except (OSError, SafetensorError) as error:
        raise CorruptFileError(f"{file} cannot be read: {error}") from error
    if (found := metadata.get("format")) != FORMAT:
        raise CorruptFileError(
            f"{file} is no exported encoder: its format is {found!r}, expected {FORMAT!r}"
        )
    return dict(metadata)


def _read_tensors(file: Path) -> StateDict:
    expected = _metadata(file).get("sha256")
    try:
        tensors = load_file(file)
    except (OSError, SafetensorError) as error:
        raise CorruptFileError(f"{file} cannot be read: {error}") from error
    if (found := tensors_sha256(tensors)) != expected:
        raise CorruptFileError(
            f"{file} was changed: its tensors have SHA-256 {found[:12]}..., "
            f"expected {str(expected)[:12]}..."
        )
    return tensors


def _below(prefix: str, tensors: StateDict) -> dict[str, Tensor]:
    return {k.removeprefix(prefix): t for k, t in tensors.items() if k.startswith(prefix)}


def _compare(
    encoder: Encoder,
    again: Encoder,
    experts: tuple[EmbeddedEpisode, ...],
    frames: NDArray[np.uint8],
    file: Path,
) -> None:
    same = np.array_equal(again.embed(frames), encoder.embed(frames))
    brought = {e.episode_id: e.values for e in again.experts}
    same &= brought.keys() == {e.episode_id for e in experts}
    if not (same and all(np.array_equal(brought[e.episode_id], e.values) for e in experts)):
        raise CorruptFileError(
            f"{file} reads back as an encoder that embeds the same pictures otherwise; "
            "nothing was written"
        )


def check_target(file: Path, force: bool = False) -> None:
    """
    :raises RefusedError: if an encoder may not be exported to ``file``.
    """
    if file.suffix != SUFFIX:
        raise RefusedError(f"cannot export to {file}: its name must end in {SUFFIX}")
    if file.exists() and not force:
        raise RefusedError(f"{file} exists; give another name, or --force to replace it")
