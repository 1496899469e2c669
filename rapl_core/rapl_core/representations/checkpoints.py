"""Encoders on disk: a folder with model.safetensors and card.json, written atomically."""

import json
import shutil
import uuid
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from rapl_core.errors import CorruptFileError, WeightsError
from rapl_core.representations.card import EncoderCard
from rapl_core.representations.encoder import POOLS, Encoder
from rapl_core.representations.extractor import make_extractor
from rapl_core.representations.heads import Embedder, empty_head
from rapl_core.representations.projection import Projection
from rapl_core.representations.weights import StateDict, load_into

MODEL_FILE = "model.safetensors"
CARD_FILE = "card.json"
BACKBONE_FILE = "backbone.safetensors"
"""Only of an encoder whose backbone was trained here."""
REPORT_FILE = "report.json"


def save_encoder(encoder: Encoder, folder: Path, report: dict[str, Any] | None = None) -> Path:
    """Write an encoder to ``folder``, which appears complete or not at all.

    The backbone's own weights are referred to by their hash, not copied, unless it was trained
    here.

    :param folder: the checkpoint's own folder, e.g. from :func:`checkpoint_folder`. If it exists
        with this very version it only becomes the newest.
    :param report: how the training went; written beside, not part of the encoder's identity.
    :raises CorruptFileError: if the folder cannot be written or is another encoder's.
    """
    folder = Path(folder)
    if folder.exists():
        if _version_in(folder) == encoder.info.version:
            (folder / CARD_FILE).touch()
            return folder
        raise CorruptFileError(f"{folder} exists and is not encoder {encoder.info.version}")
    own = encoder.extractor.backbone.weights_file if encoder.card.has_own_backbone else ""
    if encoder.card.has_own_backbone and not own:
        raise CorruptFileError(
            f"encoder {encoder.info.version} came from an exported file with its backbone in it: "
            f"copy that file beside {folder} instead"
        )
    beside = folder.with_name(f".{folder.name}.{uuid.uuid4().hex}")
    try:
        beside.mkdir(parents=True)
        tensors = {k: v.contiguous() for k, v in encoder.tensors.items()}
        save_file(tensors, beside / MODEL_FILE, metadata={"version": encoder.info.version})
        if own:
            shutil.copyfile(own, beside / BACKBONE_FILE)
        card = {**encoder.card.to_json(), "version": encoder.info.version}
        (beside / CARD_FILE).write_text(json.dumps(card, indent=2) + "\n")
        if report is not None:
            (beside / REPORT_FILE).write_text(json.dumps(report, indent=2) + "\n")
        beside.rename(folder)
    except (OSError, SafetensorError) as error:  # a full disk is the latter
        raise CorruptFileError(f"cannot write encoder {folder}: {error}") from error
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    return folder


def load_encoder(folder: Path, weights: Path | None = None) -> Encoder:
    """Read an encoder that :func:`save_encoder` wrote; runs no code from the files.

    :param weights: the backbone's weights, if not at their default or recorded place.
    :raises CorruptFileError: if files are missing, damaged, or not those that were saved.
    :raises WeightsError: if tensors are of another architecture or have NaN, or the backbone's
        weights are missing or others than at training.
    """
    folder = Path(folder)
    content, tensors = read_card(folder), _read_tensors(folder)
    version = content.pop("version", None)
    card = EncoderCard.from_json(content, str(folder / CARD_FILE))
    if card.has_own_backbone:
        weights = folder / BACKBONE_FILE
    encoder = assemble(card, tensors, weights, str(folder / MODEL_FILE))
    check_version(encoder, version, folder)
    return encoder


def assemble(
    card: EncoderCard, tensors: StateDict, weights: Path | StateDict | None, source: str
) -> Encoder:
    """An encoder of its parts.

    :param tensors: :attr:`Encoder.tensors`.
    :param weights: the backbone's; None: at their recorded or default place.
    :param source: of the tensors, named in errors.
    :raises WeightsError: as of :func:`load_encoder`.
    """
    of_pools = {k.removeprefix(POOLS): t for k, t in tensors.items() if k.startswith(POOLS)}
    embedder = _empty_embedder(card)
    load_into(embedder, {k: t for k, t in tensors.items() if not k.startswith(POOLS)}, source)
    recorded = Path(card.weights_file) if card.weights_file else None
    if weights is None and recorded is not None and recorded.is_file():
        weights = recorded
    extractor = make_extractor(card.backbone, card.recipe, weights)
    load_into(extractor.pools, of_pools, source)
    return Encoder(extractor, embedder, card)


def check_version(encoder: Encoder, version: object, source: Path) -> None:
    """
    :raises CorruptFileError: if the encoder is not the one that was saved.
    """
    if encoder.info.version != version:
        raise CorruptFileError(
            f"{source} was saved as encoder {version} and reads as {encoder.info.version}: "
            "its files were changed"
        )


def checkpoint_folder(run_folder: Path, encoder: Encoder) -> Path:
    """``<run folder>/encoders/<method>-<version>``."""
    return Path(run_folder) / "encoders" / f"{encoder.card.method}-{encoder.info.version}"


def read_card(folder: Path) -> dict[str, Any]:
    """What the card of a checkpoint says, unchecked, and under ``version`` whose it is.

    :raises CorruptFileError: if there is none that can be read.
    """
    path = folder / CARD_FILE
    try:
        content = json.loads(path.read_text())
    except FileNotFoundError as error:
        raise CorruptFileError(f"no encoder at {folder}: {CARD_FILE} is missing") from error
    except (OSError, ValueError) as error:
        raise CorruptFileError(f"{path} cannot be read: {error}") from error
    if not isinstance(content, dict):
        raise CorruptFileError(f"{path} holds no JSON object")
    return content


def read_report(folder: Path) -> dict[str, Any]:
    """How the training of a checkpoint went, as :func:`save_encoder` was told; empty if it was not.

    :raises CorruptFileError: if it cannot be read.
    """
    path = folder / REPORT_FILE
    if not path.is_file():
        return {}
    try:
        report = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise CorruptFileError(f"{path} cannot be read: {error}") from error
    return report if isinstance(report, dict) else {}


def _read_tensors(folder: Path) -> dict[str, Any]:
    path = folder / MODEL_FILE
    try:
        return load_file(path)
    except (OSError, SafetensorError) as error:
        raise CorruptFileError(f"{path} cannot be read: {error}") from error


def _version_in(folder: Path) -> str | None:
    try:
        return str(read_card(folder).get("version"))
    except CorruptFileError:
        return None


def _empty_embedder(card: EncoderCard) -> Embedder:
    projection = Projection(card.features, card.components) if card.has_projection else None
    width = card.features if projection is None else projection.dimension
    if not card.has_head and width != card.dimension:
        raise WeightsError(
            f"encoder {card.method} has dimension {card.dimension} and no head, expected {width}"
        )
    return Embedder(projection, empty_head(width, card.dimension) if card.has_head else None)
