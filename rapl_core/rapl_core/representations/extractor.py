"""The frozen part of an encoder: preprocessing, backbone, pooling."""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from rapl_core.errors import ShapeError, UnknownNameError
from rapl_core.representations.backbone_spec import Stage
from rapl_core.representations.backbones import Backbone, load_backbone
from rapl_core.representations.engines import Engine, OpenVinoEngine, flat_scenes
from rapl_core.representations.parts import PartPool
from rapl_core.representations.pooling import Pooling, make_pool
from rapl_core.representations.preprocessing import Preprocessing, preprocess
from rapl_core.representations.weights import StateDict, tensors_sha256

Precision = Literal["float32", "bfloat16"]
CHECK_EVERY = 4
"""Of a video's frames every fourth one is what an inference engine is checked on."""


@dataclass(frozen=True)
class FeatureRecipe:
    """What is read from a backbone: the pooled maps of some stages, one after another."""

    stages: tuple[Stage, ...] = ("final",)
    poolings: tuple[Pooling, ...] = (Pooling(),)
    """Each stage's map goes through each of them."""
    size: tuple[int, int] | None = None
    """Height and width of the backbone's input; None: the backbone's own choice."""

    def __post_init__(self) -> None:
        if not self.stages or not self.poolings:
            raise ShapeError("a feature recipe needs at least one stage and one pooling")


class FeatureExtractor(nn.Module):
    """Pictures to vectors, with nothing in it that is learnt from rankings."""

    def __init__(self, backbone: Backbone, recipe: FeatureRecipe) -> None:
        super().__init__()
        self.backbone = backbone
        self.recipe = recipe
        self.preprocessing = _sized(backbone.spec.preprocessing, recipe.size)
        self.engine: Engine = "torch"
        self._openvino: OpenVinoEngine | None = None
        self.pools = nn.ModuleList(
            make_pool(pooling, backbone.channels(stage))
            for stage in backbone.stages
            for pooling in recipe.poolings
        )
        """For each stage each pooling."""

    @property
    def dimension(self) -> int:
        """F, the number of features of a frame."""
        channels = [self.backbone.channels(stage) for stage in self.backbone.stages]
        return sum(pooling.size(c) for c in channels for pooling in self.recipe.poolings)

    @property
    def version(self) -> str:
        """16 hex digits for weights, preprocessing, recipe and parts."""
        parts = tensors_sha256(self.pools.state_dict())
        recipe = (asdict(self.preprocessing), asdict(self.recipe))
        text = repr((self.backbone.weights_sha256, *recipe, parts))
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """(N, 3, height, width) -> (N, F) float32."""
        maps = self.backbone(x)
        return torch.cat([pool(m) for pool, m in self._pooled(maps)], dim=1)

    @property
    def needs_parts(self) -> bool:
        """Whether :meth:`find_parts` must be called before there are features."""
        return any(isinstance(p, PartPool) and not p.is_fitted for p in self.pools)

    def find_parts(self, pictures: Iterable[NDArray[Any]], rng: np.random.Generator) -> None:
        """Find the parts that poolings of kind ``parts`` describe pictures by.

        :param pictures: frames (N, H, W, 3) uint8 RGB of one video after another, some hundred
            altogether; no labels.
        :raises ShapeError: for frames of another shape or dtype, or fewer than two.
        """
        with torch.inference_mode():
            batches = [self.backbone(preprocess(p, self.preprocessing)) for p in pictures]
            maps = [torch.cat(of_stage) for of_stage in zip(*batches, strict=True)]
            for pool, of_stage in self._pooled(maps):
                if isinstance(pool, PartPool):
                    pool.fit(of_stage, rng)

    def _pooled(self, maps: Sequence[torch.Tensor]) -> Iterator[tuple[nn.Module, torch.Tensor]]:
        """Each pool with the maps that go through it."""
        stages = (m for m in maps for _ in self.recipe.poolings)
        return zip(self.pools, stages, strict=True)

    def use_engine(
        self, engine: Engine, threads: int = 1, pictures: NDArray[Any] | None = None
    ) -> None:
        """Compute features by another engine from now on; checked against torch first.

        :param pictures: (N, H, W, 3) uint8 to check it on, like those to come, such as a video, of
            which every fourth one is taken; None: coloured boxes.
        :raises UnknownNameError: for an unknown engine.
        :raises EngineError: if it is not installed or disagrees; the old one stays.
        """
        if engine not in get_args(Engine):
            raise UnknownNameError("inference engine", engine, get_args(Engine))
        self._openvino = None if engine == "torch" else self._compile(threads, pictures)
        self.engine = engine

    @property
    def engine_precision(self) -> str:
        """What the engine computes in."""
        return self._openvino.precision if self._openvino else "float32"

    def _compile(self, threads: int, pictures: NDArray[Any] | None) -> OpenVinoEngine:
        frames = flat_scenes() if pictures is None else pictures[::CHECK_EVERY]
        return OpenVinoEngine(self, preprocess(frames, self.preprocessing), threads)

    def extract(
        self, frames: NDArray[Any], precision: Precision = "float32", batch_size: int = 16
    ) -> torch.Tensor:
        """Features of pictures, without gradients.

        ``bfloat16`` is two to three times as fast and off by about one per cent; what a running
        system must reproduce is computed in ``float32``. Neither concerns the engine OpenVINO,
        which has its own precision.

        :param frames: (N, H, W, 3) uint8 RGB of any one size.
        :return: (N, F) float32.
        :raises ShapeError: for frames of another shape or dtype.
        """
        if precision not in get_args(Precision):
            raise UnknownNameError("precision", precision, get_args(Precision))
        is_half = precision == "bfloat16"
        features = []
        with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16, enabled=is_half):
            for start in range(0, max(len(frames), 1), batch_size):
                batch = preprocess(frames[start : start + batch_size], self.preprocessing)
                features.append(self._openvino(batch) if self._openvino else self(batch))
        return torch.cat(features).clone()


def make_extractor(
    backbone: str, recipe: FeatureRecipe, weights: Path | StateDict | None = None
) -> FeatureExtractor:
    """Load a backbone and read it by a recipe.

    :param weights: as of :func:`load_backbone`.

    :raises UnknownNameError, WeightsError: from :func:`load_backbone`.
    """
    return FeatureExtractor(load_backbone(backbone, recipe.stages, weights), recipe)


def _sized(preprocessing: Preprocessing, size: tuple[int, int] | None) -> Preprocessing:
    if size is None:
        return preprocessing
    return Preprocessing(*size, mean=preprocessing.mean, std=preprocessing.std)
