"""The main job on the real graph: interrupted, resumed, complete, and equal to rapl_core."""

import json

import numpy as np
import pytest
import yaml
from graph_run import WORLDS, FinishedRun, stages_shown
from rapl_msgs import msg as wire_msg
from rapl_msgs.action import Train
from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionClient
from ros_harness import Probe

from rapl_core.analysis.stages import read_stages
from rapl_core.episodes import EpisodeStore
from rapl_core.preferences import RankingStore
from rapl_core.representations import Encoder, make_encoder
from rapl_ros import conversions, topics

pytestmark = pytest.mark.timeout(900)

PATIENCE_S = 180.0
"""Seconds where the tests have the machine to themselves."""


def test_ctrl_c_ends_every_process_within_five_seconds(finished: FinishedRun) -> None:
    assert finished.stop_s < 5.0
    assert finished.left == []
    assert finished.stop_code == 130
    assert f"--resume {finished.folder}" in finished.first_text


def test_the_resumed_run_went_on_where_it_stopped(finished: FinishedRun) -> None:
    assert stages_shown(finished.first_text) == ["collect", "rank", "align"]
    shown = stages_shown(finished.run.text())
    assert shown == ["collect", "rank", "align", "train", "evaluate", "report"]
    for stage in ("collect", "rank", "align"):
        assert f"{stage:9}  done  earlier" in finished.run.text()
    stages = {stage.name: stage for stage in read_stages(finished.folder)}
    assert [stages[name].attempts for name in ("collect", "align", "train")] == [1, 1, 2]
    unasked = {"demonstrate"}  # demonstrations are for tcc alone
    found = {name: stage.status for name, stage in stages.items()}
    assert found == {name: "skipped" if name in unasked else "done" for name in stages}


def test_a_simulator_killed_while_the_robot_learns_is_missed_and_replaced(
    finished: FinishedRun,
) -> None:
    assert finished.missed_s < 5.0
    assert "simulator was killed by SIGKILL; restarting it" in finished.run.text()


def test_everything_is_on_disk(finished: FinishedRun) -> None:
    folder = finished.folder
    summaries = EpisodeStore(folder / "episodes").summaries()
    assert sum(s.purpose == "demonstrate" for s in summaries) == 12
    with RankingStore(folder / "rankings.sqlite") as store:
        assert store.count() == 12
    results = json.loads((folder / "results.json").read_text())
    assert results["triplets"] == 12
    assert results["success"]["final_episodes"] == 12
    assert 0.0 <= results["success"]["final"] <= 1.0
    assert results["success"]["by_step"]
    config = yaml.safe_load((folder / "config.yaml").read_text())
    assert config["run"]["worlds"] == 2 and config["versions"]["python"]
    page = (folder / "report.html").read_text()
    assert "together" in page and "data:image/jpeg;base64," in page
    text = finished.run.text()
    assert "All stages are done" in text and "ROS_DOMAIN_ID=" in text


def encoder_of(finished: FinishedRun) -> Encoder:
    return make_encoder("rapl", finished.folder)


