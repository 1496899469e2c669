"""Pooling: sizes, known values, and places that are linear in the moments."""

import numpy as np
import pytest
import torch

from rapl_core.errors import ShapeError, UnknownNameError
from rapl_core.representations.pooling import Pool, Pooling


def maps_with_a_peak(row: int, column: int, size: int = 8) -> torch.Tensor:
    maps = torch.zeros(1, 1, size, size)
    maps[0, 0, row, column] = 1.0
    return maps


@pytest.mark.parametrize(
    ("config", "size"),
    [
        (Pooling("gap"), 5),
        (Pooling("grid", grid=3), 45),
        (Pooling("moments"), 15),
        (Pooling("moments", second_moments=True, attention="positive"), 30),
    ],
)
def test_the_vector_has_the_size_that_is_announced(config, size):
    maps = torch.randn(2, 5, 7, 6, generator=torch.Generator().manual_seed(0))
    assert Pool(config)(maps).shape == (2, size)
    assert config.size(5) == size


def test_the_grid_holds_the_means_of_its_cells():
    maps = torch.arange(16.0).reshape(1, 1, 4, 4)
    assert Pool(Pooling("grid", grid=2))(maps).tolist() == [[2.5, 4.5, 10.5, 12.5]]
    assert Pool(Pooling("gap"))(maps).tolist() == [[7.5]]


@pytest.mark.parametrize("attention", ["softmax", "positive"])
def test_the_moments_of_a_peak_are_its_place(attention):
    pool = Pool(Pooling("moments", attention=attention, sharpness=4.0, second_moments=True))
    x, y, _, var_x, var_y, cov = pool(maps_with_a_peak(row=6, column=1))[0].tolist()
    assert x == pytest.approx((2 * 1 + 1) / 8 - 1, abs=1e-3)
    assert y == pytest.approx((2 * 6 + 1) / 8 - 1, abs=1e-3)
    assert [var_x, var_y, cov] == pytest.approx([0.0, 0.0, 0.0], abs=1e-2)


def test_the_place_of_a_moving_peak_is_linear_in_the_moments():
    pool = Pool(Pooling("moments", attention="positive"))
    places = np.array([pool(maps_with_a_peak(3, c))[0, 0].item() for c in range(8)])
    np.testing.assert_allclose(np.diff(places), 0.25, atol=1e-3)


def test_spread_and_slant_are_in_the_second_moments():
    diagonal = torch.eye(8)[None, None]
    pool = Pool(Pooling("moments", attention="positive", second_moments=True))
    x, y, _, var_x, var_y, cov = pool(diagonal)[0].tolist()
    centres = (np.arange(8) * 2 + 1) / 8 - 1
    assert [x, y] == pytest.approx([0, 0], abs=1e-4)
    assert [var_x, var_y, cov] == pytest.approx([np.var(centres)] * 3, rel=1e-3)


@pytest.mark.parametrize("attention", ["softmax", "positive"])
def test_a_flat_map_looks_at_the_centre_and_stays_finite(attention):
    vector = Pool(Pooling("moments", attention=attention))(torch.zeros(1, 2, 5, 5))
    assert vector.tolist() == [pytest.approx([0.0] * 6, abs=1e-6)]


def test_unknown_kinds_are_refused_with_the_known_ones():
    with pytest.raises(UnknownNameError, match="max.*gap, grid, moments"):
        Pooling("max")
    with pytest.raises(UnknownNameError, match="hard.*positive, softmax"):
        Pooling("moments", attention="hard")
    with pytest.raises(ShapeError, match="grid 0"):
        Pooling("grid", grid=0)
