"""Pointing of the hanging rover to a heading by coning. Pure.

Wheels and flywheel driven in quadrature, h_x = h cos Wt and h_y = h sin Wt, make the rover cone
about the tether with the tilt th = h W/(I |w_b^2 - W^2|), w_b^2 = m g d/I, and turn it about its
own axis at -(I/I_z) th^2 w_b^2/W. The axis sweeps a cone whose solid angle is not a heading, so
the rover turns about the tether at the rate

    -th^2 (I w_b^2/(I_z W) - W/2).

Coning stores momentum inside the rover: it gives a turn rate, not a steady torque. The tether's
twist accelerates the rover back by (GJ/l) twist/I_z, as long as the swivel does not slip. With the
largest coning rate R and the torsional frequency w_t^2 = (GJ/l)/I_z the rover reaches, from zero
twist,

    twist = R/w_t sin w_t t,    at most R/w_t,

and holds it until the spin back has used up R. It then drifts by half the acceleration times the
square of the time; the uncertainty of the gyro bias adds to the error throughout. A request is
accepted with a derated rate, as the mass is uncertain.

A heavier rover tilts less in proportion. The rotor momenta therefore scale with the estimated mass,
within their margin, so that tilt and rate stay the same.

The coning rate is identified in flight. The momentum about the plumb line, of the rover's spin, its
tilt motion and its rotors H,

    I_z w_z + I (phi_x phi_y' - phi_y phi_x') + H_x phi_x + H_y phi_y,

is changed only by the twist and, periodically, by the swing. The last three terms give the part of
w_z due to the rotors, by coning or by a wheel's bias that turns with the swing; the rest is spin
from the twist. The ratio of the rotor momentum to the tilt response gives the mass.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas import topics
from msg_schemas.faults import Reason
from msg_schemas.parameters import parameter
from msg_schemas.refusal import Refusal, RefusalCode
from rover_control.hanging.hanging_rover import HangingParameters
from rover_control.hanging.rotor_pump import NO_MOMENTA, RotorMomenta
from rover_control.hanging.suspended_mass import MAX_MASS_RATIO
from rover_control.hanging.swing_estimator import SwingEstimate

_IDENTIFICATION_TIME = 15.0  # of full coning, before the identified rate is used [s]
_CONFIDENCE = 2.0  # standard deviations of the yaw rate that a heading's uncertainty allows for
_SPIN_TIME = 8.0  # low-pass of the spin that is not due to coning [s]


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
    coning_efficiency: float = parameter(
        0.89, "-", "turn rate by coning that flights show over that of the model", 0.1, 1.0
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


class TurnPrediction(NamedTuple):
    """Predicted performance of a turn.

    Attributes:
        turning: time until the heading is reached [s]; inf = never.
        holding: time for which it is then held within the tolerance [s].
        limit: cause of the end of the hold: twist or gyro bias.
    """

    turning: float
    holding: float
    limit: Reason


class Pointing:
    """Pointing controller.

    Args:
        parameters: of coning and pointing.
        hanging: rover and tether.
    """

    def __init__(self, parameters: PointingParameters, hanging: HangingParameters) -> None:
        self.parameters = parameters
        self.hanging = hanging
        x, y = hanging.inertias
        inertia = math.sqrt(x * y)
        square = hanging.stiffness / inertia
        w = parameters.coning_frequency
        tilt = w / (inertia * (square - w * w))  # per h
        # Turn rate about the tether per h^2.
        self._gain = tilt**2 * (inertia * square / (hanging.inertia_about_z * w) - 0.5 * w)
        self._tilt_response = [
            w * w / (each * (hanging.stiffness / each - w * w)) for each in (x, y)
        ]
        self._target = math.nan
        self._target_twist = 0.0  # of the tether, at the target [rad]
        self._mass = 1.0  # estimated over nominal mass
        self._coning_inertia = inertia
        self._mass_coefficient = (hanging.stiffness - inertia * w * w) / (w * w)
        self._phase = self._spin = self._coning_rate = 0.0
        self._identified = _ConingIdentification()
        self._reached = False
        self._reached_prediction: TurnPrediction | None = None
        self._reached_at = 0.0  # time from the request until it was reached [s]
        self._lost: tuple[str, Reason] | None = None
        self._initial_yaw_error = 0.0  # standard deviation of the yaw rate at the request [rad/s]
        self._time = 0.0  # since the request [s]
        self.prediction: TurnPrediction | None = None

    @property
    def is_active(self) -> bool:
        """Whether a heading is turned to or held."""
        return not math.isnan(self._target)

    @property
    def largest_rate(self) -> float:
        """Largest turn rate by coning [rad/s]."""
        return self._gain * self.parameters.coning_momentum**2

    def predict(
        self,
        turn: float,
        twist: float,
        length: float,
        *,
        yaw_error: float = 0.0,
        spin: float = 0.0,
        mass: float = 1.0,
        share: float | None = None,
    ) -> TurnPrediction:
        """Predict turn and hold.

        Args:
            turn: about +z [rad].
            twist: initial twist of the tether [rad].
            length: of the tether [m].
            yaw_error: standard deviation of the yaw rate, from the gyro bias [rad/s].
            spin: initial spin against the turn [rad/s].
            mass: mass and inertia over their nominal values.
            share: fraction of the largest rate that is assumed; None = the coning's efficiency.
        """
        p = self.parameters
        share = p.coning_efficiency if share is None else share
        rate, step = share * (self._momentum_share(mass) / mass) ** 2 * self.largest_rate, 1.0
        inertia, torsion = (
            mass * self.hanging.inertia_about_z,
            self.hanging.torsional_stiffness(length),
        )
        friction_limit = self.hanging.swivel_friction
        sense = math.copysign(1.0, turn)
        left, time, spin_back, coning = abs(turn), 0.0, spin, 0.0  # angle, time, rates
        while left > p.heading_tolerance:
            if spin_back >= rate or time > 10.0 * p.max_turn_time:
                return TurnPrediction(math.inf, 0.0, Reason.TWIST)
            # As `step` does it: coning ramps up, and slows down as the heading approaches.
            setpoint = min(left / p.approach_time + spin_back, rate)
            coning = min(setpoint, coning + rate * step / p.coning_ramp_time)
            left -= step * (coning - spin_back)
            twisted = sense * twist + abs(turn) - left
            spin_back += step * self._twist_torque(twisted, torsion, friction_limit) / inertia
            time += step
        pull = max(
            self._twist_torque(sense * twist + abs(turn), torsion, friction_limit) / inertia, 0.0
        )
        held, limit = math.inf, Reason.TWIST
        if pull > 0.0:
            held = (rate - spin_back) / pull + math.sqrt(2.0 * p.heading_tolerance / pull)
        known = self._known_for(yaw_error) - time
        if known < held:
            held, limit = max(known, 0.0), Reason.GYRO_BIAS
        return TurnPrediction(time, held, limit)

    def _momentum_share(self, mass: float) -> float:
        """Factor on the momentum that gives a rover of another mass the same tilt."""
        return min(mass, self.parameters.coning_momentum_margin)

    def _known_for(self, yaw_error: float) -> float:
        """Time [s] for which a heading is known within the tolerance."""
        return (
            self.parameters.heading_tolerance / (_CONFIDENCE * yaw_error)
            if yaw_error > 0.0
            else math.inf
        )

    @staticmethod
    def _twist_torque(twist: float, torsion: float, friction_limit: float) -> float:
        return min(max(torsion * twist, -friction_limit), friction_limit)

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
    ) -> TurnPrediction:
        """Turn by an angle and then hold the heading.

        Args:
            turn: about +z [rad].
            heading: present heading, unwrapped [rad].
            length: of the tether [m].
            yaw_error: standard deviation of the yaw rate [rad/s].
            twist: of the tether [rad].
            mass: estimated over nominal mass.
            spin: about +z, beside the coning [rad/s]. The acceptance ignores mass and spin; the
                prediction uses them.

        Raises:
            Refusal: the heading cannot be reached, or not held for long enough.
        """
        p = self.parameters
        if not math.isfinite(turn) or abs(turn) > math.pi:
            raise Refusal(
                topics.DESCENT_REQUEST,
                RefusalCode.OUT_OF_LIMITS,
                f"turn is {turn!r} rad, it must be within -pi .. pi",
            )
        guaranteed = self.predict(turn, twist, length, yaw_error=yaw_error, share=p.coning_derating)
        degrees = math.degrees(abs(turn))
        if guaranteed.turning > p.max_turn_time:
            torsion = self.hanging.torsional_stiffness(length)
            reach = p.coning_derating * self.largest_rate
            reach /= self.hanging.torsional_frequency(length)
            raise Refusal(
                topics.DESCENT_REQUEST,
                RefusalCode.OUT_OF_LIMITS,
                f"a turn of {degrees:.0f} deg takes more than {p.max_turn_time:.0f} s on "
                f"{length:.3g} m of tether: against its torsional stiffness of {torsion:.3g} "
                f"N m/rad coning reaches {math.degrees(reach):.0f} deg of twist",
            )
        if guaranteed.holding < p.min_hold_time:
            uncertain = guaranteed.limit is Reason.GYRO_BIAS
            raise Refusal(
                topics.DESCENT_REQUEST,
                RefusalCode.UNCERTAIN if uncertain else RefusalCode.OUT_OF_LIMITS,
                f"a turn of {degrees:.0f} deg would be held for {guaranteed.holding:.0f} s on "
                f"{length:.3g} m of tether, limited by {guaranteed.limit}; it must be at least "
                f"{p.min_hold_time:.0f} s",
            )
        self._target, self._target_twist, self._mass = heading + turn, twist + turn, mass
        self._coning_rate, self._identified = 0.0, _ConingIdentification()
        self._time, self._reached, self._initial_yaw_error = 0.0, False, yaw_error
        self._reached_at = 0.0
        against = -math.copysign(spin, spin * turn)
        self.prediction = self.predict(
            turn, twist, length, yaw_error=yaw_error, spin=against, mass=mass
        )
        return self.prediction

    def stop(self) -> None:
        """Release the heading."""
        self._target = math.nan

    def error(self, heading: float) -> float:
        """Heading error: angle left to turn [rad]."""
        return self._target - heading

    @property
    def is_coning(self) -> bool:
        """Whether the rotors cone the rover."""
        return self._coning_rate != 0.0

    def take_reached(self) -> TurnPrediction | None:
        """Prediction at the end of the turn, once; None = no turn has ended."""
        taken, self._reached_prediction = self._reached_prediction, None
        return taken

    def take_lost(self) -> tuple[str, Reason] | None:
        """Why the heading was released, as text and reason, once; None = it was not."""
        taken, self._lost = self._lost, None
        return taken

    def step(
        self,
        heading: float,
        length: float,
        swing: SwingEstimate,
        momenta: tuple[float, float],
        h: float,
    ) -> RotorMomenta:
        """Advance by h; returns the momentum setpoints of the rotors.

        Args:
            heading: about the tether, unwrapped: its twist [rad].
            length: of the tether [m].
            swing: estimate of swing and tilt.
            momenta: measured, of the rotors about base_link x and y [N m s].
            h: duration [s].
        """
        p = self.parameters
        w = p.coning_frequency
        identified, most = self._identified, self.largest_rate
        (ux, uy), (px, py) = swing.direction, swing.tilt
        (vx, vy), (qx, qy) = swing.direction_rate, swing.tilt_rate
        swept = (ux + px) * (vy + qy) - (uy + py) * (vx + qx)
        tilt_momentum = momenta[0] * (ux + px) + momenta[1] * (uy + py)
        rotor_rate = (
            tilt_momentum / identified.mass(self._mass_coefficient) + self._coning_inertia * swept
        )
        rotor_rate /= -self.hanging.inertia_about_z
        self._spin += min(h / _SPIN_TIME, 1.0) * (swing.yaw_rate - rotor_rate - self._spin)
        setpoint = 0.0
        if self.is_active:
            self._time += h
            if abs(self._coning_rate) >= 0.99 * most and not self._reached:
                sense = math.copysign(1.0, self._coning_rate)
                identified.add(h, sense * (rotor_rate + 0.5 * swept), tilt_momentum, swept)
            self._check_reached(heading, length)
            self._check_lost(heading)
        if self.is_active:
            # Compensate the spin from the twist.
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
        """Predict the hold when the turn ends."""
        p, identified = self.parameters, self._identified
        if self._reached or abs(self.error(heading)) > p.heading_tolerance:
            return
        self._reached = True
        torsion, friction_limit = (
            self.hanging.torsional_stiffness(length),
            self.hanging.swivel_friction,
        )
        pull = self._twist_torque(self._target_twist, torsion, friction_limit)
        inertia = self.hanging.inertia_about_z * identified.mass(self._mass_coefficient)
        held, limit = math.inf, Reason.TWIST
        if pull != 0.0:
            # The twist torque acts against its own sign; coning in its direction holds it off.
            left = identified.share(self.largest_rate) * self.largest_rate
            left = max(left + math.copysign(1.0, pull) * self._spin, 0.0)
            drift = math.sqrt(2.0 * p.heading_tolerance * inertia / abs(pull))
            held = left * inertia / abs(pull) + drift
        known = self._known_for(self._initial_yaw_error) - self._time
        if known < held:
            held, limit = max(known, 0.0), Reason.GYRO_BIAS
        self._reached_at = self._time
        self._reached_prediction = TurnPrediction(self._time, held, limit)

    def _check_lost(self, heading: float) -> None:
        """Release a heading that has drifted, or is no longer known."""
        p, degrees = self.parameters, math.degrees(self.parameters.heading_tolerance)
        held = self._time - self._reached_at
        if self._time > self._known_for(self._initial_yaw_error):
            cause = Reason.GYRO_BIAS
            reason = f"the gyro bias leaves it uncertain by more than {degrees:.0f} deg"
        elif self._reached and held > _SPIN_TIME and abs(self.error(heading)) > p.heading_tolerance:
            cause = Reason.TWIST
            reason = f"the tether's twist has turned the rover away by {degrees:.0f} deg"
        else:
            return
        self._lost = f"heading released after {held:.0f} s: {reason}", cause
        self.stop()

    def induced_tilt_rates(self, momenta: RotorMomenta) -> tuple[float, float]:
        """Tilt rates along x and y [rad/s] that the coning induces."""
        return self._tilt_response[0] * momenta.x / self._mass, self._tilt_response[
            1
        ] * momenta.y / self._mass


class _ConingIdentification:
    """Identification of turn rate and mass from sums over the time of full coning."""

    def __init__(self) -> None:
        self._time = self._turned = self._tilt_momentum = self._swept = 0.0

    def add(self, h: float, rate: float, tilt_momentum: float, swept: float) -> None:
        """Add a step: the turn rate by the rotors, and its terms."""
        self._time += h
        self._turned += h * rate
        self._tilt_momentum += h * tilt_momentum
        self._swept += h * swept

    def share(self, rate: float) -> float:
        """Turn rate over the model's rate at full coning [rad/s]."""
        if self._time < _IDENTIFICATION_TIME:
            return 1.0
        return min(max(self._turned / (self._time * rate), 0.3), 2.0)

    def mass(self, coefficient: float) -> float:
        """Identified over nominal mass.

        Args:
            coefficient: rotor momentum over the tilt rate that it induces [kg m^2].
        """
        if self._time < _IDENTIFICATION_TIME or self._swept == 0.0:
            return 1.0
        found = self._tilt_momentum / (self._swept * coefficient)
        return min(max(found, 1.0 / MAX_MASS_RATIO), MAX_MASS_RATIO)
