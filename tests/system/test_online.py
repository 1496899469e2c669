"""Alignment while the robot learns, on the real graph, in miniature; also with a node killed."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest
from graph_run import TINY, GraphRun

from rapl_core.analysis.online import OnlineAlignment, read_online
from rapl_core.episodes import EpisodeStore
from rapl_core.policies import CheckpointFolder, read_checkpoint
from rapl_core.preferences import RankingStore
from rapl_core.representations import make_encoder

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]

STEPS = 3000
"""After the swap, which a killed node delays, rounds must follow in which the buffer is rewarded
again."""
DEADLINE_S = 900.0
ONE_ROUND = [
    *("--triplets", "18"),
    *("--online-triplets", "6"),
    *("--steps", str(STEPS)),
    *("--online", "1"),
]


def check_buffer(folder: Path) -> tuple[int, str]:
    """Every reward in the newest checkpoint is rapl_core's, by the version that it names.

    Returns how many episodes there are, and that version.
    """
    newest = CheckpointFolder(folder / "policies").latest()
    assert newest is not None
    parts = read_checkpoint(newest)
    version = parts["labels"].values["replay"]["version"]
    encoder = make_encoder(f"rapl-{version}", folder)
    store = EpisodeStore(folder / "episodes")
    experts = [encoder.embed_expert(e, store.frames(e)) for e in encoder.expert_ids]
    rewards = parts["trainer"].arrays["replay.rewards"][:, 0]
    spans = parts["trainer"].values["replay"]["spans"]
    for name, start, steps in spans:
        z = encoder.embed(store.frames(name)[1:])
        expected = encoder.reward(z, experts).values
        np.testing.assert_allclose(rewards[start : start + steps], expected, rtol=1e-3, atol=1e-3)
    return len(spans), version


@pytest.fixture
def one_round(tmp_path: Path) -> Iterator[tuple[GraphRun, Path]]:
    """A run of 18 rankings, six of them about the robot's own videos after half of the training."""
    folder = tmp_path / "run"
    run = GraphRun([*TINY, *ONE_ROUND, "--out", str(folder)], tmp_path / "log")
    yield run, folder
    run.close()


def check_round(folder: Path) -> OnlineAlignment:
    """The round took place, once, and was about the robot's videos; what it was."""
    [entry] = read_online(folder)
    assert STEPS // 2 <= entry.asked_steps <= entry.steps <= STEPS
    assert entry.rankings == entry.wanted == 18
    with RankingStore(folder / "rankings.sqlite") as rankings:
        late = rankings.all()[12:]
    own = [sum(name.startswith("train-") for name in r.episode_ids) for r in late]
    assert own == [2] * 6, "each beside one expert video"
    return entry


def test_the_robots_own_videos_are_ranked_and_its_buffer_is_rewarded_by_the_new_version(
    one_round: tuple[GraphRun, Path],
) -> None:
    run, folder = one_round
    assert run.process.wait(timeout=DEADLINE_S) == 0, run.text()[-3000:]
    entry = check_round(folder)
    episodes, version = check_buffer(folder)
    assert episodes >= 15 and version == entry.version == make_encoder("rapl", folder).info.version
    log = (folder / "logs" / "learner.log").read_text()
    assert f"episodes rewarded again by RewardSource(name='rapl', version='{entry.version}'" in log
    assert "could not be rewarded again" not in log
    results = json.loads((folder / "results.json").read_text())
    assert results["online"][0]["version"] == entry.version
    assert entry.version[:8] in (folder / "report.html").read_text()


@pytest.mark.parametrize(
    "node", ["encoder", "ot_reward", "learner", "preference", "conductor", "simulated_human"]
)
def test_a_node_killed_within_a_round_is_restarted_and_the_round_is_finished_once(
    one_round: tuple[GraphRun, Path], node: str
) -> None:
    run, folder = one_round
    run.until(lambda: bool(read_online(folder)), DEADLINE_S, "the round begins")
    pid = run.kill_node(node)
    assert not read_online(folder)[-1].is_done, "the round was over before the node was killed"
    assert run.process.wait(timeout=DEADLINE_S) == 0, run.text()[-3000:]
    assert not psutil.pid_exists(pid)
    assert f"{node} was killed by SIGKILL; restarting it" in run.text()
    check_round(folder)
    episodes, _ = check_buffer(folder)  # of the version before, where the swap came at the very end
    assert episodes >= 15
