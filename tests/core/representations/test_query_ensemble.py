"""The ensemble of representations behind the strategy ``transport``."""

from itertools import permutations

import numpy as np
import pytest
import torch

from rapl_core.preferences.answers import information
from rapl_core.preferences.strategies import make_selector
from rapl_core.preferences.video_features import summarise
from rapl_core.representations import get_preset
from rapl_core.representations.query_ensemble import TransportAnswers, TransportEnsemble
from rapl_core.types import Ranking


def rankings_of(worth: dict[str, float], count: int, rng: np.random.Generator) -> list[Ranking]:
    names, made = sorted(worth), []
    for number in range(count):
        shown = tuple(names[int(i)] for i in rng.choice(len(names), 3, replace=False))
        order = sorted(shown, key=lambda name: -worth[name])
        made.append(Ranking(str(number), "ada", shown, tuple(order.index(n) + 1 for n in shown)))
    return made


def test_the_likeliest_order_is_the_one_by_distance_to_the_experts() -> None:
    places = torch.tensor([0.0, 1.0, 3.0, 0.0])  # the last one is the expert
    z = places.reshape(1, 4, 1, 1).expand(2, 4, 6, 1)  # (K, n, T, D)
    model = TransportAnswers(z, torch.tensor([3]), get_preset("tuned"))
    p = model.orders(np.array([[0, 1, 2], [2, 1, 0]]))
    assert p.shape == (2, 2, 6) and np.allclose(p.sum(-1), 1)
    orders = list(permutations(range(3)))
    assert orders[int(p[0, 0].argmax())] == (0, 1, 2)
    assert orders[int(p[0, 1].argmax())] == (2, 1, 0)
    assert information(p) == pytest.approx([0.0, 0.0], abs=1e-9), "the members are the same"


def test_it_learns_and_chooses_queries_that_nobody_was_asked() -> None:
    rng = np.random.default_rng(0)
    worth = {f"v{i:02d}": float(rng.normal()) for i in range(24)}
    features = {
        name: (np.outer(np.linspace(0.2, 1, 12), [w, -w, 1.0]) + 0.1 * rng.normal(size=(12, 3)))
        .astype(np.float32)
        for name, w in worth.items()
    }  # fmt: skip
    ensemble = TransportEnsemble(features, sorted(features), get_preset("tuned"), rng)
    few = rankings_of(worth, 5, rng)
    assert ensemble(few) is None, "too few to learn from"
    rankings = rankings_of(worth, 30, rng)
    model = ensemble(rankings)
    assert model is not None
    names = sorted(features)
    best, middle, worst = (sorted(names, key=lambda n: -worth[n])[i] for i in (0, 12, 23))
    p = model.orders(np.array([[names.index(n) for n in (worst, best, middle)]])).mean(0)[0]
    assert list(permutations(range(3)))[int(p.argmax())] == (1, 2, 0)

    selector = make_selector("transport", rng, summarise(features), ensemble)
    asked = [ranking.episode_ids for ranking in rankings]
    selector.update(rankings, asked)
    query = selector.next(names, asked)
    assert len(set(query)) == 3 and frozenset(query) not in {frozenset(a) for a in asked}
