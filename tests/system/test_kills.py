"""kill -9 of any one node: it is missed by name, the run goes on, nothing is lost."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from graph_run import RUN_DEADLINE_S, TINY, WORLDS, GraphProbe, GraphRun
from ros_harness import ros

from rapl_core.analysis.stages import read_stages
from rapl_core.episodes import EpisodeStore
from rapl_core.preferences import RankingStore

# A whole run each; test_whole_run kills one node in every `make test`.
pytestmark = [pytest.mark.timeout(900), pytest.mark.slow]

KILLED_IN = {
    "demonstrator": ("collect", 2),
    "recorder": ("collect", 4),
    "simulator": ("train", 120),
    "encoder": ("train", 120),
    "ot_reward": ("train", 120),
    "learner": ("train", 240),
    "conductor": ("train", 120),
    "preference": ("train", 120),
    "simulated_human": ("train", 120),
}
"""Stage and progress at which a node is killed: where it hurts."""


@pytest.fixture
def killing(tmp_path: Path) -> Iterator[tuple[GraphProbe, GraphRun, Path]]:
    folder = tmp_path / "run"
    with ros(own_domain=True):
        probe = GraphProbe(WORLDS)
        run = GraphRun([*TINY, "--out", str(folder)], tmp_path / "shown.txt")
        yield probe, run, folder
        run.close()
        probe.close()


@pytest.mark.parametrize("node", KILLED_IN)
def test_a_killed_node_is_missed_restarted_and_the_run_is_complete(
    killing: tuple[GraphProbe, GraphRun, Path], node: str
) -> None:
    probe, run, folder = killing
    stage, done = KILLED_IN[node]
    probe.until_stage(stage, done, run, RUN_DEADLINE_S)
    episodes = len(EpisodeStore(folder / "episodes"))
    pid = run.kill_node(node)
    if node != "conductor":  # on which none depends
        probe.until_missed(node)
    code = probe.until_ended(run, RUN_DEADLINE_S)
    text = run.text()
    assert code == 0, text[-3000:]
    assert f"{node} was killed by SIGKILL; restarting it" in text
    assert not Path(f"/proc/{pid}").exists()
    unasked = {"demonstrate"}  # demonstrations are for tcc alone
    found = {record.name: record.status for record in read_stages(folder)}
    assert found == {name: "skipped" if name in unasked else "done" for name in found}
    store = EpisodeStore(folder / "episodes")
    assert len(store) >= episodes + 12
    for episode_id in store.ids():
        store.load(episode_id)  # a damaged one would be refused
    with RankingStore(folder / "rankings.sqlite") as rankings:
        assert rankings.count() == 12


def test_nothing_survives_a_supervisor_that_is_killed(
    killing: tuple[GraphProbe, GraphRun, Path],
) -> None:
    probe, run, folder = killing
    probe.until_stage("collect", 2, run, RUN_DEADLINE_S)
    children = run.children()
    assert len(children) >= 9
    os.kill(run.process.pid, signal.SIGKILL)
    run.process.wait(timeout=5)
    probe.until(lambda: not any(c.is_running() for c in children), 5.0, "every node has ended")
    for episode_id in EpisodeStore(folder / "episodes").ids():
        EpisodeStore(folder / "episodes").load(episode_id)
