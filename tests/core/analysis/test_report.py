"""The report of a run that is made here, on real episodes and a real transport reward."""

import json
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from scipy.stats import spearmanr

from rapl_core.analysis import curves, record, report, scoring
from rapl_core.analysis.online import OnlineAlignment, OnlineBook, read_online
from rapl_core.analysis.stages import StageBook, read_stages
from rapl_core.episodes import EpisodeStore
from rapl_core.errors import CorruptFileError
from rapl_core.policies.learning_curve import CurvePoint, LearningCurve
from rapl_core.preferences.store import RankingStore
from rapl_core.transport.config import TransportConfig
from rapl_core.transport.reward import ot_reward
from rapl_core.types import EmbeddedEpisode, EncoderInfo, Episode, Ranking, RewardTrace

STEPS, SIZE = 12, 24


@dataclass(frozen=True)
class WhereIsTheSpot:
    """An encoder whose embedding is the place of the bright spot in the picture."""

    info = EncoderInfo("spot", "0" * 16, "none", "tuned", 2, SIZE, SIZE, 1.0)
    transport = TransportConfig(cost="euclidean", solver="uniform", expert="mean")

    reward_kind = "ot"
    expert_ids = ()
    experts = ()

    def embed(self, frames: NDArray[np.uint8]) -> NDArray[np.float32]:
        flat = frames[..., 0].reshape(len(frames), -1).argmax(axis=1)
        return np.stack(np.divmod(flat, SIZE), axis=1).astype(np.float32)

    def embed_expert(self, episode_id: str, frames: NDArray[np.uint8]) -> EmbeddedEpisode:
        return EmbeddedEpisode(episode_id, self.embed(frames[1:]))

    def reward(self, z: NDArray[Any], experts: Sequence[EmbeddedEpisode]) -> RewardTrace:
        return ot_reward(z, experts, self.transport, 1.0)


def video(name: str, behaviour: str, distance: float, purpose: str = "demonstrate") -> Episode:
    """A spot that moves ``distance`` of the picture's width to the right."""
    columns = np.round(np.linspace(2, 2 + distance * (SIZE - 4), STEPS + 1)).astype(int)
    frames = np.zeros((STEPS + 1, SIZE, SIZE, 3), np.uint8)
    frames[np.arange(STEPS + 1), SIZE // 2, columns] = 255
    return Episode(
        episode_id=name,
        task="spot",
        world=0,
        purpose=purpose,
        controller="demonstrator",
        frames=frames,
        states=columns[:, None].astype(float),
        actions=np.zeros((STEPS, 1)),
        stamps_ns=np.arange(1, STEPS + 2) * 10_000_000,
        human_rewards=(columns - SIZE) / SIZE,
        success=distance > 0.9,
        behaviour=behaviour,
    )


def curve(*points: tuple[int, float]) -> LearningCurve:
    return LearningCurve(tuple(CurvePoint(s, r, -1.0, -2.0, 10, float(s)) for s, r in points))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "run"
    folder.mkdir()
    rng = np.random.default_rng(0)
    store = EpisodeStore(folder / "episodes")
    returns = {}
    for number in range(24):
        distance = number / 23
        behaviour = "mime" if number < 3 else "half way" if number < 16 else "all the way"
        episode = video(f"pool-{number:02}", behaviour, distance)
        store.add(episode)
        returns[episode.episode_id] = episode.human_return
    for number, distance in enumerate((0.3, 0.6, 1.0)):
        store.add(video(f"robot-{number}", "policy", distance, "evaluate"))
    store.add(video("while-learning", "policy", 0.1, "evaluate"))
    with RankingStore(folder / "rankings.sqlite") as rankings:
        for number in range(30):
            ids = tuple(str(e) for e in rng.choice(sorted(returns), 3, replace=False))
            ranks = tuple(int(r) for r in np.argsort(np.argsort([-returns[e] for e in ids])) + 1)
            rankings.add(Ranking(f"r{number}", "test", ids, ranks))
    settings = {
        "task": "spot",
        "reward": "rapl",
        "preset": "tuned",
        "seed": 0,
        "steps": 400,
        "final_episodes": 3,
        "quick": True,
    }
    (folder / "config.yaml").write_text(yaml.safe_dump({"run": settings}))
    book = StageBook(folder)
    book.begin("align")
    book.spend("align", 65.0)
    book.finish("align", {"held_out_accuracy": 0.875, "triplets": 30})
    book.begin("evaluate")
    robot = [f"robot-{number}" for number in range(3)]
    book.finish(
        "evaluate",
        {"success_rate": 1 / 3, "episodes": 3, "human_return_mean": -4.0, "episode_ids": robot},
    )
    (folder / "policies").mkdir()
    curve((100, 0.0), (200, 0.25), (400, 0.5)).save(folder / curves.CURVE_FILE)
    return folder


@pytest.fixture(scope="module")
def page(run: Path) -> str:
    return report.write_report(run, WhereIsTheSpot()).read_text()


def test_the_page_needs_nothing_beside_it(page: str) -> None:
    sources = re.findall(r'(?:src|href|url)\s*[=(]\s*"?([^")> ]+)', page)
    assert sources
    assert [s for s in sources if not s.startswith(("data:", "#"))] == []
    assert "<script" not in page


def test_the_ids_of_its_figures_do_not_collide(page: str) -> None:
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))


