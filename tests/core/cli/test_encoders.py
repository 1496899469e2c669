"""``rapl encoders``: from the videos and rankings of a small run to encoders, figures and files."""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import yaml
from published_files import r3m_file
from scipy.stats import spearmanr

from rapl_core.cli import main
from rapl_core.cli.progress import Progress
from rapl_core.episodes import EpisodeStore
from rapl_core.errors import CorruptFileError, RefusedError, WeightsError
from rapl_core.preferences import RankingStore, expert_set
from rapl_core.representations import encoder_names, make_encoder
from rapl_core.representations.alignment_job import AlignmentOrder, run_alignment
from rapl_core.representations.exported import export_encoder, load_exported
from rapl_core.representations.methods import method_names
from rapl_core.types import Episode, Ranking

STEPS, SIZE, VIDEOS, RANKED, RANKINGS = 4, 32, 18, 14, 12


def episode(
    number: int, has_truth: bool = True, purpose: str = "demonstrate", steps: int = STEPS
) -> Episode:
    """A bright square that goes the farther the greater its number."""
    rng = np.random.default_rng(number)
    way = np.linspace(0, 24 * (number + 1) / VIDEOS, steps + 1) + rng.uniform(0, 1, steps + 1)
    frames = np.full((steps + 1, SIZE, SIZE, 3), 40, np.uint8)
    for t, x in enumerate(way.astype(int)):
        frames[t, 10:18, x : x + 8] = (220, 60, 60)
    return Episode(
        episode_id=f"{purpose}-{number:02}",
        task="franka_group",
        world=0,
        purpose=purpose,
        controller="demonstrator",
        frames=frames,
        states=np.zeros((steps + 1, 18)),
        actions=np.zeros((steps, 2)),
        stamps_ns=np.arange(steps + 1) + 1,
        human_rewards=way - 24 if has_truth else None,
        success=number > 15 if has_truth else None,
        behaviour="mime" if number % 3 == 0 else "together_from_behind",
    )


def make_run(folder: Path, has_truth: bool = True, steps: int = STEPS) -> Path:
    """The last videos are in no ranking."""
    store = EpisodeStore(folder / "episodes")
    for number in range(VIDEOS):
        store.add(episode(number, has_truth, steps=steps))
    rng = np.random.default_rng(0)
    with RankingStore(folder / "rankings.sqlite") as rankings:
        for number in range(RANKINGS):
            shown = sorted(rng.choice(RANKED, 3, replace=False), reverse=True)  # best first
            ids = tuple(f"demonstrate-{i:02}" for i in shown)
            rankings.add(Ranking(f"r{number:02}", "ada", ids, (1, 2, 3), created_ns=number))
    settings = {"task": "franka_group", "reward": "rapl", "preset": "paper", "seed": 3}
    node = {"masked_iterations": 1, "tcc_iterations": 2}
    content = {"run": settings, "nodes": {"preference": node}}
    (folder / "config.yaml").write_text(yaml.safe_dump(content))
    return folder


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_run(tmp_path_factory.mktemp("runs") / "run")


@pytest.fixture(scope="module")
def trained(run: Path) -> str:
    """The name of an RLHF encoder that learnt from the first nine rankings."""
    assert call("train", run, "--method", "rlhf", "--rankings", 9) == 0
    (folder,) = (run / "encoders").glob("rlhf-*")
    return folder.name


@pytest.fixture(autouse=True)
def no_weights_of_this_machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("RAPL_WEIGHTS", str(tmp_path / "none"))
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))


def call(verb: str, *arguments: object) -> int:
    return main(["encoders", verb, *map(str, arguments)])


def rankings_of(run: Path) -> list[Ranking]:
    with RankingStore(run / "rankings.sqlite") as store:
        return store.effective()


def hidden_files(run: Path) -> list[str]:
    return [path.name for path in run.rglob(".*")]


