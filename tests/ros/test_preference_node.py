"""The nodes preference and simulated_human: queries, rankings that stay, an encoder from them."""

import time
import uuid
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from ranked_videos import STEPS, VIDEOS, make_videos
from rapl_msgs import msg as wire_msg
from rapl_msgs.action import Align
from rapl_msgs.srv import GetProgress, GetQuery, ListRankings, SubmitRanking, Undo
from rclpy.action import ActionClient
from ros_harness import DISCOVERY_S, NodeProcess, Probe
from std_msgs.msg import Header

from rapl_core.episodes import EpisodeStore
from rapl_core.preferences import RankingStore, triplets_from
from rapl_core.representations import load_encoder
from rapl_ros import conversions, qos, topics

pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]

SIMULATED = 25


class Person:
    """A client of the preference node."""

    def __init__(self, probe: Probe) -> None:
        self.probe = probe

    def undo(self, **request: str) -> Undo.Response:
        return self._call(Undo, topics.UNDO, Undo.Request(**request))

    def progress(self, **request: str) -> GetProgress.Response:
        return self._call(GetProgress, topics.GET_PROGRESS, GetProgress.Request(**request))

    def ask(self, **request: Any) -> GetQuery.Response:
        return self._call(GetQuery, topics.GET_QUERY, GetQuery.Request(**request))

    def submit(self, episode_ids: list[str], ranks: list[int], **more: Any) -> Any:
        ranking = wire_msg.Ranking(
            ranking_id=more.pop("ranking_id", uuid.uuid4().hex),
            annotator=more.pop("annotator", "person"),
            episode_ids=episode_ids,
            ranks=ranks,
            **more,
        )
        request = SubmitRanking.Request(ranking=ranking)
        return self._call(SubmitRanking, topics.SUBMIT_RANKING, request)

    def list(self, **request: Any) -> ListRankings.Response:
        return self._call(ListRankings, topics.LIST_RANKINGS, ListRankings.Request(**request))

    def align(self, deadline_s: float = 100.0, cancel: bool = False, **goal: Any) -> Any:
        client = ActionClient(
            self.probe.node, Align, topics.of_node(topics.ALIGN, topics.PREFERENCE)
        )
        self.probe.until(client.server_is_ready, DISCOVERY_S, "align is there")
        sent = client.send_goal_async(Align.Goal(**goal))
        handle = self.probe.wait(sent, DISCOVERY_S, "the goal is answered")
        if cancel:
            self.probe.wait(handle.cancel_goal_async(), DISCOVERY_S, "the cancel is answered")
        return self.probe.wait(handle.get_result_async(), deadline_s, "the goal ends")

    def _call(self, kind: type, name: str, request: Any) -> Any:
        return self.probe.call(kind, topics.of_node(name, topics.PREFERENCE), request)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, float]]:
    folder = tmp_path_factory.mktemp("run")
    return folder, make_videos(folder)


@pytest.fixture(scope="module")
def node(run: tuple[Path, dict[str, float]]) -> Iterator[NodeProcess]:
    folder, _ = run
    process = NodeProcess(
        "rapl_ros.preference_node", folder / "log", run_folder=folder, lease_s=60.0
    )
    yield process
    process.stop()


@pytest.fixture(scope="module")
def person(node: NodeProcess, rclpy_context: None) -> Iterator[Person]:
    probe = Probe("person")
    yield Person(probe)
    probe.close()


def test_a_query_shows_videos_and_an_answer_is_stored_once_however_often_sent(
    person: Person, run: tuple[Path, dict[str, float]]
) -> None:
    folder, returns = run
    asked = person.ask(annotator="person")
    assert asked.success, asked.message
    shown = list(asked.query.episode_ids)
    assert len(set(shown)) == 3 and set(shown) <= set(returns)
    before = person.list().total
    for _ in range(3):
        stored = person.submit(
            shown, [2, 1, 3], query_id=asked.query.query_id, ranking_id="the-same"
        )
        assert stored.success and stored.rankings == before + 1
    with RankingStore(folder / "rankings.sqlite") as store:
        assert [r.ranks for r in store.all("person") if r.ranking_id == "the-same"] == [(2, 1, 3)]


@pytest.mark.parametrize(
    ("episode_ids", "ranks", "words"),
    [
        (["video-00", "video-01", "elsewhere"], [1, 2, 3], "elsewhere"),
        (["video-00", "video-01", "video-00"], [1, 2, 3], "repeats video-00"),
        (["video-00", "video-01", "video-02"], [1, 2], "2 ranks, expected 3"),
        (["video-00", "video-01", "video-02"], [0, 1, 2], "not within 1..3"),
    ],
)
def test_a_bad_ranking_is_refused_with_the_reason_and_not_stored(
    person: Person, episode_ids: list[str], ranks: list[int], words: str
) -> None:
    before = person.list().total
    stored = person.submit(episode_ids, ranks)
    assert not stored.success and words in stored.message
    assert person.list().total == before


