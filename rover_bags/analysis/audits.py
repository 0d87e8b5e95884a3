"""Audits: does the recorded energy and momentum add up, and where does the bag not tell.

The plant keeps an energy balance: initial energy, input and heat must add up to the stored energy.
The audit adds the recorded entries up itself and compares the gravity entry with the recorded
positions of bodies and tether. In flight what momentum is gained beyond gravity's must be
the tether's doing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_schemas import topics
from msg_schemas.table import (
    ENERGY_NAMES,
    FLYWHEEL,
    WHEEL_LEFT,
    WHEEL_RIGHT,
)
from rover_bags.analysis.geometry import gravity_of, inside, rotations, setting
from rover_bags.analysis.timeline import Activity, Phase, Timeline
from rover_bags.read import Bag, Floats, TimeSeries

_BOOKS: Final = ("input", "dissipated", "drift")
STORED: Final = tuple(name for name in ENERGY_NAMES if name not in _BOOKS)
"""Entries of the energy balance that are stored energy."""
_SOON: Final = 0.02
"""Within so much of a flight's ends something may still touch [s]."""


@dataclass(frozen=True)
class EnergyLine:
    """The books over one phase [J]: stored = input - dissipated, but for what is missed."""

    what: str
    begin_s: float
    end_s: float
    input_J: float
    dissipated_J: float
    stored_J: float
    missed_J: float


@dataclass(frozen=True)
class EnergyAudit:
    """Of the plant's energy balance.

    Attributes:
        turnover_J: All that was put in, taken out and turned into heat, without signs.
        missed_J: Largest distance of the books from balance.
        share: Of the turnover that was missed at most.
        energy_error_J: Largest difference between the recorded drift and the sum of the entries.
        gravity_error_J: Largest change of the difference between the gravity entry and that of the
            recorded positions of bodies and tether; None where these are not recorded.
        lines: Phase by phase.
    """

    turnover_J: float
    missed_J: float
    share: float | None
    energy_error_J: float
    gravity_error_J: float | None
    lines: tuple[EnergyLine, ...]


@dataclass(frozen=True)
class RotorAudit:
    """Momentum of what spins in the rover [N m s], and its share of the limit if it has one."""

    name: str
    largest_N_m_s: float
    final_N_m_s: float
    limit_N_m_s: float | None
    share: float | None


@dataclass(frozen=True)
class FlightAudit:
    """What momentum a flight gained beyond gravity's: the tether's doing, or nobody's.

    Attributes:
        begin_s, end_s: The flight.
        gained_N_s: Linear momentum of both bodies gained beyond gravity's.
        tether_N_s: The most that the recorded pull at the rover explains.
        unexplained_N_s: What is left beyond that.
        turned_N_m_s: Change of the angular momentum about the common centre of mass, rotors
            included; None where inertias are not configured or a rotor's rate is not recorded.
        spin_N_m_s: Largest angular momentum in the flight.
    """

    begin_s: float
    end_s: float
    gained_N_s: float
    tether_N_s: float | None
    unexplained_N_s: float | None
    turned_N_m_s: float | None
    spin_N_m_s: float | None


@dataclass(frozen=True)
class Audits:
    """All audits, and what could not be audited for want of recorded data."""

    energy: EnergyAudit | None = None
    rotors: tuple[RotorAudit, ...] = ()
    flights: tuple[FlightAudit, ...] = ()
    lacking: tuple[str, ...] = field(default=())


def audits_of(bag: Bag, timeline: Timeline) -> Audits:
    """Every audit for which the bag holds what is needed."""
    lacking = []
    energy = _energy(bag, timeline)
    if energy is None:
        lacking.append(f"energy: the bag holds no {topics.TRUTH_ENERGY}")
    elif energy.gravity_error_J is None:
        lacking.append(
            "gravity: the bag lacks the bodies' or the tether's true motion, or their masses"
        )
    rotors = tuple(_rotors(bag))
    if not rotors:
        lacking.append("rotors: the bag lacks encoders of flywheel and wheels, or their inertias")
    flights = tuple(flight_audits(bag, timeline))
    if not flights and timeline.of(Activity.FLIGHT):
        lacking.append("flights: the bag lacks the bodies' true motion or their masses")
    return Audits(energy, rotors, flights, tuple(lacking))


