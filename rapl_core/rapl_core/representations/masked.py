"""Masked autoencoding (He et al. 2022) on a task's own frames: from scratch, and by LoRA.

Most patches of a picture are hidden; an encoder sees the others, a small decoder paints the hidden
ones. The encoder is the backbone of the methods ``mae_scratch`` and ``mvp_finetuned``.
"""

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import timm
import torch
from numpy.typing import NDArray
from timm.models.vision_transformer import Block
from torch import nn

from rapl_core.errors import ConvergenceError, ShapeError, WeightsError
from rapl_core.representations.alignment import OnEpoch
from rapl_core.representations.backbone_spec import BackboneSpec
from rapl_core.representations.preprocessing import Preprocessing, preprocess
from rapl_core.representations.training import EpochProgress

_STEADY = 1e-6
_WARM_UP = 0.1
_REPORTS = 20
_FEWEST_FRAMES = 8


@dataclass(frozen=True)
class MaskedConfig:
    """Masking, decoder and training; the defaults are MAE's where it names them."""

    hidden: float = 0.75
    """Share of the patches that is hidden."""
    has_normalised_patches: bool = True
    """Paint each patch relative to its own mean and deviation."""
    decoder_width: int = 64
    decoder_depth: int = 2
    batch_size: int = 32
    iterations: int = 1500
    learning_rate: float = 1e-3
    """At its height; it rises over the first tenth and then falls as a cosine."""
    weight_decay: float = 0.05
    held_out: float = 0.1
    """Share of the frames on which the loss is watched."""
    lora_rank: int = 8
    lora_alpha: int = 16

    def __post_init__(self) -> None:
        if not 0 < self.hidden < 1 or not 0 < self.held_out < 1:
            raise ShapeError(
                f"masking hides {self.hidden} and holds out {self.held_out}, expected within (0, 1)"
            )
        for name in ("decoder_width", "decoder_depth", "batch_size", "iterations", "lora_rank"):
            if getattr(self, name) < 1:
                raise ShapeError(
                    f"MaskedConfig.{name} is {getattr(self, name)}, expected 1 or more"
                )


@dataclass(frozen=True)
class MaskedFit:
    """A trained encoder and how its loss on held-out frames went."""

    network: Any
    """timm's network with its new weights."""
    held_out_losses: tuple[float, ...]
    """Before training, then at even steps; always of the same frames and masks."""

    def to_json(self) -> dict[str, Any]:
        """For a report."""
        return {"held_out_losses": list(self.held_out_losses)}


