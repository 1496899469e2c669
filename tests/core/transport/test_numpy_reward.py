"""The reward in numpy against the one in torch, of which it is a second form."""

import subprocess
import sys

import numpy as np
import pytest

from rapl_core.errors import ConvergenceError, ShapeError
from rapl_core.transport import TransportConfig, numpy_reward, ot_reward
from rapl_core.types import EmbeddedEpisode

CONFIGS = [
    TransportConfig(cost=cost, solver=solver, epsilon=epsilon, expert=expert)
    for cost in ("cosine", "euclidean", "sqeuclidean")
    for solver, epsilon in (("sinkhorn", 0.01), ("sinkhorn", 1.0), ("exact", 1.0), ("uniform", 1.0))
    for expert in ("closest", "mean")
]


def video(rng: np.random.Generator, frames: int, name: str) -> EmbeddedEpisode:
    steps = rng.normal(size=(frames, 8)).cumsum(0) * 0.3
    return EmbeddedEpisode(name, steps.astype(np.float32))


@pytest.mark.parametrize(
    "config", CONFIGS, ids=lambda c: f"{c.cost}-{c.solver}-{c.epsilon}-{c.expert}"
)
@pytest.mark.parametrize("lengths", [(20, 20, 20), (20, 13, 31)], ids=["equal", "mixed"])
def test_it_equals_the_torch_form(config: TransportConfig, lengths: tuple[int, ...]) -> None:
    rng = np.random.default_rng(3)
    experts = [video(rng, n, f"expert{i}") for i, n in enumerate(lengths)]
    z = video(rng, 20, "z").values
    ours = numpy_reward.ot_reward(z, experts, config, scale=3.0)
    theirs = ot_reward(z, experts, config, scale=3.0)
    np.testing.assert_allclose(ours.values, theirs.values, rtol=1e-6, atol=1e-12)
    assert ours.expert_id == theirs.expert_id
    assert ours.transport_cost == pytest.approx(theirs.transport_cost, rel=1e-6)
    assert (ours.converged, ours.iterations) == (theirs.converged, theirs.iterations)
    assert ours.scale == 3.0


def test_a_video_that_is_an_expert_earns_the_greatest_reward() -> None:
    rng = np.random.default_rng(5)
    experts = [video(rng, 15, "a"), video(rng, 15, "b")]
    config = TransportConfig(cost="euclidean", solver="exact")
    same = numpy_reward.ot_reward(experts[1].values, experts, config, 1.0)
    assert same.expert_id == "b"
    assert same.total == pytest.approx(0.0, abs=1e-9)
    assert numpy_reward.ot_reward(video(rng, 15, "c").values, experts, config, 1.0).total < -1.0


def test_a_zero_vector_has_the_cosine_cost_one() -> None:
    cost = numpy_reward.pairwise_cost(np.zeros((2, 3)), np.ones((4, 3)), "cosine")
    np.testing.assert_array_equal(cost, np.ones((2, 4)))


def test_bad_input_is_named() -> None:
    rng = np.random.default_rng(6)
    expert = video(rng, 5, "only")
    with pytest.raises(ShapeError, match="NaN"):
        numpy_reward.ot_reward(np.full((4, 8), np.nan), [expert], TransportConfig(), 1.0)
    with pytest.raises(ShapeError, match=r"only.*expected \(S, 7\)"):
        numpy_reward.ot_reward(np.zeros((4, 7)), [expert], TransportConfig(), 1.0)
    with pytest.raises(ShapeError, match="no expert"):
        numpy_reward.ot_reward(np.zeros((4, 8)), [], TransportConfig(), 1.0)


def test_no_convergence_is_an_error_where_it_was_asked_for() -> None:
    rng = np.random.default_rng(7)
    config = TransportConfig(
        cost="sqeuclidean", epsilon=1e-3, max_iterations=10, require_convergence=True
    )
    with pytest.raises(ConvergenceError, match="raise epsilon"):
        numpy_reward.ot_reward(video(rng, 9, "z").values, [video(rng, 9, "e")], config, 1.0)


@pytest.mark.parametrize("solver", ["sinkhorn", "exact", "uniform"])
def test_it_loads_no_torch(solver: str) -> None:
    code = f"""
import sys
import numpy as np
from rapl_core.transport.config import TransportConfig
from rapl_core.transport.numpy_reward import ot_reward
from rapl_core.types import EmbeddedEpisode
expert = EmbeddedEpisode("e", np.eye(3, dtype=np.float32))
ot_reward(np.eye(3), [expert], TransportConfig(solver="{solver}"), 1.0)
sys.exit("torch" in sys.modules)
"""
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0
