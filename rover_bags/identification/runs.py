"""Recorded runs as experiments: commands, readings, and predicted readings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from msg_schemas import machine, topics
from msg_schemas.cdr import unpack
from msg_schemas.refusal import Refusal
from msg_schemas.samples import JointSample, Sample
from rover_bags.identification.noise import Errors, Floats
from rover_bags.identification.parameters import (
    IdentifyError,
    with_stiffness,
    with_values,
    without_errors,
)
from rover_bags.resimulation.recorded_run import RunSegment, configured_tick, read_recorded_run
from rover_bags.resimulation.resim import earliest_instant
from rover_sim import (
    START,
    Displacement,
    ScenarioError,
    SettlingError,
    Simulation,
    SpatialPlant,
    SpatialScenario,
    build_interface,
    displaced,
    scenario_from_mapping,
)

_NANO: Final = 1_000_000_000
_MIN_READINGS: Final = 50
"""Smallest number of instants with readings in a run."""
_MIN_NOISE: Final = 1e-6
"""Noise of an ideal sensor, relative to the standard deviation of its signal."""
_CREEPING: Final = 8.0
"""Counts per reading below which an encoder's quantisation error is not noise."""
_TURNING: Final = 1e-4
"""Payout rate from which the drum counts as turning [m/s]."""
_SETTLES: Final = 0.1
"""Margin before and after a turn in which the fairlead's load cell is excluded [s]."""


@dataclass(frozen=True)
class Signal:
    """One value of a sensor.

    Attributes:
        topic, field: topic and field path of the value.
        channel: sensor channel in the scenario.
    """

    topic: str
    field: str
    channel: str

    def __str__(self) -> str:
        """Return the name in reports."""
        return f"{self.topic} {self.field}"


def _vector(topic: str, field: str, channel: str) -> list[Signal]:
    return [Signal(topic, f"{field}.{axis}", channel) for axis in "xyz"]


# Encoder rates are differences of angles and would count the same reading twice. Signals of the
# winch, and the fairlead's load cell while the drum turns, depend on the winch's own friction.
SIGNALS: Final = (
    *_vector(topics.IMU, "angular_velocity", "gyro"),
    *_vector(topics.IMU, "linear_acceleration", "accelerometer"),
    Signal(topics.LOAD_CELL, "force.z", "fairlead_load_cell"),
    Signal(topics.ROVER_LOAD_CELL, "force.z", "rover_load_cell"),
    Signal(topics.WHEEL_STATE, f"{machine.WHEEL_LEFT}.position", "wheel_encoders"),
    Signal(topics.WHEEL_STATE, f"{machine.WHEEL_RIGHT}.position", "wheel_encoders"),
    Signal(topics.FLYWHEEL_STATE, f"{machine.FLYWHEEL}.position", "flywheel_encoder"),
    *(
        Signal(topics.MOTOR_CURRENTS, f"{motor}.effort", "currents")
        for motor in (machine.JUMP_MOTOR, machine.WHEEL_MOTOR)
    ),
)
"""Signals used: sensors only, no ground truth."""
DRUM: Final = Signal(topics.WINCH_STATE, f"{machine.WINCH_DRUM}.position", "drum_encoder")
"""Signal that shows whether the drum turns."""


@dataclass(frozen=True)
class Unknown:
    """An unknown of a run's initial state.

    Attributes:
        name: field of `Displacement`, with its index.
        spread: prior standard deviation [rad or rad/s].
    """

    name: str
    spread: float


UNKNOWNS: Final = (
    Unknown("swing.0", 0.05),
    Unknown("swing.1", 0.05),
    Unknown("swing_rate.0", 0.05),
    Unknown("swing_rate.1", 0.05),
    Unknown("tilt.0", 0.05),
    Unknown("tilt.1", 0.05),
    Unknown("body_rate.0", 0.05),
    Unknown("body_rate.1", 0.05),
    Unknown("body_rate.2", 0.05),
    Unknown("twist", 0.1),
)
"""Unknowns of a run that starts with the rover hanging; any other run starts as configured."""


def displacement(values: Sequence[float]) -> Displacement:
    """Return the displacement with the values of `UNKNOWNS`."""
    v = [float(value) for value in values]
    return Displacement(
        (v[0], v[1]), (v[2], v[3]), (v[4], v[5]), (v[6], v[7], v[8]), v[9]
    )  # fmt: skip


