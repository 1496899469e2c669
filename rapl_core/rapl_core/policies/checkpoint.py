"""Checkpoints of learning: a folder with safetensors and one JSON card; no pickles."""

import hashlib
import json
import os
import shutil
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

from rapl_core.errors import CorruptFileError, RaplError

CARD_FILE = "card.json"

FORMAT = 1

_TEMPORARY_PREFIX = ".writing-"


@dataclass(frozen=True)
class Part:
    """What one object needs in order to go on."""

    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    values: Mapping[str, Any] = field(default_factory=dict)
    """JSON."""


def write_checkpoint(folder: Path | str, parts: Mapping[str, Part]) -> Path:
    """Write ``parts`` to ``folder``, which must not exist; atomic.

    :raises RaplError: if ``folder`` exists or cannot be written.
    """
    folder = Path(folder)
    if folder.exists():
        raise RaplError(f"the checkpoint {folder} is already there")
    temporary = folder.parent / f"{_TEMPORARY_PREFIX}{uuid.uuid4().hex}"
    card: dict[str, Any] = {"format": FORMAT, "parts": {}}
    try:
        temporary.mkdir(parents=True)
        for name, part in parts.items():
            arrays = {key: np.ascontiguousarray(value) for key, value in part.arrays.items()}
            data = save(arrays)
            _write(temporary / f"{name}.safetensors", data)
            digest = hashlib.sha256(data).hexdigest()
            card["parts"][name] = {"sha256": digest, "values": dict(part.values)}
        _write(temporary / CARD_FILE, json.dumps(card).encode())
        temporary.rename(folder)
        _flush_folder(folder.parent)
    except OSError as error:
        raise RaplError(f"cannot write the checkpoint {folder}: {error}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return folder


def read_checkpoint(folder: Path | str) -> dict[str, Part]:
    """Return the parts in ``folder``.

    :raises CorruptFileError: if a file is missing, truncated or altered; names the file.
    """
    folder = Path(folder)
    file = folder / CARD_FILE
    try:
        card = json.loads(file.read_text(encoding="utf-8"))
        if card["format"] != FORMAT:
            raise CorruptFileError(f"{file} has the format {card['format']}, expected {FORMAT}")
        parts = {}
        for name, described in card["parts"].items():
            file = folder / f"{name}.safetensors"
            data = file.read_bytes()
            if hashlib.sha256(data).hexdigest() != described["sha256"]:
                raise CorruptFileError(f"{file} is truncated or was altered: its hash differs")
            parts[name] = Part(arrays=load(data), values=described["values"])
    except OSError as error:
        raise CorruptFileError(f"{file} cannot be read: {error}") from error
    except (ValueError, KeyError, TypeError, AttributeError, SafetensorError) as error:
        raise CorruptFileError(f"{file} is no part of a checkpoint: {error!r}") from error
    return parts


class CheckpointFolder:
    """The checkpoints of one policy, named by their world steps; the newest few are kept.

    :param folder: created by the first :meth:`save`.
    """

    def __init__(self, folder: Path | str, keep: int = 2) -> None:
        self.folder = Path(folder)
        self._keep = max(1, keep)

    def save(self, steps: int, parts: Mapping[str, Part]) -> Path:
        """Write a checkpoint and then remove the oldest; saving the same steps twice is fine."""
        target = self.folder / f"{steps:09d}"
        if not target.exists():
            write_checkpoint(target, parts)
        for old in self.all()[: -self._keep]:
            shutil.rmtree(old, ignore_errors=True)
        return target

    def all(self) -> list[Path]:
        """Return the checkpoints, the oldest first."""
        if not self.folder.is_dir():
            return []
        return sorted(
            entry
            for entry in self.folder.iterdir()
            if entry.name.isdigit() and (entry / CARD_FILE).is_file()
        )

    def latest(self) -> Path | None:
        """Return the newest checkpoint, or None."""
        return self.all()[-1] if self.all() else None


def _write(file: Path, data: bytes) -> None:
    with file.open("wb") as opened:
        opened.write(data)
        opened.flush()
        os.fsync(opened.fileno())


def _flush_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
