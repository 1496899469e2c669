"""Files that are there complete or not at all, also on a full disk and between threads."""

import stat
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import torch
from full_disk import full_disk

from rapl_core.analysis.stages import StageBook
from rapl_core.atomic import write_atomically
from rapl_core.errors import CorruptFileError, RaplError
from rapl_core.representations import features
from rapl_core.representations.trainable import save_network


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.rglob("*")}


def test_a_file_is_replaced_whole_and_its_folder_made(tmp_path: Path) -> None:
    path = tmp_path / "new" / "file"
    assert write_atomically(path, "alt") == path
    write_atomically(path, "größer", mode=0o600)
    assert path.read_text(encoding="utf-8") == "größer"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert names(path.parent) == {"file"}


def test_on_a_full_disk_the_old_content_stays_and_the_error_says_why(tmp_path: Path) -> None:
    path = write_atomically(tmp_path / "file", "old")
    with full_disk(), pytest.raises(CorruptFileError, match=f"cannot write it {path}: File too"):
        write_atomically(path, b"x" * 10_000, "it", error=CorruptFileError)
    assert path.read_text() == "old"
    assert names(tmp_path) == {"file"}


def test_what_stands_in_the_way_is_named() -> None:
    with pytest.raises(RaplError, match=r"cannot write /proc/self/file: No such file"):
        write_atomically("/proc/self/file", "")


def test_threads_may_write_the_same_file(tmp_path: Path) -> None:
    array = np.random.default_rng(0).random((50, 2000)).astype(np.float32)

    def write(number: int) -> None:
        features._write(tmp_path / f"{number // 2}.safetensors", array)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(write, range(300)))
    assert len(names(tmp_path)) == 150
    assert all(features._read(path) is not None for path in tmp_path.iterdir())


def test_stages_features_and_weights_on_a_full_disk_are_clear_errors(tmp_path: Path) -> None:
    book, network = StageBook(tmp_path), torch.nn.Linear(64, 64)
    book.begin("collect")
    with full_disk():
        with pytest.raises(RaplError, match="cannot write .*stages.json: File too large"):
            book.finish("collect", {"videos": "x" * 1000})
        with pytest.raises(RaplError, match="cannot write .*features.safetensors: File too large"):
            features._write(tmp_path / "features.safetensors", np.zeros((50, 64), np.float32))
        with pytest.raises(CorruptFileError, match=f"cannot write weights to {tmp_path}"):
            save_network(network, "linear", tmp_path)
    assert StageBook(tmp_path)["collect"].status == "running"
    assert names(tmp_path) == {"stages.json"}
