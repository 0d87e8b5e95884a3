"""Late or missing commands to the winch's drive: the shipped winch and plant on the loop host."""

from __future__ import annotations

import pytest

from msg_schemas import machine, topics
from msg_schemas.events import SimulationEvent, WinchEvent
from msg_schemas.phases import WinchMode
from rover_sim.node.sim_loop import Tick
from rover_sim.plants.spatial_state import SpatialState
from rover_verify.harness.flight import WINCH, Flight

LENGTH, DISTANCE, RATE = 15.0, 3.0, 0.3
LOAD = (10.0 + 0.005 * (LENGTH + DISTANCE)) * 1.62


class PayingOut(Flight):
    """A winch that pays out at its rate; keeps the peak tension of each tick from then on."""

    def __init__(self) -> None:
        overrides = {"tether.length": LENGTH, "sensors.error_model": "ideal"}
        super().__init__(WINCH, "free_hang", overrides, defaults={})
        self.tensions: list[float] = []
        self.run(0.5)
        assert self.call(topics.WINCH_REARM).success
        self.send_to(LENGTH + DISTANCE)
        self.run(4.0)
        assert self.rate == pytest.approx(RATE, abs=0.01)
        self.sim.observers.append(self._keep_tension)

    def _keep_tension(self, tick: Tick[SpatialState]) -> None:
        self.tensions.append(tick.result.peak_tension)

    def send_to(self, length: float) -> None:
        self.request(topics.WINCH_REQUEST, machine.WINCH_TO_LENGTH, length, RATE)

    @property
    def rate(self) -> float:
        return self.plant.payout_rate(self.state)

    def freeze_winch(self, duration: float) -> None:
        self.host.freeze("winch_node")
        self.run(duration)
        self.host.thaw("winch_node")

    def timeouts(self) -> int:
        return len(self.events_named(SimulationEvent.COMMAND_TIMEOUT))


@pytest.fixture
def flight() -> PayingOut:
    return PayingOut()


def test_a_gap_of_a_quarter_of_a_second_changes_nothing(flight: PayingOut):
    for _ in range(4):
        flight.freeze_winch(
            0.22
        )  # and up to 0.03 s for the last command before and the first after
        flight.run(0.2)
    assert not flight.timeouts()
    assert not flight.refusals
    assert flight.phases[topics.WINCH_MODE] == WinchMode.LENGTH
    assert flight.rate == pytest.approx(RATE, abs=0.01)
    assert max(flight.tensions) < 1.05 * LOAD


@pytest.mark.parametrize("duration", [0.3, 0.5, 0.9, 1.5])
def test_after_a_longer_loss_of_commands_the_motion_goes_on_from_rest(
    flight: PayingOut, monkeypatch: pytest.MonkeyPatch, duration: float
):
    with monkeypatch.context() as lost:
        lost.setattr(flight.simulation, "accept_command", lambda _topic, _sample: None)
        flight.run(duration)
    flight.run(1.2)
    assert flight.timeouts() == 1
    if duration < 1.0:
        assert "quick stop" in flight.refusals[0][1].reason
    flight.run(12.0)
    assert not flight.events_named(WinchEvent.FAULT)
    assert flight.state.length == pytest.approx(LENGTH + DISTANCE, abs=0.01)
    assert flight.phases[topics.WINCH_MODE] == WinchMode.HOLD
    assert max(flight.tensions) < 1.5 * LOAD
    assert min(flight.tensions) > 0.5 * LOAD


@pytest.mark.parametrize("duration", [0.4, 0.6, 0.9])
def test_a_controller_that_was_stopped_latches_a_fault_without_a_snatch(
    flight: PayingOut, duration: float
):
    flight.freeze_winch(duration)
    flight.run(3.0)
    (fault,) = flight.events_named(WinchEvent.FAULT)
    assert fault.values["fault"] == "node_late"
    assert flight.state.braked
    assert flight.rate == 0.0
    assert max(flight.tensions) < 1.5 * LOAD
    assert flight.timeouts() == 1
    assert flight.call(topics.WINCH_REARM).success
    flight.send_to(LENGTH)
    flight.run(9.0)
    assert flight.state.length == pytest.approx(LENGTH, abs=0.01)


def test_a_killed_controller_leaves_the_drum_braked_without_a_snatch(flight: PayingOut):
    length = flight.state.length
    flight.kill("winch_node")
    flight.run(1.2)
    assert flight.state.braked
    assert flight.rate == 0.0
    assert 0.17 < flight.state.length - length < 0.2
    assert 1.2 * LOAD < max(flight.tensions) < 1.5 * LOAD
    flight.restart("winch_node")
    flight.run(0.5)
    assert flight.call(topics.WINCH_REARM).success
    flight.send_to(LENGTH)
    flight.run(6.0)
    assert flight.state.length == pytest.approx(LENGTH, abs=0.01)


def test_without_the_load_cell_the_drum_slows_down_before_the_brake_closes(
    flight: PayingOut, monkeypatch: pytest.MonkeyPatch
):
    samples = flight.simulation.interface.samples
    monkeypatch.setattr(
        flight.simulation.interface,
        "samples",
        lambda due: samples([name for name in due if name != topics.LOAD_CELL]),
    )
    flight.run(3.0)
    (fault,) = flight.events_named(WinchEvent.FAULT)
    assert fault.values["fault"] == "tension_lost"
    assert flight.state.braked
    # The controller's own quick stop is harder than the drive's: 1 + 2 x 0.6/1.62 at most.
    assert 1.2 * LOAD < max(flight.tensions) < 1.75 * LOAD
