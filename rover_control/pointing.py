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

A rover that coefficient more tilts less by as much, so the rotors' momenta follow what it
coefficient, as far
as they reach, and the tilt with the rate is what it would be.

How much the coning turns is measured on the way. The momentum about the plumb line, of the rover's
spin, of its tilt's motion and of its rotors H,

    I_z w_z + I (phi_x phi_y' - phi_y phi_x') + H_x phi_x + H_y phi_y,

changes by nothing but the twist and, by turns, the swing. What the last three make of w_z is the
rotors', be it coning or a wheel's bias that turns with the swing; the rest is the spin by the
twist. How far the rotors' momentum and the tilt that answers to it belong together tells the mass.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas.parameters import parameter
from msg_schemas.refusal import Refusal, RefusalCode
from rover_control.hanging_rover import HangingParameters
from rover_control.rotor_pump import NO_MOMENTA, RotorMomenta
from rover_control.suspended_mass import MAX_MASS_RATIO
from rover_control.swing_estimator import SwingEstimate

SUBJECT = "pointing"  # of refusals
_IDENTIFICATION_TIME = 15.0  # of full coning, from which on its rate is known [s]
_CONFIDENCE = 2.0  # standard deviations of the yaw rate within which a heading counts as known
_SPIN_TIME = 8.0  # over which the spin that is not the coning's is smoothed [s]


@dataclass(frozen=True)
class PointingParameters:
    """Pointing to a heading by coning, and its guaranteed performance."""

    coning_frequency: float = parameter(
        3.3, "rad/s", "coning frequency W, below the tilt's natural frequency", 0.1, 20.0
    )
    coning_momentum: float = parameter(
        0.024, "N m s", "largest momentum amplitude of wheels and flywheel", 0.0, 1.0
    )
    coning_momentum_margin: float = parameter(
        1.1, "-", "largest increase of the momentum for a heavier rover", 1.0, 2.0
    )
    coning_ramp_time: float = parameter(8.0, "s", "ramp time of the coning", 0.5, 100.0)
    coning_derating: float = parameter(
        0.7, "-", "fraction of the coning's turn rate that a request may count on", 0.1, 1.0
    )
    approach_time: float = parameter(
        12.0, "s", "time constant of the approach to the heading", 1.0, 100.0
    )
    heading_tolerance: float = parameter(
        0.0873, "rad", "heading error within which a heading is held, 5 deg", 1e-3, 1.0
    )
    min_hold_time: float = parameter(
        30.0, "s", "least time for which a heading must be held", 0.0, 1e4
    )
    max_turn_time: float = parameter(240.0, "s", "longest turn", 1.0, 1e4)


