"""Audit the recorded energy and momentum balances.

The plant publishes an energy balance: initial energy + input - dissipation = stored energy. The
energy audit sums the recorded terms itself and compares the gravity term with the recorded
positions of bodies and tether. The flight audit compares the change of momentum beyond gravity's
impulse with the impulse of the tether.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_schemas import machine, topics
from rover_bags.analysis.geometry import (
    gravity_of,
    inside,
    masses_of,
    number_setting,
    rotations,
    vector_setting,
)
from rover_bags.analysis.signals import run_starts
from rover_bags.analysis.timeline import Activity, ActivityInterval, Timeline
from rover_bags.reading.read import Bag, Floats, TimeSeries

_BALANCE_TERMS: Final = ("input", "dissipated", "drift")
_PARTS: Final = ("driven_ends", "air_drag")  # of input and dissipated
STORED: Final = tuple(
    name for name in machine.ENERGY_NAMES if name not in (*_BALANCE_TERMS, *_PARTS)
)
"""Terms of the energy balance that are stored energy."""
_SOON: Final = 0.02
"""Time at each end of a flight in which the rover may still be in contact [s]."""


class Rotor(NamedTuple):
    """A rotor of the rover: topic and column of its rate, axis in Body 1, inertia [kg m^2]."""

    name: str
    topic: str
    path: str
    axis: int
    inertia: float


@dataclass(frozen=True)
class EnergyInterval:
    """Energy balance over one activity [J]: residual = stored - input + dissipated."""

    activity: str
    begin_s: float
    end_s: float
    input_J: float
    dissipated_J: float
    stored_J: float
    residual_J: float


@dataclass(frozen=True)
class EnergyAudit:
    """Audit of the plant's energy balance.

    Attributes:
        turnover_J: Sum of the magnitudes of all changes of input and dissipated energy.
        residual_J: Largest residual of the balance.
        share: Largest residual over the turnover.
        drift_error_J: Largest difference between the recorded drift and the computed residual.
        gravity_error_J: Range of the difference between the recorded gravity term and the potential
            energy of the recorded positions of bodies and tether; None if these are not recorded.
        intervals: The balance of each activity interval.
    """

    turnover_J: float
    residual_J: float
    share: float | None
    drift_error_J: float
    gravity_error_J: float | None
    intervals: tuple[EnergyInterval, ...]


@dataclass(frozen=True)
class RotorAudit:
    """Angular momentum of one rotor [N m s] and, if it has a limit, the fraction of the limit."""

    name: str
    momentum_max_N_m_s: float
    momentum_final_N_m_s: float
    momentum_limit_N_m_s: float | None
    share: float | None


@dataclass(frozen=True)
class FlightAudit:
    """Audit of the momentum in one flight.

    Attributes:
        begin_s, end_s: The flight, in simulated time.
        momentum_change_N_s: Largest change of both bodies' linear momentum beyond gravity's
            impulse.
        tether_impulse_N_s: Impulse of the recorded tether force at the rover: an upper bound of
            what the tether explains.
        unexplained_N_s: Change beyond that bound.
        angular_momentum_change_N_m_s: Largest change of the angular momentum about the common
            centre of mass, rotors included; None if inertias are not configured or the rate of a
            rotor is not recorded.
        angular_momentum_max_N_m_s: Largest angular momentum in the flight.
    """

    begin_s: float
    end_s: float
    momentum_change_N_s: float
    tether_impulse_N_s: float | None
    unexplained_N_s: float | None
    angular_momentum_change_N_m_s: float | None
    angular_momentum_max_N_m_s: float | None


@dataclass(frozen=True)
class Audits:
    """All audits, and the reasons why others could not be made."""

    energy: EnergyAudit | None = None
    rotors: tuple[RotorAudit, ...] = ()
    flights: tuple[FlightAudit, ...] = ()
    not_audited: tuple[str, ...] = field(default=())


def audits_of(bag: Bag, timeline: Timeline) -> Audits:
    """Make every audit for which the bag holds the data."""
    not_audited = []
    energy = _energy(bag, timeline)
    if energy is None:
        not_audited.append(f"energy: the bag holds no topic {topics.TRUTH_ENERGY}")
    elif energy.gravity_error_J is None:
        not_audited.append(
            "gravity: the bag lacks the true motion of the bodies or the tether, or their masses"
        )
    rotors = tuple(_rotors(bag))
    if not rotors:
        not_audited.append(
            "rotors: the bag lacks the encoders of flywheel and wheels, or their inertias"
        )
    flights = tuple(flight_audits(bag, timeline))
    if not flights and timeline.of(Activity.FLIGHT):
        not_audited.append("flights: the bag lacks the true motion of the bodies or their masses")
    return Audits(energy, rotors, flights, tuple(not_audited))


# --- energy -------------------------------------------------------------------------------------


def _energy(bag: Bag, timeline: Timeline) -> EnergyAudit | None:
    series = bag.series(topics.TRUTH_ENERGY)
    if series is None or len(series) < 2:
        return None
    # The balance restarts at a reset: each run has its own.
    edges = [0, *run_starts(bag, series.time, series.log_ns).tolist(), len(series)]
    energy_balances = [
        _EnergyBalance.of(series, slice(begin, end))
        for begin, end in pairwise(edges)
        if end - begin > 1
    ]
    if not energy_balances:
        return None
    turnover = sum(energy_balance.turnover for energy_balance in energy_balances)
    largest = max(
        float(np.abs(energy_balance.residual).max()) for energy_balance in energy_balances
    )
    errors = [_gravity_error(bag, energy_balance) for energy_balance in energy_balances]
    known = [error for error in errors if error is not None]
    return EnergyAudit(
        turnover_J=turnover,
        residual_J=largest,
        share=largest / turnover if turnover > 0.0 else None,
        drift_error_J=max(
            float(np.abs(item.residual - item.drift).max()) for item in energy_balances
        ),
        gravity_error_J=max(known) if known else None,
        intervals=tuple(
            line for energy_balance in energy_balances for line in _lines(timeline, energy_balance)
        ),
    )


class _EnergyBalance(NamedTuple):
    """The plant's energy balance over one run, from one reset to the next."""

    time: Floats
    log: tuple[int, int]  # reception times of its first and last sample [ns since 1970]
    columns: Mapping[str, Floats]
    stored: Floats
    residual: Floats  # of the recorded terms
    drift: Floats  # as published by the plant
    turnover: float

    @classmethod
    def of(cls, series: TimeSeries, part: slice) -> _EnergyBalance:
        names = (*STORED, *_BALANCE_TERMS)
        columns = {name: series.columns[f"{name}.position"][part] for name in names}
        stored = np.sum([columns[name] for name in STORED], axis=0)
        balance = stored - columns["input"] + columns["dissipated"]
        turnover = float(
            np.abs(np.diff(columns["input"])).sum() + np.abs(np.diff(columns["dissipated"])).sum()
        )
        log_ns = series.log_ns[part]
        return cls(
            series.time[part], (int(log_ns[0]), int(log_ns[-1])), columns, stored,
            balance - balance[0], columns["drift"] - columns["drift"][0], turnover,
        )  # fmt: skip


