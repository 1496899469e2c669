"""What a saved encoder says about itself."""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, get_args

import torch

from rapl_core.errors import CorruptFileError, RaplError, ShapeError, UnknownNameError
from rapl_core.representations.extractor import FeatureRecipe
from rapl_core.representations.pooling import Pooling
from rapl_core.representations.preprocessing import Preprocessing
from rapl_core.representations.weights import tensors_sha256
from rapl_core.transport import TransportConfig
from rapl_core.transport.plain_rewards import RewardKind

FORMAT = 1

_LARGEST_SIZE = 1_000_000


@dataclass(frozen=True)
class EncoderCard:
    """Everything about an encoder but its tensors."""

    method: str
    """rapl, rlhf, imagenet, ..."""
    preset: str
    backbone: str
    backbone_sha256: str
    """Of the backbone's tensors, which are not copied into a checkpoint."""
    recipe: FeatureRecipe
    preprocessing: Preprocessing
    features: int
    """F, what the extractor gives."""
    components: int | None
    """Principal components kept; None: all features, standardised."""
    has_projection: bool
    has_head: bool
    dimension: int
    """D of the embedding."""
    reward_kind: RewardKind
    """How rewards follow from embeddings."""
    transport: TransportConfig
    reward_scale: float
    expert_ids: tuple[str, ...]
    expert_from: float
    """Share of an expert video that is passed over before its frames are matched."""
    data_sha256: str
    """Of the triplets, experts and features that it was trained on; empty if on none."""
    has_own_backbone: bool = False
    """Whether the backbone was trained here, so that its weights belong to the checkpoint."""
    weights_file: str = field(default="", compare=False)
    """Where the backbone's weights were, if not at their default place; a hint, no identity."""

    def __post_init__(self) -> None:
        for name in (
            "method",
            "preset",
            "backbone",
            "backbone_sha256",
            "data_sha256",
            "weights_file",
        ):
            if not isinstance(getattr(self, name), str):
                raise ShapeError(f"{name} is {getattr(self, name)!r}, expected text")
        for name in ("has_projection", "has_head", "has_own_backbone"):
            if not isinstance(getattr(self, name), bool):
                raise ShapeError(f"{name} is {getattr(self, name)!r}, expected true or false")
        for name in ("features", "components", "dimension"):
            size = getattr(self, name)
            if not (isinstance(size, int) and 0 < size <= _LARGEST_SIZE) and not (
                name == "components" and size is None
            ):
                raise ShapeError(f"{name} is {size!r}, expected 1 to {_LARGEST_SIZE}")
        if self.reward_kind not in get_args(RewardKind):
            raise UnknownNameError("reward kind", self.reward_kind, get_args(RewardKind))
        if not (math.isfinite(self.reward_scale) and self.reward_scale > 0):
            raise ShapeError(f"reward scale is {self.reward_scale}, expected a number above 0")
        if not 0 <= self.expert_from < 1:
            raise ShapeError(f"expert_from is {self.expert_from}, expected 0 <= expert_from < 1")
        if self.reward_kind == "scalar" and self.dimension != 1:
            raise ShapeError(f"a scalar reward has dimension 1, got {self.dimension}")

    def version(self, tensors: Mapping[str, torch.Tensor]) -> str:
        """16 hex digits for the card and the encoder's own tensors."""
        identity = {k: v for k, v in self.to_json().items() if k != "weights_file"}
        text = json.dumps(identity, sort_keys=True) + tensors_sha256(tensors)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def to_json(self) -> dict[str, Any]:
        """A JSON object of this card."""
        return {"format": FORMAT, **asdict(self)}

    @classmethod
    def from_json(cls, content: Mapping[str, Any], source: str) -> "EncoderCard":
        """Read a card back.

        :param source: named in errors.
        :raises CorruptFileError: for missing or unknown fields and values out of range.
        """
        fields = dict(content)
        if (found := fields.pop("format", None)) != FORMAT:
            raise CorruptFileError(f"{source} has format {found!r}, expected {FORMAT}")
        try:
            recipe, preprocessing = dict(fields["recipe"]), dict(fields["preprocessing"])
            fields["recipe"] = FeatureRecipe(
                stages=tuple(recipe.pop("stages")),
                poolings=tuple(Pooling(**pooling) for pooling in recipe.pop("poolings")),
                size=tuple(size) if (size := recipe.pop("size")) else None,
                **recipe,
            )
            fields["preprocessing"] = Preprocessing(
                mean=tuple(preprocessing.pop("mean")),
                std=tuple(preprocessing.pop("std")),
                **preprocessing,
            )
            fields["transport"] = TransportConfig(**fields["transport"])
            fields["expert_ids"] = tuple(fields["expert_ids"])
            return cls(**fields)
        except (KeyError, TypeError, ValueError, RaplError) as error:
            raise CorruptFileError(f"{source} is not the card of an encoder: {error}") from error