# --- energy -------------------------------------------------------------------------------------


def _energy(bag: Bag, timeline: Timeline) -> EnergyAudit | None:
    track = bag.track(topics.TRUTH_ENERGY)
    if track is None or len(track) < 2:
        return None
    # The energy balance begins anew at a reset: each run has its own.
    edges = [0, *(np.flatnonzero(np.diff(track.time) < 0.0) + 1).tolist(), len(track)]
    energy_balances = [
        _EnergyBalance.of(track, slice(begin, end))
        for begin, end in pairwise(edges)
        if end - begin > 1
    ]
    if not energy_balances:
        return None
    turnover = sum(energy_balance.turnover for energy_balance in energy_balances)
    largest = max(float(np.abs(energy_balance.missed).max()) for energy_balance in energy_balances)
    strayed = [_gravity_error(bag, energy_balance) for energy_balance in energy_balances]
    known = [error for error in strayed if error is not None]
    return EnergyAudit(
        turnover_J=turnover,
        missed_J=largest,
        share=largest / turnover if turnover > 0.0 else None,
        energy_error_J=max(
            float(np.abs(item.missed - item.drift).max()) for item in energy_balances
        ),
        gravity_error_J=max(known) if known else None,
        lines=tuple(
            line for energy_balance in energy_balances for line in _lines(timeline, energy_balance)
        ),
    )


class _EnergyBalance(NamedTuple):
    """The plant's books over one run, from one reset to the next."""

    time: Floats
    log: tuple[int, int]  # when its first and its last entry came
    columns: Mapping[str, Floats]
    stored: Floats
    missed: Floats  # by what the entries add up to
    drift: Floats  # by what the plant says
    turnover: float

    @classmethod
    def of(cls, track: TimeSeries, part: slice) -> _EnergyBalance:
        columns = {name: track.columns[f"{name}.position"][part] for name in ENERGY_NAMES}
        stored = np.sum([columns[name] for name in STORED], axis=0)
        balance = stored - columns["input"] + columns["dissipated"]
        turnover = float(
            np.abs(np.diff(columns["input"])).sum() + np.abs(np.diff(columns["dissipated"])).sum()
        )
        log_ns = track.log_ns[part]
        return cls(
            track.time[part], (int(log_ns[0]), int(log_ns[-1])), columns, stored,
            balance - balance[0], columns["drift"] - columns["drift"][0], turnover,
        )  # fmt: skip


def _lines(timeline: Timeline, energy_balance: _EnergyBalance) -> Iterator[EnergyLine]:
    time, columns = energy_balance.time, energy_balance.columns
    for phase in timeline.phases:
        middle = (phase.log_begin + phase.log_end) // 2
        if phase.end_s > time[-1] + 1.0 or phase.begin_s < time[0] - 1.0:
            continue
        if not energy_balance.log[0] <= middle <= energy_balance.log[1]:
            continue
        ends = [phase.begin_s, phase.end_s]
        changes = [
            float(np.diff(np.interp(ends, time, column))[0])
            for column in (
                columns["input"],
                columns["dissipated"],
                energy_balance.stored,
                energy_balance.missed,
            )
        ]
        yield EnergyLine(phase.what.value, phase.begin_s, phase.end_s, *changes)


def _gravity_error(bag: Bag, energy_balance: _EnergyBalance) -> float | None:
    """How far the energy balance's gravity strays from that of the recorded places [J]."""
    bodies = [bag.track(name) for name in (topics.TRUTH_BODY1, topics.TRUTH_BODY2)]
    tether, gravity = bag.track(topics.TRUTH_TETHER), gravity_of(bag)
    masses = [setting(bag, "rover", name) for name in ("m1", "m2")]
    density = setting(bag, "tether", "line_density")
    if any(not isinstance(v, float | int) for v in (*masses, density, gravity)):
        return None
    if tether is None:
        return None
    span = (float(energy_balance.time[0]), float(energy_balance.time[-1]))
    part = inside(tether, *span, energy_balance.log)
    if len(part) < 2:
        return None
    at = tether.time[part]
    heights = density * np.array([_moment_of(tether.shapes[index]) for index in part.tolist()])
    for body, mass in zip(bodies, masses, strict=True):
        if body is None or not len(own := inside(body, *span, energy_balance.log)):
            return None
        heights += mass * np.interp(at, body.time[own], body.columns["position.z"][own])
    told = np.interp(at, energy_balance.time, energy_balance.columns["gravity"])
    return float(np.ptp((gravity or 0.0) * heights - told))


