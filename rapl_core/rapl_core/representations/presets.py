"""Recipes of alignment, by name: what the paper says, what its authors ran, what we found best.

A recipe of one's own is ``dataclasses.replace(get_preset("tuned"), epochs=80)``.
"""

from dataclasses import dataclass
from typing import Literal, get_args

from rapl_core.errors import ShapeError, UnknownNameError
from rapl_core.representations.extractor import FeatureRecipe
from rapl_core.representations.pooling import Pooling
from rapl_core.transport import TransportConfig
from rapl_core.types import Noise

Likelihood = Literal["log", "linear"]
Optimiser = Literal["adam", "adamw"]


@dataclass(frozen=True)
class Preset:
    """Features, loss and training of an alignment."""

    name: str
    recipe: FeatureRecipe
    """What is read from the frozen backbone."""
    has_projection: bool
    """Standardise the features before the head."""
    components: int | None
    """And keep this many principal components (at most the features there are); None: all."""
    training: TransportConfig
    """The distance d of eq. representation_alignment_loss."""
    reward: TransportConfig
    """The reward of eq. ot_reward."""
    dimension: int = 32
    likelihood: Likelihood = "log"
    """``log``: maximise log P. ``linear``: maximise P itself, as the paper's
    eq. representation_optimization is printed."""
    temperature: float = 1.0
    """Divides all distances in the loss; cosine distances, at most 2, saturate P at 0.88."""
    noise: Noise = "plain"
    """What is made of the probability e that a comparison was answered wrong
    (:class:`rapl_core.types.DoubtedTriplet`). ``plain``: nothing. ``smoothing``: a share e of each
    label is turned round. ``estimated``: P = (1 - e) sigma + e (1 - sigma), so that an answer far
    from all others counts no further than e says. See ``answer_noise.py``."""
    tie_weight: float = 0.0
    """Of (1/2 - P)^2 for videos that were ranked equal."""
    expert_weight: float = 0.0
    """Of a Bradley-Terry term over all three pairs whose score is minus the distance to expert
    videos."""
    experts_per_batch: int = 3
    expert_from: float = 0.0
    """Of an expert video only what comes after this share of it is matched; 0: all of it."""
    slow_weight: float = 0.0
    """Of a term that asks embeddings to move little between frames of any video, in proportion to
    how far they lie apart over all videos: what a person judges rests unless it is acted upon,
    the arm never does (slowness: Wiskott and Sejnowski 2002)."""
    slow_lag: float = 1 / 12
    """How far apart those frames are, as a share of the video."""
    mirror: bool = False
    """See each training video left-right mirrored too, ranked as it was: the wish holds for either
    side. For cameras and scenes that are much the same mirrored, and wishes that name no side."""
    longest_cut: float = 0.0
    """In training, drop a random share of up to this of the start of all videos of a batch."""
    frames: int | None = None
    """Training sees each video at this many frames, evenly spread; None: all frames (of the
    shortest video, if they differ in length)."""
    optimiser: Optimiser = "adam"
    learning_rate: float = 1e-3
    weight_decay: float = 0.0
    batch_size: int = 10
    epochs: int = 100
    inferred: float = 0.0
    """Triplets inferred from the ranked ones, to learn from as well, for each ranked one; see
    :func:`rapl_core.representations.inferred.inferred_triplets`."""
    held_out: float = 0.2
    """Share of the triplets that choose the best epoch."""
    disjoint_videos: bool = False
    """Drop from training every triplet that shares a video with a held-out one. Triplets of one
    pool share many videos, so this costs most of the data; see ``split.py``."""
    patience: int | None = None
    """Stop after this many epochs without a better held-out loss; None: run all epochs."""

    def __post_init__(self) -> None:
        for kind, name, known in (
            ("likelihood", self.likelihood, get_args(Likelihood)),
            ("optimiser", self.optimiser, get_args(Optimiser)),
            ("treatment of noise", self.noise, get_args(Noise)),
        ):
            if name not in known:
                raise UnknownNameError(kind, name, known)
        for field, lowest in (
            ("dimension", 1), ("temperature", 1e-6), ("tie_weight", 0), ("expert_weight", 0),
            ("experts_per_batch", 1), ("slow_weight", 0), ("learning_rate", 1e-12),
            ("weight_decay", 0), ("batch_size", 1), ("epochs", 1), ("inferred", 0),
        ):  # fmt: skip
            if not getattr(self, field) >= lowest:
                raise ShapeError(
                    f"preset {self.name}: {field} is {getattr(self, field)}, "
                    f"expected at least {lowest}"
                )
        for field in ("longest_cut", "held_out", "expert_from", "slow_lag"):
            if not 0 <= getattr(self, field) < 1:
                raise ShapeError(
                    f"preset {self.name}: {field} is {getattr(self, field)}, expected 0 <= . < 1"
                )


PAPER = Preset(
    name="paper",
    recipe=FeatureRecipe(),
    has_projection=False,
    components=None,
    # The paper names neither epsilon nor the training's settings: epsilon is ours, the settings
    # are those of its authors' code.
    training=TransportConfig(
        cost="cosine", solver="sinkhorn", epsilon=0.05, tolerance=1e-3, max_iterations=100
    ),
    reward=TransportConfig(cost="cosine", solver="sinkhorn", epsilon=0.05),
)

AUTHORS_CODE = Preset(
    name="authors_code",
    recipe=FeatureRecipe(),
    has_projection=False,
    components=None,
    training=TransportConfig(
        cost="cosine", solver="sinkhorn", epsilon=1.0, tolerance=1e-3, max_iterations=100
    ),
    reward=TransportConfig(cost="cosine", solver="sinkhorn", epsilon=1.0),
    likelihood="linear",
    tie_weight=1.0,
    frames=45,
)

_UNIFORM = TransportConfig(cost="euclidean", solver="uniform", expert="mean")

# Departs from the paper: Euclidean cost, epsilon infinite, a term anchored at expert videos, the
# task's own parts as features, slowness, random cuts, the mean over all experts, and of each expert
# video only the last sixth: matched with all of it, the best place to be is half-way to the goal.
TUNED = Preset(
    name="tuned",
    recipe=FeatureRecipe(stages=("stride2",), poolings=(Pooling("parts", parts=32, softness=0.1),)),
    has_projection=True,
    components=160,
    training=_UNIFORM,
    reward=_UNIFORM,
    expert_weight=1.0,
    slow_weight=4.0,
    mirror=True,
    expert_from=5 / 6,
    longest_cut=0.66,
    frames=20,
    optimiser="adamw",
    learning_rate=1e-2,
    weight_decay=1.0,
    batch_size=16,
    epochs=40,
    inferred=3.0,
    held_out=0.15,
)

_PRESETS = {preset.name: preset for preset in (PAPER, AUTHORS_CODE, TUNED)}


def preset_names() -> list[str]:
    """The named presets."""
    return sorted(_PRESETS)


def get_preset(name: str) -> Preset:
    """A preset by name.

    :raises UnknownNameError: naming the known ones.
    """
    if name not in _PRESETS:
        raise UnknownNameError("preset", name, _PRESETS)
    return _PRESETS[name]
