"""Sequence of stops, stepped with swings as they would be estimated."""

from __future__ import annotations

import math

import pytest

from msg_schemas.refusal import Refusal, RefusalCode
from rover_control.descent_parameters import ProfileParameters
from rover_control.descent_profile import (
    DescentPhase,
    DescentProfile,
    ProfileSetpoints,
    Stop,
)
from rover_control.hanging_rover import HangingParameters
from rover_control.swing_estimator import SwingEstimate
from rover_control.yaw_momentum import MomentumTransfer

HANGING, PROFILE = HangingParameters(), ProfileParameters()
H = 0.1


class World:
    """A winch that follows at once, and a swing that is told."""

    def __init__(self, length: float, major: float = 0.0, minor: float = 0.0) -> None:
        self.profile = DescentProfile(PROFILE, HANGING, lambda _: 30.0)
        self.length = length
        self.major, self.minor = math.radians(major), math.radians(minor)
        self.yaw_rate = 0.0
        self.transfers = False  # whether the tether passes a momentum on
        self.now = 0.0
        self.rates: list[float] = []
        self.pictures = 0

    @property
    def swing(self) -> SwingEstimate:
        frequency = HANGING.swing_frequency(self.length)
        phase = frequency * self.now
        u = (self.major * math.cos(phase), self.minor * math.sin(phase))
        v = (-frequency * self.major * math.sin(phase), frequency * self.minor * math.cos(phase))
        zero = (0.0, 0.0)
        return SwingEstimate(u, v, zero, zero, zero, self.yaw_rate, frequency, 1e-5, 1e-5)

    @property
    def transfer(self) -> MomentumTransfer:
        inertia = HANGING.pendulum_inertia(self.length)
        momentum = inertia * HANGING.swing_frequency(self.length) * self.major * self.minor
        return MomentumTransfer(momentum, 100.0 if self.transfers else math.inf, 0.0)

    def ask(self, depth: float, *, observes: bool = True, rate: float = 0.0) -> None:
        self.profile.request(Stop(depth, observes, rate), self.swing, self.length)

    def step(self, *, rests: bool = True) -> ProfileSetpoints:
        self.now += H
        at_rest = (
            math.isnan(self.profile.length_setpoint) or self.length == self.profile.length_setpoint
        )
        wish = self.profile.step(
            self.swing,
            self.length,
            transfer=self.transfer,
            winch_rests=rests and at_rest,
            rotors_rest=True,
            now=self.now,
        )
        if wish.length > self.length:
            self.length = min(wish.length, self.length + H * wish.rate)
        elif wish.length < self.length:
            self.rates.append(wish.rate / self.length)
            self.length = max(wish.length, self.length - H * wish.rate)
        if wish.trims:  # as the winch damps: all but the circle
            round_ = math.copysign(math.sqrt(self.major * abs(self.minor)), self.minor)
            self.major += H / 30.0 * (abs(round_) - self.major)
            self.minor += H / 30.0 * (round_ - self.minor)
        if wish.transfers:
            self.minor -= H / 30.0 * self.minor
        self.pictures += wish.exposes
        return wish

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / H)):
            self.step()
            if self.profile.is_idle and self.now > 10.0:
                return

    def ended(self) -> list[str]:
        changes = self.profile.take_changes()
        return [change.reason for change in changes if change.name == "stop_ended"]


def test_a_quiet_rover_takes_its_pictures_at_every_stop():
    world = World(2.0, 0.05)
    for depth in (5.0, 9.0, 12.0):
        world.ask(depth)
    world.run(300.0)
    assert world.profile.is_idle
    assert world.pictures == 3 * PROFILE.exposures
    assert world.ended() == [f"{PROFILE.exposures} pictures"] * 3
    assert world.length == pytest.approx(12.0)


def test_a_plane_swing_is_damped_before_pictures_and_not_while_they_are_taken():
    world = World(30.0, 1.5)
    world.ask(30.5)
    seen = set()
    for _ in range(3000):
        wish = world.step()
        phase = world.profile.phase
        seen.add(phase)
        if phase in (DescentPhase.SETTLING, DescentPhase.EXPOSING):
            assert not wish.trims
            assert not wish.pumps
        if world.profile.is_idle and world.now > 10.0:
            break
    assert DescentPhase.DAMPING in seen
    assert world.pictures == PROFILE.exposures


