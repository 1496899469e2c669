"""The command line: what is accepted, what is refused and with which words."""

from pathlib import Path

import pytest
from full_disk import full_disk

from rapl_core.errors import CorruptFileError, RaplError
from rapl_ros.options import RunRequest, listing, parse
from rapl_ros.run_config import RunConfig, check_writable, load_config, save_config

TASKS = ("franka_group", "kuka_group")


def ask(runs: Path, *argv: str) -> RunRequest:
    return parse(argv, TASKS, runs)


def refusal(capsys: pytest.CaptureFixture[str], runs: Path, *argv: str) -> str:
    with pytest.raises(SystemExit) as end:
        ask(runs, *argv)
    assert end.value.code == 2
    return capsys.readouterr().err


def test_a_task_alone_gives_the_documented_defaults(tmp_path: Path) -> None:
    request = ask(tmp_path, "franka_group")
    assert request.config == RunConfig("franka_group", online=9, online_triplets=8)
    assert (request.config.steps, request.config.triplets, request.config.worlds) == (40000, 150, 4)
    assert request.folder == tmp_path / "franka_group" / "rapl-tuned-seed0"
    assert not request.resume


def test_a_second_run_gets_a_folder_of_its_own(tmp_path: Path) -> None:
    first = ask(tmp_path, "franka_group").folder
    first.mkdir(parents=True)
    assert ask(tmp_path, "franka_group").folder == first.with_name(first.name + "-2")


def test_quick_is_small_and_its_parts_can_be_overridden(tmp_path: Path) -> None:
    config = ask(tmp_path, "franka_group", "--quick", "--steps", "1_000").config
    assert config.quick and config.steps == 1000
    assert config.pool_episodes < RunConfig("x").pool_episodes


def test_alignments_while_the_robot_learns_come_at_even_steps(
    tmp_path: Path,
) -> None:
    request = ask(tmp_path, "franka_group", "--online", "2", "--online-triplets", "20")
    assert request.config.online_steps == [13_333, 26_666]
    assert (request.config.online_share, request.config.pool_triplets) == (20, 110)
    assert request.folder.name == "rapl-tuned-online2-seed0"


def test_half_of_the_rankings_are_kept_for_the_robots_own_videos_where_the_preset_asks_about_them(
    tmp_path: Path,
) -> None:
    config = ask(tmp_path, "franka_group").config
    assert config.online_steps == list(range(4_000, 40_000, 4_000))
    assert (config.online_share, config.pool_triplets) == (8, 78)
    for argv in (["--preset", "paper"], ["--reward", "imagenet"], ["--online", "0"]):
        config = ask(tmp_path, "franka_group", *argv).config
        assert (config.online, config.online_steps, config.pool_triplets) == (0, [], 150)
    assert ask(tmp_path, "franka_group", "--groups", "2").config.online == 0
    assert ask(tmp_path, "franka_group", "--triplets", "12").config.online == 0, "none to spare"


def test_a_block_that_learns_too_leaves_out_alignments_while_the_robot_learns(
    tmp_path: Path,
) -> None:
    request = ask(tmp_path, "franka_group", "--trained", "last_block", "--reward", "rlhf")
    assert (request.config.trained, request.config.online) == ("last_block", 0)
    assert request.folder.name == "rlhf-tuned-last_block-seed0"


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["franka_grp"], ["unknown task 'franka_grp'", "franka_group, kuka_group"]),
        ([], ["a task is missing", "franka_group"]),
        (["franka_group", "--reward", "gold"], ["'gold'", "ground_truth", "imagenet", "rapl"]),
        (["franka_group", "--preset", "best"], ["'best'", "authors_code", "paper", "tuned"]),
        (["franka_group", "--encoder", "clip"], ["unknown encoder 'clip'", "imagenet", "rapl"]),
        (["franka_group", "--steps", "many"], ["'many'", "whole number, 1 or more"]),
        (["franka_group", "--worlds", "99"], ["1 to 16"]),
        (["franka_group", "--stesp", "5"], ["--stesp", "known options", "--steps"]),
        (
            ["franka_group", "--online", "2", "--reward", "ground_truth"],
            ["'ground_truth' learns nothing from them", "rewards that do: rapl, rlhf"],
        ),
        (["franka_group", "--online", "2", "--reward", "imagenet"], ["'imagenet' learns nothing"]),
        (["franka_group", "--online", "1", "--reward", "tcc"], ["'tcc' learns nothing"]),
        (["franka_group", "--online", "1", "--encoder", "imagenet"], ["with encoder 'imagenet'"]),
        (["franka_group", "--online", "many"], ["'many'", "0 to 50"]),
        (
            ["franka_group", "--online-triplets", "50"],
            ["9 alignments", "50 rankings each, leave -300 of 150"],
        ),
        (["franka_group", "--online", "9", "--triplets", "9"], ["of 0 rankings each"]),
        (["franka_group", "--online", "2", "--groups", "2"], ["--groups 2", "another group"]),
        (["franka_group", "--online-triplets", "9", "--reward", "imagenet"], ["keeps no rankings"]),
        (["franka_group", "--trained", "all"], ["part to train 'all'", "head, last_block"]),
        (
            ["franka_group", "--trained", "last_block", "--reward", "imagenet"],
            ["'imagenet' has no head", "rapl, rlhf, tcc, tcc_ot"],
        ),
        (
            ["franka_group", "--trained", "last_block", "--online", "2"],
            ["--online with --trained last_block", "another backbone"],
        ),
        (["franka_group", "--strategy", "own"], ["unknown query strategy 'own'", "uniform"]),
        (["--resume"], ["needs a run folder or a task"]),
        (["franka_group", "--resume"], ["no unfinished run of franka_group"]),
    ],
)
def test_what_is_unknown_is_refused_and_the_known_is_named(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, argv: list[str], words: list[str]
) -> None:
    message = refusal(capsys, tmp_path, *argv)
    for word in words:
        assert word in message


