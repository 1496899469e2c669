"""Messages and rapl_core's types, there and back."""

import io
from array import array

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image as PillowImage
from rapl_msgs import msg as wire_msg
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CompressedImage, Image

from rapl_core.errors import RankingError, ShapeError
from rapl_core.types import EmbeddedEpisode, ExpertSet, Ranking, RewardTrace
from rapl_ros import conversions
from rapl_ros.wire import (
    Command,
    EmbeddedFrame,
    EpisodeRecord,
    EpisodeReward,
    Instant,
    JoinKey,
    World,
    answer,
)

KEY = JoinKey("env_0/camera_optical_frame", 1_795_000_000_123_456_789)


def over_the_wire(msg):
    """What arrives when ``msg`` is sent."""
    return deserialize_message(serialize_message(msg), type(msg))


def an_instant(**changes) -> Instant:
    values = dict(
        key=JoinKey("env_1/world", KEY.stamp_ns),
        image=KEY,
        world=np.uint16(1),
        episode_id="train-s1-w1-000000-ab",
        purpose="train",
        controller="learner",
        step=np.int64(3),
        is_last=np.bool_(True),
        terminated=np.bool_(False),
        values=np.arange(18, dtype=np.float32) / 7,
        human_reward=np.float32(-0.25),
        success=np.bool_(True),
    )
    return Instant(**(values | changes))


@given(st.integers(min_value=0, max_value=2**31 * 10**9 - 1))
def test_a_stamp_survives_the_round_trip_to_the_nanosecond(stamp_ns):
    assert conversions.time_from_ros(conversions.time_to_ros(stamp_ns)) == stamp_ns


def test_a_state_of_numpy_scalars_arrives_as_it_was():
    instant = an_instant()
    back = conversions.state_from_ros(over_the_wire(conversions.state_to_ros(instant)))
    assert back.key == instant.key and back.image == instant.image
    assert (back.world, back.step, back.is_last, back.terminated) == (1, 3, True, False)
    assert back.human_reward == -0.25 and back.success is True
    np.testing.assert_array_equal(back.values, instant.values)


def test_an_unknown_truth_arrives_as_unknown():
    msg = conversions.state_to_ros(an_instant(human_reward=None, success=None))
    assert not msg.has_truth
    back = conversions.state_from_ros(over_the_wire(msg))
    assert back.human_reward is None and back.success is None


def test_a_state_with_nan_is_refused_by_episode_and_step():
    msg = conversions.state_to_ros(an_instant())
    msg.values[4] = float("nan")
    with pytest.raises(ShapeError, match=r"train-s1-w1-000000-ab at step 3 has 1 NaN"):
        conversions.state_from_ros(msg)


def test_a_malformed_episode_id_is_refused():
    msg = conversions.state_to_ros(an_instant())
    msg.episode_id = "../etc/passwd"
    with pytest.raises(ShapeError, match="episode id"):
        conversions.state_from_ros(msg)


def test_an_answer_carries_episode_step_and_header_of_its_state():
    instant = an_instant()
    command = answer(instant, [np.float32(0.5), -1], "mime")
    back = conversions.action_from_ros(over_the_wire(conversions.action_to_ros(command)))
    assert isinstance(back, Command)
    assert (back.key, back.world, back.step) == (instant.key, 1, 3)
    assert (back.episode_id, back.controller) == (instant.episode_id, "learner")
    assert back.behaviour == "mime"
    np.testing.assert_array_equal(back.values, [0.5, -1.0])


def test_an_action_with_infinity_is_refused():
    msg = conversions.action_to_ros(answer(an_instant(), [0.0, 1.0]))
    msg.values[1] = float("inf")
    with pytest.raises(ShapeError, match="first at 1"):
        conversions.action_from_ros(msg)


def test_an_rgb_picture_arrives_as_it_was(rng):
    frame = rng.integers(0, 256, (5, 7, 3), dtype=np.uint8)
    msg = conversions.image_to_ros(frame, KEY)
    assert isinstance(msg._data, array)  # a numpy array would cost tenths of a second
    back = over_the_wire(msg)
    assert conversions.key_from_ros(back.header) == KEY
    np.testing.assert_array_equal(conversions.image_from_ros(back), frame)