class MaskedAutoencoder(nn.Module):
    """A transformer of timm as encoder, and a decoder that is thrown away after training."""

    def __init__(self, network: Any, config: MaskedConfig) -> None:
        super().__init__()
        self.network = network
        self.config = config
        self.patch = int(network.patch_embed.patch_size[0])
        width, inner = int(network.embed_dim), config.decoder_width
        self.enter = nn.Linear(width, inner)
        self.mask_token = nn.Parameter(torch.randn(1, 1, inner) * 0.02)
        cells = int(network.patch_embed.num_patches)
        self.register_buffer("places", _places(math.isqrt(cells), inner), persistent=False)
        self.blocks = nn.ModuleList(
            Block(inner, num_heads=max(1, inner // 32)) for _ in range(config.decoder_depth)
        )
        self.norm = nn.LayerNorm(inner)
        self.paint = nn.Linear(inner, self.patch**2 * 3)

    def forward(self, x: torch.Tensor, keys: torch.Tensor) -> torch.Tensor:
        """Mean squared error on the hidden patches, a scalar.

        :param x: (N, 3, H, W) of the size that the network was made for.
        :param keys: (N, L) random numbers; the patches with the largest are hidden.
        """
        seen = max(1, round(keys.shape[1] * (1 - self.config.hidden)))
        order = keys.argsort(1)
        shown, hidden = order[:, :seen], order[:, seen:]
        painted = self._decode(self._encode(x, shown), order)  # (N, L, P)
        target = self._patches(x)
        pick = hidden[..., None].expand(-1, -1, target.shape[-1])
        return (painted.gather(1, pick) - target.gather(1, pick)).square().mean()

    def _encode(self, x: torch.Tensor, shown: torch.Tensor) -> torch.Tensor:
        """(N, 1 + seen, W) with the class token first."""
        network = self.network
        tokens = network._pos_embed(network.patch_embed(x))  # (N, 1 + L, W)
        first = tokens[:, : network.num_prefix_tokens]
        patches = tokens[:, network.num_prefix_tokens :]
        kept = patches.gather(1, shown[..., None].expand(-1, -1, patches.shape[-1]))
        tokens = network.norm_pre(torch.cat([first, kept], dim=1))
        for block in network.blocks:
            tokens = block(tokens)
        encoded: torch.Tensor = network.norm(tokens)
        return encoded[:, network.num_prefix_tokens :]

    def _decode(self, encoded: torch.Tensor, order: torch.Tensor) -> torch.Tensor:
        """(N, seen, W) -> (N, L, P) in the picture's own order."""
        tokens = self.enter(encoded)
        masks = self.mask_token.expand(len(tokens), order.shape[1] - tokens.shape[1], -1)
        back = order.argsort(1)[..., None].expand(-1, -1, tokens.shape[-1])
        tokens = torch.cat([tokens, masks], dim=1).gather(1, back) + self.get_buffer("places")
        for block in self.blocks:
            tokens = block(tokens)
        painted: torch.Tensor = self.paint(self.norm(tokens))
        return painted

    def _patches(self, x: torch.Tensor) -> torch.Tensor:
        """(N, 3, H, W) -> (N, L, P) pixels of each patch, row by row."""
        size = self.patch
        cut = x.unfold(2, size, size).unfold(3, size, size)  # (N, 3, h, w, p, p)
        flat = cut.permute(0, 2, 3, 4, 5, 1).flatten(3).flatten(1, 2)
        if not self.config.has_normalised_patches:
            return flat
        mean, variance = flat.mean(-1, keepdim=True), flat.var(-1, keepdim=True)
        return (flat - mean) / (variance + _STEADY).sqrt()


def pretrain(
    frames: NDArray[np.uint8],
    spec: BackboneSpec,
    config: MaskedConfig,
    rng: np.random.Generator,
    on_epoch: OnEpoch | None = None,
) -> MaskedFit:
    """Train a transformer from scratch to paint hidden patches of a task's frames.

    :param frames: (N, H, W, 3) uint8.
    :raises ShapeError: for fewer than eight frames.
    :raises ConvergenceError: if the loss becomes NaN or infinite.
    """
    network = _new_network(spec, rng)
    network.requires_grad_(True)
    return _train(network, frames, spec.preprocessing, config, rng, on_epoch, lambda n: n)


def fine_tune_lora(
    network: Any,
    frames: NDArray[np.uint8],
    preprocessing: Preprocessing,
    config: MaskedConfig,
    rng: np.random.Generator,
    on_epoch: OnEpoch | None = None,
) -> MaskedFit:
    """Adapt a trained transformer to a task's frames by low-rank updates (Hu et al. 2021).

    The given network stays as it is. Rank-r updates of each attention layer's queries, keys and
    values learn together with a new decoder; in the result they are added to the weights.

    :param network: timm's transformer.
    :raises WeightsError: if it has no attention layers to adapt.
    """

    def with_updates(base: Any) -> Any:
        return lora_model(base, config, rng)

    fit = _train(copy.deepcopy(network), frames, preprocessing, config, rng, on_epoch, with_updates)
    return MaskedFit(fit.network.merge_and_unload(), fit.held_out_losses)


def lora_model(network: Any, config: MaskedConfig, rng: np.random.Generator) -> Any:
    """``peft``'s model around a transformer: only its low-rank updates take gradients.

    :raises WeightsError: if the network has no attention layers to adapt.
    """
    from peft import LoraConfig, get_peft_model  # seconds to import

    if not any(name.endswith("attn.qkv") for name, _ in network.named_modules()):
        raise WeightsError("LoRA adapts attention layers named 'attn.qkv'; this network has none")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(rng.integers(2**31)))
        return get_peft_model(
            network,
            LoraConfig(
                r=config.lora_rank,
                lora_alpha=config.lora_alpha,
                target_modules=["attn.qkv"],
                lora_dropout=0.0,
                bias="none",
            ),
        )


def _new_network(spec: BackboneSpec, rng: np.random.Generator) -> Any:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(rng.integers(2**31)))
        return timm.create_model(spec.architecture, pretrained=False, **spec.options)


