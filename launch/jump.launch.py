"""A jump to command by topic: plant, jump sequencer, winch, and a recorder if wanted.

ros2 launch mother_rover jump.launch.py scenario:=paper_table1_high record:=true
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.conditions import IfCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

SHARE = Path(get_package_share_directory("mother_rover"))


def generate_launch_description() -> LaunchDescription:
    # The plant's own arguments (scenario, overrides, real_time_factor, seed, namespace, parameters,
    # log_level) are declared by the file that it includes.
    plant = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(SHARE / "launch" / "sim.launch.py"))
    )
    recorded = [
        DeclareLaunchArgument("record", default_value="false", description="record a bag"),
        DeclareLaunchArgument("bag", default_value="jump_bag", description="folder of the bag"),
    ]
    log_level = ["--ros-args", "--log-level", LaunchConfiguration("log_level")]
    controllers = [
        Node(
            package="mother_rover",
            executable=name,
            namespace=LaunchConfiguration("namespace"),
            parameters=[LaunchConfiguration("parameters"), {"use_sim_time": True}],
            arguments=log_level,
            output="screen",
        )
        for name in ("jump_node", "winch_node")
    ]
    recorder = Node(
        package="mother_rover",
        executable="bag_record",
        namespace=LaunchConfiguration("namespace"),
        arguments=["--output", LaunchConfiguration("bag"), *log_level],
        condition=IfCondition(LaunchConfiguration("record")),
        output="screen",
    )
    return LaunchDescription([plant, *recorded, *controllers, recorder])
