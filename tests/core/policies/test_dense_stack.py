"""Layers run by hand give what automatic differentiation gives."""

import pytest
import torch
from torch import nn

from rapl_core.errors import ShapeError
from rapl_core.policies.dense_stack import (
    DenseStack,
    Product,
    best_product,
    dense_layers,
    onednn_product,
    torch_product,
)

products = pytest.mark.parametrize("product", [torch_product, best_product()])


def network(linear_end: bool, sizes: tuple[int, ...], norm: bool = False) -> nn.Sequential:
    torch.manual_seed(0)
    layers: list[nn.Module] = []
    for size_in, size_out in zip(sizes, sizes[1:], strict=False):
        layers.append(nn.Linear(size_in, size_out))
        if norm:
            layers.append(nn.LayerNorm(size_out))
            nn.init.normal_(layers[-1].weight)
            nn.init.normal_(layers[-1].bias)
        layers.append(nn.ReLU())
    return nn.Sequential(*(layers[:-1] if linear_end else layers))


@products
@pytest.mark.parametrize("linear_end", [True, False])
@pytest.mark.parametrize("norm", [True, False])
@pytest.mark.parametrize("sizes", [(7, 2), (20, 64, 2), (34, 48, 32, 3)])
def test_outputs_and_gradients_equal_those_of_autograd(
    product: Product, linear_end: bool, norm: bool, sizes: tuple[int, ...]
) -> None:
    net = network(linear_end, sizes, norm)
    x = torch.randn(40, sizes[0], requires_grad=True)
    seed = torch.randn(40, sizes[-1])
    expected = net(x)
    gradients = torch.autograd.grad(expected, [x, *net.parameters()], seed)
    stack = DenseStack(dense_layers(net), linear_end, product)
    torch.testing.assert_close(stack.forward(x.detach()), expected.detach())
    by_input = stack.backward(seed, weights=True, first_input=3)
    torch.testing.assert_close(by_input, gradients[0][:, 3:])
    for parameter, gradient in zip(net.parameters(), gradients[1:], strict=True):
        torch.testing.assert_close(parameter.grad, gradient)


def test_without_weights_their_gradients_stay_as_they_were() -> None:
    net = network(True, (20, 32, 1))
    stack = DenseStack(dense_layers(net), linear_end=True)
    stack.forward(torch.randn(8, 20))
    assert stack.backward(torch.ones(8, 1), weights=False, first_input=None) is None
    assert all(parameter.grad is None for parameter in net.parameters())


def test_onednn_is_used_where_torch_has_it() -> None:
    assert torch.backends.mkldnn.is_available() == (best_product() is onednn_product)


def test_a_network_of_other_layers_is_refused() -> None:
    with pytest.raises(ShapeError, match="has a Tanh, expected Linear, LayerNorm and ReLU"):
        dense_layers(nn.Sequential(nn.Linear(2, 2), nn.Tanh()))