def _lines(timeline: Timeline, energy_balance: _EnergyBalance) -> Iterator[EnergyInterval]:
    time, columns = energy_balance.time, energy_balance.columns
    for interval in timeline.intervals:
        middle = (interval.log_begin + interval.log_end) // 2
        if interval.end_s > time[-1] + 1.0 or interval.begin_s < time[0] - 1.0:
            continue
        if not energy_balance.log[0] <= middle <= energy_balance.log[1]:
            continue
        ends = [interval.begin_s, interval.end_s]
        changes = [
            float(np.diff(np.interp(ends, time, column))[0])
            for column in (
                columns["input"],
                columns["dissipated"],
                energy_balance.stored,
                energy_balance.residual,
            )
        ]
        yield EnergyInterval(interval.activity.value, interval.begin_s, interval.end_s, *changes)


def _gravity_error(bag: Bag, energy_balance: _EnergyBalance) -> float | None:
    """Range of the recorded gravity term less the potential energy of the positions [J]."""
    bodies = [bag.series(name) for name in (topics.TRUTH_BODY1, topics.TRUTH_BODY2)]
    tether, gravity = bag.series(topics.TRUTH_TETHER), gravity_of(bag)
    masses, density = masses_of(bag), number_setting(bag, "tether", "line_density")
    if masses is None or density is None or gravity is None or tether is None:
        return None
    span = (float(energy_balance.time[0]), float(energy_balance.time[-1]))
    part = inside(tether, *span, energy_balance.log)
    if len(part) < 2:
        return None
    at = tether.time[part]
    heights = density * np.array(
        [_height_integral(tether.shapes[index]) for index in part.tolist()]
    )
    for body, mass in zip(bodies, masses, strict=True):
        if body is None or not len(own := inside(body, *span, energy_balance.log)):
            return None
        heights += mass * np.interp(at, body.time[own], body.columns["position.z"][own])
    recorded = np.interp(at, energy_balance.time, energy_balance.columns["gravity"])
    return float(np.ptp(gravity * heights - recorded))


def _height_integral(nodes: Floats) -> float:
    """Integral of the tether's height over its undeformed length [m^2], height from the fairlead.

    The norm of the slope dr/ds is the stretch, so an element's undeformed length is its chord over
    the mean stretch. The mean height of the cubic follows from heights and slopes at its ends.
    """
    chord = np.linalg.norm(np.diff(nodes[:, :3], axis=0), axis=1)
    stretch = np.linalg.norm(nodes[:, 3:6], axis=1)
    length = chord / (0.5 * (stretch[1:] + stretch[:-1]))
    z, slope = nodes[:, 2], nodes[:, 5]
    mean = 0.5 * (z[1:] + z[:-1]) + length * (slope[:-1] - slope[1:]) / 12.0
    return float(np.sum(length * mean))


