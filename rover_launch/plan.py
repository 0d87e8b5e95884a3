"""Plan of a launch: processes and their parameters. Pure: imports no ROS.

All launch files share the arguments of `arguments_of` and the function `plan`, which plans the
plant, the controllers, the recorder and the viewer in one namespace with its own clock, so that
several rovers can run at the same time.
"""

from __future__ import annotations

import argparse
import difflib
import os
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeAlias

from msg_schemas.access import COMPOSED
from msg_schemas.name_arguments import namespace
from msg_schemas.package import PACKAGE

SIM, MOCK, HIL = "sim", "mock", "hil"
SPATIAL = "spatial"
EMULATED = "emulated"
FALSE, TRUE = "false", "true"
VIEWER = "rviz2"
CONSOLE = "console"
VIEW = "view_node"
ACTION = "action_node"
_FRAMES = "frames"
ACTIONS = "actions"
_PAGE = "operator_console"

Value: TypeAlias = str | float | int | bool

PLANTS: Mapping[str, str] = {
    SIM: "sim_node",
    MOCK: "mock_plant",
    HIL: "hil_bridge",
}
"""Executable of each kind of plant."""

PARAMETERS: Mapping[str, tuple[type[Value], str]] = {
    "scenario": (str, "name of a scenario of the package, or path of a .yaml file"),
    "overrides": (str, 'overrides of the scenario by dotted path: {"start.slack": 2.0}'),
    "start_state": (str, "file of a saved state in which the plant starts"),
    "seed": (int, "seed of the sensors' errors"),
    "model": (str, "scenario: the scenario's model; planar, spatial: refuse another model"),
    "real_time_factor": (float, "simulated seconds per second; 0 = as fast as possible"),
    "start_paused": (bool, "true: start with simulated time paused"),
    "duration": (float, "simulated time after which the plant ends [s]; 0 = never"),
}
"""Arguments that override parameters of the plant's file: type, meaning."""

EMULATOR_PARAMETERS = ("scenario", "overrides", "start_state", "seed")
"""The parameters among them that the drive emulator has."""

LOCKSTEP = "lockstep"
"""Processes for which simulated time waits, a parameter of every node."""

PRIORITY = "realtime_priority"
"""Real-time priority, a parameter of every node; set for plant and controllers."""

EXTRA_FILES_WITH_DESCENT: Mapping[str, tuple[str, ...]] = {"winch_node": ("winch_descent",)}
"""Additional parameter files of a controller that runs together with `descent_node`."""

_OF_LOCKSTEP = ("participants", "delay_seed")

_FILE_ARGUMENTS = {"sim_node": "sim_params_file", "winch_descent": "winch_descent_file"}

HANGING_DEFAULTS: Mapping[str, str] = {
    "scenario": "marius_hills",
    "model": SPATIAL,
    "overrides": '{"winch.min_length": 1.4, "tether.element_length": 0.9}',
}
"""Defaults for the hanging rover, which may rise to 1.6 m below the fairlead."""


class LaunchError(ValueError):
    """An invalid argument; the message has its name, value and the valid values."""


@dataclass(frozen=True)
class LaunchArgument:
    """One argument of a launch file."""

    name: str
    default: str
    about: str
    choices: tuple[str, ...] = ()


@dataclass(frozen=True)
class ProcessSpec:
    """A process to start.

    Attributes:
        files: parameter files; later files override earlier ones.
        parameters: override those of the files.
        arguments: before ``--ros-args``.
        shutdown_reason: reason to end the launch when the process ends; empty: none.
        nodes: its nodes; empty: one of the executable's name.
    """

    executable: str
    package: str = PACKAGE
    files: tuple[str, ...] = ()
    parameters: Mapping[str, Value] = field(default_factory=dict)
    arguments: tuple[str, ...] = ()
    shutdown_reason: str = ""
    nodes: tuple[str, ...] = ()

    @property
    def node_names(self) -> tuple[str, ...]:
        """Names of its nodes."""
        return self.nodes or (self.executable,)

    @property
    def enclave_name(self) -> str:
        """Name of its access enclave; processes of other packages have the operator's."""
        return self.executable if self.package == PACKAGE else "operator"


@dataclass(frozen=True)
class LaunchPlan:
    """The processes of a launch.

    Attributes:
        namespace: of all processes; empty: none.
        log_level: of all nodes of the suite.
        messages: to be logged for the operator.
    """

    namespace: str
    log_level: str
    started: tuple[ProcessSpec, ...]
    messages: tuple[str, ...] = ()


