"""The winch over the link to emulated drives, compared with the same run without the link."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_schemas import machine, topics
from msg_schemas.phases import WinchMode
from msg_schemas.samples import JointSample, JointValue, Sample, WrenchSample
from rover_sim import Simulation
from rover_verify.checks import CheckBatch, Measured
from rover_verify.checks.hil_safety import simulation as hanging
from rover_verify.harness.hil_bench import HilBench
from tether_winch.winch import WinchController
from tether_winch.winch_parameters import WinchParameters

_START = (8.0, 12.0)  # initial lengths [m]
_DISTANCE = (1.0, 2.0)  # of payout [m]
_RATE = (0.1, 0.3)  # [m/s]
_LONGEST = 60.0  # [s]
_MOST_RUNS = 5
_INPUTS = (topics.WINCH_STATE, topics.LOAD_CELL, topics.MOTOR_CURRENTS)
_SETTLING = 0.2  # of devices and drives before the winch is armed [s]

Floats = NDArray[np.float64]


class _LinkFlight:
    """A winch controller that is armed, requested to a length, and comes to rest."""

    def __init__(self, goal: float, rate: float) -> None:
        self._winch = WinchController(WinchParameters())
        self._goal, self._rate = goal, rate
        self._begun_ns: int | None = None
        self._requested = False

    def commands(self, samples: Mapping[str, Sample], stamp_ns: int) -> Mapping[str, JointSample]:
        """Commands of the winch to its drive, from the samples of a time."""
        winch = self._winch
        drum, load, currents = (samples.get(name) for name in _INPUTS)
        if not (
            isinstance(drum, JointSample)
            and isinstance(load, WrenchSample)
            and isinstance(currents, JointSample)
        ):
            return {}
        winch.sensing.on_drum(drum, stamp_ns)
        winch.sensing.on_load_cell(load, stamp_ns)
        winch.sensing.on_currents(currents, stamp_ns)
        order = winch.step(stamp_ns)
        self._begun_ns = stamp_ns if self._begun_ns is None else self._begun_ns
        if not self._requested and stamp_ns - self._begun_ns >= _SETTLING * 1e9:
            winch.rearm(stamp_ns)
            goal = {machine.WINCH_TO_LENGTH: JointValue(self._goal, self._rate, 0.0)}
            winch.request(JointSample(stamp_ns, goal), stamp_ns)
            self._requested = True
        if order is None:
            return {}
        joints = {
            machine.WINCH_DRUM: JointValue(order.length, order.rate, order.feed_forward),
            machine.WINCH_BRAKE: JointValue(float(order.release_brake)),
            machine.WINCH_LIMIT: JointValue(0.0, 0.0, order.limit),
        }
        return {topics.WINCH_COMMAND: JointSample(stamp_ns, joints)}

    @property
    def is_over(self) -> bool:
        """Whether it holds again; raises RuntimeError after a fault."""
        if self._winch.mode is WinchMode.FAULT:
            raise RuntimeError(f"the winch is in fault: {self._winch.fault_reason}")
        return self._requested and self._winch.mode is WinchMode.HOLD


def _flown(
    simulation: Simulation[Any], flight: _LinkFlight, cycle: Callable[[], None]
) -> Iterator[tuple[float, float, float]]:
    """Time since the start [s], true length [m] and tension [N] of each cycle until rest."""
    begun = simulation.stamp_ns
    while not flight.is_over:
        cycle()
        time = (simulation.stamp_ns - begun) * 1e-9
        assert simulation.last is not None
        forces = simulation.last.forces
        length = simulation.interface.drive_feedback(simulation.state).length
        yield time, length, forces.fairlead_tension
        if time > _LONGEST:
            raise RuntimeError(f"the winch did not come to rest within {_LONGEST:g} s")


def _direct(length: float, goal: float, rate: float, seed: int) -> Floats:
    simulation, flight = hanging(seed, **{"tether.length": length}), _LinkFlight(goal, rate)
    simulation.tick()

    def cycle() -> None:
        samples = dict(simulation.interface.samples(_INPUTS))
        for topic, sample in flight.commands(samples, simulation.stamp_ns).items():
            simulation.accept_command(topic, sample)
        simulation.tick()

    return np.array(list(_flown(simulation, flight, cycle)))


def _through_the_link(length: float, goal: float, rate: float, seed: int) -> Floats:
    simulation, flight = hanging(seed, **{"tether.length": length}), _LinkFlight(goal, rate)
    with closing(HilBench(simulation, rover_offset=3.0)) as bench:
        bench.arm()

        def cycle() -> None:
            bench.cycle(lambda: flight.commands(bench.published, simulation.stamp_ns))

        return np.array(list(_flown(simulation, flight, cycle)))


def descent(batch: CheckBatch) -> Measured:
    """Largest difference of length [m] from the same descent without the link."""
    worst, tension, late, flights = 0.0, 0.0, 0.0, min(batch.runs, _MOST_RUNS)
    for generator in batch.generators(flights):
        length = float(generator.uniform(*_START))
        goal = length + float(generator.uniform(*_DISTANCE))
        rate = float(generator.uniform(*_RATE))
        seed = int(generator.integers(1, 2**31))
        direct = _direct(length, goal, rate, seed)
        linked = _through_the_link(length, goal, rate, seed)
        common = min(len(direct), len(linked))
        worst = max(worst, float(np.abs(direct[:common, 1] - linked[:common, 1]).max()))
        worst = max(worst, abs(float(direct[-1, 1] - linked[-1, 1])))
        tension = max(tension, float(np.abs(direct[:common, 2] - linked[:common, 2]).max()))
        late = max(late, abs(float(direct[-1, 0] - linked[-1, 0])))
    return Measured(
        worst,
        f"{flights} descents of {_DISTANCE[0]:g} to {_DISTANCE[1]:g} m, with and without the link",
        {"tension [N]": tension, "time to rest [s]": late},
    )
