"""Turning to a heading about the tether, and holding it there, by coning. Pure.

Wheels and flywheel driven in quadrature, h_x = h cos Wt and h_y = h sin Wt, let the rover cone
about the tether with the tilt th = h W/(I |w_b^2 - W^2|), w_b^2 = m g d/I, and turn it about its
own axis at -(I/I_z) th^2 w_b^2/W. The axis itself sweeps a cone, whose solid angle is no heading,
so that about the tether it turns at the rate

    -th^2 (I w_b^2/(I_z W) - W/2).

Coning is internal: it turns the rover while it lasts, and stores the momentum; it is no steady
torque. Against it works the tether's twist, which spins the rover back at (GJ/l) twist/I_z more and
more, as long as the swivel does not slip. So with the largest coning rate R and the frequency of
the torsion w_t^2 = (GJ/l)/I_z

    twist = R/w_t sin w_t t,    at most R/w_t,

can be reached from no twist, and is held until the spin back has used up R. From then on the rover
drifts away, by half the acceleration times the square of the time. What the gyro's bias is not
known to adds to the error all the time. A turn is promised with less than the largest rate, as the
mass may be off.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas.parameters import parameter
from msg_schemas.refusal import Refusal, RefusalCode
from rover_control.hanging_rover import HangingParameters
from rover_control.rotor_pump import NO_PUMPING, Pumping

SUBJECT = "pointing"  # of refusals
_LEARNT = 15.0  # of full coning, from which on its rate is known [s]
_SPIN_TIME = 8.0  # over which the spin that is not the coning's is smoothed [s]


@dataclass(frozen=True)
class PointingParameters:
    """How the rover is turned, and what of it is promised."""

    coning_frequency: float = parameter(3.3, "rad/s", "W, below the tilt's own", 0.1, 20.0)
    coning_momentum: float = parameter(0.024, "N m s", "largest amplitude of both", 0.0, 1.0)
    coning_ramp: float = parameter(8.0, "s", "in which the coning comes up", 0.5, 100.0)
    promised: float = parameter(0.7, "-", "of the coning's rate, that is counted on", 0.1, 1.0)
    approach: float = parameter(12.0, "s", "in which what is left of a turn is made", 1.0, 100.0)
    tolerance: float = parameter(0.0873, "rad", "of the heading that is held, 5 deg", 1e-3, 1.0)
    least_hold: float = parameter(30.0, "s", "that a heading must be held at least", 0.0, 1e4)
    longest_turn: float = parameter(240.0, "s", "that a turn may take", 1.0, 1e4)


class Forecast(NamedTuple):
    """What a turn comes to.

    Attributes:
        turning: time until the heading is reached [s]; inf = never.
        holding: time for which it is held within the tolerance from then on [s].
        limit: what ends the holding: twist or gyro bias.
    """

    turning: float
    holding: float
    limit: str


class Pointing:
    """Turns the rover.

    Args:
        parameters: how.
        hanging: the rover.
    """

    def __init__(self, parameters: PointingParameters, hanging: HangingParameters) -> None:
        self.parameters = parameters
        self.hanging = hanging
        x, y = hanging.inertias
        inertia = math.sqrt(x * y)
        square = hanging.stiffness / inertia
        w = parameters.coning_frequency
        tilt = w / (inertia * (square - w * w))  # over h
        # Rate about the tether over h^2.
        self._gain = tilt**2 * (inertia * square / (hanging.inertia_about_z * w) - 0.5 * w)
        self._own = [w * w / (each * (hanging.stiffness / each - w * w)) for each in (x, y)]
        self._target = math.nan
        self._phase = self._spin = self._coned = 0.0
        self._full = 0.0  # for how long it has coned as much as it can [s]
        self._back = 0.0  # spin by the twist, as the model has it [rad/s]
        self._turned = 0.0  # by full coning alone [rad]
        self._reached = False
        self._told: Forecast | None = None
        self._begun = 0.0  # error of the yaw rate when it was asked [rad/s]
        self._time = 0.0  # since then [s]
        self._heading: float | None = None  # at the last step
        self.forecast: Forecast | None = None

    @property
    def is_active(self) -> bool:
        """Whether there is a heading to turn to or to hold."""
        return not math.isnan(self._target)

    @property
    def largest_rate(self) -> float:
        """By coning [rad/s]."""
        return self._gain * self.parameters.coning_momentum**2

    @property
    def coning_rate(self) -> float:
        """At which the coning now turns the rover, as the model has it [rad/s]."""
        return self._coned

    def foretell(
        self,
        turn: float,
        twist: float,
        length: float,
        *,
        yaw_error: float = 0.0,
        spin: float = 0.0,
        share: float = 1.0,
    ) -> Forecast:
        """What a turn comes to.

        Args:
            turn: about +z [rad].
            twist: of the tether before [rad].
            length: of the tether [m].
            yaw_error: of the yaw rate, by the gyro's bias [rad/s].
            spin: of the rover against the turn already [rad/s].
            share: of the largest rate that is counted on.
        """
        p = self.parameters
        rate, step = share * self.largest_rate, 1.0
        inertia, torsion = self.hanging.inertia_about_z, self.hanging.torsion(length)
        slips = self.hanging.swivel_friction
        sense = math.copysign(1.0, turn)
        passed, time, back = 0.0, 0.0, spin  # turned, spin against it
        while passed < abs(turn):
            if back >= rate or time > 10.0 * p.longest_turn:
                return Forecast(math.inf, 0.0, "twist")
            passed += step * (rate - back)
            back += step * self._pull(sense * (twist + sense * passed), torsion, slips) / inertia
            time += step
        pull = max(self._pull(sense * twist + abs(turn), torsion, slips) / inertia, 0.0)
        held, limit = math.inf, "twist"
        if pull > 0.0:
            held = (rate - back) / pull + math.sqrt(2.0 * p.tolerance / pull)
        if yaw_error > 0.0 and p.tolerance / yaw_error < held:
            held, limit = p.tolerance / yaw_error, "gyro bias"
        return Forecast(time, held, limit)

    @staticmethod
    def _pull(twist: float, torsion: float, slips: float) -> float:
        return min(max(torsion * twist, -slips), slips)

    def request(
        self, turn: float, heading: float, length: float, *, yaw_error: float, twist: float
    ) -> Forecast:
        """Turn by so much, and hold the heading then.

        Args:
            turn: about +z [rad].
            heading: without ever jumping [rad].
            length: of the tether [m].
            yaw_error: standard deviation of the yaw rate [rad/s].
            twist: of the tether [rad].

        Raises:
            Refusal: it cannot be reached, or not be held.
        """
        p = self.parameters
        if not math.isfinite(turn) or abs(turn) > math.pi:
            raise Refusal(
                SUBJECT,
                RefusalCode.OUT_OF_LIMITS,
                f"turn is {turn!r} rad, it must be within half a turn",
            )
        promise = self.foretell(turn, twist, length, yaw_error=yaw_error, share=p.promised)
        degrees = math.degrees(abs(turn))
        if promise.turning > p.longest_turn:
            torsion = self.hanging.torsion(length)
            reach = p.promised * self.largest_rate
            reach /= math.sqrt(torsion / self.hanging.inertia_about_z)
            raise Refusal(
                SUBJECT,
                RefusalCode.OUT_OF_LIMITS,
                f"{degrees:.0f} deg are not reached within {p.longest_turn:.0f} s on "
                f"{length:.3g} m of tether: its twist turns the rover back by {torsion:.3g} "
                f"N m/rad, coning is sure to reach {math.degrees(reach):.0f} deg of twist",
            )
        if promise.holding < p.least_hold:
            raise Refusal(
                SUBJECT,
                RefusalCode.OUT_OF_LIMITS,
                f"{degrees:.0f} deg would be held for {promise.holding:.0f} s on {length:.3g} m of "
                f"tether, limited by {promise.limit}; it must be {p.least_hold:.0f} s",
            )
        self._target = heading + turn
        self._spin = self._coned = self._full = self._back = self._turned = 0.0
        self._time, self._reached, self._begun = 0.0, False, yaw_error
        self.forecast = self.foretell(turn, twist, length, yaw_error=yaw_error)
        return self.forecast

    def stop(self) -> None:
        """Let go."""
        self._target = math.nan

    def error(self, heading: float) -> float:
        """What is left to turn [rad]."""
        return self._target - heading

    @property
    def is_coning(self) -> bool:
        """Whether the rotors cone."""
        return self._coned != 0.0

    def take_reached(self) -> Forecast | None:
        """What is foretold from where the heading was reached, once."""
        taken, self._told = self._told, None
        return taken

    def step(self, heading: float, twist: float, length: float, h: float) -> Pumping:
        """Advance by h; returns the momenta that the rotors are to have.

        Args:
            heading: without ever jumping [rad].
            twist: of the tether [rad].
            length: of the tether [m].
            h: duration [s].
        """
        p = self.parameters
        w = p.coning_frequency
        if self._heading is None:
            self._heading = heading
        turning, self._heading = (heading - self._heading) / h, heading
        self._spin += min(h / _SPIN_TIME, 1.0) * (turning - self._coned - self._spin)
        wanted = 0.0
        if self.is_active:
            # What spins back is made up for.
            wanted = self.error(heading) / p.approach - self._spin
            self._watch(heading, twist, length, turning, h)
        most = self.largest_rate
        wanted = min(max(wanted, -most), most)
        change = most * h / p.coning_ramp
        self._coned = min(max(wanted, self._coned - change), self._coned + change)
        if self._coned == 0.0:
            return NO_PUMPING
        amplitude = math.sqrt(abs(self._coned) / self._gain)
        sense = -math.copysign(1.0, self._coned)
        self._phase = math.remainder(self._phase + w * h, math.tau)
        along = amplitude * math.cos(self._phase)
        across = sense * amplitude * math.sin(self._phase)
        return Pumping(along, across, -sense * amplitude * math.cos(self._phase) / w)

    def _watch(self, heading: float, twist: float, length: float, turning: float, h: float) -> None:
        """Learn on the way how well the coning turns, and foretell the holding where it ends."""
        p, most = self.parameters, self.largest_rate
        self._time += h
        pull = self._pull(twist, self.hanging.torsion(length), self.hanging.swivel_friction)
        self._back += h * pull / self.hanging.inertia_about_z
        if abs(self._coned) >= 0.99 * most and not self._reached:
            self._full += h
            self._turned += h * (turning + self._back) / math.copysign(most, self._coned)
        if self._reached or abs(self.error(heading)) > p.tolerance:
            return
        self._reached = True
        share = self._turned / self._full if self._full > _LEARNT else 1.0
        share = min(max(share, 0.3), 2.0)
        # It goes by the mass to the power -2, the inertia by the mass.
        inertia = self.hanging.inertia_about_z / math.sqrt(share)
        self._told = self._holding(share * most, inertia, pull)

    def _holding(self, rate: float, inertia: float, pull: float) -> Forecast:
        """How long the heading that was reached is held.

        Args:
            rate: largest by coning [rad/s].
            inertia: about the tether [kg m^2].
            pull: torque of the twist [N m].
        """
        p = self.parameters
        back = self._back * self.hanging.inertia_about_z / inertia
        held, limit = math.inf, "twist"
        if pull != 0.0:
            left = max(rate - math.copysign(1.0, pull) * back, 0.0)
            drift = math.sqrt(2.0 * p.tolerance * inertia / abs(pull))
            held = left * inertia / abs(pull) + drift
        if self._begun > 0.0 and p.tolerance / self._begun - self._time < held:
            held, limit = max(p.tolerance / self._begun - self._time, 0.0), "gyro bias"
        return Forecast(self._time, held, limit)

    def own_tilt_rates(self, momenta: Pumping) -> tuple[float, float]:
        """Tilt rates along x and y [rad/s] that the coning itself causes."""
        return self._own[0] * momenta.x, self._own[1] * momenta.y