# --- momentum -----------------------------------------------------------------------------------


def rotors_of(bag: Bag) -> Iterator[Rotor]:
    """Yield the rotors whose inertia is configured."""
    inertia = number_setting(bag, "rover", "jump_drive", "inertia")
    if inertia is not None:
        path = f"{machine.FLYWHEEL}.velocity"
        yield Rotor("flywheel", topics.FLYWHEEL_STATE, path, 0, inertia)
    inertia = number_setting(bag, "rover", "wheel_drive", "wheel_inertia")
    if inertia is not None:
        for name in (machine.WHEEL_LEFT, machine.WHEEL_RIGHT):
            yield Rotor(name, topics.WHEEL_STATE, f"{name}.velocity", 1, inertia)


def _rotors(bag: Bag) -> Iterator[RotorAudit]:
    for rotor in rotors_of(bag):
        series = bag.series(rotor.topic)
        if series is not None:
            is_flywheel = rotor.topic == topics.FLYWHEEL_STATE
            path = ("rover", "jump_drive", "momentum_limit")
            limit = number_setting(bag, *path) if is_flywheel else None
            yield _rotor(rotor.name, series, rotor.path, rotor.inertia, limit)


def _rotor(
    name: str, series: TimeSeries, path: str, inertia: float, limit: float | None
) -> RotorAudit:
    largest = inertia * float(
        max(np.abs(series.lowest(path)).max(), np.abs(series.highest(path)).max())
    )
    return RotorAudit(
        name,
        largest,
        inertia * float(series.columns[path][-1]),
        limit,
        largest / limit if limit else None,
    )


def flight_audits(bag: Bag, timeline: Timeline) -> Iterator[FlightAudit]:
    """Audit the momentum of each flight."""
    bodies = [bag.series(name) for name in (topics.TRUTH_BODY1, topics.TRUTH_BODY2)]
    gravity, masses = gravity_of(bag), masses_of(bag)
    if gravity is None or masses is None:
        return
    first, second = bodies
    if first is None or second is None:
        return
    for interval in timeline.of(Activity.FLIGHT):
        audit = _flight(bag, interval, (first, second), masses, gravity)
        if audit is not None:
            yield audit


def _flight(
    bag: Bag,
    interval: ActivityInterval,
    bodies: tuple[TimeSeries, TimeSeries],
    masses: tuple[float, float],
    gravity: float,
) -> FlightAudit | None:
    begin, end = interval.begin_s + _SOON, interval.end_s - _SOON
    log = (interval.log_begin, interval.log_end)
    if any(body.stride > 1 for body in bodies):
        return None
    # Use instants at which both bodies are recorded.
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
        interval.begin_s,
        interval.end_s,
        size,
        tether,
        None if tether is None else max(0.0, size - tether),
        turned_by,
        spin,
    )


def _impulse(bag: Bag, begin: float, end: float, log: tuple[int, int]) -> float | None:
    """Impulse of the tether at the rover [N s], from the tension or the rover's load cell."""
    tether = bag.series(topics.TRUTH_TETHER)
    if tether is not None and tether.shapes:
        part = inside(tether, begin - 0.02, end + 0.02, log)
        if len(part) > 1:
            pull = np.array([max(tether.shapes[index][-1, -1], 0.0) for index in part.tolist()])
            return _integral(pull, tether.time[part])
    cell = bag.series(topics.ROVER_LOAD_CELL)
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
    """Largest change and magnitude of the angular momentum about the common centre [N m s]."""
    inertias = [vector_setting(bag, 3, "rover", name) for name in ("inertia1", "inertia2")]
    if None in inertias:
        return None, None
    total = masses[0] + masses[1]
    centre = (masses[0] * places[0] + masses[1] * places[1]) / total
    drift = (masses[0] * speeds[0] + masses[1] * speeds[1]) / total
    time = bodies[0].time[parts[0]]
    whole = np.zeros((len(time), 3))
    for index, body in enumerate(bodies):
        if masses[index] == 0.0:
            continue  # a rover of a single body, whatever the inertia of the second
        arm, rate = places[index] - centre, speeds[index] - drift
        whole += masses[index] * np.cross(arm, rate)
        spin = body.vector("angular")[parts[index]] * np.asarray(inertias[index])
        whole += np.einsum("nij,nj->ni", turns[index], spin)
    for _, topic, path, axis, inertia in rotors_of(bag):
        series = bag.series(topic)
        if series is None or not len(near := inside(series, time[0] - 0.1, time[-1] + 0.1, log)):
            return None, None
        omega = bodies[0].vector("angular")[parts[0], axis]
        rate = np.interp(time, series.time[near], series.columns[path][near]) + omega
        whole += inertia * rate[:, None] * turns[0][:, :, axis]
    change = whole - whole[0]
    return (
        float(np.linalg.norm(change, axis=1).max()),
        float(np.linalg.norm(whole, axis=1).max()),
    )
