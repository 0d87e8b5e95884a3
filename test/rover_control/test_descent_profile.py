"""Sequence of stops, stepped with simulated swing estimates."""

from __future__ import annotations

import math

import pytest

from msg_schemas.events import DescentEvent, EventName, EventReport
from msg_schemas.faults import Reason
from msg_schemas.phases import DescentPhase
from msg_schemas.refusal import Refusal, RefusalCode
from rover_control.hanging.descent_parameters import ProfileParameters
from rover_control.hanging.descent_profile import DescentProfile, ProfileSetpoints
from rover_control.hanging.descent_stop import DescentStop
from rover_control.hanging.hanging_rover import HangingParameters
from rover_control.hanging.swing_estimator import SwingEstimate
from rover_control.hanging.yaw_momentum import MomentumTransfer, YawTask

HANGING, PROFILE = HangingParameters(), ProfileParameters()
H = 0.1

STOP_ENDS = (DescentEvent.STOP_COMPLETED, DescentEvent.STOP_ABORTED, DescentEvent.STOP_FAILED)
IMAGED = (DescentEvent.STOP_COMPLETED, PROFILE.exposures)


class World:
    """A winch that follows at once, and a given swing."""

    def __init__(self, length: float, major: float = 0.0, minor: float = 0.0) -> None:
        self.profile = DescentProfile(PROFILE, HANGING, lambda _: 30.0)
        self.length = length
        self.major, self.minor = math.radians(major), math.radians(minor)
        self.yaw_rate = 0.0
        self.transfers = False  # whether the tether can transfer a momentum
        self.twist = 0.0  # of the tether [rad]
        self.now = 0.0
        self.swing_error = 1e-5  # [rad/s]
        self.ascents: list[float] = []  # rates [m/s]
        self.pictures = 0

    @property
    def swing(self) -> SwingEstimate:
        frequency = HANGING.swing_frequency(self.length)
        phase = frequency * self.now
        u = (self.major * math.cos(phase), self.minor * math.sin(phase))
        v = (-frequency * self.major * math.sin(phase), frequency * self.minor * math.cos(phase))
        zero = (0.0, 0.0)
        return SwingEstimate(
            u, v, zero, zero, zero, self.yaw_rate, frequency, self.swing_error, 1e-5
        )

    @property
    def transfer(self) -> MomentumTransfer:
        inertia = HANGING.pendulum_inertia(self.length)
        momentum = inertia * HANGING.swing_frequency(self.length) * self.major * self.minor
        time = 100.0 if self.transfers else math.inf
        return MomentumTransfer(momentum, time, 0.0, abs(self.twist))

    def request(self, depth: float, *, observes: bool = True, rate: float = 0.0) -> None:
        self.profile.request(DescentStop(depth, observes, rate), self.swing, self.length)

    def step(self, *, rests: bool = True) -> ProfileSetpoints:
        self.now += H
        at_rest = (
            math.isnan(self.profile.length_setpoint) or self.length == self.profile.length_setpoint
        )
        setpoints = self.profile.step(
            self.swing,
            self.length,
            transfer=self.transfer,
            winch_rests=rests and at_rest,
            rotors_rest=True,
            now=self.now,
        )
        if setpoints.length > self.length:
            self.length = min(setpoints.length, self.length + H * setpoints.rate)
        elif setpoints.length < self.length:
            self.ascents.append(setpoints.rate)
            before = self.length
            self.length = max(setpoints.length, self.length - H * setpoints.rate)
            growth = HANGING.swing_amplitude_at(1.0, before, self.length)
            self.major, self.minor = growth * self.major, growth * self.minor
        if setpoints.trim < 0.0:
            self.major += H / 30.0 * self.major
        if setpoints.trim > 0.0:  # the winch damps all but the circle
            round_ = math.copysign(math.sqrt(self.major * abs(self.minor)), self.minor)
            self.major += H / 30.0 * (abs(round_) - self.major)
            self.minor += H / 30.0 * (round_ - self.minor)
        if setpoints.yaw is YawTask.TRANSFER:
            self.minor -= H / 30.0 * self.minor
        if setpoints.yaw is YawTask.RELAX:
            self.twist -= H / 50.0 * self.twist
        self.pictures += setpoints.exposes
        return setpoints

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / H)):
            self.step()
            if self.profile.is_idle and self.now > 10.0:
                return

    def ended_stops(self) -> list[EventReport]:
        changes = self.profile.take_changes()
        return [change for change in changes if change.name in STOP_ENDS]

    def ended(self) -> list[tuple[EventName, object]]:
        """How each stop has ended, and its pictures."""
        return [(stop.name, stop.values["pictures"]) for stop in self.ended_stops()]


