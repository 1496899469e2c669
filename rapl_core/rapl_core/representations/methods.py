"""Every method of making an encoder, by name: what it learns from and how it rewards.

Free of torch, so that a command line can list them at once.
"""

from dataclasses import dataclass
from typing import Literal

from rapl_core.errors import UnknownNameError
from rapl_core.transport.plain_rewards import RewardKind

DEFAULT_BACKBONE = "efficientnet_lite0"

Lesson = Literal["rankings", "demonstrations", "frames", "truth", "nothing"]
"""What a method learns from: rankings of videos; preferred demonstrations without rankings; the
videos' pictures alone; the human's own reward (a ceiling, never for learning); nothing here."""

Trained = Literal["head", "last_block"]
"""What learns: the last linear layer, on features that are computed once (the paper); or the
backbone's last block with it."""


@dataclass(frozen=True)
class Method:
    """One row of the tables."""

    name: str
    title: str
    lesson: Lesson
    reward: RewardKind
    backbone: str = DEFAULT_BACKBONE
    """Unless another is asked for."""
    is_control: bool = False
    """In tables to read the others by."""

    @property
    def is_trained(self) -> bool:
        """True when an encoder exists only after training."""
        return self.lesson != "nothing"


_METHODS = {
    method.name: method
    for method in (
        Method("rapl", "RAPL", "rankings", "ot"),
        Method("rlhf", "RLHF", "rankings", "scalar"),
        Method("tcc", "TCC (XIRL)", "demonstrations", "goal"),
        Method("tcc_ot", "TCC-OT", "demonstrations", "ot"),
        Method("imagenet", "ImageNet-OT", "nothing", "ot"),
        Method("r3m", "R3M-OT", "nothing", "ot", "r3m_resnet18"),
        Method("mvp", "MVP-OT", "nothing", "ot", "mvp_vit_small"),
        Method("mvp_finetuned", "fine-tuned MVP-OT (LoRA)", "frames", "ot", "mvp_vit_small"),
        Method("mae_scratch", "masked autoencoder from scratch, OT", "frames", "ot", "mae_vit"),
        Method("vip", "VIP-OT", "nothing", "ot", "vip_resnet50"),
        Method("liv", "LIV-OT", "nothing", "ot", "liv_resnet50"),
        Method("dinov2", "DINOv2-OT", "nothing", "ot", "dinov2_vit_small"),
        Method("clock", "clock (frame index)", "nothing", "clock", is_control=True),
        Method("mean_distance", "mean distance (epsilon infinite)", "nothing", "ot",
               is_control=True),
        Method("supervised_probe", "supervised probe (ridge on r*)", "truth", "scalar",
               is_control=True),
    )
}  # fmt: skip


def method_names() -> list[str]:
    """The known methods."""
    return sorted(_METHODS)


def get_method(name: str) -> Method:
    """A method by name.

    :raises UnknownNameError: naming the known ones.
    """
    if name not in _METHODS:
        raise UnknownNameError("method of alignment", name, _METHODS)
    return _METHODS[name]