def test_figures_take_the_colour_of_the_page(page: str) -> None:
    assert page.count("currentColor") > 50
    assert "#010203" not in page


def test_it_tells_what_was_found(page: str) -> None:
    for words in (
        "88 %",
        "held-out triplets",
        "33 %",
        "success over 3 episodes",
        "all the way",
        "half way",
        "1:05",
        "--quick",
        "preset tuned",
        "disliked",
    ):
        assert words in page, words


def test_results_hold_the_numbers_of_the_run(run: Path, page: str) -> None:
    found = json.loads((run / "results.json").read_text())
    assert found["success"]["final"] == pytest.approx(1 / 3)
    assert found["success"]["mean_of_last_three"] == pytest.approx(0.25)
    assert found["triplets"] == 30
    assert {share["behaviour"]: share["videos"] for share in found["pool"]} == {
        "mime": 3,
        "half way": 13,
        "all the way": 8,
    }
    assert found["wall_time_s"] == pytest.approx(65.0)
    assert found["versions"]["numpy"] == np.__version__
    agreement = found["agreement"]["pool"]
    assert agreement["videos"] == 14  # 24 without the ten experts
    assert agreement["episode"] == pytest.approx(expected_episode_correlation(run))
    assert found["agreement"]["the robot's own, after learning"]["videos"] == 3


def expected_episode_correlation(run: Path) -> float:
    found, encoder = record.read_run(run), WhereIsTheSpot()
    episodes = [found.store.load(e.episode_id) for e in found.pool]
    ids = found.expert_ids()
    experts = [
        EmbeddedEpisode(e.episode_id, encoder.embed(e.frames[1:]))
        for e in episodes
        if e.episode_id in ids
    ]
    others = [e for e in episodes if e.episode_id not in ids]
    sums = [encoder.reward(encoder.embed(e.frames[1:]), experts).total for e in others]
    return float(spearmanr(sums, [e.human_return for e in others]).statistic)


def test_disliked_examples_are_of_different_behaviours_and_preferred_ones_no_experts() -> None:
    strengths = {"a": 3.0, "b": 2.0, "c": 1.0, "d": -1.0, "e": -2.0, "f": -3.0}
    behaviours = {"a": "x", "b": "x", "c": "x", "d": "y", "e": "z", "f": "z"}
    preferred, disliked = scoring.choose_examples(strengths, behaviours, ["a"])
    assert preferred == ["b", "c"]
    assert disliked == ["f", "d"]


