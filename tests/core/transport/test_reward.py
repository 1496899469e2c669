"""The reward against the paper's equation written out, and what must hold of it."""

import subprocess
import sys

import numpy as np
import ot
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from rapl_core.errors import ConvergenceError, ShapeError
from rapl_core.transport import TransportConfig, ot_reward, pairwise_cost
from rapl_core.transport.reward import frame_cost
from rapl_core.types import EmbeddedEpisode

EXACT = TransportConfig(cost="cosine", solver="exact")
CONFIGS = (
    EXACT,
    TransportConfig(epsilon=0.1),
    TransportConfig(cost="euclidean", solver="uniform", expert="mean"),
)


def embed(rng: np.random.Generator, frames: int = 12, width: int = 4) -> np.ndarray:
    return rng.normal(size=(frames, width)).astype(np.float32)


def experts_from(rng: np.random.Generator, lengths=(12, 12, 12)) -> list[EmbeddedEpisode]:
    return [EmbeddedEpisode(f"expert-{i}", embed(rng, n)) for i, n in enumerate(lengths)]


def test_the_reward_is_the_equation_of_the_paper_for_the_closest_expert():
    rng = np.random.default_rng(0)
    z, experts = embed(rng), experts_from(rng, (12, 9, 15))
    by_hand = {}
    for expert in experts:
        cost = cdist(z.astype(float), expert.values.astype(float), "cosine")
        mass = np.full(12, 1 / 12), np.full(len(expert.values), 1 / len(expert.values))
        plan = ot.emd(*mass, cost)
        by_hand[expert.episode_id] = (plan * cost).sum(), -(plan * cost).sum(1)
    closest = min(by_hand, key=lambda name: by_hand[name][0])
    trace = ot_reward(z, experts, EXACT, scale=3.0)
    assert trace.expert_id == closest
    assert trace.transport_cost == pytest.approx(by_hand[closest][0])
    np.testing.assert_allclose(trace.values, 3.0 * 12 * by_hand[closest][1], atol=1e-12)
    assert trace.values.dtype == np.float64 and trace.converged


def test_the_mean_over_experts_of_a_uniform_coupling_is_the_mean_distance_to_all_frames():
    rng = np.random.default_rng(1)
    z, experts = embed(rng), experts_from(rng, (12, 5, 20))
    config = TransportConfig(cost="euclidean", solver="uniform", expert="mean")
    trace = ot_reward(z, experts, config, scale=2.0)
    frames = np.concatenate([e.values for e in experts]).astype(float)
    np.testing.assert_allclose(trace.values, -2.0 * cdist(z.astype(float), frames).mean(1))
    assert trace.expert_id == ""


@pytest.mark.parametrize("config", CONFIGS)
def test_the_total_is_the_length_times_the_transport_cost(config):
    rng = np.random.default_rng(2)
    trace = ot_reward(embed(rng), experts_from(rng), config, scale=0.5)
    assert trace.total == pytest.approx(-0.5 * 12 * trace.transport_cost, rel=1e-5)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**16), kind=st.sampled_from(["cosine", "euclidean"]))
def test_no_video_has_a_greater_reward_than_the_expert_itself(seed, kind):
    rng = np.random.default_rng(seed)
    experts = experts_from(rng, (8,))
    config = TransportConfig(cost=kind, solver="exact")
    own = ot_reward(experts[0].values, experts, config, scale=1.0).total
    other = ot_reward(embed(rng, 8), experts, config, scale=1.0).total
    assert own == pytest.approx(0.0, abs=1e-6)
    assert other < own


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 2**16),
    scale=st.floats(1e-3, 1e3),
    order=st.permutations(range(12)),
    config=st.sampled_from(CONFIGS),
)
def test_the_reward_scales_and_permutes_with_its_frames(seed, scale, order, config):
    rng = np.random.default_rng(seed)
    z, experts = embed(rng), experts_from(rng)
    plain = ot_reward(z, experts, config, scale=1.0)
    changed = ot_reward(z[list(order)], experts, config, scale=scale)
    np.testing.assert_allclose(changed.values, scale * plain.values[list(order)], atol=1e-5 * scale)


def test_a_solver_that_did_not_converge_is_reported_or_raised():
    rng = np.random.default_rng(3)
    z, experts = embed(rng, 30), experts_from(rng, (30,))
    trace = ot_reward(z, experts, TransportConfig(epsilon=1e-3, max_iterations=1), scale=1.0)
    assert not trace.converged and trace.marginal_error > 1e-3 and trace.iterations > 0
    strict = TransportConfig(epsilon=1e-3, max_iterations=1, require_convergence=True)
    with pytest.raises(ConvergenceError):
        ot_reward(z, experts, strict, scale=1.0)


def test_bad_input_is_refused_by_name():
    rng = np.random.default_rng(4)
    z, experts = embed(rng), experts_from(rng)
    broken = z.copy()
    broken[3, 1] = np.nan
    with pytest.raises(ShapeError, match="1 NaN or infinite"):
        ot_reward(broken, experts, EXACT, 1.0)
    with pytest.raises(ShapeError, match="no expert"):
        ot_reward(z, [], EXACT, 1.0)
    with pytest.raises(ShapeError, match=r"expert-0 .*\(12, 4\).*\(S, 3\)"):
        ot_reward(z[:, :3], experts, EXACT, 1.0)
    with pytest.raises(ShapeError, match=r"\(12,\)"):
        ot_reward(z[:, 0], experts, EXACT, 1.0)
    with pytest.raises(ShapeError, match="scale is 0"):
        ot_reward(z, experts, EXACT, 0.0)


@pytest.mark.parametrize("kind", ["cosine", "euclidean", "sqeuclidean"])
def test_the_cost_of_frames_equals_the_one_that_learning_differentiates(kind):
    rng = np.random.default_rng(5)
    x, y = rng.normal(size=(20, 8)), rng.normal(size=(13, 8))
    y[3] = x[7]
    differentiable = pairwise_cost(torch.from_numpy(x), torch.from_numpy(y), kind)
    np.testing.assert_allclose(frame_cost(x, y, kind), differentiable, rtol=1e-9, atol=1e-12)


def test_a_zero_vector_has_the_cosine_cost_one():
    cost = frame_cost(np.zeros((2, 3)), np.ones((4, 3)), "cosine")
    np.testing.assert_array_equal(cost, np.ones((2, 4)))


@pytest.mark.parametrize("solver", ["sinkhorn", "exact", "uniform"])
def test_it_loads_no_torch(solver):
    code = f"""
import sys
import numpy as np
from rapl_core.transport import TransportConfig, ot_reward
from rapl_core.types import EmbeddedEpisode
expert = EmbeddedEpisode("e", np.eye(3, dtype=np.float32))
ot_reward(np.eye(3), [expert], TransportConfig(solver="{solver}"), 1.0)
sys.exit("torch" in sys.modules)
"""
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0
