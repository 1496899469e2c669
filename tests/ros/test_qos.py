"""Queues are deep enough for what back-pressure lets accumulate."""

from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import Image

from rapl_core.tasks import get_task, task_names
from rapl_ros import qos, topics


def test_the_stream_depth_holds_three_episodes_of_eight_worlds_of_every_task():
    for name in task_names():
        assert qos.stream_depth(8, get_task(name).horizon) <= qos.STREAM_DEPTH
    assert qos.stream_depth(4, 60) == 3 * 4 * 61


def test_an_override_changes_its_own_profile_only():
    profile = qos.stream()
    profile.reliability = ReliabilityPolicy.BEST_EFFORT
    assert qos.stream().reliability == ReliabilityPolicy.RELIABLE


def test_a_reader_that_stalls_loses_nothing(probe):
    """KEEP_LAST loses silently: a full depth of messages must wait for a reader that is busy."""
    writer = Node("writer", namespace=topics.NAMESPACE)
    try:
        publisher = writer.create_publisher(Image, topics.CAMERA_IMAGE, qos.stream())
        images = probe.listen(Image, topics.CAMERA_IMAGE, qos.stream())
        probe.until(lambda: publisher.get_subscription_count() == 1, 10.0, "discovery")
        count = qos.stream_depth(4, 60)
        for index in range(count):  # the probe does not spin meanwhile
            publisher.publish(Image(width=index, data=bytes(112 * 112 * 3)))
        probe.until(lambda: len(images) == count, 30.0, f"all {count} images arrive")
        assert [image.width for image in images] == list(range(count))
    finally:
        writer.destroy_node()