def _moment_of(nodes: Floats) -> float:
    """Height times undeformed length of the tether [m^2], from the fairlead.

    The slope dr/ds tells the stretch, so the length of an element is its chord's over that; the
    cubic's mean height follows from the ends' heights and slopes.
    """
    chord = np.linalg.norm(np.diff(nodes[:, :3], axis=0), axis=1)
    stretch = np.linalg.norm(nodes[:, 3:6], axis=1)
    length = chord / (0.5 * (stretch[1:] + stretch[:-1]))
    z, slope = nodes[:, 2], nodes[:, 5]
    mean = 0.5 * (z[1:] + z[:-1]) + length * (slope[:-1] - slope[1:]) / 12.0
    return float(np.sum(length * mean))


# --- momentum -----------------------------------------------------------------------------------


def _rotors(bag: Bag) -> Iterator[RotorAudit]:
    flywheel, wheels = bag.track(topics.FLYWHEEL_STATE), bag.track(topics.WHEEL_STATE)
    inertia = setting(bag, "rover", "jump_drive", "inertia")
    if flywheel is not None and isinstance(inertia, float | int):
        limit = setting(bag, "rover", "jump_drive", "momentum_limit")
        path = f"{FLYWHEEL}.velocity"
        yield _rotor("flywheel", flywheel, path, float(inertia), limit)
    inertia = setting(bag, "rover", "wheel_drive", "wheel_inertia")
    if wheels is not None and isinstance(inertia, float | int):
        for name in (WHEEL_LEFT, WHEEL_RIGHT):
            yield _rotor(name, wheels, f"{name}.velocity", float(inertia), None)


def _rotor(
    name: str, track: TimeSeries, path: str, inertia: float, limit: float | None
) -> RotorAudit:
    largest = inertia * float(
        max(np.abs(track.lowest(path)).max(), np.abs(track.highest(path)).max())
    )
    return RotorAudit(
        name,
        largest,
        inertia * float(track.columns[path][-1]),
        limit,
        largest / limit if limit else None,
    )


def flight_audits(bag: Bag, timeline: Timeline) -> Iterator[FlightAudit]:
    """What momentum each flight gained."""
    bodies = [bag.track(name) for name in (topics.TRUTH_BODY1, topics.TRUTH_BODY2)]
    gravity = gravity_of(bag)
    masses = [setting(bag, "rover", name) for name in ("m1", "m2")]
    if gravity is None or any(not isinstance(mass, float | int) for mass in masses):
        return
    first, second = bodies
    if first is None or second is None:
        return
    for phase in timeline.of(Activity.FLIGHT):
        audit = _flight(bag, phase, (first, second), (masses[0], masses[1]), gravity)
        if audit is not None:
            yield audit


def _flight(
    bag: Bag,
    phase: Phase,
    bodies: tuple[TimeSeries, TimeSeries],
    masses: tuple[float, float],
    gravity: float,
) -> FlightAudit | None:
    begin, end = phase.begin_s + _SOON, phase.end_s - _SOON
    log = (phase.log_begin, phase.log_end)
    if any(body.stride > 1 for body in bodies):
        return None
    # Samples of the same instants: one of either body may be missing.
    both = [inside(body, begin, end, log) for body in bodies]
    one, other = (np.round(b.time[p] * 1e9) for b, p in zip(bodies, both, strict=True))
    _, first, second = np.intersect1d(one, other, return_indices=True)
    parts = [both[0][first], both[1][second]]
    if len(parts[0]) < 3:
        return None
    places, speeds, turns = [], [], []
    for body, part in zip(bodies, parts, strict=True):
        turned = rotations(body)[part]
        places.append(body.vector("position")[part])
        speeds.append(np.einsum("nij,nj->ni", turned, body.vector("linear")[part]))
        turns.append(turned)
    time = bodies[0].time[parts[0]]
    momentum = masses[0] * speeds[0] + masses[1] * speeds[1]
    gained = momentum - momentum[0]
    gained[:, 2] += (masses[0] + masses[1]) * gravity * (time - time[0])
    size = float(np.linalg.norm(gained, axis=1).max())
    tether = _impulse(bag, begin, end, log)
    turned_by, spin = _angular(bag, bodies, parts, log, masses, places, speeds, turns)
    return FlightAudit(
        phase.begin_s,
        phase.end_s,
        size,
        tether,
        None if tether is None else max(0.0, size - tether),
        turned_by,
        spin,
    )