def test_a_cone_that_nothing_can_damp_ends_the_stop_with_the_reason():
    world = World(7.0, 0.9, 0.85)
    world.ask(7.5)
    world.run(200.0)
    (reason,) = world.ended()
    assert "cone" in reason
    assert "momentum" in reason
    assert world.pictures == 0


def test_a_circle_that_the_winch_can_make_no_rounder_is_taken_as_it_is():
    # It turns the camera by 0.09 deg/s: more than damping ends with, less than pictures bear.
    world = World(7.4, 0.2, 0.19)
    world.ask(7.5)
    rate = 0.2 * HANGING.swing_frequency(7.5)
    assert math.degrees(PROFILE.damped_swing_rate) < rate < math.degrees(PROFILE.steady_rate)
    world.yaw_rate = math.radians(0.2)
    world.run(20.0)
    assert world.profile.phase is DescentPhase.DAMPING
    # What was too much is gone; the circle stays.
    world.yaw_rate = 0.0
    world.run(100.0)
    assert world.pictures == PROFILE.exposures


def test_a_cone_is_handed_on_before_it_is_taken_along_where_that_can_be_done():
    world = World(2.0, 3.0, 1.5)
    world.transfers = True
    world.ask(7.5)
    handed = 0
    while world.length == 2.0:
        wish = world.step()
        handed += wish.transfers
        assert wish.pumps or not wish.transfers
        assert world.now < 400.0
    assert handed > 300
    assert math.degrees(world.minor) < 0.5
    # What the longer tether makes of it.
    world.major, world.minor = (
        HANGING.swing_amplitude_at(each, 2.0, 7.5) for each in (world.major, world.minor)
    )
    world.run(400.0)
    assert world.ended() == [f"{PROFILE.exposures} pictures"]


def test_a_cone_that_pictures_would_not_bear_is_not_taken_along_for_want_of_patience():
    world = World(2.0, 0.8, 0.7)
    world.transfers = True
    world.ask(7.5)
    momentum = 1.1 * PROFILE.steady_rate**2 * HANGING.pendulum_inertia(7.5)
    momentum /= HANGING.swing_frequency(7.5)
    inertia = HANGING.pendulum_inertia(2.0) * HANGING.swing_frequency(2.0)
    while world.now < 0.9 * PROFILE.stop_timeout:
        # So much is left, however long it is handed on.
        world.minor = momentum / (inertia * world.major)
        world.step()
    assert world.length == 2.0
    world.run(PROFILE.stop_timeout)
    assert world.length > 2.0


def test_a_plane_swing_is_the_winch_s_even_where_the_tether_passes_a_momentum_on():
    world = World(7.5, 3.0, 0.03)
    world.transfers = True
    world.ask(7.5)
    # Its momentum would be handed on, had it the shape of a cone.
    limit = (
        PROFILE.transfer_threshold_rate**2
        * HANGING.pendulum_inertia(7.5)
        / HANGING.swing_frequency(7.5)
    )
    assert abs(world.transfer.momentum) > 2.0 * limit
    for _ in range(200):
        assert not world.step().transfers
    assert math.degrees(world.major) < 2.3


def test_deep_down_pictures_are_taken_where_the_swing_turns_back():
    # 0.6 deg at 30 m turn the camera by 0.14 deg/s at most.
    world = World(29.8, 0.6)
    world.ask(30.0)
    rates = [world.swing.camera_rate for _ in range(1500) if world.step().exposes]
    assert len(rates) == PROFILE.exposures
    assert max(rates) < PROFILE.steady_rate


def test_the_last_picture_is_taken_before_the_rover_goes_on():
    world = World(5.0, 0.05)
    world.ask(6.0)
    world.ask(9.0)
    last = math.nan
    while world.length < 6.1:
        if world.step().exposes:
            last = world.now
        assert world.now < 100.0
        if world.length > 6.0 and world.pictures == PROFILE.exposures:
            break
    assert world.now - last >= PROFILE.exposure_interval - 1e-9