def test_the_list_says_what_each_method_is_and_where_its_weights_are(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert call("list") == 0
    said = capsys.readouterr().out
    rows = {line.split()[0]: line for line in said.splitlines() if line}
    assert set(method_names()) < set(rows)
    assert rows["rapl"].endswith("here") and "rankings" in rows["rapl"]
    assert rows["r3m"].endswith("not here")
    assert "control" in rows["clock"] and rows["mae_scratch"].endswith("made in training")
    assert "https://github.com/facebookresearch/r3m (MIT)" in rows["r3m_resnet18"]
    assert f"{tmp_path / 'none'} as BACKBONE.pt" in said
    assert "fetched from https" in rows["resnet18"]
    (tmp_path / "r3m_resnet18.pt").write_text("")
    assert call("list", "--weights", tmp_path) == 0
    assert f"here: {tmp_path}" in capsys.readouterr().out


def test_training_is_what_the_action_does(
    run: Path, trained: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("train", run, "--method", "rlhf", "--rankings", 9) == 0
    said = capsys.readouterr()
    assert f"encoders/{trained}, from 9 triplets" in said.out
    assert "held-out triplets right (95 %: " in said.out
    assert "ros2 param set /rapl/encoder encoder rlhf" in said.out
    assert "RLHF, preset paper, on efficientnet_lite0, seed 3" in said.err
    assert "epoch 10/100" in said.err and "epoch 11/100" not in said.err
    order = AlignmentOrder(run, "rlhf", "paper", rankings=9, seed=3)
    outcome = run_alignment(order, lambda done, total: None, lambda progress: None)
    assert outcome.groups[0].uri == f"encoders/{trained}"
    assert make_encoder("rlhf", run).info.version in trained
    learnt = json.loads((run / "encoders" / trained / "report.json").read_text())["learnt_from"]
    assert learnt["rankings"] == [f"r{number:02}" for number in range(9)]


def test_the_list_of_a_run_has_its_encoders_and_names_the_damaged_ones(
    run: Path, trained: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other"
    shutil.copytree(run / "encoders", other / "encoders")
    damaged = other / "encoders" / "rapl-0123456789abcdef"
    damaged.mkdir()
    (damaged / "card.json").write_text("{")
    assert call("list", other) == 0
    said = capsys.readouterr().out.partition(f"In {other}")[2]
    assert trained in said and "preset paper, efficientnet_lite0, 1-d" in said
    assert "card.json (" in said and "ordered " in said
    assert f"damaged: {damaged / 'card.json'}" in said
    assert call("list", tmp_path / "nothing") == 1
    assert "holds no run" in capsys.readouterr().err


def test_measures_are_those_of_videos_and_rankings_that_it_did_not_learn_from(
    run: Path, trained: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("evaluate", run, trained, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    store, encoder = EpisodeStore(run / "episodes"), make_encoder(trained, run)
    ranked = {name for ranking in rankings_of(run) for name in ranking.episode_ids}
    unseen = [name for name in store.ids() if name not in ranked]
    assert found["human"]["videos"] == len(unseen) >= VIDEOS - RANKED
    assert f"{len(unseen)} of {VIDEOS} videos of the pool" in found["measured_on"]

    def reward(name: str) -> np.ndarray:
        return encoder.reward(encoder.embed(store.frames(name)[1:]), []).values

    felt = [store.load(name).human_rewards for name in unseen]
    correlations = [
        spearmanr(reward(name), f[1:]).statistic for name, f in zip(unseen, felt, strict=True)
    ]
    assert found["human"]["step"] == pytest.approx(np.mean(correlations))
    late = [r for r in rankings_of(run) if r.ranking_id >= "r09"]
    right = []
    for ranking in late:
        best, middle, worst = (reward(name).sum() for name in ranking.episode_ids)
        right += [best > middle, middle > worst, best > worst]
    assert found["rankings"]["triplets"] == len(late) == 3
    assert found["rankings"]["accuracy"] == pytest.approx(np.mean(right))
    assert found["rankings"]["chose_epoch"] is False
    assert call("evaluate", run, trained) == 0
    lines = capsys.readouterr().out.splitlines()
    names = ("step", "step given time", "concordance", "episode", "arm only", "rankings")
    assert [line.split("  ")[1] for line in lines[-6:]] == list(names)


def test_test_episodes_come_first(
    run: Path, trained: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = Path(shutil.copytree(run, tmp_path / "run"))
    for number in (3, 7):
        EpisodeStore(other / "episodes").add(episode(number, purpose="test"))
    assert call("evaluate", other, trained, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["measured_on"] == "2 of 2 test episodes"
    assert found["human"]["video_mix"] == {"mime": 1, "together_from_behind": 1}


def test_without_a_human_reward_rankings_alone_are_measured_and_without_both_nothing(
    run: Path, trained: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    camera = make_run(tmp_path / "camera", has_truth=False)
    shutil.copytree(run / "encoders" / trained, camera / "encoders" / trained)
    assert call("evaluate", camera, "rlhf") == 0
    said = capsys.readouterr().out
    assert "no human reward in these videos" in said and "% of 3 held-out triplets" in said
    assert "concordance" not in said
    assert call("evaluate", camera, "clock") == 2
    assert "no human reward in these videos" in capsys.readouterr().err


def test_an_export_is_whole_elsewhere_and_overwrites_nothing(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("train", run, "--method", "imagenet") == 0
    other = tmp_path / "other"
    file = other / "encoders" / "mine.safetensors"
    assert call("export", run, "imagenet", file) == 0
    assert "10 expert videos embedded" in capsys.readouterr().out
    before, after = make_encoder("imagenet", run), make_encoder("mine", other)
    assert "mine" in encoder_names(other) and after.info == before.info
    assert make_encoder("imagenet", other).info == before.info, "the newest of its method"
    assert [e.episode_id for e in after.experts] == list(before.expert_ids)
    assert list(before.expert_ids) == expert_set(rankings_of(run), 10)
    videos = EpisodeStore(run / "episodes")
    experts = [before.embed_expert(name, videos.frames(name)) for name in before.expert_ids]
    z = before.embed(videos.frames("demonstrate-17")[1:])
    np.testing.assert_array_equal(
        after.reward(z, after.experts).values, before.reward(z, experts).values
    )
    content = file.read_bytes()
    assert call("export", run, "imagenet", file) == 2
    assert f"{file} exists" in capsys.readouterr().err and file.read_bytes() == content
    assert call("export", run, "imagenet", file.with_suffix(".pt")) == 2
    file.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    with pytest.raises(CorruptFileError, match="mine.safetensors was changed"):
        load_exported(file)
    assert call("export", run, "imagenet", file, "--force") == 0
    assert load_exported(file).info == before.info and hidden_files(other) == []


def test_an_export_that_reads_back_otherwise_is_not_written(run: Path, tmp_path: Path) -> None:
    encoder = make_encoder("imagenet", run)
    frames = EpisodeStore(run / "episodes").frames("demonstrate-00")

    class Noisy(type(encoder)):  # type: ignore[misc]
        def embed(self, frames: np.ndarray, batch_size: int = 16) -> np.ndarray:
            return super().embed(frames, batch_size) + 1e-3

    noisy = Noisy(encoder.extractor, encoder.embedder, encoder.card)
    with pytest.raises(CorruptFileError, match="embeds the same pictures otherwise"):
        export_encoder(noisy, tmp_path / "x.safetensors", (), frames)
    (tmp_path / "x.safetensors").write_text("mine")
    with pytest.raises(RefusedError, match="exists"):
        export_encoder(encoder, tmp_path / "x.safetensors", (), frames)
    assert [path.name for path in tmp_path.iterdir()] == ["x.safetensors"]
    with pytest.raises(CorruptFileError, match="x.safetensors cannot be read"):
        load_exported(tmp_path / "x.safetensors")


def test_a_backbone_that_was_trained_or_given_here_goes_along(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "short", steps=2)  # R3M sees large pictures
    assert call("train", run, "--method", "mae_scratch") == 0
    r3m_file(tmp_path / "r3m_resnet18.pt")
    assert call("train", run, "--method", "r3m") == 1
    assert "weights for r3m_resnet18 are not here" in capsys.readouterr().err
    assert call("train", run, "--method", "r3m", "--weights", tmp_path) == 0
    other, frames = tmp_path / "other", EpisodeStore(run / "episodes").frames("demonstrate-00")
    expected = {}
    for method, more in (("mae_scratch", ()), ("r3m", ("--with-backbone",))):
        file = other / "encoders" / f"{method}-here.safetensors"
        assert call("export", run, method, file, *more) == 0
        assert "with its backbone; read back" in capsys.readouterr().out
        expected[file.stem] = make_encoder(method, run).embed(frames)
    (tmp_path / "r3m_resnet18.pt").unlink()
    shutil.rmtree(run / "backbones")
    with pytest.raises(WeightsError, match="r3m_resnet18 are not here"):
        make_encoder("r3m", run)
    for name, z in expected.items():
        np.testing.assert_array_equal(make_encoder(name, other).embed(frames), z)


def test_ctrl_c_ends_training_and_leaves_nothing_half_written(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stop(self: Progress, what: str, done: int, total: int, detail: str = "") -> None:
        if what == "epoch":
            raise KeyboardInterrupt

    before = sorted(path.name for path in (run / "encoders").iterdir())
    monkeypatch.setattr(Progress, "show", stop)
    assert call("train", run, "--method", "rapl") == 130
    assert "stopped" in capsys.readouterr().err
    assert sorted(path.name for path in (run / "encoders").iterdir()) == before
    assert hidden_files(run) == []


@pytest.mark.parametrize(
    ("verb", "arguments", "code", "said"),
    [
        ("train", ("--method", "magic"), 2, "'magic'; known: clock, "),
        ("train", ("--method", "rapl", "--preset", "magic"), 2, "'magic'; known: authors_code, "),
        ("train", ("--method", "rapl", "--backbone", "vgg"), 2, "'vgg'; known: dinov2_"),
        ("evaluate", ("magic",), 2, "unknown encoder 'magic'"),
        ("evaluate", ("tcc",), 1, "no checkpoint of encoder 'tcc'"),
        ("export", ("magic", "x.safetensors"), 2, "unknown encoder 'magic'"),
    ],
)
def test_what_is_not_to_be_had_is_refused_by_name(
    run: Path,
    capsys: pytest.CaptureFixture[str],
    verb: str,
    arguments: Sequence[str],
    code: int,
    said: str,
) -> None:
    assert call(verb, run, *arguments) == code
    assert said in capsys.readouterr().err


def test_a_folder_without_videos_or_rankings_stays_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("train", tmp_path / "typo", "--method", "rapl") == 1
    assert "typo holds no run" in capsys.readouterr().err and not (tmp_path / "typo").exists()
    EpisodeStore(tmp_path / "run" / "episodes").add(episode(0))
    assert call("train", tmp_path / "run", "--method", "rapl") == 1
    assert "has no rankings.sqlite" in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["episodes"]