def test_a_steady_rover_takes_its_pictures_at_every_stop():
    world = World(2.0, 0.05)
    for depth in (5.0, 9.0, 12.0):
        world.request(depth)
    world.run(300.0)
    assert world.profile.is_idle
    assert world.pictures == 3 * PROFILE.exposures
    assert world.ended() == [IMAGED] * 3
    assert world.length == pytest.approx(12.0)


def test_a_plane_swing_is_damped_before_but_not_during_pictures():
    world = World(30.0, 1.5)
    world.request(30.5)
    seen = set()
    for _ in range(3000):
        setpoints = world.step()
        phase = world.profile.phase
        seen.add(phase)
        if phase in (DescentPhase.SETTLING, DescentPhase.EXPOSING):
            assert setpoints.trim == 0.0
            assert not setpoints.pumps
        if world.profile.is_idle and world.now > 10.0:
            break
    assert DescentPhase.DAMPING in seen
    assert world.pictures == PROFILE.exposures


def test_an_undampable_cone_ends_the_stop_with_the_reason():
    world = World(7.0, 0.9, 0.85)
    world.request(7.5)
    world.run(200.0)
    (stop,) = world.ended_stops()
    assert (stop.name, stop.reason) == (DescentEvent.STOP_FAILED, Reason.TIME_LIMIT)
    assert "a cone" in stop.message
    assert world.pictures == 0


def test_a_round_swing_below_the_steady_rate_is_accepted():
    # Camera rate 0.09 deg/s: above the end of damping, below the steady rate.
    world = World(7.4, 0.2, 0.19)
    world.request(7.5)
    rate = 0.2 * HANGING.swing_frequency(7.5)
    assert math.degrees(PROFILE.damped_swing_rate) < rate < math.degrees(PROFILE.steady_rate)
    world.yaw_rate = math.radians(0.2)
    world.run(20.0)
    assert world.profile.phase is DescentPhase.DAMPING
    # The plane part is damped; the circle remains.
    world.yaw_rate = 0.0
    world.run(100.0)
    assert world.pictures == PROFILE.exposures


def test_a_cone_is_transferred_before_a_travel_where_possible():
    world = World(2.0, 3.0, 1.5)
    world.transfers = True
    world.request(7.5)
    handed = 0
    while world.length == 2.0:
        setpoints = world.step()
        transfers = setpoints.yaw is YawTask.TRANSFER
        handed += transfers
        assert setpoints.pumps or not transfers
        assert world.now < 400.0
    assert handed > 300
    assert math.degrees(world.minor) < 0.5
    # Its amplitude on the longer tether.
    world.major, world.minor = (
        HANGING.swing_amplitude_at(each, 2.0, 7.5) for each in (world.major, world.minor)
    )
    world.run(400.0)
    assert world.ended() == [IMAGED]


def test_relaxation_of_the_transfer_keeps_below_the_steady_rate():
    world = World(2.0, 0.8, 0.7)
    world.transfers = True
    world.request(7.5)
    momentum = 1.1 * PROFILE.steady_rate**2 * HANGING.pendulum_inertia(7.5)
    momentum /= HANGING.swing_frequency(7.5)
    inertia = HANGING.pendulum_inertia(2.0) * HANGING.swing_frequency(2.0)
    while world.now < 0.9 * PROFILE.stop_timeout:
        # This rest remains however long the transfer lasts.
        world.minor = momentum / (inertia * world.major)
        world.step()
    assert world.length == 2.0
    world.run(PROFILE.stop_timeout)
    assert world.length > 2.0