def _impulse(bag: Bag, begin: float, end: float, log: tuple[int, int]) -> float | None:
    """Of the pull at the rover [N s], from its load cell, or else from the tether's tension."""
    tether = bag.track(topics.TRUTH_TETHER)
    if tether is not None and tether.shapes:
        part = inside(tether, begin - 0.02, end + 0.02, log)
        if len(part) > 1:
            pull = np.array([max(tether.shapes[index][-1, -1], 0.0) for index in part.tolist()])
            return _integral(pull, tether.time[part])
    cell = bag.track(topics.ROVER_LOAD_CELL)
    if cell is None:
        return None
    part = inside(cell, begin, end, log)
    pull = np.linalg.norm(cell.vector("force")[part], axis=1)
    return _integral(pull, cell.time[part]) if len(part) > 1 else None


def _integral(values: Floats, time: Floats) -> float:
    return float(np.sum(0.5 * (values[1:] + values[:-1]) * np.diff(time)))


def _angular(
    bag: Bag, bodies: tuple[TimeSeries, TimeSeries],
    parts: list[NDArray[np.intp]], log: tuple[int, int],
    masses: tuple[float, float], places: list[Floats], speeds: list[Floats], turns: list[Floats],
) -> tuple[float | None, float | None]:  # fmt: skip
    """Change and size of the angular momentum about the common centre [N m s]."""
    inertias = [setting(bag, "rover", name) for name in ("inertia1", "inertia2")]
    if any(not isinstance(inertia, list | tuple) or len(inertia) != 3 for inertia in inertias):
        return None, None
    total = masses[0] + masses[1]
    centre = (masses[0] * places[0] + masses[1] * places[1]) / total
    drift = (masses[0] * speeds[0] + masses[1] * speeds[1]) / total
    time = bodies[0].time[parts[0]]
    whole = np.zeros((len(time), 3))
    for index, body in enumerate(bodies):
        arm, rate = places[index] - centre, speeds[index] - drift
        whole += masses[index] * np.cross(arm, rate)
        spin = body.vector("angular")[parts[index]] * np.asarray(inertias[index])
        whole += np.einsum("nij,nj->ni", turns[index], spin)
    for topic, path, axis, inertia in _spinning(bag):
        track = bag.track(topic)
        if track is None or not len(near := inside(track, time[0] - 0.1, time[-1] + 0.1, log)):
            return None, None
        omega = bodies[0].vector("angular")[parts[0], axis]
        rate = np.interp(time, track.time[near], track.columns[path][near]) + omega
        whole += inertia * rate[:, None] * turns[0][:, :, axis]
    change = whole - whole[0]
    return (
        float(np.linalg.norm(change, axis=1).max()),
        float(np.linalg.norm(whole, axis=1).max()),
    )


def _spinning(bag: Bag) -> Iterator[tuple[str, str, int, float]]:
    """Topic, column, axis in Body 1 and inertia of each rotor."""
    inertia = setting(bag, "rover", "jump_drive", "inertia")
    if isinstance(inertia, float | int):
        yield topics.FLYWHEEL_STATE, f"{FLYWHEEL}.velocity", 0, float(inertia)
    inertia = setting(bag, "rover", "wheel_drive", "wheel_inertia")
    if isinstance(inertia, float | int):
        for name in (WHEEL_LEFT, WHEEL_RIGHT):
            yield topics.WHEEL_STATE, f"{name}.velocity", 1, float(inertia)