def test_a_video_is_never_matched_with_itself(run: Path) -> None:
    found = record.read_run(run)
    experts = found.expert_ids()
    scorer = scoring.Scorer(found.store, WhereIsTheSpot(), experts)
    plan, expert, solver = scorer.plan(scorer.score(experts[0]))
    assert expert in experts[1:]
    assert "shown: sinkhorn" in solver
    assert plan.sum() == pytest.approx(1.0)


def test_the_reward_shown_is_that_of_the_encoder(run: Path) -> None:
    found = record.read_run(run)
    encoder = WhereIsTheSpot()
    scorer = scoring.Scorer(found.store, encoder, found.expert_ids())
    shown = scorer.score("pool-12").reward
    frames = found.store.load("pool-12").frames[1:]
    want = encoder.reward(encoder.embed(frames), scorer.experts)
    np.testing.assert_array_equal(shown, want.values)


def test_the_oracles_curve_is_found_beside_the_run(run: Path) -> None:
    assert curves.oracle_curve(run) is None
    oracle = run.parent / "ground_truth-seed0"
    (oracle / "policies").mkdir(parents=True)
    curve((9, 0.9)).save(oracle / curves.CURVE_FILE)
    found = curves.oracle_curve(run)
    assert found is not None and found.last(1) == pytest.approx(0.9)


def test_broken_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(CorruptFileError, match=r"config\.yaml is missing"):
        record.read_run(tmp_path)
    (tmp_path / "stages.json").write_text("{")
    with pytest.raises(CorruptFileError, match=r"stages\.json"):
        read_stages(tmp_path)


def test_stages_survive_the_process_and_times_add_up(tmp_path: Path) -> None:
    book = StageBook(tmp_path)
    book.begin("train")
    book.spend("train", 3.0)
    again = StageBook(tmp_path)
    assert again["train"].status == "running"
    again.begin("train")
    again.spend("train", 4.0)
    again.finish("train", {"steps": 5})
    last = StageBook(tmp_path)["train"]
    assert (last.status, last.seconds, last.attempts) == ("done", 7.0, 2)
    assert last.result == {"steps": 5}


def test_what_is_unknown_is_null_in_the_stages(tmp_path: Path) -> None:
    StageBook(tmp_path).finish("align", {"held_out_accuracy": float("nan"), "n": np.int64(3)})
    text = (tmp_path / "stages.json").read_text()
    assert "NaN" not in text
    assert StageBook(tmp_path)["align"].result == {"held_out_accuracy": None, "n": 3}


def test_a_stage_whose_input_changed_is_forgotten_but_not_its_time(tmp_path: Path) -> None:
    book = StageBook(tmp_path)
    book.begin("report")
    book.spend("report", 3.0)
    book.finish("report", {"report": "report.html"})
    book.forget(["report", "never begun"])
    assert [(r.name, r.status, r.seconds, dict(r.result)) for r in book.records] == [
        ("report", "waiting", 3.0, {})
    ]


def test_alignments_while_learning_are_kept_marked_and_told(run: Path, tmp_path: Path) -> None:
    folder = tmp_path / "online"
    shutil.copytree(run, folder)
    assert read_online(folder) == []
    book = OnlineBook(folder)
    assert book.under_way is None and book.done == 0
    book.begin(2_000, 14)
    again = OnlineBook(folder)  # as after a restart
    assert again.begin(2_500, 99) == OnlineAlignment(2_000, 14), "what was begun goes on"
    again.finish(2_600, 15, "c0ffee0123456789", float("nan"))
    again.begin(4_000, 20)
    assert again.done == 1 and again.under_way is not None
    page = report.write_report(folder, WhereIsTheSpot()).read_text()
    assert "c0ffee01" in page and "at work from step" in page and "waited for 20" in page
    assert "c0ffee01" in page[page.index("<svg") : page.index("</svg>")], "marked on the curve"
    [first, second] = json.loads((folder / "results.json").read_text())["online"]
    assert (first["steps"], first["rankings"], first["held_out_accuracy"]) == (2_600, 15, None)
    assert second["version"] == ""
    (folder / "online.json").write_text("[{}]")
    with pytest.raises(CorruptFileError, match=r"online\.json"):
        read_online(folder)
