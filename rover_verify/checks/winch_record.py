"""Motion of the winch, recorded in a flight or read from a bag, and its metrics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from msg_schemas import machine, topics
from msg_schemas.samples import JointSample, Sample
from rover_bags.reading.read import Bag, ReadError, TimeSeries, read_bag
from rover_verify.harness.flight import Flight
from tether_winch.drum_model import DrumModel
from tether_winch.servo import GoalKind, SensedState, ServoGoal, WinchServo
from tether_winch.winch_parameters import WinchParameters

Floats = NDArray[np.float64]

COLUMNS = ("time", "length", "reference", "rate", "reference_rate", "tension")
TICK = 0.01  # of the controller [s]
_MOVING = 1e-4  # of a reference [m/s]
_STEADY = 0.99  # fraction of the requested rate above which the payout is steady
_NEAR_ENDS = 2.0  # at both ends of a leg, excluded from steady payout [m]
_LEAST = 5.0  # payout below which the rover's tilt couples with the tension [m]


@dataclass(frozen=True)
class WinchRecord:
    """Recorded motion of the winch between rests.

    Attributes:
        columns: by `COLUMNS`, at the drum's samples: time [s], length and reference [m], their
            rates [m/s], tension at the fairlead [N]; shape (N,) each.
        requests: time [s], length [m] and rate [m/s] of each request for a length.
    """

    columns: Mapping[str, Floats]
    requests: tuple[tuple[float, float, float], ...]

    def __getitem__(self, name: str) -> Floats:
        """One column."""
        return self.columns[name]

    def legs(self) -> list[tuple[slice, float, float]]:
        """Of each request: the samples until the next one, length [m] and requested rate [m/s]."""
        begins = [float(at) for at, _, _ in self.requests]
        marks = [int(i) for i in np.searchsorted(self["time"], begins)] + [len(self["time"])]
        return [
            (slice(marks[i], marks[i + 1]), length, rate)
            for i, (_, length, rate) in enumerate(self.requests)
        ]

    # --- metrics ---------------------------------------------------------------------------------

    def length_error(self) -> float:
        """Largest distance of the drum's length from the reference that the winch reports [m]."""
        return float(np.abs(self["length"] - self["reference"]).max())

    def distance_from_curve(self) -> float:
        """Largest distance [m] from S-curves that wait for nothing, begun when the drum begins."""
        worst = 0.0
        for part, goal, rate in self.legs():
            time, length = self["time"][part], self["length"][part]
            begun = int(np.argmax(np.abs(self["reference_rate"][part]) > _MOVING))
            times, curve = ideal_curve(float(length[begun]), goal, rate)
            ideal = np.interp(time[begun:] - time[begun], times, curve)
            worst = max(worst, float(np.abs(length[begun:] - ideal).max()))
        return worst

    def overshoot(self) -> float:
        """How far the drum goes beyond the lengths that were requested [m]."""
        worst = 0.0
        for part, goal, _ in self.legs():
            length = self["length"][part]
            side = np.sign(goal - length[0])
            worst = max(worst, float(np.max(side * (length - goal))))
        return worst

    def ripple(self) -> dict[str, float]:
        """RMS of the tension over its mean in steady payout by direction, less its slow rise."""
        found = {}
        for part, goal, rate in self.legs():
            time, length, speed, tension = (
                self[name][part] for name in ("time", "length", "rate", "tension")
            )
            side = float(np.sign(goal - length[0]))
            far = np.minimum(np.abs(length - length[0]), np.abs(length - goal)) > _NEAR_ENDS
            steady = far & (length > _LEAST) & (side * speed > _STEADY * rate)
            line = np.polynomial.Polynomial.fit(time[steady], tension[steady], 1)
            rest = tension[steady] - line(time[steady])
            name = f"{'down' if side > 0.0 else 'up'} over {np.ptp(length[steady]):.1f} m"
            found[name] = float(np.sqrt(np.mean(rest**2)) / np.mean(tension[steady]))
        return found


