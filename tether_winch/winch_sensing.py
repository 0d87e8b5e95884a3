"""What the winch senses: payout, tension, load, taut length and the motor's heat. Pure."""

from __future__ import annotations

import math

from msg_schemas import machine, topics
from msg_schemas.events import EventReport
from msg_schemas.samples import JointSample, JointValue, WrenchSample
from tether_winch.drum_model import DrumModel
from tether_winch.estimates import PayoutEstimate, TensionEstimate, TensionSource
from tether_winch.load_monitor import LoadMonitor
from tether_winch.servo import SensedState, WinchServo
from tether_winch.thermal import MotorThermalModel
from tether_winch.winch_events import alarm_event
from tether_winch.winch_parameters import WinchParameters

_NANO = 1e9
_OPEN = 0.5  # brake position above which the brake is open
_MOVING = 0.02  # rate above which the drum moves [m/s]


class WinchSensing:
    """Estimates of one winch from the samples of its sensors.

    Args:
        parameters: of the winch.
        drum: its model.

    Attributes:
        payout: length and rate of the tether that is out.
        tension: at the fairlead.
        load: what hangs on the tether, with the alarms.
        heat: of the motor.
        taut_length: payout at which the tether was last taut [m]; None: never yet.
    """

    def __init__(self, parameters: WinchParameters, drum: DrumModel) -> None:
        self._parameters = parameters
        self._drum = drum
        self.taut_length: float | None = None
        self._begin()

    def _begin(self) -> None:
        p = self._parameters
        self.payout = PayoutEstimate(p.estimates)
        self.tension = TensionEstimate(p.estimates, self._drum)
        self.load = LoadMonitor(p.load)
        self.heat = _thermal_model(p)
        self._brake_is_open = False
        self._motor_torque = 0.0
        self._alarms: dict[str, bool] = {}

    def restart(self) -> None:
        """Begin anew, because the times of all samples are invalid; the mean load is kept."""
        mean = self.load.mean
        self._begin()
        self.load.mean = mean

    def retune(self, parameters: WinchParameters, drum: DrumModel) -> None:
        """Apply other parameters."""
        self._parameters, self._drum = parameters, drum
        self.payout.parameters = parameters.estimates
        self.tension.retune(parameters.estimates, drum)
        self.load.parameters = parameters.load
        heat, self.heat = self.heat.heat, _thermal_model(parameters)
        self.heat.heat = heat

    # --- samples ---------------------------------------------------------------------------------

    def on_drum(self, sample: JointSample, now_ns: int) -> None:
        """Update with the state of drum and brake."""
        length, rate, _ = sample.joints[machine.WINCH_DRUM]
        is_open = sample.joints[machine.WINCH_BRAKE].position >= _OPEN
        now = now_ns / _NANO
        moves = max(abs(rate), abs(self.payout.rate)) > _MOVING
        if self._brake_is_open and not is_open and moves:
            self.load.on_braking(now)
        self._brake_is_open = is_open
        taken = sample.stamp_ns / _NANO if sample.stamp_ns else now
        self.payout.update(length, rate, taken, now)

    def on_load_cell(self, sample: WrenchSample, now_ns: int) -> None:
        """Update with the tether force at the fairlead."""
        self.tension.on_load_cell(math.hypot(*sample.force), now_ns / _NANO)

    def on_currents(self, sample: JointSample, now_ns: int) -> None:
        """Update with the motor currents; uses the winch motor's."""
        current = sample.joints[machine.WINCH_MOTOR].effort
        self._motor_torque = current * self._parameters.drum.torque_constant
        self.tension.on_motor(current, self.payout, self._brake_is_open, now_ns / _NANO)

    def on_timeout(self, reason: str) -> None:
        """Invalidate tension and load; the sensors timed out by another clock."""
        self.tension.invalidate(reason)
        self.load.invalidate()

    def step(self, now_ns: int, h: float, delay: float) -> list[EventReport]:
        """Advance to now; returns the events of the alarms that have changed.

        Args:
            now_ns: controller's clock [ns].
            h: time since the last step [s].
            delay: of this step, so that the clock is ahead of the queued samples [s].
        """
        now = now_ns / _NANO
        self.tension.step(self.payout, now - delay)
        tension, _ = self.tension_now(now_ns)
        own, length = self.own_weight, self.payout.length
        bounce_period = self._drum.bounce_period(length, self.load.mean)
        self.load.step(tension, own, self.payout.rate, bounce_period, now)
        # A NaN compares as false.
        if tension - own > 0.5 * self._parameters.requests.take_up_tension:
            self.taut_length = length
        self.heat.step(self._motor_torque, h)
        values = {"tension": tension, "length": length, "load_mean": self.load.mean}
        before, self._alarms = self._alarms, dict(self.load.alarms)
        return [
            alarm_event(name, is_on=is_on, values=values)
            for name, is_on in self._alarms.items()
            if is_on is not before.get(name, False)
        ]

    # --- estimates -------------------------------------------------------------------------------

    def silent_topics(self, now_ns: int) -> tuple[str, ...]:
        """Topics of the sensors that have timed out; without them no motion starts."""
        silent = []
        if self.payout.age(now_ns / _NANO) > self._parameters.estimates.encoder_timeout:
            silent.append(topics.WINCH_STATE)
        if self.tension.cell_fault:
            silent.append(topics.LOAD_CELL)
        return tuple(silent)

    def tension_now(self, now_ns: int) -> tuple[float, TensionSource]:
        """Tension [N] and its source; NaN where no source is valid."""
        value, source = self.tension.value(now_ns / _NANO)
        if source is TensionSource.MOTOR and self._parameters.faults.load_cell_required:
            return math.nan, TensionSource.NONE
        return value, source

    @property
    def tension_fault(self) -> str:
        """Why the tension is unknown or imprecise; empty if it is known."""
        return self.tension.mismatch or self.tension.cell_fault

    @property
    def own_weight(self) -> float:
        """Weight of the tether that is out [N]."""
        return self._drum.hanging_weight(self.payout.length)

    @property
    def allowed_tension(self) -> float:
        """Tension that the motor may carry, as hot as it is [N]."""
        return self._drum.tension_of(self.heat.allowed, self.payout.length)

    def state(self, now_ns: int) -> SensedState:
        """State of the drum for the servo."""
        tension, _ = self.tension_now(now_ns)
        return SensedState(
            self.payout.length_at(now_ns / _NANO),
            self.payout.rate,
            tension,
            0.0 if self.load.is_supported else self.load.mean,
            self._drum.tension_of(-self._motor_torque, self.payout.length),
            self._brake_is_open,
        )

    def estimate(self, servo: WinchServo, now_ns: int) -> JointSample | None:
        """Sample of `winch/estimate` with the servo's reference; None before the first drum state.

        Without a valid tension, the stretched length assumes the mean load.
        """
        if not self.payout.is_known:
            return None
        tension, source = self.tension_now(now_ns)
        known = source is not TensionSource.NONE
        length, rate = max(self.payout.length_at(now_ns / _NANO), 0.0), self.payout.rate
        weight = self._drum.hanging_weight(length)
        stretched = self._drum.stretched(length, tension if known else weight + self.load.mean)
        aim = servo.reference
        values = {
            machine.PAYOUT: JointValue(length, rate, 0.0),
            machine.STRETCHED: JointValue(
                stretched, rate * stretched / length if length else rate, 0.0
            ),
            machine.TENSION: JointValue(float(known), 0.0, max(tension, 0.0) if known else 0.0),
            machine.TETHER_OUT: JointValue(
                self._parameters.drum.line_density * length, 0.0, weight
            ),
            machine.REFERENCE: JointValue(
                min(max(aim.length, 0.0), machine.MAX_LENGTH),
                min(max(aim.rate, -machine.MAX_PAYOUT_RATE), machine.MAX_PAYOUT_RATE),
                min(servo.tension_setpoint, machine.MAX_TENSION),
            ),
        }
        return JointSample(now_ns, values)


def _thermal_model(p: WinchParameters) -> MotorThermalModel:
    drum = p.drum
    return MotorThermalModel(
        drum.motor_continuous_torque, drum.motor_torque, drum.motor_thermal_time
    )