def _train(
    network: Any,
    frames: NDArray[np.uint8],
    preprocessing: Preprocessing,
    config: MaskedConfig,
    rng: np.random.Generator,
    on_epoch: OnEpoch | None,
    wrap: Callable[[Any], Any],
) -> MaskedFit:
    """:param wrap: makes the network that trains of the one given."""
    if len(frames) < _FEWEST_FRAMES:
        raise ShapeError(f"masked autoencoding on {len(frames)} frames, expected 8 or more")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(rng.integers(2**31)))
        model = MaskedAutoencoder(network, config)
    trained = wrap(network)
    order = rng.permutation(len(frames))
    held = order[: min(256, max(1, round(config.held_out * len(frames))))]
    rest = order[len(held) :]
    cells = int(network.patch_embed.num_patches)
    held_x = preprocess(frames[np.sort(held)], preprocessing)
    held_keys = torch.from_numpy(rng.random((len(held), cells)))
    free = [p for p in model.parameters() if p.requires_grad]
    optimiser = torch.optim.AdamW(
        free, lr=config.learning_rate, betas=(0.9, 0.95), weight_decay=config.weight_decay
    )
    schedule = torch.optim.lr_scheduler.LambdaLR(optimiser, _warm_cosine(config.iterations))
    losses = [_held_out(model, held_x, held_keys, config.batch_size)]
    chunk = max(1, config.iterations // _REPORTS)
    for iteration in range(1, config.iterations + 1):
        rows = rng.choice(rest, min(config.batch_size, len(rest)), replace=False)
        keys = torch.from_numpy(rng.random((len(rows), cells)))
        loss = model(preprocess(frames[rows], preprocessing), keys)
        if not bool(torch.isfinite(loss)):
            raise ConvergenceError(
                f"the masked loss became {float(loss.detach())} in iteration {iteration}; lower "
                f"learning_rate ({config.learning_rate})"
            )
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        if iteration % chunk == 0 or iteration == config.iterations:
            losses.append(_held_out(model, held_x, held_keys, config.batch_size))
            if on_epoch:
                on_epoch(
                    EpochProgress(
                        iteration, config.iterations, float(loss.detach()), losses[-1], math.nan
                    )
                )
    return MaskedFit(trained.eval(), tuple(losses))


def _held_out(
    model: MaskedAutoencoder, x: torch.Tensor, keys: torch.Tensor, batch_size: int
) -> float:
    total = 0.0
    with torch.no_grad():
        for start in range(0, len(x), batch_size):
            part = slice(start, start + batch_size)
            total += float(model(x[part], keys[part])) * len(x[part])
    return total / len(x)


def _warm_cosine(iterations: int) -> Callable[[int], float]:
    warm = max(1, round(_WARM_UP * iterations))

    def factor(step: int) -> float:
        if step < warm:
            return (step + 1) / warm
        return 0.5 * (1 + math.cos(math.pi * (step - warm) / max(1, iterations - warm)))

    return factor


def _places(side: int, width: int) -> torch.Tensor:
    """(1, side^2, width) fixed sines and cosines of row and column."""
    quarter = max(1, width // 4)
    frequencies = 1.0 / 10000 ** (torch.arange(quarter) / quarter)
    angles = torch.arange(side)[:, None] * frequencies  # (side, width / 4)
    line = torch.cat([angles.sin(), angles.cos()], dim=1)
    rows = line[:, None].expand(-1, side, -1)
    columns = line[None].expand(side, -1, -1)
    grid = torch.cat([rows, columns], dim=-1).flatten(0, 1)
    return torch.nn.functional.pad(grid, (0, width - grid.shape[1]))[None]
