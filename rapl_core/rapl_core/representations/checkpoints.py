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
from rapl_core.representations.weights import load_into

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
    beside = folder.with_name(f".{folder.name}.{uuid.uuid4().hex}")
    try:
        beside.mkdir(parents=True)
        tensors = {k: v.contiguous() for k, v in encoder.tensors.items()}
        save_file(tensors, beside / MODEL_FILE, metadata={"version": encoder.info.version})
        if encoder.card.has_own_backbone:
            shutil.copyfile(encoder.extractor.backbone.weights_file, beside / BACKBONE_FILE)
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
    content = _read_card(folder)
    version = content.pop("version", None)
    card = EncoderCard.from_json(content, str(folder / CARD_FILE))
    tensors, source = _read_tensors(folder), str(folder / MODEL_FILE)
    of_pools = {k.removeprefix(POOLS): t for k, t in tensors.items() if k.startswith(POOLS)}
    embedder = _empty_embedder(card)
    load_into(embedder, {k: t for k, t in tensors.items() if not k.startswith(POOLS)}, source)
    recorded = Path(card.weights_file) if card.weights_file else None
    if card.has_own_backbone:
        weights = folder / BACKBONE_FILE
    elif weights is None and recorded is not None and recorded.is_file():
        weights = recorded
    extractor = make_extractor(card.backbone, card.recipe, weights)
    load_into(extractor.pools, of_pools, source)
    encoder = Encoder(extractor, embedder, card)
    if encoder.info.version != version:
        raise CorruptFileError(
            f"{folder} was saved as encoder {version} and reads as {encoder.info.version}: "
            "its files were changed"
        )
    return encoder


def checkpoint_folder(run_folder: Path, encoder: Encoder) -> Path:
    """``<run folder>/encoders/<method>-<version>``."""
    return Path(run_folder) / "encoders" / f"{encoder.card.method}-{encoder.info.version}"


def _read_card(folder: Path) -> dict[str, Any]:
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


def _read_tensors(folder: Path) -> dict[str, Any]:
    path = folder / MODEL_FILE
    try:
        return load_file(path)
    except (OSError, SafetensorError) as error:
        raise CorruptFileError(f"{path} cannot be read: {error}") from error


def _version_in(folder: Path) -> str | None:
    try:
        return str(_read_card(folder).get("version"))
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