def test_ground_truth_needs_no_rankings_and_imagenet_no_alignment() -> None:
    truth, imagenet = RunConfig("t", reward="ground_truth"), RunConfig("t", reward="imagenet")
    assert not truth.uses_rankings and not truth.aligns and truth.reward_encoder == ""
    assert imagenet.uses_rankings and not imagenet.aligns and imagenet.reward_encoder == "imagenet"
    assert RunConfig("t").aligns


def test_resume_takes_the_newest_unfinished_run_with_its_settings(tmp_path: Path) -> None:
    finished, open_run = tmp_path / "franka_group" / "a", tmp_path / "franka_group" / "b"
    for folder in (finished, open_run):
        folder.mkdir(parents=True)
        save_config(RunConfig("franka_group", seed=7, steps=500), folder)
    (finished / "results.json").write_text("{}")
    for argv in (["franka_group", "--resume"], ["--resume", "franka_group"]):
        request = ask(tmp_path, *argv)
        assert request.folder == open_run and request.resume
        assert request.config.seed == 7
    longer = ask(tmp_path, "--resume", str(finished), "--steps", "900")
    assert longer.config.steps == 900 and longer.folder == finished


def test_a_resumed_run_keeps_its_settings(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    folder = tmp_path / "franka_group" / "a"
    folder.mkdir(parents=True)
    save_config(RunConfig("franka_group", seed=7), folder)
    assert "started with seed 7" in refusal(
        capsys, tmp_path, "franka_group", "--resume", "--seed", "8"
    )
    assert "holds a run already" in refusal(capsys, tmp_path, "franka_group", "--out", str(folder))


def test_config_survives_the_disk_and_a_broken_one_is_named(tmp_path: Path) -> None:
    config = RunConfig("franka_group", reward="imagenet", seed=3, quick=True)
    save_config(config, tmp_path, {"versions": {"python": "3"}})
    assert load_config(tmp_path) == config
    (tmp_path / "config.yaml").write_text("run: {task: [")
    with pytest.raises(CorruptFileError, match=r"config\.yaml"):
        load_config(tmp_path)
    with pytest.raises(CorruptFileError, match="holds no run"):
        load_config(tmp_path / "elsewhere")


def test_a_folder_that_cannot_be_written_is_refused_before_anything_starts(tmp_path: Path) -> None:
    check_writable(tmp_path / "fine" / "run")
    assert list((tmp_path / "fine" / "run").iterdir()) == []
    (tmp_path / "file").write_text("")
    with pytest.raises(RaplError, match="cannot write to the run folder.*--out"):
        check_writable(tmp_path / "file" / "run")
    with pytest.raises(RaplError, match="cannot write to the run folder"):
        check_writable(Path("/proc/rapl"))


def test_a_full_disk_is_noticed_before_anything_starts_and_clear_later(tmp_path: Path) -> None:
    with full_disk():
        with pytest.raises(RaplError, match="cannot write to the run folder.*File too large"):
            check_writable(tmp_path)
        with pytest.raises(RaplError, match=r"cannot write the settings to .*config\.yaml"):
            save_config(RunConfig("franka_group"), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_listing_names_tasks_rewards_and_presets() -> None:
    text = listing({"franka_group": "push two cubes together"})
    for word in ("franka_group", "push two cubes together", "ground_truth", "authors_code"):
        assert word in text


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--strategy", "luck"], "unknown query strategy 'luck'; known: contest, coverage"),
        (["--noise", "none"], "unknown treatment of noise 'none'; known: estimated, plain"),
        (["--people", "ann"], "'ann' is no person, expected name:wish"),
        (["--people", "ann:task,ann:apart"], "a name comes twice"),
        (["--people", "ann:fame"], "unknown wish 'fame'; known: apart, opposite, progress, task"),
        (["--knobs", "beta=0"], "beta is 0"),
        (["--knobs", "luck=1"], "unknown knob of the simulated human 'luck'; known: beta"),
        (["--knobs", "skip=often"], "knob skip is 'often', expected a number"),
    ],
)
def test_what_people_are_and_how_they_are_asked_is_refused_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    with pytest.raises(SystemExit) as ended:
        parse(["franka_group", *arguments], ["franka_group"], tmp_path)
    assert ended.value.code == 2
    assert words in capsys.readouterr().err
