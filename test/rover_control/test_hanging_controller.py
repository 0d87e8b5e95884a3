"""Reports of the hanging controller on its swing estimate."""

from __future__ import annotations

from msg_schemas import machine
from msg_schemas.events import DescentEvent
from msg_schemas.samples import ImuSample, JointSample, JointValue
from rover_control.hanging.hanging_controller import HangingController, HangingControllerParameters

TICK_NS = 10_000_000
PULL = 1.62


def events_at(rover: HangingController, first: int, seconds: float, rate: float) -> list[str]:
    """Names of the events while the gyro about x reads a rate [rad/s]."""
    rest = JointValue()
    for k in range(first, first + round(100 * seconds)):
        now = k * TICK_NS
        drum = {machine.WINCH_DRUM: JointValue(5.0), machine.WINCH_BRAKE: rest}
        rover.on_drum(JointSample(now, drum), now)
        rover.on_wheels(
            JointSample(now, {machine.WHEEL_LEFT: rest, machine.WHEEL_RIGHT: rest}), now
        )
        rover.on_flywheel(JointSample(now, {machine.FLYWHEEL: rest}), now)
        rover.on_imu(ImuSample(now, (rate, 0.0, 0.0), (0.0, 0.0, PULL)), now)
    return [change.name for change in rover.take_changes()]


def test_a_divergence_is_reported_once_and_its_end_too():
    rover = HangingController(HangingControllerParameters())
    assert events_at(rover, 1, 10.0, 0.0) == []
    # The rate of a rover that is turned over, not of a hanging one.
    assert events_at(rover, 1001, 20.0, 1.0) == [DescentEvent.SWING_LOST]
    assert rover.estimator.divergences > 1
    assert events_at(rover, 3001, 60.0, 0.0) == [DescentEvent.SWING_RECOVERED]


def test_a_rotor_state_that_is_overtaken_by_its_imu_sample_is_waited_for():
    late, paired = (HangingController(HangingControllerParameters()) for _ in range(2))
    for k in range(1, 300):
        now = k * TICK_NS
        turning = JointSample(now, {machine.FLYWHEEL: JointValue(0.0, 0.5 * k)})
        rest = JointValue()
        imu = ImuSample(now, (0.0, 0.0, 0.0), (0.0, 0.0, PULL))
        for rover in (late, paired):
            rover.on_drum(
                JointSample(now, {machine.WINCH_DRUM: JointValue(5.0), machine.WINCH_BRAKE: rest}),
                now,
            )
            rover.on_wheels(
                JointSample(now, {machine.WHEEL_LEFT: rest, machine.WHEEL_RIGHT: rest}), now
            )
        late.on_imu(imu, now)
        late.on_flywheel(turning, now)
        paired.on_flywheel(turning, now)
        paired.on_imu(imu, now)
    assert late.swing == paired.swing