def test_a_picture_that_is_a_view_is_sent_in_reading_order(rng):
    frame = rng.integers(0, 256, (5, 7, 3), dtype=np.uint8)
    back = conversions.image_from_ros(conversions.image_to_ros(frame[::-1, ::2], KEY))
    np.testing.assert_array_equal(back, frame[::-1, ::2])


@given(
    width=st.integers(1, 9),
    height=st.integers(1, 9),
    padding=st.integers(0, 5),
    encoding=st.sampled_from(sorted(conversions.ENCODINGS)),
    seed=st.integers(0, 1000),
)
def test_every_known_encoding_is_read_with_padded_rows(width, height, padding, encoding, seed):
    channels, order = conversions.ENCODINGS[encoding]
    pixels = np.random.default_rng(seed).integers(0, 256, (height, width, channels), np.uint8)
    step = width * channels + padding
    rows = np.full((height, step), 99, np.uint8)
    rows[:, : width * channels] = pixels.reshape(height, -1)
    msg = Image(width=width, height=height, step=step, encoding=encoding, data=rows.tobytes())
    expected = np.stack([pixels[..., channel] for channel in order], axis=-1)
    np.testing.assert_array_equal(conversions.image_from_ros(msg), expected)


def test_bgr_is_turned_round():
    msg = Image(width=1, height=1, step=3, encoding="bgr8", data=bytes([1, 2, 3]))
    assert conversions.image_from_ros(msg).tolist() == [[[3, 2, 1]]]


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"data": bytes(35)}, "expected height \\* step = 36 bytes"),
        ({"data": bytes(37)}, "expected height \\* step = 36 bytes"),
        ({"data": b""}, "and 0 bytes"),
        ({"step": 11}, "expected a step of at least 12"),
        ({"width": 0, "step": 0, "data": b""}, "has no pixels"),
        ({"height": 0, "data": b""}, "has no pixels"),
        ({"encoding": "32FC1"}, "known: bgr8, bgra8, mono8, rgb8, rgba8"),
        ({"encoding": ""}, "unknown encoding"),
    ],
)
def test_a_corrupt_picture_is_refused_with_its_numbers(changes, complaint):
    fields = dict(width=4, height=3, step=12, encoding="rgb8", data=bytes(36)) | changes
    with pytest.raises(ShapeError, match=complaint) as refused:
        conversions.image_from_ros(Image(**fields))
    for name in ("width", "height", "step"):
        assert f"{name}={fields[name]}" in str(refused.value)
    assert f"{len(fields['data'])} bytes" in str(refused.value)


@pytest.mark.parametrize("kind", ["png", "jpeg"])
def test_a_compressed_picture_is_read(kind):
    frame = np.full((16, 24, 3), (200, 100, 50), np.uint8)
    encoded = io.BytesIO()
    PillowImage.fromarray(frame).save(encoded, kind)
    msg = CompressedImage(format=f"rgb8; {kind} compressed bgr8", data=encoded.getvalue())
    read = conversions.compressed_image_from_ros(msg)
    assert read.shape == frame.shape
    assert np.abs(read.astype(int) - frame).max() <= (0 if kind == "png" else 4)


@pytest.mark.parametrize("cut", [0, 3, 60])
def test_a_truncated_compressed_picture_is_refused(cut):
    encoded = io.BytesIO()
    noise = np.random.default_rng(0).integers(0, 256, (16, 24, 3), np.uint8)
    PillowImage.fromarray(noise).save(encoded, "png")
    msg = CompressedImage(format="png", data=encoded.getvalue()[:cut])
    with pytest.raises(ShapeError, match=f"format='png' and {cut} bytes"):
        conversions.compressed_image_from_ros(msg)


def test_the_cameras_focal_length_follows_from_its_field_of_view():
    info = conversions.camera_info_to_ros(KEY, 200, 100, fovy_deg=90.0)
    assert info.k[0] == pytest.approx(50.0) and info.k[4] == pytest.approx(50.0)
    assert (info.k[2], info.k[5]) == (100.0, 50.0)
    assert (info.width, info.height, len(info.p)) == (200, 100, 12)


