"""The whole graph, or a part of it, with ros2 launch.

ros2 launch rapl_bringup rapl.launch.py task:=franka_group
ros2 launch rapl_bringup rapl.launch.py --show-args
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, SetEnvironmentVariable
from launch.events import Shutdown
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node

from rapl_ros.launching import ARGUMENTS, ENVIRONMENT, plan


def _nodes(context: LaunchContext) -> list[Node]:
    given = {
        argument.name: LaunchConfiguration(argument.name).perform(context) for argument in ARGUMENTS
    }
    return [
        Node(
            package="rapl_ros",
            executable=node.executable,
            name=node.name,
            namespace=node.namespace,
            parameters=[node.parameters, *node.parameter_files],
            output="screen",
            # The nodes go on where they stopped; the graph is over when the conductor is.
            respawn=not node.ends,
            respawn_delay=1.0,
            on_exit=EmitEvent(event=Shutdown(reason="all stages are done")) if node.ends else None,
        )
        for node in plan(given)
    ]


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments; the nodes follow from their values."""
    declared = [
        DeclareLaunchArgument(
            argument.name, default_value=argument.default, description=argument.description
        )
        for argument in ARGUMENTS
    ]
    unless_set = [
        SetEnvironmentVariable(name, EnvironmentVariable(name, default_value=value))
        for name, value in ENVIRONMENT.items()
    ]
    return LaunchDescription([*declared, *unless_set, OpaqueFunction(function=_nodes)])
