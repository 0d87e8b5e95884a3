"""The simulated rover with its jump and winch controllers; all arguments of sim.launch.py hold.

ros2 launch mother_rover jump.launch.py
ros2 topic pub --once /jump/request sensor_msgs/msg/JointState \
    "{name: [jump_stroke], position: [0.2], velocity: [0.1], effort: [0.0]}"
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import (
    LaunchConfiguration,
    NotEqualsSubstitution,
    PathJoinSubstitution,
)
from launch_ros.actions import Node, PushROSNamespace, SetRemap
from launch_ros.substitutions import FindPackageShare

from msg_schemas import topics

PACKAGE = "mother_rover"
SHARE = FindPackageShare(PACKAGE)
CONTROLLERS = ("jump_node", "winch_node")


def generate_launch_description() -> LaunchDescription:
    sim = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(PathJoinSubstitution([SHARE, "launch", "sim.launch.py"]))
    )
    own_clock = SetRemap(
        topics.CLOCK,
        topics.CLOCK.strip("/"),
        condition=IfCondition(NotEqualsSubstitution(LaunchConfiguration("namespace"), "")),
    )
    controllers = [
        Node(
            package=PACKAGE,
            executable=name,
            parameters=[LaunchConfiguration(f"{name}_params_file"), {"use_sim_time": True}],
            arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
            output="screen",
        )
        for name in CONTROLLERS
    ]
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(
                    f"{name}_params_file",
                    default_value=PathJoinSubstitution([SHARE, "config", f"{name}.yaml"]),
                    description=f"parameters of {name}",
                )
                for name in CONTROLLERS
            ),
            sim,
            GroupAction(
                [PushROSNamespace(LaunchConfiguration("namespace")), own_clock, *controllers]
            ),
        ]
    )