_ARGUMENTS = (
    LaunchArgument(
        "drives",
        EMULATED,
        "with plant:=hil: emulated, or the link to real drives: socketcan:can0, "
        "serial:/dev/ttyUSB0:3000000",
    ),
    LaunchArgument(
        "link",
        "",
        "link to emulated drives, one per rover, with plant:=hil; empty = as in the files",
    ),
    LaunchArgument(
        PRIORITY,
        "",
        "SCHED_RR priority of plant and controllers, from 1; empty = normal scheduling",
    ),
    LaunchArgument(
        LOCKSTEP,
        "",
        "true: simulated time waits for plant and controllers; a busy machine is slow, and "
        "the same requests give the same messages; empty = false with plant:=hil, true "
        "otherwise",
        ("", FALSE, TRUE),
    ),
    LaunchArgument(
        "participants",
        "",
        "further nodes, separated by commas, for which simulated time waits in lockstep",
    ),
    LaunchArgument("delay_seed", "", "seed of the messages' delays in lockstep; empty = 1"),
    LaunchArgument(
        "composed",
        TRUE,
        f"true: {', '.join(COMPOSED)} run the controllers, one process each; false: each "
        "controller has a process of its own",
        (FALSE, TRUE),
    ),
    LaunchArgument("namespace", "", "of all nodes; each namespace has its own clock"),
    LaunchArgument("record", "", "new folder for the bag; empty = no recorder"),
    LaunchArgument(
        _FRAMES,
        TRUE,
        f"true: {VIEW} publishes tf, tf_static and joint_states, as rviz:=true needs",
        (FALSE, TRUE),
    ),
    LaunchArgument(
        ACTIONS,
        FALSE,
        f"true: {ACTION} offers descend, turn, drive, jump and mission as actions",
        (FALSE, TRUE),
    ),
    LaunchArgument("rviz", FALSE, "true: RViz with the package's view", (FALSE, TRUE)),
    LaunchArgument(
        CONSOLE,
        FALSE,
        "true: the operators' page, on this machine only",
        (FALSE, TRUE),
    ),
    LaunchArgument(
        "log_level", "info", "of all nodes", ("debug", "info", "warn", "error", "fatal")
    ),
)
"""Arguments of all launch files besides those of the plant and of files."""