def test_a_plane_swing_is_damped_by_the_winch_even_if_a_transfer_is_possible():
    world = World(7.5, 3.0, 0.03)
    world.transfers = True
    world.request(7.5)
    # As a cone, its momentum would be transferred.
    limit = (
        PROFILE.transfer_threshold_rate**2
        * HANGING.pendulum_inertia(7.5)
        / HANGING.swing_frequency(7.5)
    )
    assert abs(world.transfer.momentum) > 2.0 * limit
    for _ in range(200):
        assert world.step().yaw is not YawTask.TRANSFER
    assert math.degrees(world.major) < 2.3


def test_a_transfer_at_the_stop_ends_where_it_does_not_help():
    world = World(2.0, 0.4, 0.35)
    world.transfers = True
    world.request(2.0)
    rest = math.radians(0.108)  # radius of a circle that remains, by the estimate
    last = 0.0
    while world.pictures < PROFILE.exposures:
        world.minor = rest**2 / world.major
        if world.step().yaw is YawTask.RELAX:  # little momentum on a short tether
            last = world.now
        assert world.now < PROFILE.stop_timeout
    assert last == pytest.approx(2.0 * PROFILE.transfer_relaxation_time, rel=0.1)


@pytest.mark.parametrize(
    ("length", "task", "trim"), [(2.0, YawTask.RELAX, -1.0), (7.5, YawTask.TRANSFER, 0.0)]
)
def test_only_a_relaxation_raises_a_swing_that_is_too_small_for_the_rotors(
    length: float, task: YawTask, trim: float
):
    world = World(length, 0.25, 0.2)
    world.transfers = True
    world.request(length)
    while world.step().yaw is not task:
        assert world.now < 20.0
    world.major = 0.5 * PROFILE.transfer_swing
    world.minor = 0.5 * world.major
    assert world.step().trim == trim
    world.major = 0.7 * PROFILE.transfer_swing
    assert world.step().trim == 0.0


@pytest.mark.parametrize(
    ("length", "depth", "minor", "task"),
    [
        (2.0, 2.0, 0.1, YawTask.RELAX),
        (2.0, 2.0, 1.5, YawTask.TRANSFER),
        (2.0, 7.5, 0.2, YawTask.TRANSFER),
        (7.5, 7.5, 0.2, YawTask.TRANSFER),
    ],
    ids=["little momentum", "much", "before a travel", "long tether"],
)
def test_the_last_momentum_at_a_short_stop_is_relaxed(
    length: float, depth: float, minor: float, task: YawTask
):
    world = World(length, 0.6 if minor < 0.6 else 3.0, minor)
    world.transfers = True
    world.request(depth)
    while (begun := world.step().yaw) is YawTask.HOLD:
        assert world.now < 60.0
    assert begun is task


def wound(length: float, turns: float) -> World:
    """A calm rover whose tether is wound by turns."""
    world = World(length, 0.1)
    world.transfers, world.twist = True, math.tau * turns
    return world


def tasks_before_the_travel(world: World) -> list[YawTask]:
    """Run until the rover travels; returns the tasks of its rotors."""
    length, tasks = world.length, []
    while world.length == length:
        tasks.append(world.step().yaw)
        assert world.now < 400.0
    return tasks


@pytest.mark.parametrize("turns", [1.0, -3.0])
def test_a_tether_wound_by_turns_is_relaxed_before_a_look(turns: float):
    world = wound(2.0, turns)
    world.request(15.0)
    raised = 0.0
    while world.length == 2.0:
        assert world.step().yaw is YawTask.RELAX or abs(world.twist) < 0.3 or world.now < 9.0
        raised = max(raised, world.major)
        assert world.now < 400.0
    # The rotors needed a swing, which the winch has damped again.
    assert raised > 0.59 * PROFILE.transfer_swing
    there = HANGING.swing_amplitude_at(world.major, 2.0, 15.0) * HANGING.swing_frequency(15.0)
    assert there < 1.1 * PROFILE.damped_swing_rate
    assert abs(world.twist) < 0.3
    world.run(200.0)
    assert world.ended() == [IMAGED]


