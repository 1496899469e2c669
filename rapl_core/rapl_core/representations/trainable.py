"""A backbone of which a part is trained here, and how its weights get to disk."""

import uuid
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.torch import save_file
from torch import nn

from rapl_core.errors import CorruptFileError, UnknownNameError
from rapl_core.representations.backbone_spec import Stage
from rapl_core.representations.backbones import load_network, stage_index, stage_maps
from rapl_core.representations.extractor import FeatureExtractor, make_extractor
from rapl_core.representations.preprocessing import preprocess
from rapl_core.representations.weights import file_sha256

_BATCH = 64


class TrainableBackbone(nn.Module):
    """Pictures to features, with gradients for the last block that the recipe reads.

    Batch statistics stay frozen: batches here are frames of few videos.
    """

    def __init__(self, start: FeatureExtractor, weights: Path | None = None) -> None:
        """
        :param start: what the features are read as before training; its parts are kept.
        :param weights: those of ``start``.
        :raises UnknownNameError, WeightsError: from loading the backbone, or if nothing in it is
            to be trained for this recipe.
        """
        super().__init__()
        name, recipe = start.backbone.spec.name, start.recipe
        self.spec, self.network, _ = load_network(name, weights)
        self.recipe, self.preprocessing = recipe, start.preprocessing
        self.pools = start.pools
        self._is_chain: bool | None = None
        self._indices = [stage_index(self.network, name, s) for s in recipe.stages if s != "final"]
        self.network.requires_grad_(False)
        self._block = last_block(self.network, name, recipe.stages)
        for module in self._block:
            module.requires_grad_(True)
        if not self.free_parameters():
            raise UnknownNameError(
                f"stage of {name} that ends with a block to train", " and ".join(recipe.stages),
                {f"stride{info['reduction']}" for info in self.network.feature_info[1:]},
            )  # fmt: skip
        self.train(False)

    def train(self, mode: bool = True) -> "TrainableBackbone":
        """Stay in evaluation mode."""
        del mode
        return super().train(False)

    def free_parameters(self) -> list[nn.Parameter]:
        """What is trained."""
        return [p for p in self.network.parameters() if p.requires_grad]

    def forward(self, frames: NDArray[np.uint8]) -> torch.Tensor:
        """(N, H, W, 3) uint8 -> (N, F)."""
        x = preprocess(frames, self.preprocessing)
        maps = stage_maps(self.network, self.spec, self.recipe.stages, self._indices, x)
        of_stages = (m for m in maps for _ in self.recipe.poolings)
        return torch.cat([pool(m) for pool, m in zip(self.pools, of_stages, strict=True)], dim=1)

    def trunk(self, frames: NDArray[np.uint8]) -> NDArray[Any]:
        """Return what the trained block starts from, to be computed once a picture.

        :param frames: (N, H, W, 3) uint8.
        :return: (N, C, h, w) float32, the maps before the block; or the pictures themselves, where
            the maps take more room than the backbone's input has bytes or the network is no chain
            of modules from there on (several stages, tokens).
        """
        if self._is_chain is None:
            self._is_chain = self._check_chain(frames[:1])
        if not self._is_chain:
            return frames
        parts = [self._before(frames[i : i + _BATCH]) for i in range(0, len(frames), _BATCH)]
        return np.asarray(torch.cat(parts).numpy())

    def tail(self, start: torch.Tensor) -> torch.Tensor:
        """Features (N, F) of what :meth:`trunk` gave; the same as those of the pictures."""
        if not self._is_chain:
            return self(start.numpy())  # type: ignore[no-any-return]
        for module in self._block:
            start = module(start)
        return torch.cat([pool(start) for pool in self.pools], dim=1)

    def _before(self, frames: NDArray[np.uint8]) -> torch.Tensor:
        """The input of the block."""
        kept: list[torch.Tensor] = []
        hook = self._block[0].register_forward_pre_hook(lambda _, given: kept.append(given[0]))
        try:
            with torch.no_grad():
                self(frames)
        finally:
            hook.remove()
        return kept[0]

    def _check_chain(self, frames: NDArray[np.uint8]) -> bool:
        """Whether block and poolings alone give the features, from less than the pictures."""
        if len(self.recipe.stages) > 1:
            return False
        start = self._before(frames)
        of_input = 3 * self.preprocessing.height * self.preprocessing.width  # bytes
        if start.ndim != 4 or start.nbytes > of_input:
            return False
        self._is_chain = True
        with torch.no_grad():
            again, whole = self.tail(start), self(frames)
        return again.shape == whole.shape and torch.allclose(again, whole, atol=1e-5)

    def trained(self, folder: Path) -> FeatureExtractor:
        """Write the whole network and read it as the frozen part of an encoder."""
        file = save_network(self.network, self.spec.name, folder)
        extractor = make_extractor(self.spec.name, self.recipe, file)
        extractor.pools.load_state_dict(self.pools.state_dict())
        return extractor


def last_block(network: Any, name: str, stages: tuple[Stage, ...]) -> list[nn.Module]:
    """The modules behind the deepest stage that is read, and what follows up to it."""
    if "final" not in stages:
        index = max(stage_index(network, name, stage) for stage in stages)
        return [network.get_submodule(network.feature_info[index]["module"])]
    deepest = [network.get_submodule(network.feature_info[-1]["module"])]
    if hasattr(network, "blocks"):  # a transformer, or an EfficientNet with its blocks in stages
        deepest = [network.blocks[-1]]
    after = ("conv_head", "bn2", "norm")
    return deepest + [getattr(network, part) for part in after if hasattr(network, part)]


def save_network(network: nn.Module, name: str, folder: Path) -> Path:
    """Write weights to ``folder/<name>-<start of SHA-256>.safetensors``, atomically.

    :raises CorruptFileError: if it cannot be written.
    """
    folder = Path(folder)
    beside = folder / f".{name}.{uuid.uuid4().hex}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        save_file({k: v.detach().contiguous() for k, v in network.state_dict().items()}, beside)
        path = folder / f"{name}-{file_sha256(beside)[:16]}.safetensors"
        beside.replace(path)
    except (OSError, SafetensorError) as error:  # a full disk is the latter
        raise CorruptFileError(f"cannot write weights to {folder}: {error}") from error
    finally:
        with suppress(OSError):
            beside.unlink(missing_ok=True)
    return path