def test_published_embeddings_equal_those_of_rapl_core_on_the_same_frames(
    finished: FinishedRun,
) -> None:
    probe, encoder = finished.probe, encoder_of(finished)
    pairs = [
        (picture, embedding)
        for picture in list(probe.pictures)
        if (embedding := probe.embeddings.get(conversions.key_from_ros(picture.header)))
        and embedding.version == encoder.info.version
    ]
    assert len(pairs) > 100
    chosen = pairs[:: len(pairs) // 40]
    frames = np.stack([conversions.image_from_ros(picture) for picture, _ in chosen])
    ours = encoder.embed(frames).astype(np.float64)  # (N, D)
    theirs = np.array([np.array(embedding.values) for _, embedding in chosen], dtype=np.float64)
    cosines = (ours * theirs).sum(1) / np.linalg.norm(ours, axis=1) / np.linalg.norm(theirs, axis=1)
    assert cosines.min() >= 0.99999
    np.testing.assert_allclose(theirs, ours, rtol=1e-3, atol=1e-3 * np.abs(ours).max())


def test_published_rewards_equal_those_of_rapl_core_from_the_published_embeddings(
    finished: FinishedRun,
) -> None:
    probe, encoder = finished.probe, encoder_of(finished)
    store = EpisodeStore(finished.folder / "episodes")
    experts = [encoder.embed_expert(e, store.frames(e)) for e in encoder.expert_ids]
    compared = 0
    for reward in probe.rewards:
        embedded = probe.embedded(reward.episode_id)
        if not reward.valid or embedded is None or reward.version != encoder.info.version:
            continue
        z = np.array([np.array(msg.values, dtype=np.float32) for msg in embedded])  # (T, D)
        trace = encoder.reward(z, experts)
        np.testing.assert_allclose(np.array(reward.values), trace.values, rtol=1e-6)
        assert reward.total == pytest.approx(trace.total, rel=1e-6)
        assert reward.scale == encoder.info.reward_scale
        compared += 1
    assert compared >= 8


def test_every_episode_that_ended_got_exactly_one_reward(finished: FinishedRun) -> None:
    probe = finished.probe
    rewarded = [reward.episode_id for reward in probe.rewards]
    assert len(rewarded) == len(set(rewarded))
    ended = {
        episode_id
        for episode_id, states in probe.states.items()
        if any(state.is_last for state in states.values())
    }
    unrewarded = ended - set(rewarded)
    # Ctrl-C may come between an episode's end and its reward: a controller lets no more than two
    # episodes a world wait for theirs.
    assert len(unrewarded & finished.seen_before) <= 2 * WORLDS
    assert unrewarded - finished.seen_before == set()


def test_stamps_increase_per_world_across_resets_and_the_restart(finished: FinishedRun) -> None:
    for world in range(2):
        stamps = sorted(
            (conversions.time_from_ros(state.header.stamp), state.episode_id, step)
            for states in finished.probe.states.values()
            for step, state in states.items()
            if state.world == world
        )
        assert len({stamp for stamp, _, _ in stamps}) == len(stamps)
        order = [episode_id for _, episode_id, _ in stamps]
        changes = sum(a != b for a, b in zip(order, order[1:], strict=False))
        assert changes == len(set(order)) - 1  # no episode is interleaved with another


def set_encoder(probe: Probe, name: str) -> tuple[bool, str]:
    return probe.set_parameter(topics.ENCODER, "encoder", name, PATIENCE_S)


def encoder_at_work(probe: Probe) -> str:
    response = probe.call(
        GetParameters, "encoder/get_parameters", GetParameters.Request(names=["encoder"])
    )
    return str(response.values[0].string_value)


def test_the_encoder_is_swapped_while_the_robot_learns(finished: FinishedRun) -> None:
    probe, run = finished.probe, finished.run
    pids = {child.pid for child in run.children()}
    client = ActionClient(probe.node, Train, topics.of_node(topics.TRAIN, topics.LEARNER))
    probe.until(client.server_is_ready, 20.0, "the learner serves train")
    handle = probe.wait(
        client.send_goal_async(Train.Goal(steps=100_000, resume=True)), 30.0, "the goal is taken"
    )
    assert handle.accepted
    try:
        first = len(probe.rewards)

        def newest_is(encoder: str) -> bool:
            news = probe.rewards[first:]
            return bool(news) and news[-1].valid and news[-1].encoder == encoder

        probe.until(lambda: newest_is("rapl"), PATIENCE_S, "rewards by rapl")
        assert set_encoder(probe, "imagenet") == (True, "")
        probe.until(lambda: newest_is("imagenet"), PATIENCE_S, "rewards by imagenet")

        successful, reason = set_encoder(probe, "no_such_encoder")
        assert not successful
        assert "no_such_encoder" in reason and "imagenet" in reason
        assert encoder_at_work(probe) == "imagenet"
        news = len(probe.rewards)
        probe.until(lambda: len(probe.rewards) > news + 2, PATIENCE_S, "rewards go on")
        assert newest_is("imagenet")

        assert set_encoder(probe, "rapl") == (True, "")
        probe.until(lambda: newest_is("rapl"), PATIENCE_S, "rewards by rapl again")
    finally:
        probe.wait(handle.cancel_goal_async(), 20.0, "the goal is cancelled")
        probe.wait(handle.get_result_async(), 30.0, "training ends")
    assert {child.pid for child in run.children()} == pids, "a node was restarted"
    check_no_mixed_episode(probe.rewards[first:], probe)


def check_no_mixed_episode(rewards: list[wire_msg.Reward], probe: Probe) -> None:
    """A valid reward comes from embeddings of its own version alone; a mixed one is dropped."""
    versions = {}
    for reward in rewards:
        embedded = probe.embedded(reward.episode_id)
        if embedded is None:
            continue
        seen = {msg.version for msg in embedded}
        versions[reward.episode_id] = seen
        if reward.valid:
            assert seen == {reward.version}
        if len(seen) > 1:
            assert not reward.valid and reward.reason
    assert any(len(seen) == 1 for seen in versions.values())


def test_a_look_from_outside_takes_no_part(finished: FinishedRun) -> None:
    """Who listens late still learns which world and encoder there are."""
    probe = Probe("late")
    try:
        from rapl_ros import qos

        infos = probe.listen(wire_msg.EncoderInfo, topics.ENCODER_INFO, qos.latched())
        worlds = probe.listen(wire_msg.WorldInfo, topics.WORLD_INFO, qos.latched())
        probe.until(lambda: infos and worlds, 20.0, "latched messages arrive")
        assert infos[-1].encoder == "rapl" and worlds[-1].worlds == 2
    finally:
        probe.close()
