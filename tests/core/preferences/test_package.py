"""Rankings leave a run and come into another: JSON lines, Parquet, and the bags with them."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from rapl_core.cli import main
from rapl_core.episodes import EpisodeStore
from rapl_core.errors import CorruptFileError, RankingError
from rapl_core.preferences import RankingStore
from rapl_core.preferences.package import export_package, import_package
from rapl_core.preferences.parquet import SCHEMA, export_parquet, read_parquet
from rapl_core.types import Episode, Ranking


def episode(name: str) -> Episode:
    return Episode(
        episode_id=name,
        task="franka_group",
        world=0,
        purpose="demonstrate",
        controller="demonstrator",
        frames=np.full((3, 8, 8, 3), 90, np.uint8),
        states=np.zeros((3, 2)),
        actions=np.zeros((2, 2)),
        stamps_ns=np.arange(1, 4, dtype=np.int64),
    )


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run with four videos and three rows about three of them."""
    folder = tmp_path / "run"
    episodes = EpisodeStore(folder / "episodes")
    for name in "abcd":
        episodes.add(episode(name))
    with RankingStore(folder / "rankings.sqlite", episodes.__contains__) as store:
        store.add(Ranking("r1", "ada", ("a", "b", "c"), (1, 2, 2), response_s=2.5, created_ns=7))
        store.add(Ranking("r2", "ada", ("a", "b", "c"), (2, 1, 3), replaces="r1", shown_ns=5))
        store.undo("ada", "u1", "r2")
    return folder


@pytest.mark.parametrize("kind", ["jsonl", "parquet"])
def test_an_export_with_bags_makes_another_run_of_its_rankings(
    run: Path, tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out, other = tmp_path / "out", tmp_path / "other"
    assert main(["rankings", "export", str(run), str(out), "--format", kind, "--bags"]) == 0
    assert f"rankings.{kind}: 3 rankings, 3 bags copied" in capsys.readouterr().out
    assert EpisodeStore(out / "episodes").ids() == ["a", "b", "c"], "d was in no query"
    assert main(["rankings", "import", str(other), str(out)]) == 0
    assert "3 rankings added, 3 bags copied" in capsys.readouterr().out
    with RankingStore(run / "rankings.sqlite") as one:
        with RankingStore(other / "rankings.sqlite") as two:
            assert [repr(r) for r in two.all()] == [repr(r) for r in one.all()]
            assert two.effective() == []
    assert np.array_equal(EpisodeStore(other / "episodes").frames("a"), episode("a").frames)
    again = import_package(other, out)
    assert (again.rankings, again.episodes) == (0, 0)


def test_rankings_of_videos_that_are_not_there_are_refused_whole(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    done = export_package(run, tmp_path / "out")
    other = tmp_path / "other"
    assert main(["rankings", "import", str(other), str(done.path)]) == 1
    assert "3 videos that" in (said := capsys.readouterr().err) and "such as a" in said
    assert not (other / "rankings.sqlite").exists()


def test_a_damaged_bag_is_not_handed_on(run: Path, tmp_path: Path) -> None:
    (bag,) = (run / "episodes" / "b").glob("*.mcap")
    bag.write_bytes(bag.read_bytes()[:-7])
    with pytest.raises(CorruptFileError, match="b.mcap is truncated"):
        export_package(run, tmp_path / "out", bags=True)
    assert not (tmp_path / "out" / "episodes" / "b").exists()


def test_what_is_no_export_is_refused_by_name(run: Path, tmp_path: Path) -> None:
    with pytest.raises(RankingError, match="has no rankings.sqlite"):
        export_package(tmp_path / "nothing", tmp_path / "out")
    with pytest.raises(RankingError, match="no rankings at .*rankings.jsonl"):
        import_package(run, tmp_path)
    (tmp_path / "bad.parquet").write_bytes(b"PAR1 no")
    with pytest.raises(RankingError, match="cannot read rankings from .*bad.parquet"):
        import_package(run, tmp_path / "bad.parquet")
    with pytest.raises(RankingError, match="cannot write rankings to /proc"):
        export_package(run, Path("/proc/self/new"))


def test_a_bad_row_is_named_with_its_number(run: Path, tmp_path: Path) -> None:
    path = tmp_path / "rankings.parquet"
    with RankingStore(run / "rankings.sqlite") as store:
        assert export_parquet(store, path) == 3
    rows = pq.read_table(path).to_pylist()
    rows[1]["ranks"] = [1, 2]
    pq.write_table(pa.Table.from_pylist(rows, schema=SCHEMA), path)
    with pytest.raises(RankingError, match="rankings.parquet, row 2: .*2 ranks, expected 3"):
        read_parquet(path)
