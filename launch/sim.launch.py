"""The plant alone: sim_node with a scenario.

ros2 launch mother_rover sim.launch.py scenario:=tether_pendulum real_time_factor:=0.5
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

PARAMETERS = Path(get_package_share_directory("mother_rover")) / "config" / "jump.yaml"

ARGUMENTS = {
    "scenario": ("paper_table1_high", "name of a scenario of the package, or path of a .yaml file"),
    "overrides": ("", 'changes by dotted path, as YAML: "{start.slack: 2.0}"'),
    "real_time_factor": ("1.0", "simulated seconds per second; 0 = as fast as possible"),
    "seed": ("1", "seed of everything random"),
    "namespace": ("", "namespace of the rover"),
    "parameters": (str(PARAMETERS), "parameter file"),
    "log_level": ("info", "debug, info, warn, error"),
}


def generate_launch_description() -> LaunchDescription:
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=about)
        for name, (default, about) in ARGUMENTS.items()
    ]
    given = {
        "scenario": ParameterValue(LaunchConfiguration("scenario"), value_type=str),
        "overrides": ParameterValue(LaunchConfiguration("overrides"), value_type=str),
        "real_time_factor": ParameterValue(
            LaunchConfiguration("real_time_factor"), value_type=float
        ),
        "seed": ParameterValue(LaunchConfiguration("seed"), value_type=int),
    }
    plant = Node(
        package="mother_rover",
        executable="sim_node",
        namespace=LaunchConfiguration("namespace"),
        parameters=[LaunchConfiguration("parameters"), given],
        arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
        output="screen",
    )
    return LaunchDescription([*declared, plant])