def files_of(controllers: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the names of the parameter files in ``config/``, without suffix, by executable.

    Later files override earlier ones.
    """
    files: dict[str, tuple[str, ...]] = {
        name: (name,) for name in (*PLANTS.values(), "drive_emulator", VIEW)
    }
    for name in controllers:
        additional = EXTRA_FILES_WITH_DESCENT.get(name, ()) if "descent_node" in controllers else ()
        files[name] = (name, *additional)
    return files


def arguments_of(
    controllers: Sequence[str], config: str, defaults: Mapping[str, str]
) -> tuple[LaunchArgument, ...]:
    """Return the arguments of a launch file.

    Args:
        controllers: of the launch file.
        config: folder of the parameter files.
        defaults: of arguments, in place of the usual ones.
    """
    found = [
        LaunchArgument(
            "plant",
            SIM,
            "sim: simulated; mock: follows commands exactly; hil: drives on a link",
            tuple(PLANTS),
        ),
        *(
            LaunchArgument(name, "", f"{about}; empty = as in the file")
            for name, (_, about) in PARAMETERS.items()
        ),
        *_ARGUMENTS,
        LaunchArgument("rviz_config", f"{config}/mother_rover.rviz", "view configuration of RViz"),
        *(
            LaunchArgument(_argument_of(file), f"{config}/{file}.yaml", f"parameters of {name}")
            for name, files in {**files_of(controllers), _PAGE: (_PAGE,)}.items()
            for file in files
        ),
    ]
    unknown = defaults.keys() - {argument.name for argument in found}
    if unknown:
        raise LaunchError(f"no launch file has the argument {sorted(unknown)[0]}")
    return tuple(
        LaunchArgument(each.name, defaults.get(each.name, each.default), each.about, each.choices)
        for each in found
    )


def plan(
    controllers: Sequence[str],
    given: Mapping[str, str],
    find: Callable[[str], str | None] = shutil.which,
) -> LaunchPlan:
    """Plan the processes of a launch.

    Args:
        controllers: executables of the controllers.
        given: value of each argument of `arguments_of`.
        find: returns the path of a command, or None.

    Raises:
        LaunchError: a value has the wrong type, or the argument does not apply to the plant.
    """
    _check_plant(given)
    try:
        namespace(given["namespace"])
    except argparse.ArgumentTypeError as error:
        raise LaunchError(f"namespace: {error}") from None
    kind = given["plant"]
    simulated_time = kind != HIL or given["drives"] == EMULATED
    # Drives on a link have a time of their own, as hardware has, unless it is asked for.
    in_lockstep = given[LOCKSTEP] == TRUE or (not given[LOCKSTEP] and kind != HIL)
    if in_lockstep and not simulated_time:
        raise LaunchError(f"{LOCKSTEP} is true: it must be false with real drives")
    for name in () if in_lockstep else _OF_LOCKSTEP:
        if given[name]:
            raise LaunchError(
                f"{name} is {given[name]!r}, but time runs by itself: set {LOCKSTEP}:={TRUE}"
            )
    clock: dict[str, Value] = {} if in_lockstep else {"use_sim_time": simulated_time}
    started = _hil(given, clock) if kind == HIL else [_simulated(PLANTS[kind], given)]
    started += _controllers(controllers, given, clock)
    shared = _priority(given) | (_lockstep(started, given) if in_lockstep else {})
    started = [replace(each, parameters={**each.parameters, **shared}) for each in started]
    if given["record"]:
        started.append(_recorder(Path(given["record"])))
    started += _observers(given, simulated_time)
    messages = []
    if given["rviz"] == TRUE:
        if find(VIEWER):
            started.append(_rviz(given, simulated_time))
        else:
            messages.append(
                f"rviz:=true, but {VIEWER} is not installed (apt install ros-jazzy-{VIEWER}); "
                "all other processes start"
            )
    return LaunchPlan(given["namespace"], given["log_level"], tuple(started), tuple(messages))


def _check_plant(given: Mapping[str, str]) -> None:
    kind = given["plant"]
    if kind not in PLANTS:
        raise LaunchError(f"plant is {kind!r}, it must be one of {', '.join(PLANTS)}")
    for name, usual in (("drives", EMULATED), ("link", "")):
        if kind != HIL and given[name] != usual:
            raise LaunchError(
                f"{name} is {given[name]!r}, but plant:={kind} has no link to drives; "
                f"set plant:={HIL}"
            )
    if given["link"] and given["drives"] != EMULATED:
        raise LaunchError(
            f"link is {given['link']!r}, but the link to real drives is given by drives, "
            f"{given['drives']!r}: leave link empty"
        )


def _controllers(
    controllers: Sequence[str], given: Mapping[str, str], clock: Mapping[str, Value]
) -> list[ProcessSpec]:
    files = files_of(controllers)
    processes = _composed(controllers) if given["composed"] == TRUE else _alone(controllers)
    return [
        ProcessSpec(
            executable,
            files=tuple(given[_argument_of(file)] for name in nodes for file in files[name]),
            parameters=clock,
            arguments=nodes if executable in COMPOSED else (),
            nodes=nodes,
        )
        for executable, nodes in processes.items()
    ]


def _observers(given: Mapping[str, str], simulated_time: bool) -> list[ProcessSpec]:
    """Plan the nodes for viewers, actions and the page, for which simulated time does not wait."""
    requested = {
        VIEW: TRUE in {given[_FRAMES], given["rviz"]},
        ACTION: given[ACTIONS] == TRUE,
        _PAGE: given[CONSOLE] == TRUE,
    }
    return [
        ProcessSpec(
            executable,
            files=() if executable == ACTION else (given[_argument_of(executable)],),
            parameters={"use_sim_time": simulated_time},
        )
        for executable, is_requested in requested.items()
        if is_requested
    ]


def _rviz(given: Mapping[str, str], simulated_time: bool) -> ProcessSpec:
    return ProcessSpec(
        VIEWER,
        VIEWER,
        parameters={"use_sim_time": simulated_time},
        arguments=("-d", given["rviz_config"]),
    )


def _alone(controllers: Sequence[str]) -> dict[str, tuple[str, ...]]:
    return {name: (name,) for name in controllers}


def _composed(controllers: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Nodes of each process that runs some of the controllers."""
    found = {
        executable: tuple(name for name in controllers if name in nodes)
        for executable, nodes in COMPOSED.items()
    }
    return {executable: nodes for executable, nodes in found.items() if nodes}


def _lockstep(started: Sequence[ProcessSpec], given: Mapping[str, str]) -> dict[str, Value]:
    """Parameters of processes for which simulated time waits."""
    processes = [f"{each.executable}={'+'.join(each.node_names)}" for each in started]
    text = ",".join(processes + ([given["participants"]] if given["participants"] else []))
    seed: dict[str, Value] = {}
    if given["delay_seed"]:
        if not given["delay_seed"].isdecimal():
            raise LaunchError(f"delay_seed is {given['delay_seed']!r}, it must be a whole number")
        seed = {"delay_seed": int(given["delay_seed"])}
    return {LOCKSTEP: text, **seed}


def _simulated(executable: str, given: Mapping[str, str]) -> ProcessSpec:
    return ProcessSpec(
        executable,
        files=(given[_argument_of(executable)],),
        parameters=_parameters(given, PARAMETERS),
        shutdown_reason="the plant has ended",
    )


def _hil(given: Mapping[str, str], clock: Mapping[str, Value]) -> list[ProcessSpec]:
    """Return the bridge, and the drive emulator unless the drives are real.

    Real drives run by the wall clock, emulated ones by simulated time.
    """
    emulated = given["drives"] == EMULATED
    for name in PARAMETERS:
        allowed = {"", "scenario", SPATIAL} if name == "model" else {""}
        if name not in EMULATOR_PARAMETERS and given[name] not in allowed:
            raise LaunchError(
                f"{name} is {given[name]!r}: it must be empty with plant:=hil, whose drives "
                "determine the time and have a spatial scenario"
            )
    link = given["link"] if emulated else given["drives"]
    of_link: dict[str, Value] = {"link": link} if link else {}
    bridge = ProcessSpec(
        PLANTS[HIL],
        files=(given[_argument_of(PLANTS[HIL])],),
        parameters={**clock, **of_link},
    )
    if not emulated:
        return [bridge]
    emulator = ProcessSpec(
        "drive_emulator",
        files=(given[_argument_of("drive_emulator")],),
        parameters={**_parameters(given, EMULATOR_PARAMETERS), **of_link},
        shutdown_reason="the emulated drives have ended",
    )
    return [emulator, bridge]


def _parameters(
    given: Mapping[str, str], names: Sequence[str] | Mapping[str, object]
) -> dict[str, Value]:
    return {name: _typed(name, given[name]) for name in names if given[name]}


def _typed(name: str, text: str) -> Value:
    kind, _ = PARAMETERS[name]
    try:
        if kind is bool:
            return {TRUE: True, FALSE: False}[text.lower()]
        return kind(text)
    except (ValueError, KeyError):
        expected = "true or false" if kind is bool else f"of type {kind.__name__}"
        raise LaunchError(f"{name} is {text!r}, it must be {expected}") from None


def unknown_arguments(given: Iterable[str], known: Sequence[str]) -> list[str]:
    """Return a message for each given argument that the launch file does not have.

    Another launch file that includes this one may have arguments of its own.

    Raises:
        LaunchError: the name is nearly that of an argument.
    """
    messages = []
    for name in given:
        if name in known:
            continue
        near = difflib.get_close_matches(name, known, n=1, cutoff=0.7)
        if near:
            raise LaunchError(f"there is no argument {name!r}; did you mean {near[0]!r}?")
        messages.append(f"the argument {name!r} has no effect on the nodes of {PACKAGE}")
    return messages


def _recorder(folder: Path) -> ProcessSpec:
    """Plan the recorder; nobody should operate without the record that was asked for."""
    target = folder.expanduser()
    if target.exists() or target.is_symlink():
        raise LaunchError(f"record is {str(folder)!r}, which exists: choose another folder")
    nearest = next(each for each in target.absolute().parents if each.exists())
    if not nearest.is_dir() or not os.access(nearest, os.W_OK | os.X_OK):
        raise LaunchError(f"record is {str(folder)!r}, but no folder can be made in {nearest}")
    return ProcessSpec("bag_record", arguments=("--output", str(target)))


def _priority(given: Mapping[str, str]) -> dict[str, Value]:
    text = given[PRIORITY]
    if text and not (text.isdecimal() and int(text)):
        raise LaunchError(f"{PRIORITY} is {text!r}, it must be a whole number from 1")
    return {PRIORITY: int(text)} if text else {}


def _argument_of(file: str) -> str:
    """Return the name of the argument of a parameter file."""
    return _FILE_ARGUMENTS.get(file, f"{file}_params_file")
