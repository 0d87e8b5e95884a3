"""Starts the processes of a launch plan as components of the loop host."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence

from rover_launch.nodes import NODES
from rover_launch.parameter_files import config_folder, read_parameters
from rover_launch.plan import ACTION, VIEW, LaunchPlan, arguments_of, plan
from rover_runtime.component import Component
from rover_runtime.loop_host import LoopHost

_ROS_ALONE = (VIEW, ACTION)
"""Executables that the ROS host alone carries."""

_OF_ROS_HOST = ("autostart", "realtime_priority", "use_sim_time", "lockstep", "delay_seed")

Parameters = Mapping[str, Mapping[str, object]]
"""Parameters by node and name."""


def component_class(executable: str) -> type[Component]:
    """Return the component of an executable.

    Raises:
        KeyError: there is none.
    """
    module = importlib.import_module(NODES[executable])
    for value in vars(module).values():
        if isinstance(value, type) and issubclass(value, Component) and executable == value.NAME:
            return value
    msg = f"{module.__name__} has no component {executable}"
    raise KeyError(msg)


def make_plan(
    controllers: Sequence[str], defaults: Mapping[str, str], given: Mapping[str, str]
) -> LaunchPlan:
    """Return the plan of a launch with the shipped parameter files.

    Args:
        controllers: executables of the controllers.
        defaults: of arguments, as a launch file gives them.
        given: arguments on the command line.
    """
    arguments = arguments_of(controllers, str(config_folder()), defaults)
    return plan(controllers, {each.name: each.default for each in arguments} | dict(given))


def start_plan(
    host: LoopHost, planned: LaunchPlan, changed: Parameters | None = None
) -> dict[str, dict[str, object]]:
    """Start plant and controllers of a plan.

    Args:
        host: that carries them.
        planned: plan of the launch.
        changed: parameters that override those of the plan.

    Returns:
        The parameters of each component, for its restart.
    """
    parameters: dict[str, dict[str, object]] = {}
    started = [each for each in planned.started if each.executable not in _ROS_ALONE]
    nodes = [(name, each) for each in started for name in each.node_names]
    for name, each in nodes:
        values = read_parameters(each.files, name) | dict(each.parameters)
        values |= (changed or {}).get(name, {})
        parameters[name] = {k: v for k, v in values.items() if k not in _OF_ROS_HOST}
        host.start(component_class(name), parameters[name])
    return parameters