@pytest.mark.parametrize(
    ("length", "turns", "observes"),
    [(2.0, 0.04, True), (15.0, 1.0, True), (2.0, 1.0, False)],
    ids=["little twist", "long tether, relaxed slowly", "no pictures"],
)
def test_a_tether_is_relaxed_only_where_it_pays(length: float, turns: float, observes: bool):
    world = wound(length, turns)
    world.request(20.0, observes=observes)
    assert YawTask.RELAX not in tasks_before_the_travel(world)


def test_without_rotors_a_wound_tether_does_not_delay_the_travel():
    world = wound(2.0, 1.0)
    world.transfers = False
    world.request(15.0)
    assert YawTask.RELAX not in tasks_before_the_travel(world)


def test_on_a_long_tether_pictures_are_taken_at_the_turning_points():
    # 0.6 deg at 30 m gives a camera rate of up to 0.14 deg/s.
    world = World(29.8, 0.6)
    world.request(30.0)
    rates = [world.swing.camera_rate for _ in range(1500) if world.step().exposes]
    assert len(rates) == PROFILE.exposures
    assert max(rates) < PROFILE.steady_rate


def test_the_last_picture_is_taken_before_the_next_travel():
    world = World(5.0, 0.05)
    world.request(6.0)
    world.request(9.0)
    last = math.nan
    while world.length < 6.1:
        if world.step().exposes:
            last = world.now
        assert world.now < 100.0
        if world.length > 6.0 and world.pictures == PROFILE.exposures:
            break
    assert world.now - last >= PROFILE.exposure_interval - 1e-9


def test_a_spinning_rover_ends_the_stop_without_pictures():
    world = World(30.0, 0.05)
    world.yaw_rate = math.radians(0.5)
    world.request(30.5)
    world.run(PROFILE.stop_timeout + 100.0)
    (stop,) = world.ended_stops()
    assert (stop.name, stop.reason) == (DescentEvent.STOP_FAILED, Reason.TIME_LIMIT)
    assert "0.50 deg/s" in stop.message


def ascend(major: float, minor: float) -> World:
    """Ascend from 45 m to 4 m with a swing [deg], which grows with the shortening."""
    world = World(45.0, major, minor)
    world.request(4.0, observes=False)
    world.run(2000.0)
    assert world.length == pytest.approx(4.0, abs=0.01)
    return world


def test_an_ascent_damps_a_plane_swing_first():
    world = World(45.0, 0.5)
    world.request(4.0, observes=False)
    world.run(12.0)
    assert world.profile.phase is DescentPhase.DAMPING


def test_a_calm_rover_ascends_at_full_rate_and_a_swinging_one_slows_with_the_length():
    calm, plane, cone = ascend(0.05, 0.0), ascend(0.16, 0.0), ascend(0.3, 0.29)
    assert min(calm.ascents) == pytest.approx(PROFILE.travel_rate)
    slow = PROFILE.ascent_rate_gain * 4.0
    assert slow < min(plane.ascents) < PROFILE.travel_rate
    assert min(cone.ascents) == pytest.approx(slow, rel=0.01)
    assert len(calm.ascents) < len(plane.ascents) < len(cone.ascents)


def test_an_ascent_with_an_uncertain_swing_is_slow():
    world = World(20.0, 0.0)
    world.swing_error = PROFILE.largest_swing * HANGING.swing_frequency(20.0)
    world.request(4.0, observes=False)
    world.run(100.0)
    assert max(world.ascents) <= PROFILE.ascent_rate_gain * 20.0


def test_a_stop_that_could_touch_the_wall_is_refused():
    world = World(20.0, 7.0)
    with pytest.raises(Refusal, match=r"the wall is at 3 m") as refused:
        world.request(45.0)
    assert refused.value.code is RefusalCode.OUT_OF_LIMITS
    assert world.profile.is_idle


