"""Convert a launch plan to a launch description of ROS 2; needs a sourced ROS 2."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction, Shutdown
from launch.launch_context import LaunchContext
from launch.launch_description import LaunchDescription
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from msg_schemas import topics
from msg_schemas.access import TRANSFORMS
from msg_schemas.access_policy import enclave
from msg_schemas.package import PACKAGE
from rover_launch.plan import LaunchPlan, ProcessSpec, arguments_of, plan, unknown_arguments


def describe(*controllers: str, **defaults: str) -> LaunchDescription:
    """Return the launch description of the plant, controllers, optional recorder and viewer.

    Args:
        controllers: executables of the controllers.
        defaults: of arguments, in place of those of `plan.arguments_of`.
    """
    config = str(Path(get_package_share_directory(PACKAGE)) / "config")
    arguments = arguments_of(controllers, config, defaults)

    def act(context: LaunchContext) -> list[Any]:
        given = {each.name: LaunchConfiguration(each.name).perform(context) for each in arguments}
        names = [each.partition(":=")[0] for each in context.argv if ":=" in each]
        unknown = unknown_arguments(names, [each.name for each in arguments])
        return [*(LogInfo(msg=each) for each in unknown), *_actions(plan(controllers, given))]

    declared = [
        DeclareLaunchArgument(
            each.name,
            default_value=each.default,
            description=each.about,
            **({"choices": each.choices} if each.choices else {}),
        )
        for each in arguments
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=act)])


def _actions(planned: LaunchPlan) -> list[Any]:
    messages = [LogInfo(msg=message) for message in planned.messages]
    return [*messages, *(_node(each, planned) for each in planned.started)]


def _node(started: ProcessSpec, planned: LaunchPlan) -> Node:
    shutdown = (
        {"on_exit": Shutdown(reason=started.shutdown_reason)} if started.shutdown_reason else {}
    )
    # The clock's name is absolute by convention; each namespace has its own clock.
    # So are those of the frames for tf2's listeners.
    absolute = (topics.CLOCK, *(f"/{name}" for name in TRANSFORMS))
    own = [(name, name.strip("/")) for name in absolute] if planned.namespace else []
    return Node(
        package=started.package,
        executable=started.executable,
        namespace=planned.namespace,
        parameters=[*started.files, dict(started.parameters)],
        remappings=own,
        arguments=[
            *started.arguments,
            "--ros-args",
            *("--enclave", enclave(started.enclave_name, f"/{planned.namespace.strip('/')}")),
            *("--log-level", planned.log_level),
        ],
        output="screen",
        **shutdown,
    )