def test_a_rover_that_spins_takes_no_pictures_and_says_so():
    world = World(30.0, 0.05)
    world.yaw_rate = math.radians(0.5)
    world.ask(30.5)
    world.run(PROFILE.stop_timeout + 100.0)
    (reason,) = world.ended()
    assert "not steady" in reason
    assert "0.50 deg/s" in reason


def test_an_ascent_slows_with_the_length_and_damps_a_plane_swing_first():
    world = World(45.0, 0.5)
    world.ask(4.0, observes=False)
    world.run(12.0)
    assert world.profile.phase is DescentPhase.DAMPING
    world.run(2000.0)
    assert world.length == pytest.approx(4.0, abs=0.01)
    assert max(world.rates) <= PROFILE.ascent_rate_gain + 1e-9
    assert world.ended() == ["reached"]


def test_what_could_touch_the_wall_is_refused_with_the_distance():
    world = World(20.0, 7.0)
    with pytest.raises(Refusal, match=r"the wall is 3 m away") as refused:
        world.ask(45.0)
    assert refused.value.code is RefusalCode.OUT_OF_LIMITS
    assert world.profile.is_idle


@pytest.mark.parametrize(("depth", "rate"), [(-1.0, 0.0), (math.nan, 0.0), (10.0, 0.4)])
def test_bad_stops_are_refused(depth: float, rate: float):
    world = World(5.0)
    with pytest.raises(Refusal):
        world.ask(depth, rate=rate)


def test_a_hold_stands_where_it_is_and_goes_on_with_the_same_stop():
    world = World(5.0, 0.05)
    world.ask(20.0)
    for _ in range(200):
        world.step()
    assert world.profile.phase is DescentPhase.TRAVELLING
    held = world.length
    world.profile.hold(held, world.now)
    for _ in range(100):
        world.step()
    assert world.length == pytest.approx(held)
    with pytest.raises(Refusal):
        world.ask(25.0)
    assert "1 stops" in world.profile.resume(world.now)
    world.run(200.0)
    assert world.pictures == PROFILE.exposures
    with pytest.raises(Refusal):
        world.profile.resume(world.now)


def test_an_abort_forgets_everything_and_says_so():
    world = World(5.0, 0.05)
    world.ask(20.0)
    world.ask(30.0)
    for _ in range(200):
        world.step()
    assert world.profile.abort(world.length, world.now) == "2 stops are dropped"
    here = world.length
    for _ in range(100):
        world.step()
    assert world.length == pytest.approx(here)
    assert world.ended() == ["aborted"]


def test_a_stop_that_is_left_on_the_way_has_none_of_the_last_ones_pictures():
    world = World(5.0, 0.05)
    world.ask(6.0)
    world.ask(30.0)
    while world.profile.phase is not DescentPhase.TRAVELLING or world.pictures == 0:
        world.step()
    world.profile.abort(world.length, world.now)
    ended = [each for each in world.profile.take_changes() if each.name == "stop_ended"]
    assert [each.values["pictures"] for each in ended] == [PROFILE.exposures, 0]


def last_picture(world: World) -> None:
    """Until the last picture of the first stop is ordered."""
    world.ask(6.0)
    while world.pictures < PROFILE.exposures:
        world.step()


def test_a_stop_ends_when_its_last_picture_is_exposed():
    world = World(5.0, 0.05)
    last_picture(world)
    ordered = world.now
    assert world.ended() == []
    while not (ended := world.ended()):
        world.step()
    assert ended == [f"{PROFILE.exposures} pictures"]
    assert world.now - ordered == pytest.approx(PROFILE.exposure_interval, abs=2 * H)
    assert world.profile.is_idle


def test_pictures_that_are_all_taken_are_not_taken_again_after_a_hold_and_not_lost_by_an_abort():
    world = World(5.0, 0.05)
    last_picture(world)
    world.profile.hold(world.length, world.now)
    assert world.profile.resume(world.now) == "0 stops are left"
    world.run(30.0)
    assert world.pictures == PROFILE.exposures
    assert world.ended() == [f"{PROFILE.exposures} pictures"]

    world = World(5.0, 0.05)
    last_picture(world)
    assert world.profile.abort(world.length, world.now) == "0 stops are dropped"
    assert world.ended() == [f"{PROFILE.exposures} pictures"]
