"""Episodes on disk: what goes in comes out, half of one is never seen, damage is named."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader

from rapl_core.episodes import EpisodeStore, JointTrack, read_episode, read_summary, write_episode
from rapl_core.episodes.bag_types import ACTION, STATE, definitions, typestore
from rapl_core.errors import CorruptFileError, RaplError, ShapeError, UnknownNameError
from rapl_core.types import Episode

REPOSITORY = Path(__file__).parents[3]

WRITER = """
import sys
import numpy as np
from rapl_core.episodes import EpisodeStore
from rapl_core.types import Episode

store = EpisodeStore(sys.argv[1])
frames = np.random.default_rng(0).integers(0, 256, (30, 64, 64, 3), dtype=np.uint8)
for number in range(10_000):
    store.add(Episode(
        f"e{number:05d}", "t", 0, "train", "c", frames, np.zeros((30, 2)), np.zeros((29, 1)),
        np.arange(30),
    ))
    print(f"e{number:05d}", flush=True)
"""


def make_episode(episode_id: str = "train-w1-0", world: int = 1, steps: int = 5) -> Episode:
    rng = np.random.default_rng(7)
    return Episode(
        episode_id=episode_id,
        task="franka_group",
        world=world,
        purpose="train",
        controller="learner",
        frames=rng.integers(0, 256, (steps + 1, 20, 24, 3), dtype=np.uint8),
        states=rng.normal(size=(steps + 1, 18)),
        actions=rng.uniform(-1, 1, (steps, 2)),
        stamps_ns=1_999_999_990_000_000_000 + np.arange(steps + 1, dtype=np.int64) * 80_000_001,
        human_rewards=rng.normal(size=steps + 1),
        success=True,
        behaviour="push together",
    )


def make_joints(steps: int = 5) -> JointTrack:
    rng = np.random.default_rng(8)
    shape = (steps + 1, 3)
    return JointTrack(("j1", "j2", "j3"), rng.normal(size=shape), rng.normal(size=shape))


def assert_equal(one: Episode, other: Episode) -> None:
    for name, value in vars(one).items():
        if isinstance(value, np.ndarray):
            got = getattr(other, name)
            assert got.dtype == value.dtype and np.array_equal(got, value), name
        else:
            assert getattr(other, name) == value, name


@pytest.fixture
def store(tmp_path: Path) -> EpisodeStore:
    return EpisodeStore(tmp_path / "episodes")


def test_an_episode_comes_back_to_the_last_bit(store: EpisodeStore) -> None:
    episode, joints = make_episode(), make_joints()
    path = store.add(episode, joints)
    assert path == store.folder / "train-w1-0"
    assert_equal(episode, store.load("train-w1-0"))
    assert np.array_equal(store.frames("train-w1-0"), episode.frames)
    got = store.joints("train-w1-0")
    assert got is not None and got.names == joints.names
    assert np.array_equal(got.positions, joints.positions)
    assert np.array_equal(got.velocities, joints.velocities)


def test_what_is_unknown_stays_unknown(store: EpisodeStore) -> None:
    episode = replace(make_episode(), human_rewards=None, success=None)
    store.add(episode)
    got = store.load(episode.episode_id)
    assert got.human_rewards is None and got.success is None
    assert store.joints(episode.episode_id) is None
    summary = store.summary(episode.episode_id)
    assert not summary.has_truth and summary.success is None and np.isnan(summary.human_return)


def test_the_summary_says_what_the_episode_says(store: EpisodeStore) -> None:
    episode = make_episode()
    store.add(episode, terminated=True)
    summary = store.summary(episode.episode_id)
    assert summary.human_return == episode.human_return
    assert (summary.success, summary.behaviour, summary.purpose) == (True, "push together", "train")
    assert (summary.steps, summary.image_height, summary.image_width) == (5, 20, 24)
    assert summary.terminated
    assert summary.last_stamp_ns == episode.stamps_ns[-1]


def test_any_rosbag_reader_finds_the_topics_of_the_graph(store: EpisodeStore) -> None:
    episode = make_episode()
    path = store.add(episode, make_joints(), terminated=True)
    with AnyReader([path], default_typestore=typestore()) as reader:
        counts = {c.topic: (c.msgtype, c.msgcount) for c in reader.connections}
        assert counts == {
            "/rapl/env_1/camera/image_raw": ("sensor_msgs/msg/Image", 6),
            "/rapl/env_1/joint_states": ("sensor_msgs/msg/JointState", 6),
            "/rapl/state": ("rapl_msgs/msg/State", 6),
            "/rapl/action": ("rapl_msgs/msg/Action", 5),
        }
        states = [
            (stamp, reader.deserialize(data, connection.msgtype))
            for connection, stamp, data in reader.messages()
            if connection.topic == "/rapl/state"
        ]
    stamp, last = states[-1]
    assert stamp == episode.stamps_ns[-1]
    assert last.image.stamp == last.header.stamp
    assert last.image.frame_id == "env_1/camera_optical_frame"
    assert [s.is_last for _, s in states] == [False] * 5 + [True]
    assert last.terminated and last.success and last.has_truth
    metadata = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert metadata["storage_identifier"] == "mcap"
    assert metadata["relative_file_paths"] == [f"{episode.episode_id}.mcap"]
    assert (path / f"{episode.episode_id}.mcap").read_bytes().startswith(b"\x89MCAP0\r\n")


def test_world_0_has_the_bare_topic_names(store: EpisodeStore) -> None:
    path = store.add(make_episode(world=0))
    with AnyReader([path], default_typestore=typestore()) as reader:
        assert "/rapl/camera/image_raw" in reader.topics


def test_what_is_defined_here_is_what_an_episode_needs_beyond_ros() -> None:
    assert set(definitions()) == {STATE, ACTION} == {"rapl_msgs/msg/State", "rapl_msgs/msg/Action"}


@pytest.mark.parametrize("kind", [STATE, ACTION])
def test_our_message_definitions_are_those_of_the_ros_package(kind: str) -> None:
    ros = REPOSITORY / "ros_ws" / "src" / f"{kind}.msg"
    assert definitions()[kind] == ros.read_text(), f"copy {ros} to rapl_core/episodes/messages"


@pytest.mark.parametrize("kind", [STATE, ACTION])
def test_type_hashes_are_those_of_the_built_messages(kind: str) -> None:
    built = Path(sys.prefix) / "share" / f"{kind}.json"
    if not built.exists():
        pytest.skip(f"{kind} is not built into this environment")
    hashes = {
        entry["type_name"]: entry["hash_string"]
        for entry in json.loads(built.read_text())["type_hashes"]
    }
    assert typestore().hash_rihs01(kind) == hashes[kind]


@pytest.mark.parametrize("share", [0.0, 0.3, 0.999])
def test_a_truncated_bag_is_named(store: EpisodeStore, share: float) -> None:
    path = store.add(make_episode())
    file = path / "train-w1-0.mcap"
    file.write_bytes(file.read_bytes()[: int(file.stat().st_size * share)])
    for read in (store.load, store.frames, store.joints):
        with pytest.raises(CorruptFileError, match=r"train-w1-0\.mcap is truncated"):
            read("train-w1-0")


def test_a_flipped_bit_is_noticed(store: EpisodeStore) -> None:
    path = store.add(make_episode())
    file = path / "train-w1-0.mcap"
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    with pytest.raises(CorruptFileError, match=r"train-w1-0\.mcap is truncated or was altered"):
        store.load("train-w1-0")


@pytest.mark.parametrize(
    ("file", "content", "complaint"),
    [
        ("summary.json", "{", "summary.json is no summary"),
        ("summary.json", '{"format": 99}', "format 99, expected 1"),
        ("summary.json", '{"format": 1, "human_return": 0}', "summary.json is no summary"),
        ("metadata.yaml", "nonsense: [", "train-w1-0.mcap cannot be read"),
    ],
)
def test_damaged_side_files_are_named(
    store: EpisodeStore, file: str, content: str, complaint: str
) -> None:
    path = store.add(make_episode())
    (path / file).write_text(content)
    with pytest.raises(CorruptFileError, match=complaint):
        store.load("train-w1-0")


def test_missing_files_are_named(store: EpisodeStore) -> None:
    path = store.add(make_episode())
    (path / "train-w1-0.mcap").unlink()
    with pytest.raises(CorruptFileError, match=r"train-w1-0\.mcap"):
        store.load("train-w1-0")
    with pytest.raises(CorruptFileError, match=r"summary\.json"):
        read_episode(store.folder / "nowhere")


def test_a_bag_that_has_too_few_messages_is_named(store: EpisodeStore) -> None:
    path = store.add(make_episode())
    summary = json.loads((path / "summary.json").read_text())
    summary["steps"] = 9
    (path / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(CorruptFileError, match="has 6 messages .*, expected 10"):
        store.load("train-w1-0")


def test_an_unknown_episode_names_those_there_are(store: EpisodeStore) -> None:
    store.add(make_episode("here"))
    with pytest.raises(UnknownNameError, match="'gone'; known: here"):
        store.load("gone")
    assert "here" in store and "gone" not in store and "../here" not in store and 3 not in store


def test_an_episode_is_stored_once(store: EpisodeStore) -> None:
    store.add(make_episode())
    with pytest.raises(RaplError, match="already stored"):
        store.add(make_episode(steps=3))
    assert store.load("train-w1-0").steps == 5


def test_ids_are_sorted_and_other_folders_passed_over(store: EpisodeStore) -> None:
    assert store.ids() == [] and store.summaries() == []
    for name in ("b", "a", "c"):
        store.add(make_episode(name))
    (store.folder / ".writing-abc").mkdir()
    (store.folder / "half").mkdir()
    assert store.ids() == ["a", "b", "c"]
    assert [s.episode_id for s in store.summaries()] == ["a", "b", "c"]
    assert len(store) == 3


def test_joints_of_another_length_are_refused(store: EpisodeStore) -> None:
    with pytest.raises(ShapeError, match="joints of 3 instants, expected 6"):
        store.add(make_episode(), make_joints(steps=2))
    assert store.ids() == []


def test_a_folder_that_cannot_be_written_is_a_clear_error() -> None:
    with pytest.raises(RaplError, match="cannot write episode train-w1-0 to /proc/self/episodes"):
        write_episode("/proc/self/episodes", make_episode())


def test_kill_9_leaves_complete_episodes_only(tmp_path: Path) -> None:
    folder = tmp_path / "episodes"
    writer = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(folder)], stdout=subprocess.PIPE, text=True
    )
    assert writer.stdout is not None
    announced = [writer.stdout.readline().strip() for _ in range(3)]
    writer.send_signal(signal.SIGKILL)
    announced += [line.strip() for line in writer.stdout if line.endswith("\n")]
    writer.wait(timeout=10)
    store = EpisodeStore(folder)
    assert set(announced) <= set(store.ids())
    for episode_id in store.ids():
        assert store.load(episode_id).steps == 29


def test_abandoned_half_written_episodes_are_removed_when_old(tmp_path: Path) -> None:
    old, new = tmp_path / ".writing-old", tmp_path / ".writing-new"
    for folder in (old, new):
        (folder / "e0").mkdir(parents=True)
    an_hour_ago = time.time() - 3600
    os.utime(old, (an_hour_ago, an_hour_ago))
    EpisodeStore(tmp_path)
    assert not old.exists() and new.exists()


def test_an_episode_folder_may_be_moved(store: EpisodeStore, tmp_path: Path) -> None:
    path = store.add(make_episode())
    moved = tmp_path / "elsewhere" / path.name
    shutil.copytree(path, moved)
    assert read_summary(moved) == store.summary(path.name)
    assert_equal(read_episode(moved), store.load(path.name))


def test_writing_and_reading_take_milliseconds(store: EpisodeStore) -> None:
    frames = np.full((61, 112, 112, 3), 200, dtype=np.uint8)
    rng = np.random.default_rng(0)
    frames[:, 60:] = 90 + rng.integers(0, 30, (52, 112, 3), dtype=np.uint8)
    wide = replace(make_episode(steps=60), frames=frames)
    store.add(replace(wide, episode_id="warm"))
    store.load("warm")
    write_s, read_s = [], []
    for number in range(5):
        began = time.perf_counter()
        store.add(replace(wide, episode_id=f"e{number}"))
        write_s.append(time.perf_counter() - began)
        began = time.perf_counter()
        store.load(f"e{number}")
        read_s.append(time.perf_counter() - began)
    # 17 ms each on an idle machine of two cores; the best of five, for the machine may be busy.
    assert min(write_s) < 0.1 and min(read_s) < 0.06