class Prediction(NamedTuple):
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
        self._tilt_response = [
            w * w / (each * (hanging.stiffness / each - w * w)) for each in (x, y)
        ]
        self._target = math.nan
        self._mass = 1.0  # of the rover over what is known, as it was weighed
        self._coning_inertia = inertia
        self._mass_coefficient = (hanging.stiffness - inertia * w * w) / (w * w)
        self._phase = self._spin = self._coning_rate = 0.0
        self._identified = _ConingIdentification()
        self._reached = False
        self._reached_prediction: Prediction | None = None
        self._reached_at = 0.0  # when it was reached, since it was asked [s]
        self._lost = ""
        self._initial_yaw_error = 0.0  # error of the yaw rate when it was asked [rad/s]
        self._time = 0.0  # since then [s]
        self.prediction: Prediction | None = None

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
        return self._coning_rate

    def predict(
        self,
        turn: float,
        twist: float,
        length: float,
        *,
        yaw_error: float = 0.0,
        spin: float = 0.0,
        mass: float = 1.0,
        share: float = 1.0,
    ) -> Prediction:
        """What a turn comes to.

        Args:
            turn: about +z [rad].
            twist: of the tether before [rad].
            length: of the tether [m].
            yaw_error: of the yaw rate, by the gyro's bias [rad/s].
            spin: of the rover against the turn already [rad/s].
            mass: of the rover, and its inertia, over what is known.
            share: of the largest rate that is counted on.
        """
        p = self.parameters
        rate, step = share * (self._momentum_share(mass) / mass) ** 2 * self.largest_rate, 1.0
        inertia, torsion = (
            mass * self.hanging.inertia_about_z,
            self.hanging.torsional_stiffness(length),
        )
        slips = self.hanging.swivel_friction
        sense = math.copysign(1.0, turn)
        passed, time, back = 0.0, 0.0, spin  # turned, spin against it
        while passed < abs(turn):
            if back >= rate or time > 10.0 * p.max_turn_time:
                return Prediction(math.inf, 0.0, "twist")
            passed += step * (rate - back)
            back += (
                step
                * self._twist_torque(sense * (twist + sense * passed), torsion, slips)
                / inertia
            )
            time += step
        pull = max(self._twist_torque(sense * twist + abs(turn), torsion, slips) / inertia, 0.0)
        held, limit = math.inf, "twist"
        if pull > 0.0:
            held = (rate - back) / pull + math.sqrt(2.0 * p.heading_tolerance / pull)
        known = self._known_for(yaw_error) - time
        if known < held:
            held, limit = max(known, 0.0), "gyro bias"
        return Prediction(time, held, limit)

    def _momentum_share(self, mass: float) -> float:
        """Momentum over that for a rover of the mass that is known, so that it tilts as much."""
        return min(mass, self.parameters.coning_momentum_margin)

    def _known_for(self, yaw_error: float) -> float:
        """How long a heading is known to within the tolerance [s], by the yaw rate's error."""
        return (
            self.parameters.heading_tolerance / (_CONFIDENCE * yaw_error)
            if yaw_error > 0.0
            else math.inf
        )

    @staticmethod
    def _twist_torque(twist: float, torsion: float, slips: float) -> float:
        return min(max(torsion * twist, -slips), slips)

    def request(
        self,
        turn: float,
        heading: float,
        length: float,
        *,
        yaw_error: float,
        twist: float,
        mass: float = 1.0,
        spin: float = 0.0,
    ) -> Prediction:
        """Turn by so much, and hold the heading then.

        Args:
            turn: about +z [rad].
            heading: without ever jumping [rad].
            length: of the tether [m].
            yaw_error: standard deviation of the yaw rate [rad/s].
            twist: of the tether [rad].
            mass: of the rover over what is known, as it is weighed.
            spin: about +z that it will have beside the coning's [rad/s]. What is promised does
                not count on mass and spin, what is predicted does.

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
        guaranteed = self.predict(turn, twist, length, yaw_error=yaw_error, share=p.coning_derating)
        degrees = math.degrees(abs(turn))
        if guaranteed.turning > p.max_turn_time:
            torsion = self.hanging.torsional_stiffness(length)
            reach = p.coning_derating * self.largest_rate
            reach /= math.sqrt(torsion / self.hanging.inertia_about_z)
            raise Refusal(
                SUBJECT,
                RefusalCode.OUT_OF_LIMITS,
                f"{degrees:.0f} deg are not reached within {p.max_turn_time:.0f} s on "
                f"{length:.3g} m of tether: its twist turns the rover back by {torsion:.3g} "
                f"N m/rad, coning is sure to reach {math.degrees(reach):.0f} deg of twist",
            )
        if guaranteed.holding < p.min_hold_time:
            raise Refusal(
                SUBJECT,
                RefusalCode.OUT_OF_LIMITS,
                f"{degrees:.0f} deg would be held for {guaranteed.holding:.0f} s on "
                f"{length:.3g} m of tether, limited by {guaranteed.limit}; it must be at least "
                f"{p.min_hold_time:.0f} s",
            )
        self._target, self._mass = heading + turn, mass
        self._coning_rate, self._identified = 0.0, _ConingIdentification()
        self._time, self._reached, self._initial_yaw_error = 0.0, False, yaw_error
        self._reached_at = 0.0
        against = -math.copysign(spin, spin * turn)
        self.prediction = self.predict(
            turn, twist, length, yaw_error=yaw_error, spin=against, mass=mass
        )
        return self.prediction

    def stop(self) -> None:
        """Let go."""
        self._target = math.nan

    def error(self, heading: float) -> float:
        """What is left to turn [rad]."""
        return self._target - heading

    @property
    def is_coning(self) -> bool:
        """Whether the rotors cone."""
        return self._coning_rate != 0.0

    def take_reached(self) -> Prediction | None:
        """What is predicted from where the heading was reached, once."""
        taken, self._reached_prediction = self._reached_prediction, None
        return taken

    def take_lost(self) -> str:
        """Why the heading was let go, once; empty = it was not."""
        taken, self._lost = self._lost, ""
        return taken

    def step(
        self,
        heading: float,
        length: float,
        swing: SwingEstimate,
        momenta: tuple[float, float],
        h: float,
    ) -> RotorMomenta:
        """Advance by h; returns the momenta that the rotors are to have.

        Args:
            heading: about the tether, without ever jumping: its twist [rad].
            length: of the tether [m].
            swing: swing and tilt as estimated.
            momenta: of the rotors about base_link x and y [N m s].
            h: duration [s].
        """
        p = self.parameters
        w = p.coning_frequency
        identified, most = self._identified, self.largest_rate
        (ux, uy), (px, py) = swing.direction, swing.tilt
        (vx, vy), (qx, qy) = swing.direction_rate, swing.tilt_rate
        swept = (ux + px) * (vy + qy) - (uy + py) * (vx + qx)
        leaning = momenta[0] * (ux + px) + momenta[1] * (uy + py)
        by_rotors = leaning / identified.mass(self._mass_coefficient) + self._coning_inertia * swept
        by_rotors /= -self.hanging.inertia_about_z
        self._spin += min(h / _SPIN_TIME, 1.0) * (swing.yaw_rate - by_rotors - self._spin)
        setpoint = 0.0
        if self.is_active:
            self._time += h
            if abs(self._coning_rate) >= 0.99 * most and not self._reached:
                sense = math.copysign(1.0, self._coning_rate)
                identified.add(h, sense * (by_rotors + 0.5 * swept), leaning, swept)
            self._check_reached(heading, length)
            self._check_lost(heading)
        if self.is_active:
            # What spins back is made up for.
            setpoint = (self.error(heading) / p.approach_time - self._spin) / identified.share(most)
        setpoint = min(max(setpoint, -most), most)
        change = most * h / p.coning_ramp_time
        self._coning_rate = min(
            max(setpoint, self._coning_rate - change), self._coning_rate + change
        )
        if self._coning_rate == 0.0:
            return NO_MOMENTA
        amplitude = self._momentum_share(self._mass) * math.sqrt(
            abs(self._coning_rate) / self._gain
        )
        sense = -math.copysign(1.0, self._coning_rate)
        self._phase = math.remainder(self._phase + w * h, math.tau)
        along = amplitude * math.cos(self._phase)
        across = sense * amplitude * math.sin(self._phase)
        return RotorMomenta(along, across, -sense * amplitude * math.cos(self._phase) / w)

    def _check_reached(self, heading: float, length: float) -> None:
        """Predict the holding where the turn ends."""
        p, identified = self.parameters, self._identified
        if self._reached or abs(self.error(heading)) > p.heading_tolerance:
            return
        self._reached = True
        torsion, slips = self.hanging.torsional_stiffness(length), self.hanging.swivel_friction
        pull = self._twist_torque(self._target, torsion, slips)
        inertia = self.hanging.inertia_about_z * identified.mass(self._mass_coefficient)
        held, limit = math.inf, "twist"
        if pull != 0.0:
            # The twist turns against its own sign, and is held off by coning the other way.
            left = identified.share(self.largest_rate) * self.largest_rate
            left = max(left + math.copysign(1.0, pull) * self._spin, 0.0)
            drift = math.sqrt(2.0 * p.heading_tolerance * inertia / abs(pull))
            held = left * inertia / abs(pull) + drift
        known = self._known_for(self._initial_yaw_error) - self._time
        if known < held:
            held, limit = max(known, 0.0), "gyro bias"
        self._reached_at = self._time
        self._reached_prediction = Prediction(self._time, held, limit)

    def _check_lost(self, heading: float) -> None:
        """Let go what is held no longer, or not known to be."""
        p, degrees = self.parameters, math.degrees(self.parameters.heading_tolerance)
        held = self._time - self._reached_at
        if self._time > self._known_for(self._initial_yaw_error):
            why = f"it is not known to within {degrees:.0f} deg any more, by the gyro's bias"
        elif self._reached and held > _SPIN_TIME and abs(self.error(heading)) > p.heading_tolerance:
            why = f"the tether's twist has turned it away by {degrees:.0f} deg"
        else:
            return
        self._lost = f"the heading is let go after {held:.0f} s: {why}"
        self.stop()

    def induced_tilt_rates(self, momenta: RotorMomenta) -> tuple[float, float]:
        """Tilt rates along x and y [rad/s] that the coning itself causes."""
        return self._tilt_response[0] * momenta.x / self._mass, self._tilt_response[
            1
        ] * momenta.y / self._mass


class _ConingIdentification:
    """Sums over the time of full coning, and what follows from them once they are long enough."""

    def __init__(self) -> None:
        self._time = self._turned = self._leaning = self._swept = 0.0

    def add(self, h: float, rate: float, leaning: float, swept: float) -> None:
        """Take a step: the rate by the rotors, and what it is made of."""
        self._time += h
        self._turned += h * rate
        self._leaning += h * leaning
        self._swept += h * swept

    def share(self, rate: float) -> float:
        """Rate by full coning over what the model says [rad/s]."""
        if self._time < _IDENTIFICATION_TIME:
            return 1.0
        return min(max(self._turned / (self._time * rate), 0.3), 2.0)

    def mass(self, coefficient: float) -> float:
        """The rover's mass over what is known of it.

        Args:
            coefficient: momentum of the rotors over the tilt's rate that it makes [kg m^2].
        """
        if self._time < _IDENTIFICATION_TIME or self._swept == 0.0:
            return 1.0
        found = self._leaning / (self._swept * coefficient)
        return min(max(found, 1.0 / MAX_MASS_RATIO), MAX_MASS_RATIO)
