"""Layers of a network run forwards and backwards by hand.

Automatic differentiation costs a small network on a CPU nearly as much as its arithmetic, and
torch's own matrix products go through MKL, which is half as quick as oneDNN on AMD's processors
(256 x 256 x 256 in float32: 0.32 ms against 0.17 ms).
"""

from collections.abc import Callable, Sequence

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


class DenseStack:
    """Linear layers, each followed by ReLU but, if ``linear_end``, the last.

    Works on the parameters of the layers given and writes to their ``grad``.
    """

    def __init__(
        self, layers: Sequence[nn.Linear], linear_end: bool, product: Product | None = None
    ) -> None:
        self._layers = tuple(layers)
        self._rectified = [True] * len(layers)
        self._rectified[-1] = not linear_end
        self._values: list[Tensor] = []
        self._product = product or best_product()

    @torch.no_grad()
    def forward(self, inputs: Tensor) -> Tensor:
        """Return the outputs (B, out) of inputs (B, in)."""
        self._values = [inputs]
        for layer, rectified in zip(self._layers, self._rectified, strict=True):
            self._values.append(
                self._product(self._values[-1], layer.weight, layer.bias, rectified)
            )
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
            layer, values = self._layers[number], self._values[number]
            if self._rectified[number]:
                result = self._values[number + 1]
                gradient = torch.ops.aten.threshold_backward(gradient, result, 0.0)
            if weights:
                layer.weight.grad = self._product(gradient.t(), values.t(), None, False)
                layer.bias.grad = gradient.sum(0)
            if number:
                gradient = self._product(gradient, layer.weight.t(), None, False)
        if first_input is None:
            return None
        return gradient @ self._layers[0].weight[:, first_input:]


def linear_layers(network: nn.Module) -> list[nn.Linear]:
    """Return the linear layers of a sequence of such and ReLUs.

    :raises ShapeError: if there is anything else in it.
    """
    modules = list(network.children())
    for module in modules:
        if not isinstance(module, nn.Linear | nn.ReLU):
            raise ShapeError(f"a network has a {type(module).__name__}, expected Linear and ReLU")
    return [module for module in modules if isinstance(module, nn.Linear)]
