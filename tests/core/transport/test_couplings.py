"""Problems one after another, of any size; the solvers' own tests are in test_solvers."""

import numpy as np
import pytest

from rapl_core.errors import ConvergenceError
from rapl_core.transport import TransportConfig
from rapl_core.transport.couplings import couple, marginal_error


def costs(*sizes: tuple[int, int]) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [rng.uniform(size=size) for size in sizes]


def test_each_problem_keeps_its_size_and_what_its_frames_pay_adds_up():
    for coupling, size in zip(
        couple(costs((5, 9), (7, 2)), TransportConfig(epsilon=0.1)), [(5, 9), (7, 2)], strict=True
    ):
        assert coupling.plan.shape == size and coupling.per_frame.shape == size[:1]
        assert coupling.per_frame.sum() == pytest.approx(coupling.total)
        assert coupling.marginal_error == marginal_error(coupling.plan) <= 1e-6


def test_the_error_counts_those_that_did_not_converge():
    easy, hard = np.zeros((4, 4)), costs((30, 30))[0]
    config = TransportConfig(epsilon=1e-3, max_iterations=10, require_convergence=True)
    with pytest.raises(ConvergenceError, match="1 of 2 problems.*raise epsilon"):
        couple([easy, hard], config)
