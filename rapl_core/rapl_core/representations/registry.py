"""Encoders by name."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rapl_core.errors import CorruptFileError, UnknownNameError
from rapl_core.representations.card import EncoderCard
from rapl_core.representations.checkpoints import (
    CARD_FILE,
    MODEL_FILE,
    load_encoder,
    read_card,
    read_report,
)
from rapl_core.representations.encoder import Encoder
from rapl_core.representations.exported import (
    SUFFIX,
    load_exported,
    read_exported_card,
    read_exported_report,
)
from rapl_core.representations.methods import DEFAULT_BACKBONE, get_method, method_names
from rapl_core.representations.pretrained import raw_encoder

__all__ = ["DEFAULT_BACKBONE", "SavedEncoder", "encoder_names", "make_encoder", "saved_encoders"]


@dataclass(frozen=True)
class SavedEncoder:
    """A checkpoint of a run."""

    name: str
    """What it is loaded by: ``<method>-<version>``, or that of an exported file."""
    path: Path
    """A folder, or an exported file."""
    card: EncoderCard
    version: str
    made_s: float
    """Wall clock at which it was written here."""
    report: dict[str, Any]
    """How its training went; empty where it is not told."""


def encoder_names(run_folder: Path | None = None) -> list[str]:
    """The methods; with a run folder also each checkpoint in it, as ``<method>-<version>``, and
    each exported file, by its name without suffix."""
    saved = [_name_of(path) for path in _checkpoints(run_folder)]
    return sorted({*method_names(), *saved})


def saved_encoders(run_folder: Path) -> tuple[list[SavedEncoder], list[CorruptFileError]]:
    """What a run has, the newest first, and what cannot be read of it."""
    found, damaged = [], []
    for path in _checkpoints(run_folder):
        try:
            content = _card_of(path)
            version = str(content.pop("version", ""))
            card = EncoderCard.from_json(content, str(path))
            made = path / MODEL_FILE if path.is_dir() else path
            report = read_report(path) if path.is_dir() else read_exported_report(path)
            found.append(
                SavedEncoder(_name_of(path), path, card, version, made.stat().st_mtime, report)
            )
        except CorruptFileError as error:
            damaged.append(error)
        except OSError as error:
            damaged.append(CorruptFileError(f"{path} cannot be read: {error}"))
    return found, damaged


def report_of(encoder: Encoder, run_folder: Path) -> dict[str, Any]:
    """How the training of an encoder of a run went; empty where that is not told."""
    saved = saved_encoders(run_folder)[0]
    reports = [s.report for s in saved if s.version == encoder.info.version]
    return next(filter(None, reports), {})


def make_encoder(
    name: str,
    run_folder: Path | None = None,
    backbone: str | None = None,
    weights: Path | None = None,
) -> Encoder:
    """Load an encoder by name.

    :param name: a method (its newest checkpoint in ``run_folder/encoders``), a checkpoint's own
        name ``<method>-<version>``, or that of an exported file there without its suffix. A method
        that learns nothing, such as ``imagenet`` or ``r3m``, needs no checkpoint; without one its
        reward scale is 1.
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
        if _name_of(path) == name or (name in method_names() and _method_of(path) == name):
            return load_encoder(path, weights) if path.is_dir() else load_exported(path, weights)
    if name in method_names() and not get_method(name).is_trained:
        return raw_encoder(backbone, weights, name)
    raise CorruptFileError(
        f"no checkpoint of encoder '{name}' in {run_folder or 'no run folder'}; "
        f"there are: {', '.join(map(_name_of, checkpoints)) or 'none'}"
    )


def _checkpoints(run_folder: Path | None) -> list[Path]:
    """Complete checkpoint folders and exported files, newest first."""
    if run_folder is None:
        return []
    folder = Path(run_folder) / "encoders"
    dated = [*folder.glob(f"[!.]*/{CARD_FILE}"), *folder.glob(f"[!.]*{SUFFIX}")]
    by_age = sorted(dated, key=lambda file: (file.stat().st_mtime_ns, str(file)))
    return [file.parent if file.name == CARD_FILE else file for file in reversed(by_age)]


def _name_of(path: Path) -> str:
    return path.name if path.is_dir() else path.name.removesuffix(SUFFIX)


def _card_of(path: Path) -> dict[str, Any]:
    return read_card(path) if path.is_dir() else read_exported_card(path)


def _method_of(path: Path) -> str:
    try:
        return str(_card_of(path).get("method"))
    except CorruptFileError:
        return ""