def test_a_lease_is_good_for_one_answer_and_an_undo_opens_it_again(person: Person) -> None:
    asked = person.ask(annotator="person").query
    shown = list(asked.episode_ids)
    assert (asked.annotator, asked.purpose) == ("person", "new")
    before = person.progress()
    first = person.submit(shown, [1, 2, 3], query_id=asked.query_id, ranking_id="first")
    assert first.success and first.given == before.given + 1
    replay = person.submit(shown, [3, 2, 1], query_id=asked.query_id)
    assert not replay.success and "answered already, by ranking first" in replay.message
    undone = person.undo(annotator="person", withdrawal_id="taken-back")
    assert undone.success and undone.ranking.ranking_id == "first"
    assert list(undone.query.episode_ids) == shown and undone.given == before.given
    assert person.undo(annotator="person", withdrawal_id="taken-back").success, "sent twice"
    again = person.ask(annotator="person", resume=True).query
    assert again.query_id == asked.query_id, "the page was reloaded: the same is asked again"
    anew = person.submit(shown, [2, 1, 3], query_id=asked.query_id, ranking_id="anew")
    assert anew.success
    counted = person.list(annotator="person", effective=True, limit=1000)
    ids = [ranking.ranking_id for ranking in counted.rankings]
    assert "anew" in ids and "first" not in ids and "taken-back" not in ids
    every = [ranking.ranking_id for ranking in person.list(limit=1000).rankings]
    assert {"first", "taken-back", "anew"} <= set(every), "nothing is deleted"


def test_progress_says_how_many_are_needed_and_how_each_annotator_gets_on(person: Person) -> None:
    assert person.probe.set_parameter(topics.PREFERENCE, "rankings_wanted", 1000)[0]
    videos = ["video-00", "video-01", "video-02"]
    for name, ranks in (("ada", [1, 2, 3]), ("ada", [1, 3, 2]), ("bob", [3, 2, 1])):
        assert person.submit(videos, ranks, annotator=name).success
    progress = person.progress()
    assert progress.wanted == 1000 and progress.needed == 1000 - progress.given
    assert progress.videos == VIDEOS and progress.strategy == "uniform"
    rows = {row.annotator: row for row in progress.annotators}
    assert (rows["ada"].ranked, rows["bob"].ranked) == (2, 1), "counts are of now"

    def agreement() -> dict[str, wire_msg.AnnotatorProgress] | None:
        rows = {row.annotator: row for row in person.progress().annotators}
        return rows if rows["bob"].agreement_pairs >= 6 else None

    rows = person.probe.until(agreement, 20.0, "agreement is measured, after some seconds")
    assert rows["ada"].consistency == pytest.approx(2 / 3) and rows["ada"].consistency_pairs == 3
    assert rows["bob"].agreement_pairs >= 6 and 0 <= rows["bob"].agreement < 0.5
    assert len(person.progress(annotator="bob").annotators) == 1


def test_an_unknown_strategy_names_the_known(person: Person) -> None:
    asked = person.ask(strategy="telepathy")
    assert not asked.success
    assert "unknown query strategy 'telepathy'; known: contest, coverage" in asked.message


def test_the_simulated_human_ranks_by_the_true_return_and_goes_on_after_a_kill(
    person: Person, run: tuple[Path, dict[str, float]], node: NodeProcess
) -> None:
    folder, returns = run
    human = NodeProcess(
        "rapl_ros.simulated_human_node", folder / "human", run_folder=folder, seed=3
    )
    probe = person.probe
    beats = probe.listen(
        wire_msg.Heartbeat,
        topics.of_node(topics.HEARTBEAT, topics.SIMULATED_HUMAN),
        qos.heartbeat(),
    )

    def want(rankings: int) -> None:
        assert probe.set_parameter(topics.SIMULATED_HUMAN, "rankings", rankings)[0]

    def is_done(rankings: int) -> bool:
        return bool(beats) and beats[-1].detail == f"done: {rankings} of {rankings} rankings"

    try:
        want(10)
        probe.until(lambda: is_done(10), 30.0, "ten rankings")
        assert person.list(annotator="simulated").total == 10
        node.kill()
        node.restart()
        assert person.list(annotator="simulated").total == 10, "none is lost"
        want(SIMULATED)
        probe.until(lambda: is_done(SIMULATED), 40.0, "all rankings")
    finally:
        human.stop()
    listed = person.list(annotator="simulated", limit=1000)
    assert listed.total == len(listed.rankings) == SIMULATED
    for ranking in listed.rankings:
        order = [e for _, e in sorted(zip(ranking.ranks, ranking.episode_ids, strict=True))]
        assert order == sorted(ranking.episode_ids, key=lambda e: -returns[e])
    combinations = {frozenset(ranking.episode_ids) for ranking in listed.rankings}
    assert len(combinations) == SIMULATED, "nothing is asked twice"


