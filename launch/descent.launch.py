"""The hanging rover with winch and descent; all arguments of sim.launch.py hold.

ros2 launch mother_rover descent.launch.py record:=descent_bag
ros2 service call /winch/rearm std_srvs/srv/Trigger
ros2 topic pub --once /descent/request sensor_msgs/msg/JointState \
    "{name: [observation_stop], position: [12.0]}"
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
# Parameter files of each node, the last one's values hold.
FILES = {
    "winch_node": {"winch_node": "winch_node_params_file", "winch_descent": "winch_descent_file"},
    "descent_node": {"descent_node": "descent_node_params_file"},
}
# Other defaults than those of sim.launch.py.
SIMULATOR = {
    "scenario": ("marius_hills", "name of a spatial scenario, or path of a .yaml file"),
    "model": ("spatial", "a planar scenario is refused: it has neither wheels nor flywheel"),
    "overrides": (
        '{"winch.min_length": 1.4, "tether.element_length": 0.9}',
        "changes to the scenario by dotted path; by default the rover may come up to 1.6 m",
    ),
}


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
            parameters=[
                *(LaunchConfiguration(argument) for argument in files.values()),
                {"use_sim_time": True},
            ],
            arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
            output="screen",
        )
        for name, files in FILES.items()
    ]
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=about)
                for name, (default, about) in SIMULATOR.items()
            ),
            *(
                DeclareLaunchArgument(
                    argument,
                    default_value=PathJoinSubstitution([SHARE, "config", f"{file}.yaml"]),
                    description=f"parameters of {name}",
                )
                for name, files in FILES.items()
                for file, argument in files.items()
            ),
            sim,
            GroupAction(
                [PushROSNamespace(LaunchConfiguration("namespace")), own_clock, *controllers]
            ),
        ]
    )
