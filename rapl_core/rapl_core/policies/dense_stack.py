"""Layers of a network run forwards and backwards by hand.

Automatic differentiation costs a small network on a CPU nearly as much as its arithmetic, and
torch's own matrix products go through MKL, which is half as quick as oneDNN on AMD's processors
(256 x 256 x 256 in float32: 0.32 ms against 0.17 ms).
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from rapl_core.errors import ShapeError

_WIDE = 16
"""Products narrower than this do not repay oneDNN's preparations."""

Product = Callable[[Tensor, Tensor, Tensor | None, bool], Tensor]
"""x (B, in), w (out, in), bias (out,), whether to rectify -> (B, out)."""


def torch_product(x: Tensor, w: Tensor, bias: Tensor | None, rectify: bool) -> Tensor:
    """x w^T + bias by torch's default library."""
    result = x @ w.t() if bias is None else torch.addmm(bias, x, w.t())
    return result.relu_() if rectify else result


def onednn_product(x: Tensor, w: Tensor, bias: Tensor | None, rectify: bool) -> Tensor:
    """x w^T + bias by oneDNN."""
    if min(*x.shape, *w.shape) < _WIDE:
        return torch_product(x, w, bias, rectify)
    result: Tensor = torch.ops.mkldnn._linear_pointwise(
        x, w, bias, "relu" if rectify else "none", [], ""
    )
    return result


def best_product() -> Product:
    """oneDNN where torch has it, else torch's default; equal up to rounding."""
    has_onednn = torch.backends.mkldnn.is_available() and hasattr(  # type: ignore[no-untyped-call]
        torch.ops.mkldnn, "_linear_pointwise"
    )
    return onednn_product if has_onednn else torch_product


class DenseLayer(NamedTuple):
    """A linear layer and what normalises its outputs."""

    linear: nn.Linear
    norm: nn.LayerNorm | None = None


class _Normalised(NamedTuple):
    """What a layer normalisation's gradient needs of its forward run."""

    inputs: Tensor
    """(B, out)."""
    mean: Tensor
    """(B, 1)."""
    inverse_deviation: Tensor
    """(B, 1)."""


class DenseStack:
    """Linear layers, normalised where they have a norm, each followed by ReLU but, if
    ``linear_end``, the last.

    Works on the parameters of the layers given and writes to their ``grad``.
    """

    def __init__(
        self, layers: Sequence[DenseLayer], linear_end: bool, product: Product | None = None
    ) -> None:
        self._layers = tuple(layers)
        self._rectified = [True] * len(layers)
        self._rectified[-1] = not linear_end
        self._values: list[Tensor] = []
        self._normalised: list[_Normalised | None] = []
        self._product = product or best_product()

    @torch.no_grad()
    def forward(self, inputs: Tensor) -> Tensor:
        """Return the outputs (B, out) of inputs (B, in)."""
        self._values, self._normalised = [inputs], []
        for (linear, norm), rectified in zip(self._layers, self._rectified, strict=True):
            at_once = rectified and norm is None
            result = self._product(self._values[-1], linear.weight, linear.bias, at_once)
            kept = None
            if norm is not None:
                kept, result = _normalise(norm, result)
                if rectified:
                    result = result.relu_()
            self._normalised.append(kept)
            self._values.append(result)
        return self._values[-1]

    @torch.no_grad()
    def backward(self, gradient: Tensor, weights: bool, first_input: int | None) -> Tensor | None:
        """Propagate the gradient of a loss by the outputs of the last :meth:`forward`.

        :param gradient: (B, out).
        :param weights: set the gradients of the layers' weights.
        :param first_input: return the gradient by the inputs from this one on, (B, in - first);
            None: not needed.
        """
        for number in range(len(self._layers) - 1, -1, -1):
            (linear, norm), values = self._layers[number], self._values[number]
            if self._rectified[number]:
                result = self._values[number + 1]
                gradient = torch.ops.aten.threshold_backward(gradient, result, 0.0)
            kept = self._normalised[number]
            if norm is not None and kept is not None:
                gradient = _normalise_backward(norm, kept, gradient, weights)
            if weights:
                linear.weight.grad = self._product(gradient.t(), values.t(), None, False)
                linear.bias.grad = gradient.sum(0)
            if number:
                gradient = self._product(gradient, linear.weight.t(), None, False)
        if first_input is None:
            return None
        return gradient @ self._layers[0].linear.weight[:, first_input:]


def _normalise(norm: nn.LayerNorm, inputs: Tensor) -> tuple[_Normalised, Tensor]:
    outputs, mean, inverse_deviation = torch.ops.aten.native_layer_norm(
        inputs, norm.normalized_shape, norm.weight, norm.bias, norm.eps
    )
    return _Normalised(inputs, mean, inverse_deviation), outputs


def _normalise_backward(
    norm: nn.LayerNorm, kept: _Normalised, gradient: Tensor, weights: bool
) -> Tensor:
    """The gradient by the inputs (B, out); with ``weights``, those of the norm are set."""
    by_input, by_weight, by_bias = torch.ops.aten.native_layer_norm_backward(
        gradient, kept.inputs, norm.normalized_shape, kept.mean, kept.inverse_deviation,
        norm.weight, norm.bias, [True, weights, weights],
    )  # fmt: skip
    if weights:
        norm.weight.grad, norm.bias.grad = by_weight, by_bias
    result: Tensor = by_input
    return result


def dense_layers(network: nn.Module) -> list[DenseLayer]:
    """Return the layers of a sequence of Linear, LayerNorm behind one, and ReLU.

    :raises ShapeError: if there is anything else in it.
    """
    layers: list[DenseLayer] = []
    for module in network.children():
        if isinstance(module, nn.Linear):
            layers.append(DenseLayer(module))
        elif isinstance(module, nn.LayerNorm) and layers:
            layers[-1] = layers[-1]._replace(norm=module)
        elif not isinstance(module, nn.ReLU):
            raise ShapeError(
                f"a network has a {type(module).__name__}, expected Linear, LayerNorm and ReLU"
            )
    return layers