@dataclass(frozen=True)
class IdentificationRun:
    """One run from its start on.

    Attributes:
        bag: path of its bag.
        scenario: configured scenario, with the tether given by stiffnesses.
        tick: tick of the simulation [s].
        begin_ns: simulated time of its start [ns].
        commands: simulated time [ns] of the tick, topic and sample of each command.
        stamps: simulated times of the readings [ns], ascending, (n,).
        signals: signals with readings, (m,).
        readings: readings, (n, m); NaN if missing or excluded.
        errors: error variances of the signals, (m,).
        remark: defects of the bag, and reasons for excluded parts of the run.
    """

    bag: Path
    scenario: SpatialScenario
    tick: float
    begin_ns: int
    commands: tuple[tuple[int, str, JointSample], ...]
    stamps: tuple[int, ...]
    signals: tuple[Signal, ...]
    readings: Floats
    errors: tuple[Errors, ...]
    remark: str = ""

    @property
    def name(self) -> str:
        """Name in reports."""
        begin = f" from {self.begin_ns / _NANO:g} s" if self.begin_ns else ""
        return f"{self.bag} ({self.scenario.name}{begin})"

    @property
    def times(self) -> Floats:
        """Times of the readings [s], (n,)."""
        return np.array(self.stamps) / _NANO

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """Unknowns of the initial state."""
        start = self.scenario.start
        hangs = start.kind == "hanging" and start.payout_rate == 0.0
        return UNKNOWNS if hangs and self.scenario.rover is not None else ()


# ------------------------------------------------------------------------------ reading bags


def read_experiments(
    path: Path, *, begin: float = 0.0, end: float = math.inf, namespace: str | None = None
) -> list[IdentificationRun]:
    """Return the runs of a bag; a reset of plant or clock starts a new run.

    Args:
        path: the bag.
        begin: time after each start from which readings are used [s].
        end: time after each start until which readings are used [s].
        namespace: namespace of the rover, if the bag holds several.

    Raises:
        IdentifyError: the bag holds no configuration, the model has no sensor errors, or no run is
            long enough.
        BagError: the bag cannot be read.
    """
    recorded_run = read_recorded_run(path, namespace)
    found, longest, why = [], 0, ""
    for segment in recorded_run.segments:
        scenario, tick = _configured(path, segment.configuration)
        starts = sorted({0, *segment.plant_resets})
        for start, after in zip(starts, [*starts[1:], None], strict=True):
            stop = segment.last_ns if after is None else after
            stop, remark = _without_gap(segment, start, stop, round(tick * _NANO))
            first = start + round(begin * _NANO)
            last = stop if math.isinf(end) else min(stop, start + round(end * _NANO))
            stamps = tuple(s for s in sorted(segment.recorded) if start < s and first <= s <= last)
            if len(stamps) >= longest:
                longest, why = len(stamps), remark
            if len(stamps) < _MIN_READINGS:
                continue
            one = _experiment(path, scenario, tick, segment, start, stamps)
            if one.signals:
                found.append(
                    replace(
                        one, remark="; ".join([*recorded_run.file_defects, *filter(None, [remark])])
                    )
                )
    if not found:
        raise IdentifyError(
            f"{path} holds no run that is long enough: the longest has readings at {longest} "
            f"instants from its start on, at minimum {_MIN_READINGS} are needed"
            + (f" ({why})" if why else "")
        )
    return found


def _without_gap(segment: RunSegment, start: int, stop: int, tick_ns: int) -> tuple[int, str]:
    """End of the gap-free part of a run [ns], and the reason for the exclusion of the rest."""
    for before, after in segment.gaps(tick_ns, start, stop):
        return before, (
            f"from {before / _NANO:.3f} s to {after / _NANO:.3f} s nothing is recorded: later "
            "readings are excluded, as commands may be missing"
        )
    return stop, ""


def _configured(path: Path, content: Mapping[str, Any] | None) -> tuple[SpatialScenario, float]:
    if content is None:
        raise IdentifyError(
            f"{path} holds no configuration of a simulator ({topics.CONFIG} with a scenario): the "
            "machine is unknown"
        )
    try:
        scenario = scenario_from_mapping(content["scenario"])
        tick = configured_tick(content)
    except (ScenarioError, KeyError, TypeError, ValueError) as error:
        raise IdentifyError(f"the configuration in {path} cannot be used here: {error}") from error
    if START in content:
        raise IdentifyError(
            f"{path} holds a run from a saved state, which is one of the recorded machine alone; "
            "record a run from the scenario's start"
        )
    if not isinstance(scenario, SpatialScenario):
        raise IdentifyError(
            f"{path} was recorded with the {scenario.model} model ({scenario.name}), which has no "
            "sensor errors; record with the spatial model"
        )
    return with_stiffness(scenario), tick