def test_an_embedding_copies_the_header_of_its_image():
    frame = EmbeddedFrame(KEY, "rapl", "0123456789abcdef", np.linspace(-1, 1, 32, dtype=np.float32))
    back = conversions.embedding_from_ros(over_the_wire(conversions.embedding_to_ros(frame)))
    assert back.image == KEY and back.encoder == "rapl" and back.version == "0123456789abcdef"
    np.testing.assert_array_equal(back.values, frame.values)


def test_experts_survive_and_a_wrong_number_of_values_is_refused(rng):
    values = rng.normal(size=(4, 3)).astype(np.float32)
    experts = ExpertSet("rapl", "v", (EmbeddedEpisode("a", values), EmbeddedEpisode("b", -values)))
    msg = over_the_wire(conversions.experts_to_ros(experts, KEY.stamp_ns))
    back = conversions.experts_from_ros(msg)
    assert [expert.episode_id for expert in back.experts] == ["a", "b"]
    np.testing.assert_array_equal(back.experts[1].values, -values)
    msg.experts[1].frames = 5
    with pytest.raises(ShapeError, match=r"video b has 12 values.*5 \* 3"):
        conversions.experts_from_ros(msg)


def test_a_reward_survives_and_a_dropped_episode_has_its_reason(rng):
    whose = EpisodeReward(KEY, "e-1", 2, "train", "rapl", "v")
    trace = RewardTrace(
        values=-rng.random(6),
        expert_id="x",
        transport_cost=np.float32(0.5),
        converged=np.bool_(True),
        iterations=np.int64(12),
        marginal_error=np.float64(1e-9),
        scale=np.float32(2.0),
    )
    msg = over_the_wire(conversions.reward_to_ros(whose, trace))
    assert msg.valid and msg.total == pytest.approx(trace.total)
    back_whose, back = conversions.reward_from_ros(msg)
    assert back_whose == whose and back is not None
    np.testing.assert_array_equal(back.values, trace.values)
    assert (back.transport_cost, back.iterations, back.converged) == (0.5, 12, True)
    dropped = over_the_wire(conversions.invalid_reward_to_ros(whose, "image missing at step 17"))
    assert conversions.reward_from_ros(dropped) == (whose, None)
    assert dropped.reason == "image missing at step 17"


def test_an_episode_record_survives():
    record = EpisodeRecord(
        KEY, "e-1", "franka_group", 1, "demonstrate", "demonstrator", "mime", 60, "episodes/e-1",
        np.float64(-31.5), np.bool_(False),
    )  # fmt: skip
    back = conversions.episode_record_from_ros(
        over_the_wire(conversions.episode_record_to_ros(record))
    )
    assert back == record


def test_a_world_survives():
    world = World(
        "franka_group", 4, 0.08, 60, True, ("x",), ("m",), ("forward", "left"), ("a", "b"), 7
    )
    msg = over_the_wire(conversions.world_to_ros(world, 5))
    assert conversions.world_from_ros(msg) == world


def test_a_ranking_survives_with_ties_and_an_unknown_verdict_is_refused():
    ranking = Ranking(
        "r-1", "ann", ("a", "b", "c"), (1, 1, 3), "ranked", "q", 1.5, KEY.stamp_ns, "r-0"
    )
    msg = over_the_wire(conversions.ranking_to_ros(ranking))
    assert conversions.ranking_from_ros(msg) == ranking
    msg.verdict = 9
    with pytest.raises(RankingError, match="verdict 9; known: 0 = ranked"):
        conversions.ranking_from_ros(msg)


def test_a_ranking_that_repeats_a_video_is_refused():
    msg = wire_msg.Ranking(ranking_id="r", episode_ids=["a", "a"], ranks=array("H", [1, 2]))
    with pytest.raises(RankingError, match="repeats a"):
        conversions.ranking_from_ros(msg)


@pytest.fixture
def rng():
    return np.random.default_rng(0)
