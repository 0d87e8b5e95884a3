"""The identification procedure and its dry run, simulated in lockstep and recorded.

Two short runs excite the parameters. For each parameter one manoeuvre moves the sensors strongly
and depends little on the other parameters:

- ``identify_hang``: the winch starts and stops, and the rover bounces on the tether (axial
  stiffness and damping). The flywheel accelerates and reverses (inertia about x); while it spins
  and the rover tilts, its momentum turns the rover about the vertical (inertia about z). The wheels
  spin up and coast down (friction) and tilt the rover (inertia about y). The swivel slips
  throughout, as the tether is twisted at the start and the rover turns in the same sense: only its
  friction slows the yaw.
- ``identify_bow``: the rover stands right below the winch with a slack tether. The force of the
  bent tether before and after payout shows the bending stiffness.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

from msg_schemas import machine, topics
from msg_schemas.cdr import pack
from msg_schemas.samples import ClockSample, JointSample, JointValue, TextSample
from msg_schemas.table import TOPICS
from rover_bags.files.store import BagWriter, standard_type
from rover_sim import (
    AnyScenario,
    Simulation,
    build_interface,
    build_plant,
    compile_ahead,
    load_scenario,
)

TICK: Final = 0.04
"""Tick of the simulated runs [s]."""
_EPOCH_NS: Final = 1_790_000_000_000_000_000
_REPEAT_TICKS: Final = 2
"""Ticks after which a command is repeated, before the drives time out."""
_TIME_TOLERANCE: Final = 1e-9
_COMMAND_DELAY: Final = 0.2
"""Fraction of a tick after which commands are recorded."""


@dataclass(frozen=True)
class CommandSegment:
    """A constant command over a time interval.

    Attributes:
        begin, end: times [s].
        value: payout rate [m/s] or torque [N m].
    """

    begin: float
    end: float
    value: float


@dataclass(frozen=True)
class Manoeuvre:
    """The commands of one run of the procedure.

    Attributes:
        duration: duration [s].
        payout: payout rates of the winch [m/s]; otherwise its brake is closed.
        feed_forward: feed-forward tension of the winch while it turns [N].
        flywheel, wheels: torques [N m]; otherwise 0.
    """

    duration: float
    payout: tuple[CommandSegment, ...] = ()
    feed_forward: float = 0.0
    flywheel: tuple[CommandSegment, ...] = ()
    wheels: tuple[CommandSegment, ...] = ()

    def commands(self, time: float) -> dict[str, dict[str, JointValue]]:
        """Return the commands of the tick that starts at a time [s], by topic."""
        rate = _at(self.payout, time)
        turns = rate is not None
        commands = {
            topics.WINCH_COMMAND: {
                machine.WINCH_DRUM: JointValue(
                    0.0, rate or 0.0, self.feed_forward if turns else 0.0
                ),
                machine.WINCH_BRAKE: JointValue(1.0 if turns else 0.0),
                machine.WINCH_LIMIT: JointValue(effort=200.0),
            }
        }
        if self.flywheel:
            torque = _at(self.flywheel, time) or 0.0
            commands[topics.FLYWHEEL_COMMAND] = {machine.FLYWHEEL: JointValue(effort=torque)}
        if self.wheels:
            torque = _at(self.wheels, time) or 0.0
            commands[topics.WHEEL_TORQUE_COMMAND] = {machine.WHEEL_DRIVE: JointValue(effort=torque)}
        return commands


def _at(pieces: tuple[CommandSegment, ...], time: float) -> float | None:
    for piece in pieces:
        if piece.begin - _TIME_TOLERANCE <= time < piece.end - _TIME_TOLERANCE:
            return piece.value
    return None


PROCEDURE: Final[Mapping[str, Manoeuvre]] = MappingProxyType(
    {
        "identify_hang": Manoeuvre(
            duration=7.5,
            payout=(CommandSegment(0.5, 1.5, 0.15), CommandSegment(4.0, 5.0, -0.15)),
            feed_forward=16.2,
            flywheel=(
                CommandSegment(1.0, 2.0, 0.07),
                CommandSegment(2.0, 4.0, -0.07),
                CommandSegment(4.0, 5.0, 0.07),
            ),
            wheels=(CommandSegment(1.5, 2.3, 0.15), CommandSegment(5.0, 5.6, -0.15)),
        ),
        "identify_bow": Manoeuvre(duration=3.0, payout=(CommandSegment(1.5, 2.0, 0.075),)),
    }
)
"""Manoeuvre by scenario name."""


def record(
    path: Path, configured: AnyScenario, true: AnyScenario, manoeuvre: Manoeuvre, *, seed: int
) -> Path:
    """Simulate a run in lockstep and record its sensors and commands.

    Args:
        path: folder to create.
        configured: scenario written into the bag.
        true: scenario that is simulated.
        manoeuvre: commands.
        seed: seed of the sensor errors. It is not recorded: it would reveal them.

    Raises:
        BagError: the folder exists or cannot be written.
    """
    compile_ahead(true)
    simulation = Simulation(build_interface(build_plant(true), seed), TICK)
    content = {
        "node": "/sim_node",
        "parameters": {"tick": TICK},
        "scenario": configured.to_mapping(),
        "seed": 0,
    }
    recorded_topics = set(simulation.interface.available_after_tick) - {topics.CAMERA}
    with BagWriter(path, sync=False) as writer:
        channels: dict[str, int] = {}

        def put(name: str, wall: float, data: bytes) -> None:
            if name not in channels:
                full = name if name.startswith("/") else f"/{name}"
                channels[name] = writer.add_topic(full, standard_type(TOPICS[name].message))
            stamp = _EPOCH_NS + round(wall * 1e9)
            writer.write(channels[name], stamp, stamp, data)

        put(topics.CONFIG, 0.0, pack(topics.CONFIG, TextSample(json.dumps(content))))
        before: dict[str, dict[str, JointValue]] = {}
        for tick in range(round(manoeuvre.duration / TICK)):
            now = simulation.stamp_ns
            # A command stamped 0 would count as unstamped.
            commands = manoeuvre.commands(tick * TICK) if now else {}
            if commands == before and tick % _REPEAT_TICKS:
                commands = {}
            before = commands or before
            for name, joints in commands.items():
                sample = JointSample(now, joints)
                put(name, (tick + _COMMAND_DELAY) * TICK, pack(name, sample))
                simulation.accept_command(name, sample)
            simulation.tick()
            wall = (tick + 1) * TICK
            put(topics.CLOCK, wall, pack(topics.CLOCK, ClockSample(simulation.stamp_ns)))
            for name, sensed in simulation.interface.samples(sorted(recorded_topics)):
                put(name, wall, pack(name, sensed))
    return path


def record_dry_run(folder: Path, true_values: Mapping[str, object], *, seed: int) -> list[Path]:
    """Simulate and record the whole procedure.

    Args:
        folder: folder to create; it holds one bag per run.
        true_values: true values by dotted path, where they differ from the configured scenario.
        seed: seed of the sensor errors.

    Raises:
        ScenarioError: a true value is invalid.
        BagError: the folder cannot be written.
    """
    bags = []
    for index, (name, manoeuvre) in enumerate(PROCEDURE.items()):
        configured = load_scenario(name)
        true = load_scenario(name, true_values)
        bags.append(record(folder / name, configured, true, manoeuvre, seed=seed + index))
    return bags
