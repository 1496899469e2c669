"""A node with a bit of everything that the stand-in shows; run as a process by its tests."""

import array
import sys

import rclpy
from rapl_msgs.msg import Reward, WorldInfo
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import Image
from std_srvs.srv import SetBool

RATE_HZ = 20.0


def allow(parameters: list[Parameter]) -> SetParametersResult:
    """Refuse every encoder but two."""
    for parameter in parameters:
        if parameter.name == "encoder" and parameter.value not in ("rapl", "imagenet"):
            reason = f"unknown encoder '{parameter.value}'; known: imagenet, rapl"
            return SetParametersResult(successful=False, reason=reason)
    return SetParametersResult(successful=True)


def main() -> None:
    """Publish until stopped."""
    rclpy.init(args=sys.argv)
    node = rclpy.create_node("subject", namespace="rapl")
    node.declare_parameter("encoder", "rapl", ParameterDescriptor(description="which encoder"))
    bounds = FloatingPointRange(from_value=0.5, to_value=4.0)
    node.declare_parameter(
        "rate_hz", 2.0, ParameterDescriptor(floating_point_range=[bounds], read_only=True)
    )
    node.add_on_set_parameters_callback(allow)

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    world_info = node.create_publisher(WorldInfo, "world_info", latched)
    world_info.publish(WorldInfo(task="franka_group", worlds=4, state_names=["x", "y"]))

    rewards = node.create_publisher(Reward, "reward", 10)
    reward = Reward(episode_id="e-1", valid=True, total=-1.5, values=[float(i) for i in range(130)])
    images = node.create_publisher(Image, "camera/image_raw", qos_profile_sensor_data)
    image = Image(height=2, width=100, encoding="rgb8", data=array.array("B", bytes(600)))

    def publish() -> None:
        rewards.publish(reward)
        images.publish(image)

    node.create_timer(1.0 / RATE_HZ, publish)

    def switch(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success, response.message = request.data, f"switched to {request.data}"
        return response

    node.create_service(SetBool, "~/switch", switch)
    try:
        rclpy.spin(node)
    except rclpy.executors.ExternalShutdownException:
        pass


if __name__ == "__main__":
    main()
