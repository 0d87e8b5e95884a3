"""Late or missing commands to the winch: controller, drive and spatial plant together."""

from __future__ import annotations

from typing import Any

import pytest

from msg_schemas import topics
from msg_schemas.events import SimulationEvent
from msg_schemas.faults import WinchFault
from msg_schemas.machine import WINCH_BRAKE, WINCH_DRUM, WINCH_LIMIT, WINCH_TO_LENGTH
from msg_schemas.phases import WinchMode
from msg_schemas.refusal import Refusal
from msg_schemas.samples import JointSample, JointValue
from rover_sim import build_plant, load_spatial
from rover_sim.interface_factory import build_interface
from rover_sim.sim_loop import Simulation
from tether_winch.winch import Winch, WinchParameters

TICK = 0.01
LENGTH, RATE = 15.0, 0.3
LOAD = (10.0 + 0.005 * (LENGTH + 3.0)) * 1.62


class Machine:
    """A winch controller and a plant with its drives, in simulated time."""

    def __init__(self) -> None:
        scenario = load_spatial(
            "free_hang", {"tether.length": LENGTH, "sensors.error_model": "ideal"}
        )
        self.simulation: Simulation[Any] = Simulation(
            build_interface(build_plant(scenario), 1), TICK
        )
        self.winch = Winch(WinchParameters())
        self.has_load_cell = True
        self.events: list[str] = []
        self.refusals: list[Refusal] = []
        self.tensions: list[float] = []
        self.run(0.1)
        self.winch.rearm(self.simulation.stamp_ns)
        target = JointSample(
            self.simulation.stamp_ns, {WINCH_TO_LENGTH: JointValue(LENGTH + 3.0, RATE)}
        )
        self.winch.request(target, self.simulation.stamp_ns)
        self.run(4.0)
        assert self.rate == pytest.approx(RATE, abs=0.01)
        self.tensions.clear()

    @property
    def rate(self) -> float:
        return self.simulation.interface.drive_feedback(self.simulation.state).payout_rate

    def run(self, duration: float, *, link: bool = True, controller: bool = True) -> None:
        """Run for a time [s] without the link to the drive, or with the controller stopped."""
        for _ in range(round(duration / TICK)):
            tick = self.simulation.tick()
            self.events += [report.name for report in tick.event_reports]
            self.tensions.append(tick.result.peak_tension)
            now_ns, samples = self.simulation.stamp_ns, self._samples()
            if not controller:
                continue
            self.winch.on_drum(samples[topics.WINCH_STATE], now_ns)
            if self.has_load_cell:
                self.winch.on_load_cell(samples[topics.LOAD_CELL], now_ns)
            self.winch.on_currents(samples[topics.MOTOR_CURRENTS], now_ns)
            command = self.winch.step(now_ns)
            if command is None or not link:
                continue
            joints = {
                WINCH_DRUM: JointValue(command.length, command.rate, command.feed_forward),
                WINCH_BRAKE: JointValue(float(command.release_brake)),
                WINCH_LIMIT: JointValue(effort=command.limit),
            }
            try:
                self.simulation.accept_command(topics.WINCH_COMMAND, JointSample(now_ns, joints))
            except Refusal as refusal:
                self.refusals.append(refusal)

    def _samples(self) -> dict[str, Any]:
        names = (topics.WINCH_STATE, topics.LOAD_CELL, topics.MOTOR_CURRENTS)
        return dict(self.simulation.interface.samples(names))


@pytest.fixture
def machine() -> Machine:
    return Machine()


def test_a_quarter_of_a_second_without_commands_changes_nothing(machine: Machine):
    for _ in range(4):
        machine.run(0.24, link=False)
        machine.run(0.1)
        machine.run(0.24, controller=False)
        machine.run(0.1)
    assert not machine.events
    assert not machine.refusals
    assert machine.winch.mode is WinchMode.LENGTH
    assert machine.rate == pytest.approx(RATE, abs=0.01)
    assert max(machine.tensions) < 1.05 * LOAD


@pytest.mark.parametrize("duration", [0.3, 0.5, 0.9, 1.5])
def test_after_a_longer_loss_of_commands_the_motion_goes_on_from_rest(
    machine: Machine, duration: float
):
    machine.run(duration, link=False)
    machine.run(1.2)
    assert machine.events == [SimulationEvent.COMMAND_TIMEOUT]
    if duration < 1.0:
        assert "quick stop" in machine.refusals[0].reason
    assert machine.winch.fault is None
    machine.run(12.0)
    assert machine.simulation.state.length == pytest.approx(LENGTH + 3.0, abs=0.01)
    assert machine.winch.mode is WinchMode.HOLD
    assert max(machine.tensions) < 1.5 * LOAD
    assert min(machine.tensions) > 0.5 * LOAD


@pytest.mark.parametrize("duration", [0.4, 0.6, 0.9])
def test_a_controller_that_was_stopped_latches_a_fault_without_a_snatch(
    machine: Machine, duration: float
):
    machine.run(duration, controller=False)
    machine.run(3.0)
    assert machine.winch.fault is WinchFault.NODE_LATE
    state = machine.simulation.state
    assert state.braked
    assert machine.rate == 0.0
    assert max(machine.tensions) < 1.5 * LOAD
    assert machine.events == [SimulationEvent.COMMAND_TIMEOUT]
    machine.winch.rearm(machine.simulation.stamp_ns)
    target = JointSample(machine.simulation.stamp_ns, {WINCH_TO_LENGTH: JointValue(LENGTH, RATE)})
    machine.winch.request(target, machine.simulation.stamp_ns)
    machine.run(9.0)
    assert machine.simulation.state.length == pytest.approx(LENGTH, abs=0.01)


def test_without_the_load_cell_the_drum_slows_down_before_the_brake_closes(machine: Machine):
    machine.has_load_cell = False
    machine.run(3.0)
    assert machine.winch.fault is WinchFault.TENSION_LOST
    assert machine.simulation.state.braked
    # The controller's own quick stop is harder than the drive's: 1 + 2 x 0.6/1.62 at most.
    assert 1.2 * LOAD < max(machine.tensions) < 1.75 * LOAD