def test_a_stop_waits_until_the_swing_is_known_to_leave_the_wall_clear():
    world = World(20.0, 2.0)
    world.swing_error = math.radians(5.0) * HANGING.swing_frequency(20.0)
    world.request(45.0, observes=False)
    world.run(60.0)
    assert world.profile.phase is DescentPhase.STANDBY
    assert not world.ended_stops()
    world.swing_error = 1e-5
    world.run(1.0)
    assert world.profile.phase is not DescentPhase.STANDBY


def test_a_stop_fails_if_the_swing_stays_unknown():
    world = World(20.0, 2.0)
    world.swing_error = math.radians(5.0) * HANGING.swing_frequency(20.0)
    world.request(45.0, observes=False)
    world.run(1.1 * PROFILE.stop_timeout)
    (stop,) = world.ended_stops()
    assert (stop.name, stop.reason) == (DescentEvent.STOP_FAILED, Reason.OUT_OF_LIMITS)
    assert world.length == 20.0


@pytest.mark.parametrize(("depth", "rate"), [(-1.0, 0.0), (math.nan, 0.0), (10.0, 0.4)])
def test_bad_stops_are_refused(depth: float, rate: float):
    world = World(5.0)
    with pytest.raises(Refusal):
        world.request(depth, rate=rate)


def test_a_resume_continues_with_the_held_stop():
    world = World(5.0, 0.05)
    world.request(20.0)
    for _ in range(200):
        world.step()
    assert world.profile.phase is DescentPhase.TRAVELLING
    held = world.length
    world.profile.hold(held, world.now)
    for _ in range(100):
        world.step()
    assert world.length == pytest.approx(held)
    with pytest.raises(Refusal):
        world.request(25.0)
    assert "1 stops" in world.profile.resume(world.now)
    world.run(200.0)
    assert world.pictures == PROFILE.exposures
    with pytest.raises(Refusal):
        world.profile.resume(world.now)


def test_an_abort_drops_all_stops_and_reports_them():
    world = World(5.0, 0.05)
    world.request(20.0)
    world.request(30.0)
    for _ in range(200):
        world.step()
    assert world.profile.abort(world.length, world.now) == "2 stops dropped"
    here = world.length
    for _ in range(100):
        world.step()
    assert world.length == pytest.approx(here)
    assert world.ended() == [(DescentEvent.STOP_ABORTED, 0)]


def test_an_aborted_travel_reports_no_pictures_of_the_last_stop():
    world = World(5.0, 0.05)
    world.request(6.0)
    world.request(30.0)
    while world.profile.phase is not DescentPhase.TRAVELLING or world.pictures == 0:
        world.step()
    world.profile.abort(world.length, world.now)
    ended = [each for each in world.profile.take_changes() if each.name in STOP_ENDS]
    assert [each.values["pictures"] for each in ended] == [PROFILE.exposures, 0]


def last_picture(world: World) -> None:
    """Run until the last picture of the first stop is commanded."""
    world.request(6.0)
    while world.pictures < PROFILE.exposures:
        world.step()


def test_a_stop_ends_when_its_last_picture_is_exposed():
    world = World(5.0, 0.05)
    last_picture(world)
    ordered = world.now
    assert world.ended() == []
    while not (ended := world.ended()):
        world.step()
    assert ended == [IMAGED]
    assert world.now - ordered == pytest.approx(PROFILE.exposure_interval, abs=2 * H)
    assert world.profile.is_idle


def test_complete_pictures_survive_a_hold_and_an_abort():
    world = World(5.0, 0.05)
    last_picture(world)
    world.profile.hold(world.length, world.now)
    assert world.profile.resume(world.now) == "0 stops left"
    world.run(30.0)
    assert world.pictures == PROFILE.exposures
    assert world.ended() == [IMAGED]

    world = World(5.0, 0.05)
    last_picture(world)
    assert world.profile.abort(world.length, world.now) == "0 stops dropped"
    assert world.ended() == [IMAGED]
