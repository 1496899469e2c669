"""How much of each object the camera sees, by the simulator's segmentation."""

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco
import numpy as np
from numpy.typing import NDArray

from rapl_core.demonstrators import make_demonstrator
from rapl_core.errors import RaplError
from rapl_core.simulation.simulation import Simulation, episode_rng

HIDDEN = 0.25
"""Of the pixels that an object alone would show; whoever shows fewer counts as hidden."""


def object_bodies(model: mujoco.MjModel) -> dict[str, int]:
    """Return names and ids of the things that lie about: movable bodies that no servo moves.

    :raises RaplError: if a servo acts on something else than a joint or a site.
    """
    bodies_of = {
        int(mujoco.mjtTrn.mjTRN_JOINT): model.jnt_bodyid,
        int(mujoco.mjtTrn.mjTRN_SITE): model.site_bodyid,
    }
    driven: set[int] = set()
    for kind, (target, _) in zip(model.actuator_trntype, model.actuator_trnid, strict=True):
        if int(kind) not in bodies_of:
            raise RaplError(f"a servo acts on {mujoco.mjtTrn(kind).name}, expected joint or site")
        driven.add(int(bodies_of[int(kind)][target]))
    return {
        model.body(body).name: body
        for body in range(1, model.nbody)
        if model.body_parentid[body] == 0
        and model.body_jntnum[body] > 0
        and not any(model.body_rootid[d] == body for d in driven)
    }


def seen_shares(simulation: Simulation, world: int = 0) -> dict[str, float]:
    """Return of each object the share of its pixels that nothing stands before.

    An object outside the picture has none to show: 0.
    """
    model, data, renderer = simulation.model, simulation.data[world], simulation.renderer
    seen = renderer.segment(data)  # (H, W)
    shares = {}
    for name, body in object_bodies(model).items():
        first = model.body_geomadr[body]
        own = np.arange(first, first + model.body_geomnum[body])
        with _alone(model, own):
            alone = int(np.isin(renderer.segment(data), own).sum())
        shares[name] = float(np.isin(seen, own).sum()) / alone if alone else 0.0
    return shares


def cut_objects(simulation: Simulation, world: int = 0) -> set[str]:
    """Return the objects that the picture's edge cuts, or that are outside of it."""
    seen = simulation.renderer.segment(simulation.data[world])  # (H, W)
    border = {*seen[0], *seen[-1], *seen[:, 0], *seen[:, -1]}
    model, cut = simulation.model, set()
    for name, body in object_bodies(model).items():
        first = model.body_geomadr[body]
        own = set(range(first, first + model.body_geomnum[body]))
        if own & border or not own & set(seen.ravel().tolist()):
            cut.add(name)
    return cut


@contextmanager
def _alone(model: mujoco.MjModel, geoms: NDArray[np.int64]) -> Iterator[None]:
    """Draw nothing but these geoms."""
    groups = model.geom_group.copy()
    model.geom_group[:] = mujoco.mjNGROUP - 1  # which no renderer draws by default
    model.geom_group[geoms] = 0
    try:
        yield
    finally:
        model.geom_group[:] = groups


def hidden_shares(shares: list[dict[str, float]]) -> dict[str, float]:
    """Return of each object in which share of the instants it was hidden.

    :param shares: what :func:`seen_shares` gave at instants of an episode.
    """
    return {name: float(np.mean([s[name] < HIDDEN for s in shares])) for name in shares[0]}


def hidden_in_episode(
    simulation: Simulation, behaviour: str, number: int, noise: float = 0.0, every: int = 6
) -> dict[str, float]:
    """Play a scripted episode and return of each object in which share of it it was hidden.

    :param number: of the episode: its start and what the demonstrator draws follow from it.
    :param noise: standard deviation of the action's noise.
    :param every: steps between two looks.
    """
    rng = np.random.default_rng(number)
    demonstrator = make_demonstrator(simulation.task, behaviour, rng, noise)
    snapshot = simulation.reset(0, episode_rng(0, "demonstrate", 0, number))
    looks = [seen_shares(simulation)]
    while not snapshot.is_last:
        snapshot = simulation.step(0, demonstrator.act(snapshot.state, snapshot.step))
        if snapshot.step % every == 0:
            looks.append(seen_shares(simulation))
    return hidden_shares(looks)
