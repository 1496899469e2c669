"""Two hundred annotators at once: none lost, none doubled, also after kill -9."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

from rapl_core.preferences import RankingStore

SCRIPT = Path(__file__).parents[3] / "experiments" / "preferences" / "many_annotators.py"


@pytest.fixture(scope="module")
def study() -> ModuleType:
    """The script that does the same for a full minute."""
    spec = importlib.util.spec_from_file_location("many_annotators", SCRIPT)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules["many_annotators"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def test_two_hundred_threads_lose_nothing_and_double_nothing(
    study: ModuleType, tmp_path: Path
) -> None:
    with RankingStore(tmp_path / "rankings.sqlite") as store:
        crowd = study.Crowd(store, annotators=200)
        outcome = study.judge(crowd, crowd.rank(0.5))
    assert crowd.errors == []
    assert outcome.answered >= 200 and outcome.sent_twice and outcome.corrected
    assert (outcome.lost, outcome.doubled, outcome.same_videos) == (0, 0, 0)


def test_the_judge_notices_what_is_lost_and_what_is_doubled(
    study: ModuleType, tmp_path: Path
) -> None:
    with RankingStore(tmp_path / "rankings.sqlite") as store:
        crowd = study.Crowd(store, annotators=3)
        crowd.rank(0.05)
        crowd.confirmed.append("never stored")
        forgotten = crowd.confirmed.pop(0)
        outcome = study.judge(crowd, 1.0)
    assert (outcome.lost, outcome.doubled) == (1, 1), forgotten


def test_every_answer_that_was_confirmed_survives_kill_9(study: ModuleType, tmp_path: Path) -> None:
    outcome = study.survive_kill(tmp_path / "rankings.sqlite", annotators=50, after=60)
    assert outcome["confirmed"] >= 60
    assert (outcome["lost"], outcome["doubled"]) == (0, 0)
    assert outcome["stored"] - outcome["confirmed"] <= 50, "at most one under way for each"