def test_align_writes_an_encoder_that_loads_and_tells_how_good_it_is(
    person: Person, run: tuple[Path, dict[str, float]]
) -> None:
    folder, _ = run
    answer = person.align(encoder="rapl", preset="tuned", triplets=0, seed=1)
    result = answer.result
    assert answer.status == GoalStatus.STATUS_SUCCEEDED, result.message
    with RankingStore(folder / "rankings.sqlite") as store:
        assert result.triplets == len(triplets_from(store.effective()))
    assert 0.0 <= result.held_out_accuracy <= 1.0
    encoder = load_encoder(folder / result.uri)
    assert encoder.info.version == result.version and encoder.info.name == "rapl"
    assert len(encoder.expert_ids) == 10
    assert "video-11" in encoder.expert_ids and "video-00" not in encoder.expert_ids


def test_own_queries_are_about_the_learners_new_videos_until_the_next_alignment(
    person: Person, run: tuple[Path, dict[str, float]]
) -> None:
    folder, _ = run
    probe, store = person.probe, EpisodeStore(folder / "episodes")
    told = probe.node.create_publisher(wire_msg.EpisodeInfo, topics.EPISODE, qos.event())
    probe.until(told.get_subscription_count, DISCOVERY_S, "preference listens")
    few = person.ask(annotator="person", strategy="own")
    assert not few.success and "the learner has recorded 0 of 2 new videos" in few.message
    base = store.load("video-05")
    for number in range(4):
        frames = np.ascontiguousarray(base.frames[:, ::-1] + np.uint8(number))
        stamps = np.arange(100, 100 + STEPS + 1) * (number + 1)
        name = f"train-{number}"
        store.add(replace(base, episode_id=name, purpose="train", frames=frames, stamps_ns=stamps))
        stamp = conversions.time_to_ros(int(stamps[-1]))
        told.publish(
            wire_msg.EpisodeInfo(header=Header(stamp=stamp), episode_id=name, purpose="train")
        )
    probe.until(
        lambda: person.ask(annotator="first", strategy="own").success, 20.0, "they are known"
    )
    ranked: set[str] = set()
    while len(ranked) < 2:
        asked = person.ask(annotator="person", strategy="own")
        shown = list(asked.query.episode_ids)
        own = {name for name in shown if name.startswith("train-")}
        assert asked.query.strategy == "own" and len(own) == 2 and len(shown) == 3
        ranked |= own
        assert person.submit(shown, [1, 2, 3], query_id=asked.query.query_id).success
    assert person.progress().videos == VIDEOS, "the pool is what it was"
    uniform = person.ask(annotator="person")
    assert not [name for name in uniform.query.episode_ids if name.startswith("train-")]

    answer = person.align(encoder="rapl", preset="tuned", triplets=0, seed=1)
    assert answer.status == GoalStatus.STATUS_SUCCEEDED, answer.result.message
    read = [len(list(kind.iterdir())) for kind in (folder / "features").iterdir()]
    assert 2 * (VIDEOS + len(ranked)) in read, "the pool, what was ranked, and mirrored twins"
    none = person.ask(annotator="person", strategy="own")
    assert not none.success and "recorded 0 of 2 new videos" in none.message


def test_align_refuses_what_it_does_not_know_and_can_be_cancelled(
    person: Person, run: tuple[Path, dict[str, float]]
) -> None:
    folder, _ = run
    unknown = person.align(encoder="magic", preset="tuned")
    assert unknown.status == GoalStatus.STATUS_ABORTED
    assert "'magic'; known: clock, " in unknown.result.message
    unknown = person.align(encoder="rapl", preset="best")
    assert "unknown preset 'best'; known: authors_code, paper, tuned" in unknown.result.message
    before = sorted(path.name for path in (folder / "encoders").iterdir())
    began_s = time.monotonic()
    cancelled = person.align(encoder="rapl", preset="authors_code", seed=9, cancel=True)
    assert cancelled.status == GoalStatus.STATUS_CANCELED, cancelled.result.message
    assert time.monotonic() - began_s < 60
    assert sorted(path.name for path in (folder / "encoders").iterdir()) == before
