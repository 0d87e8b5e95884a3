"""Which processes a launch starts, with which parameters. Pure: no ROS is imported.

All launch files share the arguments of `arguments_of`, and what `plan` makes of their values: the
plant, the controllers, the recorder and the viewer, all in one namespace with a clock of its own,
so that several rovers run side by side.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

PACKAGE = "mother_rover"
SIM, MOCK, HIL = "sim", "mock", "hil"
SPATIAL = "spatial"
EMULATED = "emulated"
FALSE, TRUE = "false", "true"
VIEWER = "rviz2"
CONSOLE = "console"
_PAGE = "operator_console"

Value: TypeAlias = str | float | int | bool

PLANTS: Mapping[str, str] = {
    SIM: "sim_node",
    MOCK: "mock_plant",
    HIL: "hil_bridge",
}
"""Executable that stands for the plant towards the controllers."""

PARAMETERS: Mapping[str, tuple[type[Value], str]] = {
    "scenario": (str, "name of a scenario of the package, or path of a .yaml file"),
    "overrides": (str, 'changes to the scenario by dotted path: {"start.slack": 2.0}'),
    "seed": (int, "seed of the sensors' errors"),
    "model": (str, "planar or spatial: refuse a scenario of another; scenario: take what it says"),
    "real_time_factor": (float, "simulated seconds per second; 0 = as fast as possible"),
    "start_paused": (bool, "true: simulated time stands still until stepped or resumed"),
    "duration": (float, "end after this much simulated time [s]; 0 = never"),
}
"""Parameters of the plant that go before those of its file where they are given: type, meaning."""

EMULATOR_PARAMETERS = ("scenario", "overrides", "seed")
"""Those of them that emulated drives have as well: they keep to the wall clock."""

PRIORITY = "realtime_priority"
"""Parameter of every node; plant and controllers are given it, as the loop goes through them."""

CONTROLLER_FILES: Mapping[str, tuple[str, ...]] = {
    "winch_node": ("winch_node",),
    "descent_node": ("descent_node",),
    "jump_node": ("jump_node",),
    "drive_node": ("drive_node",),
    "mission_node": ("mission_node",),
}
"""Parameter files of each controller, the last one's values hold."""

EXTRA_FILES_WITH_DESCENT: Mapping[str, tuple[str, ...]] = {"winch_node": ("winch_descent",)}
"""Further files of a controller beside `descent_node`."""

_FILE_ARGUMENTS = {"sim_node": "sim_params_file", "winch_descent": "winch_descent_file"}

HANGING_DEFAULTS: Mapping[str, str] = {
    "scenario": "marius_hills",
    "model": SPATIAL,
    "overrides": '{"winch.min_length": 1.4, "tether.element_length": 0.9}',
}
"""Defaults where the hanging rover is controlled: it may come up to 1.6 m below the fairlead."""


class PlanError(ValueError):
    """An argument that makes no sense: which one, its value, and what would."""


@dataclass(frozen=True)
class Argument:
    """One argument of a launch file."""

    name: str
    default: str
    about: str
    choices: tuple[str, ...] = ()


@dataclass(frozen=True)
class ProcessSpec:
    """One process.

    Attributes:
        files: parameter files, the last one's values hold.
        parameters: that go before those of the files.
        arguments: before ``--ros-args``.
        shutdown_reason: why all the others end when it does; empty: they go on.
    """

    executable: str
    package: str = PACKAGE
    files: tuple[str, ...] = ()
    parameters: Mapping[str, Value] = field(default_factory=dict)
    arguments: tuple[str, ...] = ()
    shutdown_reason: str = ""

    @property
    def enclave_name(self) -> str:
        """Whose access it has: its own, or what is not of the suite that of the operator."""
        return self.executable if self.package == PACKAGE else "operator"


@dataclass(frozen=True)
class Plan:
    """What a launch starts.

    Attributes:
        namespace: of all processes; empty: none.
        log_level: of all nodes of the suite.
        messages: what the operator should know.
    """

    namespace: str
    log_level: str
    started: tuple[ProcessSpec, ...]
    messages: tuple[str, ...] = ()