def ideal_curve(start: float, goal: float, rate: float) -> tuple[Floats, Floats]:
    """Time [s] and length [m] of the winch's own S-curve on a drum that follows it perfectly."""
    p = WinchParameters()
    servo = WinchServo(p.servo, DrumModel(p.drum))
    servo.set_goal(ServoGoal(GoalKind.LENGTH, length=goal, rate=rate))
    length, lengths = start, [start]
    for _ in range(round((abs(goal - start) / rate + 60.0) / TICK)):
        is_open = servo.phase.name in {"OPENING", "OPEN"}
        servo.step(SensedState(length, servo.motion.rate, 0.0, 0.0, 0.0, is_open), 1e3, TICK)
        length = servo.reference.length
        if servo.motion.rate != 0.0 or len(lengths) > 1:
            lengths.append(length)
    return np.linspace(0.0, TICK * (len(lengths) - 1), len(lengths)), np.array(lengths)


class WinchRecorder:
    """Records the winch of a flight at each of its drive commands: truth and reference.

    Args:
        flight: with a winch_node.
    """

    def __init__(self, flight: Flight) -> None:
        self._flight = flight
        self._begun = flight.time
        self._rows: list[tuple[float, ...]] = []  # by COLUMNS
        self._requests: list[tuple[float, float, float]] = []
        flight.host.exchange.listen(self._on_command, topics.WINCH_COMMAND)
        flight.host.exchange.listen(self._on_request, topics.WINCH_REQUEST)

    def record(self) -> WinchRecord:
        """Return what was recorded up to now."""
        values = np.array(self._rows, dtype=np.float64).T
        return WinchRecord(dict(zip(COLUMNS, values, strict=True)), tuple(self._requests))

    def _on_command(self, *_: object) -> None:
        flight = self._flight
        state, aim = flight.state, flight.winch.servo.reference
        self._rows.append(
            (
                flight.time - self._begun,
                state.length,
                aim.length,
                flight.plant.payout_rate(state),
                aim.rate,
                flight.result.forces.fairlead_tension,
            )
        )

    def _on_request(self, _topic: str, sample: Sample, _sender: str, _now_ns: int) -> None:
        assert isinstance(sample, JointSample)
        if machine.WINCH_TO_LENGTH in sample.joints:
            length, rate, _ = sample.joints[machine.WINCH_TO_LENGTH]
            self._requests.append((self._flight.time - self._begun, length, rate))


_TOPICS = (
    topics.CLOCK, topics.WINCH_STATE, topics.WINCH_ESTIMATE, topics.WINCH_REQUEST,
    topics.LOAD_CELL, topics.CONFIG,
)  # fmt: skip


def record_of_bag(path: Path) -> tuple[WinchRecord, Bag]:
    """Read a record from a bag: encoder and load cell against the reference.

    Raises:
        ReadError: one of the winch's topics is not in the bag, or begins too late.
    """
    bag = read_bag(path, _TOPICS)
    state, estimate = _series(bag, topics.WINCH_STATE), _series(bag, topics.WINCH_ESTIMATE)
    cell, request = _series(bag, topics.LOAD_CELL), _series(bag, topics.WINCH_REQUEST)
    known = (state.time >= estimate.time[0]) & (state.time <= estimate.time[-1])
    time = state.time[known]
    begun = float(time[0])

    def at_samples(series: TimeSeries, values: Floats) -> Floats:
        return np.asarray(np.interp(time, series.time, values), dtype=np.float64)

    columns = {
        "time": time - begun,
        "length": state.columns[f"{machine.WINCH_DRUM}.position"][known],
        "rate": state.columns[f"{machine.WINCH_DRUM}.velocity"][known],
        "reference": at_samples(estimate, estimate.columns[f"{machine.REFERENCE}.position"]),
        "reference_rate": at_samples(estimate, estimate.columns[f"{machine.REFERENCE}.velocity"]),
        "tension": at_samples(cell, np.linalg.norm(cell.vector("force"), axis=1)),
    }
    requests = zip(
        (request.time - begun).tolist(),
        request.columns[f"{machine.WINCH_TO_LENGTH}.position"].tolist(),
        request.columns[f"{machine.WINCH_TO_LENGTH}.velocity"].tolist(),
        strict=True,
    )
    record = WinchRecord(columns, tuple(requests))
    if record.requests[0][0] < 0.0:
        late = -record.requests[0][0]
        raise ReadError(f"the bag {path} holds the winch from {late:.2g} s after its request on")
    return record, bag


def _series(bag: Bag, topic: str) -> TimeSeries:
    series = bag.series(topic)
    if series is None or not len(series):
        raise ReadError(f"the bag {bag.path} holds nothing of {topic}")
    return series
