"""Layers of a network run forwards and backwards by hand, in memory that is kept.

Half of a small network's time on a CPU is not matrix products but the bookkeeping of automatic
differentiation and fresh memory for each result. Both are absent here.
"""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from rapl_core.errors import ShapeError


class DenseStack:
    """Linear layers, each followed by ReLU but, if ``linear_end``, the last.

    Works on the parameters of the layers given and writes to their ``grad``. What it returns is
    overwritten by its next call.
    """

    def __init__(self, layers: Sequence[nn.Linear], linear_end: bool) -> None:
        self._layers = tuple(layers)
        self._rectified = [True] * len(layers)
        self._rectified[-1] = not linear_end
        self._results: list[Tensor] = []
        self._gradients: list[Tensor] = []
        for layer in layers:
            layer.weight.grad = torch.zeros_like(layer.weight)
            layer.bias.grad = torch.zeros_like(layer.bias)

    @torch.no_grad()
    def forward(self, inputs: Tensor) -> Tensor:
        """Return the outputs (B, out) of inputs (B, in)."""
        self._reserve(len(inputs))
        self._inputs = values = inputs
        for layer, result, rectified in zip(
            self._layers, self._results, self._rectified, strict=True
        ):
            torch.addmm(layer.bias, values, layer.weight.t(), out=result)
            values = result.relu_() if rectified else result
        return values

    @torch.no_grad()
    def backward(self, gradient: Tensor, weights: bool, first_input: int | None) -> Tensor | None:
        """Propagate the gradient of a loss by the outputs of the last :meth:`forward`.

        :param gradient: (B, out); overwritten where the last layer is rectified.
        :param weights: write the gradients of the layers' weights.
        :param first_input: return the gradient by the inputs from this one on, (B, in - first);
            None: not needed.
        """
        for number in range(len(self._layers) - 1, -1, -1):
            layer, result = self._layers[number], self._results[number]
            if self._rectified[number]:
                torch.ops.aten.threshold_backward.grad_input(
                    gradient, result, 0.0, grad_input=gradient
                )
            if weights:
                values = self._results[number - 1] if number else self._inputs
                assert layer.weight.grad is not None and layer.bias.grad is not None
                torch.mm(gradient.t(), values, out=layer.weight.grad)
                torch.sum(gradient, 0, out=layer.bias.grad)
            if number:
                gradient = torch.mm(gradient, layer.weight, out=self._gradients[number - 1])
        if first_input is None:
            return None
        return gradient @ self._layers[0].weight[:, first_input:]

    def _reserve(self, batch: int) -> None:
        if self._results and len(self._results[0]) == batch:
            return
        self._results = [torch.empty(batch, layer.out_features) for layer in self._layers]
        self._gradients = [torch.empty(batch, layer.out_features) for layer in self._layers[:-1]]


def linear_layers(network: nn.Module) -> list[nn.Linear]:
    """Return the linear layers of a sequence of such and ReLUs.

    :raises ShapeError: if there is anything else in it.
    """
    modules = list(network.children())
    for module in modules:
        if not isinstance(module, nn.Linear | nn.ReLU):
            raise ShapeError(f"a network has a {type(module).__name__}, expected Linear and ReLU")
    return [module for module in modules if isinstance(module, nn.Linear)]
