"""The simulated rover: sim_node, and on request a recorder.

ros2 launch mother_rover sim.launch.py scenario:=lunar_jump real_time_factor:=2.0 record:=bag1
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node, PushROSNamespace, SetRemap
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from msg_schemas import topics

PACKAGE = "mother_rover"
PARAMS_FILE = PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "sim_node.yaml"])

# Parameters of sim_node that go before those of its file where they are given: type, meaning.
PARAMETERS = {
    "scenario": (str, "name of a scenario of the package, or path of a .yaml file"),
    "model": (str, "planar or spatial: refuse a scenario of another; scenario: take what it says"),
    "overrides": (str, 'changes to the scenario by dotted path: {"start.slack": 2.0}'),
    "real_time_factor": (float, "simulated seconds per second; 0 = as fast as possible"),
    "start_paused": (bool, "true: simulated time stands still until stepped or resumed"),
    "duration": (float, "end after this much simulated time [s]; 0 = never"),
    "seed": (int, "seed of the sensors' errors"),
}
ARGUMENTS = {
    "sim_params_file": (PARAMS_FILE, "parameters of sim_node"),
    "namespace": ("", "of all nodes; each namespace has a clock of its own"),
    "record": ("", "folder to create for a bag; empty = no recorder"),
    "log_level": ("info", "debug, info, warn, error or fatal"),
}


def nodes(context: LaunchContext) -> list[GroupAction]:
    def argument(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    log_level = ["--ros-args", "--log-level", argument("log_level")]
    given = {
        name: ParameterValue(LaunchConfiguration(name), value_type=kind)
        for name, (kind, _) in PARAMETERS.items()
        if argument(name)
    }
    actions = [PushROSNamespace(argument("namespace"))]
    if argument("namespace"):
        actions.append(SetRemap(topics.CLOCK, topics.CLOCK.strip("/")))
    actions.append(
        Node(
            package=PACKAGE,
            executable="sim_node",
            parameters=[argument("sim_params_file"), given],
            arguments=log_level,
            output="screen",
            on_exit=Shutdown(reason="the simulator has ended"),
        )
    )
    if argument("record"):
        actions.append(
            Node(
                package=PACKAGE,
                executable="bag_record",
                arguments=["--output", argument("record"), *log_level],
                output="screen",
            )
        )
    return [GroupAction(actions)]


def generate_launch_description() -> LaunchDescription:
    declared = [
        DeclareLaunchArgument(name, default_value="", description=f"{about}; empty = as the file")
        for name, (_, about) in PARAMETERS.items()
    ]
    declared += [
        DeclareLaunchArgument(name, default_value=default, description=about)
        for name, (default, about) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])
