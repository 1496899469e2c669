"""Videos whose worth is linear in what is seen of them, for tests of models and strategies."""

import numpy as np
from numpy.typing import NDArray

from rapl_core.preferences import SimulatedHuman, UniformQueries
from rapl_core.types import Ranking

Features = dict[str, NDArray[np.float32]]
Returns = dict[str, float]


def made_videos(count: int, rng: np.random.Generator, width: int = 12) -> tuple[Features, Returns]:
    """(T, F) features by id, and what each video is worth."""
    wish = rng.normal(size=width)
    features, returns = {}, {}
    for number in range(count):
        place = rng.normal(size=width) * np.linspace(1.5, 0.3, width)
        name = f"v{number:03d}"
        features[name] = (place + 0.05 * rng.normal(size=(8, width))).astype(np.float32)
        returns[name] = float(place @ wish)
    return features, returns


def asked(
    returns: Returns,
    count: int,
    rng: np.random.Generator,
    annotator: str = "ada",
    human: SimulatedHuman | None = None,
) -> list[Ranking]:
    """Answers to uniform queries."""
    queries, human = UniformQueries(rng), human or SimulatedHuman(rng)
    shown: list[tuple[str, ...]] = []
    rankings = []
    for number in range(count):
        shown.append(queries.next(list(returns), shown))
        ranks = human.rank([returns[name] for name in shown[-1]])
        rankings.append(Ranking(f"{annotator}-{number}", annotator, shown[-1], ranks))
    return rankings