def files_of(controllers: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Names of the parameter files of plants and controllers in ``config/``, without ending."""
    files: dict[str, tuple[str, ...]] = {
        name: (name,) for name in (*PLANTS.values(), "drive_emulator", "view_node")
    }
    for name in controllers:
        further = EXTRA_FILES_WITH_DESCENT.get(name, ()) if "descent_node" in controllers else ()
        files[name] = CONTROLLER_FILES[name] + further
    return files


def arguments_of(
    controllers: Sequence[str], config: str, defaults: Mapping[str, str]
) -> tuple[Argument, ...]:
    """The arguments of a launch file.

    Args:
        controllers: that it starts.
        config: folder of the parameter files.
        defaults: values of arguments that are other here.
    """
    found = [
        Argument(
            "plant",
            SIM,
            "sim: simulated; mock: follows commands perfectly; hil: behind a link to its drives",
            tuple(PLANTS),
        ),
        *(
            Argument(name, "", f"{about}; empty = as the file")
            for name, (_, about) in PARAMETERS.items()
        ),
        Argument(
            "drives",
            EMULATED,
            "of plant:=hil: emulated, or the link to real ones: socketcan:can0, "
            "serial:/dev/ttyUSB0:3000000",
        ),
        Argument(
            "link",
            "",
            "of plant:=hil to emulated drives, each rover its own; empty = as the files",
        ),
        Argument(
            PRIORITY,
            "",
            "of plant and controllers, by SCHED_RR, from 1; empty = scheduled as any process",
        ),
        Argument("namespace", "", "of all nodes; each namespace has a clock of its own"),
        Argument("record", "", "folder to create for a bag; empty = no recorder"),
        Argument("rviz", FALSE, "true: RViz with the package's view, and view_node", (FALSE, TRUE)),
        Argument(
            CONSOLE,
            FALSE,
            "true: the operators' page, by itself on this machine alone",
            (FALSE, TRUE),
        ),
        Argument("rviz_config", f"{config}/mother_rover.rviz", "what RViz shows"),
        Argument("log_level", "info", "of all nodes", ("debug", "info", "warn", "error", "fatal")),
        *(
            Argument(_argument_of(file), f"{config}/{file}.yaml", f"parameters of {name}")
            for name, files in {**files_of(controllers), _PAGE: (_PAGE,)}.items()
            for file in files
        ),
    ]
    unknown = defaults.keys() - {argument.name for argument in found}
    if unknown:
        raise PlanError(f"no launch file has the argument {sorted(unknown)[0]}")
    return tuple(
        Argument(each.name, defaults.get(each.name, each.default), each.about, each.choices)
        for each in found
    )


def plan(
    controllers: Sequence[str],
    given: Mapping[str, str],
    find: Callable[[str], str | None] = shutil.which,
) -> Plan:
    """Which processes are started.

    Args:
        controllers: executables of the controllers.
        given: value of each argument of `arguments_of`.
        find: path of a command of this machine, or None.

    Raises:
        PlanError: a value is of the wrong kind, or the wanted plant has no such argument.
    """
    messages = []
    kind = given["plant"]
    if kind not in PLANTS:
        raise PlanError(f"plant is {kind!r}, it must be one of {', '.join(PLANTS)}")
    if kind != HIL and given["drives"] != EMULATED:
        raise PlanError(
            f"drives is {given['drives']!r}, but plant is {kind}: nothing would speak to them; "
            f"plant:={HIL} does"
        )
    started = _hil(given) if kind == HIL else [_simulated(PLANTS[kind], given)]
    simulated_time = kind != HIL or given["drives"] == EMULATED
    started += [
        ProcessSpec(
            name,
            files=tuple(given[_argument_of(file)] for file in files_of(controllers)[name]),
            parameters={"use_sim_time": simulated_time},
        )
        for name in controllers
    ]
    started = [
        replace(each, parameters={**each.parameters, **_priority(given)}) for each in started
    ]
    if given["record"]:
        started.append(ProcessSpec("bag_record", arguments=("--output", given["record"])))
    if given["rviz"] == TRUE:
        started.append(
            ProcessSpec(
                "view_node",
                files=(given[_argument_of("view_node")],),
                parameters={"use_sim_time": simulated_time},
            )
        )
        if find(VIEWER):
            started.append(
                ProcessSpec(
                    VIEWER,
                    VIEWER,
                    parameters={"use_sim_time": simulated_time},
                    arguments=("-d", given["rviz_config"]),
                )
            )
        else:
            messages.append(
                f"rviz:=true, but there is no {VIEWER} on this machine (with ROS 2 Jazzy: apt "
                f"install ros-jazzy-{VIEWER}); everything else is started"
            )
    if given[CONSOLE] == TRUE:
        started.append(
            ProcessSpec(
                _PAGE,
                files=(given[_argument_of(_PAGE)],),
                parameters={"use_sim_time": simulated_time},
            )
        )
    return Plan(given["namespace"], given["log_level"], tuple(started), tuple(messages))


def _simulated(executable: str, given: Mapping[str, str]) -> ProcessSpec:
    return ProcessSpec(
        executable,
        files=(given[_argument_of(executable)],),
        parameters=_parameters(given, PARAMETERS),
        shutdown_reason="the plant has ended",
    )


def _hil(given: Mapping[str, str]) -> list[ProcessSpec]:
    """The bridge, and the drives that it speaks to unless they are real."""
    emulated = given["drives"] == EMULATED
    for name in PARAMETERS:
        plays = {"", "scenario", SPATIAL} if name == "model" else {""}
        if name not in EMULATOR_PARAMETERS and given[name] not in plays:
            raise PlanError(
                f"{name} is {given[name]!r}: with plant:=hil nothing has that, it keeps to the "
                "wall clock; emulated drives play a spatial scenario"
            )
    link = given["link"] if emulated else given["drives"]
    of_link: dict[str, Value] = {"link": link} if link else {}
    bridge = ProcessSpec(
        PLANTS[HIL],
        files=(given[_argument_of(PLANTS[HIL])],),
        # Real drives run by the wall clock, emulated ones by the plant's.
        parameters={"use_sim_time": emulated, **of_link},
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
        wanted = "true or false" if kind is bool else f"of type {kind.__name__}"
        raise PlanError(f"{name} is {text!r}, it must be {wanted}") from None


def _priority(given: Mapping[str, str]) -> dict[str, Value]:
    text = given[PRIORITY]
    if text and not text.isdecimal():
        raise PlanError(f"{PRIORITY} is {text!r}, it must be a whole number from 1")
    return {PRIORITY: int(text)} if text else {}


def _argument_of(file: str) -> str:
    """Argument that names a parameter file."""
    return _FILE_ARGUMENTS.get(file, f"{file}_params_file")