def _experiment(
    path: Path,
    scenario: SpatialScenario,
    tick: float,
    segment: RunSegment,
    start: int,
    stamps: tuple[int, ...],
) -> IdentificationRun:
    signals = (*SIGNALS, DRUM)
    needed_topics = {signal.topic for signal in signals}
    readings = np.full((len(stamps), len(signals)), np.nan)
    for row, stamp in enumerate(stamps):
        samples = {
            name: each for name, each in segment.recorded[stamp].items() if name in needed_topics
        }
        _fill(readings[row], signals, samples)
    turning = _turning(np.array(stamps) / _NANO, readings[:, -1], scenario)
    errors = []
    for place, signal in enumerate(SIGNALS):
        channel = getattr(scenario.sensors, signal.channel)
        column = readings[:, place]
        has_errors = scenario.sensors.error_model == "full"
        resolution = channel.resolution if has_errors else 0.0
        if resolution > 0.0:
            _exclude_stationary(column, _CREEPING * resolution)
        if signal.topic == topics.LOAD_CELL:
            column[turning] = np.nan
        column[np.abs(column) >= channel.range] = np.nan
        minimum = _MIN_NOISE * float(np.nanstd(column)) if np.isfinite(column).any() else 0.0
        errors.append(
            Errors(
                (channel.noise_density**2 / tick if has_errors else 0.0)
                + resolution**2 / 12.0
                + max(minimum, 1e-12) ** 2,
                channel.bias_random_walk**2 if has_errors else 0.0,
                channel.bias**2 if has_errors else 0.0,
            )
        )
    used = [place for place in range(len(SIGNALS)) if np.isfinite(readings[:, place]).sum() > 2]
    return IdentificationRun(
        path,
        scenario,
        tick,
        start,
        _commands(segment, start, stamps[-1], round(tick * _NANO)),
        stamps,
        tuple(SIGNALS[place] for place in used),
        readings[:, used],
        tuple(errors[place] for place in used),
    )


def _exclude_stationary(column: Floats, minimum: float) -> None:
    """Exclude readings of an encoder at rest: their error is constant, not noise."""
    known = np.flatnonzero(np.isfinite(column))
    moves = np.abs(np.diff(column[known])) >= minimum
    keep = np.concatenate([[False], moves]) & np.concatenate([moves, [False]])
    column[known[~keep[: len(known)]]] = np.nan


def _turning(times: Floats, length: Floats, scenario: SpatialScenario) -> NDArray[np.bool_]:
    """Which readings were taken while the drum turned, or shortly before or after, (n,)."""
    if scenario.winch is None or np.isnan(length).all():
        return np.zeros(len(times), dtype=bool)
    known = np.flatnonzero(np.isfinite(length))
    minimum = np.maximum(
        _TURNING * np.diff(times[known]), 1.5 * scenario.sensors.drum_encoder.resolution
    )
    # Up to each known length; before the first and after the last one it is not known.
    turns = np.concatenate([[known[0] > 0], np.abs(np.diff(length[known])) > minimum, [True]])
    around = 2 * math.ceil(_SETTLES / float(np.median(np.diff(times)))) + 1
    spread = maximum_filter1d(turns[np.searchsorted(known, np.arange(len(times)))], around)
    return np.asarray(spread, dtype=bool)


def _commands(
    segment: RunSegment, start: int, last: int, tick_ns: int
) -> tuple[tuple[int, str, JointSample], ...]:
    commands = []
    for command in segment.commands:
        given = earliest_instant(segment, command)
        given = -(-given // tick_ns) * tick_ns
        if not start <= given < last:
            continue
        try:
            sample = unpack(command.name, command.data, given)
        except Refusal:
            continue
        if isinstance(sample, JointSample):
            commands.append((given, command.name, sample))
    return tuple(commands)


def _fill(row: Floats, signals: Sequence[Signal], samples: Mapping[str, Sample]) -> None:
    numbers = {name: dict(sample.scalars()) for name, sample in samples.items()}
    for place, signal in enumerate(signals):
        if signal.topic in numbers:
            row[place] = numbers[signal.topic].get(signal.field, math.nan)


# -------------------------------------------------------------------------------- prediction

Task: TypeAlias = tuple[int, Mapping[str, float], Sequence[float]]
"""A simulation: index of the experiment, parameter values, values of the initial unknowns."""


def predict(
    experiment: IdentificationRun, values: Mapping[str, float], start: Sequence[float] = ()
) -> Floats:
    """Predict the readings of error-free sensors, (n, m).

    Args:
        experiment: the run with its commands.
        values: values by parameter name; other parameters are as configured.
        start: values of the initial unknowns; empty: all 0.

    Returns:
        Readings; NaN from the time on at which the simulation fails.
    """
    found = np.full(experiment.readings.shape, np.nan)
    try:
        plant = SpatialPlant(without_errors(with_values(experiment.scenario, values)))
        simulation = Simulation(build_interface(plant, 0), experiment.tick)
        if experiment.unknowns and len(start):
            simulation.state = displaced(plant, displacement(start))
    except (ScenarioError, SettlingError):
        return found
    simulation.stamp_ns = experiment.begin_ns
    simulation.interface.restart(simulation.state, simulation.stamp_ns)
    rows = {stamp: row for row, stamp in enumerate(experiment.stamps)}
    names = {signal.topic for signal in experiment.signals}
    waiting = list(reversed(experiment.commands))
    while simulation.stamp_ns < experiment.stamps[-1]:
        while waiting and waiting[-1][0] <= simulation.stamp_ns:
            _, name, sample = waiting.pop()
            try:
                simulation.accept_command(name, sample)
            except Refusal:  # the recorded plant may have refused it as well
                continue
        if simulation.tick().after.phase.final:
            break
        row = rows.get(simulation.stamp_ns)
        if row is not None:
            _fill(found[row], experiment.signals, dict(simulation.interface.samples(names)))
    return found
