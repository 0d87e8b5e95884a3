"""The identification procedure, and its rehearsal: simulated in lockstep and recorded.

Two short runs show what ``mother_rover bag identify`` estimates; each parameter has a
part that moves the sensors much and little else does:

- ``identify_hang``: the winch starts and stops, and the rover bounces on the tether (axial
  stiffness and damping). The flywheel is turned to and fro (inertia about x); while it turns and
  the rover tilts, its momentum turns the rover about the vertical (inertia about z). The wheels are
  turned up and run down (their friction) and tilt the rover (inertia about y). All the while the
  swivel slips, as the tether was wound up and the rover is pushed to wind it up further: its
  friction alone slows the yaw.
- ``identify_bow``: the rover stands right below the winch and the tether is slack; how hard the bow
  pushes, before and after it is paid out, tells the bending stiffness.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

from msg_schemas import topics
from msg_schemas.samples import ClockSample, JointSample, JointValue, TextSample
from msg_schemas.table import FLYWHEEL, TOPICS, WHEEL_DRIVE, WINCH_BRAKE, WINCH_DRUM, WINCH_LIMIT
from rover_bags.files.cdr import cdr
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
"""Of the rehearsed runs [s]."""
_EPOCH_NS: Final = 1_790_000_000_000_000_000
_RENEWED: Final = 2
"""Ticks after which a command is given again, before the drives take silence for an end."""
_SWITCHED: Final = 1e-9
_LATER: Final = 0.2
"""Of a tick, after which commands come in the record."""


@dataclass(frozen=True)
class Piece:
    """A command that holds for a while.

    Attributes:
        begin, end: [s].
        value: payout rate [m/s] or torque [N m].
    """

    begin: float
    end: float
    value: float


@dataclass(frozen=True)
class Manoeuvre:
    """A run of the procedure.

    Attributes:
        duration: [s].
        payout: rates of the winch; its brake is closed otherwise.
        feed_forward: tension that the winch carries while it turns [N].
        flywheel, wheels: torques; 0 otherwise.
    """

    duration: float
    payout: tuple[Piece, ...] = ()
    feed_forward: float = 0.0
    flywheel: tuple[Piece, ...] = ()
    wheels: tuple[Piece, ...] = ()

    def orders(self, time: float) -> dict[str, dict[str, JointValue]]:
        """Commands of a tick that begins at a time [s], by topic."""
        rate = _at(self.payout, time)
        turns = rate is not None
        orders = {
            topics.WINCH_COMMAND: {
                WINCH_DRUM: JointValue(0.0, rate or 0.0, self.feed_forward if turns else 0.0),
                WINCH_BRAKE: JointValue(1.0 if turns else 0.0),
                WINCH_LIMIT: JointValue(effort=200.0),
            }
        }
        if self.flywheel:
            torque = _at(self.flywheel, time) or 0.0
            orders[topics.FLYWHEEL_COMMAND] = {FLYWHEEL: JointValue(effort=torque)}
        if self.wheels:
            torque = _at(self.wheels, time) or 0.0
            orders[topics.WHEEL_TORQUE_COMMAND] = {WHEEL_DRIVE: JointValue(effort=torque)}
        return orders


def _at(pieces: tuple[Piece, ...], time: float) -> float | None:
    for piece in pieces:
        if piece.begin - _SWITCHED <= time < piece.end - _SWITCHED:
            return piece.value
    return None


PROCEDURE: Final[Mapping[str, Manoeuvre]] = MappingProxyType(
    {
        "identify_hang": Manoeuvre(
            duration=7.5,
            payout=(Piece(0.5, 1.5, 0.15), Piece(4.0, 5.0, -0.15)),
            feed_forward=16.2,
            flywheel=(Piece(1.0, 2.0, 0.07), Piece(2.0, 4.0, -0.07), Piece(4.0, 5.0, 0.07)),
            wheels=(Piece(1.5, 2.3, 0.15), Piece(5.0, 5.6, -0.15)),
        ),
        "identify_bow": Manoeuvre(duration=3.0, payout=(Piece(1.5, 2.0, 0.075),)),
    }
)
"""By the name of the scenario."""


def record(
    path: Path, configured: AnyScenario, real: AnyScenario, manoeuvre: Manoeuvre, *, seed: int
) -> Path:
    """Simulate a run in lockstep and record what its sensors tell.

    Args:
        path: folder to make.
        configured: what the record says that the machine is.
        real: what it is.
        manoeuvre: what is commanded.
        seed: of the sensors' errors. It is not told in the record, or their errors would be.

    Raises:
        BagError: the folder exists or cannot be written.
    """
    compile_ahead(real)
    simulation = Simulation(build_interface(build_plant(real), seed), TICK)
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

        put(topics.CONFIG, 0.0, cdr(topics.CONFIG, TextSample(json.dumps(content))))
        before: dict[str, dict[str, JointValue]] = {}
        for tick in range(round(manoeuvre.duration / TICK)):
            now = simulation.stamp_ns
            # At time 0 a command would count as unstamped.
            orders = manoeuvre.orders(tick * TICK) if now else {}
            if orders == before and tick % _RENEWED:
                orders = {}
            before = orders or before
            for name, joints in orders.items():
                sample = JointSample(now, joints)
                put(name, (tick + _LATER) * TICK, cdr(name, sample))
                simulation.accept_command(name, sample)
            simulation.tick()
            wall = (tick + 1) * TICK
            put(topics.CLOCK, wall, cdr(topics.CLOCK, ClockSample(simulation.stamp_ns)))
            for name, sensed in simulation.interface.samples(sorted(recorded_topics)):
                put(name, wall, cdr(name, sensed))
    return path


def rehearse(folder: Path, really: Mapping[str, object], *, seed: int) -> list[Path]:
    """Record the whole procedure with the machine of its scenarios.

    Args:
        folder: to make; a bag for each run in it.
        really: values by dotted path that the machine really has, other than configured.
        seed: of the sensors' errors.

    Raises:
        ScenarioError: such a machine cannot be.
        BagError: the folder cannot be written.
    """
    bags = []
    for index, (name, manoeuvre) in enumerate(PROCEDURE.items()):
        configured = load_scenario(name)
        real = load_scenario(name, really)
        bags.append(record(folder / name, configured, real, manoeuvre, seed=seed + index))
    return bags
