"""Controller of the hanging rover: estimator, damping, attitude, pointing and descent. Pure.

Inputs are IMU, encoders of drum and rotors, load cell, camera and the winch's mode; each time step
returns the commands to wheels, flywheel and winch.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from msg_schemas import machine, topics
from msg_schemas.events import DescentEvent, EventReport
from msg_schemas.faults import Reason
from msg_schemas.phases import WinchMode
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import ImuSample, JointSample, WrenchSample
from rover_control.coordination.winch_link import WinchRequest
from rover_control.hanging.attitude import FlywheelReaction, RotorParameters, WheelReaction
from rover_control.hanging.attitude_gains import AttitudeDesign
from rover_control.hanging.descent_parameters import ProfileParameters
from rover_control.hanging.descent_profile import DescentProfile, ProfileSetpoints
from rover_control.hanging.descent_stop import DescentStop
from rover_control.hanging.hanging_rover import HangingParameters
from rover_control.hanging.pointing import Pointing, PointingParameters, TurnPrediction
from rover_control.hanging.rotor_momentum import RotorMomentum
from rover_control.hanging.rotor_pump import RotorMomenta, RotorPump
from rover_control.hanging.suspended_mass import SuspendedMassEstimator
from rover_control.hanging.swing_damping import DampingParameters, WinchTrim
from rover_control.hanging.swing_estimator import EstimatorParameters, SwingEstimate, SwingEstimator
from rover_control.hanging.swing_filter import SwingFilter
from rover_control.hanging.tether_turn import TetherTurn
from rover_control.hanging.yaw_momentum import (
    MomentumTransfer,
    YawMomentumController,
    YawParameters,
    YawTask,
)

_NANO = 1e9
_SENSOR_TIMEOUT = 0.3  # age at which a sensor has timed out [s]
_LONGEST_STEP = 0.2  # of the estimator; after a longer gap only the gyro biases stay [s]
_LONGEST_WAIT = 0.06  # of an IMU sample for the rotors' states of its time [s]
_OPEN = 0.5  # brake position above which the brake is open
_RENEWAL_PERIOD = 1.0  # shortest time between two winch requests [s]
_PUMP_RAMP = 5.0  # ramp time of the pumping [s]
_ARMED = frozenset({WinchMode.HOLD, WinchMode.LENGTH, WinchMode.RATE})  # accept a trim


@dataclass(frozen=True)
class HangingControllerParameters:
    """All parameters of the controller."""

    hanging: HangingParameters = field(default_factory=HangingParameters)
    estimator: EstimatorParameters = field(default_factory=EstimatorParameters)
    damping: DampingParameters = field(default_factory=DampingParameters)
    yaw: YawParameters = field(default_factory=YawParameters)
    design: AttitudeDesign = field(default_factory=AttitudeDesign)
    pointing: PointingParameters = field(default_factory=PointingParameters)
    rotors: RotorParameters = field(default_factory=RotorParameters)
    profile: ProfileParameters = field(default_factory=ProfileParameters)
    uses_winch: bool = True  # damp the swing by its trim
    uses_rotors: bool = True


class Exposure(NamedTuple):
    """A picture of the wall."""

    time: float  # [s]
    depth: float  # length at the drum [m]
    heading: float  # about the plumb line, since the start, by the gyro [rad]
    camera_rate: float  # estimated [rad/s]


class ActuatorCommands(NamedTuple):
    """Commands to the drives; None = nothing is sent."""

    wheel_rate: float | None  # of the left wheel [rad/s]
    flywheel_torque: float | None  # [N m]
    winch: WinchRequest | None
    trim: float | None  # [m/s]
    exposure: Exposure | None


NO_COMMANDS = ActuatorCommands(None, None, None, None, None)


class HangingController:
    """Controller of the rover on the tether."""

    def __init__(self, parameters: HangingControllerParameters) -> None:
        self.parameters = parameters
        p = parameters
        self.estimator = SwingEstimator(p.estimator, p.hanging)
        self.trim = WinchTrim(p.damping)
        self.pump = RotorPump(p.damping, p.hanging)
        self.swing_filter = SwingFilter()
        self._disturbances = 0
        self._divergences = 0
        self._is_lost = False  # the swing estimate has diverged
        self.yaw = YawMomentumController(p.yaw, p.hanging)
        self.wheels = WheelReaction(p.hanging, p.rotors, p.design)
        self.flywheel = FlywheelReaction(p.hanging, p.rotors, p.design)
        self.profile = DescentProfile(p.profile, p.hanging, self._decay_time)
        self.pointing = Pointing(p.pointing, p.hanging)
        self.suspended_mass = SuspendedMassEstimator(p.hanging)
        self.turn = TetherTurn(p.hanging)
        self._received_ns: dict[str, int] = {}
        self._imu_ns: int | None = None
        self._load_ns: int | None = None
        self._has_stood: bool | None = None  # since the estimates began; None: not known
        self.length = math.nan  # at the drum [m]
        self._brake_is_open = False
        self._mode = ""
        self._left_rate = 0.0  # of the left wheel [rad/s]
        self._wheel_momentum = RotorMomentum()  # about +y
        self._flywheel_momentum = RotorMomentum()  # about +x
        self._screw = (0.0, 0.0)  # angle [rad], rate [rad/s]
        self._screw_ns = 0  # their stamp
        self._waiting: deque[ImuSample] = deque()  # for the momenta of their time
        self._momentum: tuple[float, float] | None = (
            None  # rotor momenta at the last estimator step
        )
        self._stepped: float | None = None
        self._estimation_paused = False  # the rover may stand
        self._pause = 0.0  # duration of the pause [s]
        self._requested: WinchRequest | None = None
        self._requested_at = -math.inf
        self._pump_gain = 0.0  # 0..1
        self._reported_saturation: dict[str, str] = {}
        self._changes: list[EventReport] = []

    @property
    def heading(self) -> float:
        """Heading about the plumb line since the start, by the gyro [rad]."""
        return math.remainder(self.turn.angle, math.tau)

    def _decay_time(self, length: float) -> float:
        if not self.parameters.uses_winch:
            return math.inf
        return 1.0 / self.trim.decay(length, self.parameters.hanging.swing_frequency(length))

    def take_changes(self) -> list[EventReport]:
        """Return the transitions since the last call, and clear them."""
        taken = self._changes + self.profile.take_changes()
        self._changes = []
        return taken

    # --- sensors ---------------------------------------------------------------------------------

    def on_drum(self, sample: JointSample, now_ns: int) -> None:
        """Update with the state of drum and brake."""
        length, rate, _ = sample.joints[machine.WINCH_DRUM]
        self._received_ns[topics.WINCH_STATE] = now_ns
        self.length = length
        self._brake_is_open = sample.joints[machine.WINCH_BRAKE].position >= _OPEN
        self.estimator.on_drum(length, rate)

    def on_load_cell(self, sample: WrenchSample, now_ns: int) -> None:
        """Update the suspended mass with the tension at the fairlead."""
        stamp = sample.stamp_ns or now_ns
        last, self._load_ns = self._load_ns, stamp
        if math.isnan(self.length):
            return
        tension = math.hypot(*sample.force)
        stands = not self.suspended_mass.hangs(tension, self.length)
        self._has_stood = bool(self._has_stood) or stands
        if not self._estimation_paused and last is not None and stamp > last:
            self.suspended_mass.update(tension, self.length, (stamp - last) / _NANO)

    def on_wheels(self, sample: JointSample, now_ns: int) -> None:
        """Update with the wheel rates."""
        self._received_ns[topics.WHEEL_STATE] = now_ns
        self._left_rate = sample.joints[machine.WHEEL_LEFT].velocity
        rates = self._left_rate + sample.joints[machine.WHEEL_RIGHT].velocity
        momentum = self.parameters.hanging.wheel_inertia * rates
        self._wheel_momentum.add(sample.stamp_ns or now_ns, momentum)
        self._estimate()

    def on_flywheel(self, sample: JointSample, now_ns: int) -> None:
        """Update with angle and rate of the flywheel."""
        self._received_ns[topics.FLYWHEEL_STATE] = now_ns
        angle, rate, _ = sample.joints[machine.FLYWHEEL]
        self._screw, self._screw_ns = (angle, rate), sample.stamp_ns or now_ns
        self._flywheel_momentum.add(self._screw_ns, self.parameters.hanging.flywheel_inertia * rate)
        self._estimate()

    def on_imu(self, sample: ImuSample, now_ns: int) -> None:
        """Step the estimator with an IMU sample, once the rotors' states of its time are there."""
        self._received_ns[topics.IMU] = now_ns
        self._waiting.append(sample if sample.stamp_ns else replace(sample, stamp_ns=now_ns))
        self._estimate()

    def _estimate(self) -> None:
        """Step the estimator with the IMU samples whose rotor momenta are known.

        Messages of different topics overtake each other: with the momentum of another instant the
        rotors' reaction would be taken for a swing.
        """
        while self._waiting:
            stamp = self._waiting[0].stamp_ns
            known = min(self._wheel_momentum.newest_ns, self._flywheel_momentum.newest_ns)
            if known < stamp and self._waiting[-1].stamp_ns - stamp < _LONGEST_WAIT * _NANO:
                return
            self._step_estimator(self._waiting.popleft())

    def _step_estimator(self, sample: ImuSample) -> None:
        stamp = sample.stamp_ns
        last, self._imu_ns = self._imu_ns, stamp
        momentum = (-self._wheel_momentum.at(stamp), self._flywheel_momentum.at(stamp))
        before, self._momentum = self._momentum, momentum
        if last is None or before is None or stamp <= last:
            return
        h = (stamp - last) / _NANO
        if h > _LONGEST_STEP:
            self.estimator.reset_swing(h)
            return
        if self._estimation_paused:
            self._pause += h
            turned = (sample.angular_velocity[2] - self.estimator.yaw_bias) * h
            self.turn.add(turned, self.length)
            return
        # Momentum that turns with the rover changes in the inertial frame.
        turned = self.estimator.yaw_rate * h
        change = (
            momentum[0] - before[0] - turned * momentum[1],
            momentum[1] - before[1] + turned * momentum[0],
        )
        self.estimator.step(sample.angular_velocity, sample.linear_acceleration, change, h)
        self.turn.add(self.estimator.twist_increment, self.length)
        self._publish_divergence()

    def _publish_divergence(self) -> None:
        """Report a divergence of the estimator, once until it has settled again."""
        if self.estimator.divergences != self._divergences:
            self._divergences = self.estimator.divergences
            self.profile.on_swing_lost()
            if not self._is_lost:
                self._is_lost = True
                text = (
                    "the swing estimate has diverged: the sensors do not fit a rover on a taut "
                    "tether; the estimator restarts"
                )
                self._changes.append(EventReport(DescentEvent.SWING_LOST, text))
        elif self._is_lost and self.estimator.is_settled:
            self._is_lost = False
            text = "the swing estimate has settled"
            self._changes.append(EventReport(DescentEvent.SWING_RECOVERED, text))

    def release(self) -> None:
        """Let rotors, pumping and coning begin from rest; pause the estimates of swing and mass.

        The rover may be set down from here on. The heading is still integrated.
        """
        p = self.parameters
        self.wheels = WheelReaction(p.hanging, p.rotors, p.design)
        self.flywheel = FlywheelReaction(p.hanging, p.rotors, p.design)
        self.pointing = Pointing(p.pointing, p.hanging)
        self._pump_gain = 0.0
        self._estimation_paused = True

    def restart_estimation(self) -> None:
        """Restart swing and mass estimates if the rover may have stood. The gyro biases stay."""
        if self._has_stood is False and not self._estimation_paused:
            return
        self._has_stood = None
        self.estimator.reset_swing(self._pause)
        self._pause = 0.0
        self.swing_filter = SwingFilter()
        self.suspended_mass.restart()
        self.profile.on_swing_lost()

    def resume_estimation(self) -> None:
        """Estimate swing and mass of a rover that hangs; the wheels start from their rate."""
        self._estimation_paused = False
        self.wheels.start_from(self._left_rate)

    def on_winch_mode(self, mode: str) -> None:
        """Update with the mode of the winch."""
        self._mode = mode

    def on_camera(self, sample: JointSample) -> None:
        """Update with the camera's report on its last picture."""
        smear, distance = (
            sample.joints[name].position for name in (machine.SMEAR, machine.WALL_DISTANCE)
        )
        if distance > 0.0 and not self._estimation_paused:
            self.estimator.on_image(smear, distance)

    def waiting_for(self, now_ns: int) -> tuple[str, ...]:
        """Topics of the sensors that have timed out; without them nothing is driven."""
        needed = [topics.IMU, topics.WINCH_STATE]
        if self.parameters.uses_rotors:
            needed += [topics.WHEEL_STATE, topics.FLYWHEEL_STATE]
        limit = _SENSOR_TIMEOUT * _NANO
        never = -1 << 62
        return tuple(name for name in needed if now_ns - self._received_ns.get(name, never) > limit)

    @property
    def swing(self) -> SwingEstimate | None:
        """Estimate of the swing; None before the first samples."""
        if self._momentum is None or math.isnan(self.length):
            return None
        return self.estimator.estimate

    # --- requests --------------------------------------------------------------------------------

    def request(self, stop: DescentStop) -> None:
        """Add a stop.

        Raises:
            Refusal: the winch is not armed, or the profile refuses.
        """
        if self._mode not in _ARMED:
            raise Refusal(
                topics.DESCENT_REQUEST,
                RefusalCode.NOT_ARMED,
                f"the winch is in {self._mode or 'no known mode'}, it must be in hold or length; "
                f"{topics.WINCH_REARM} arms it",
            )
        self.profile.request(stop, self.swing, self.length)

    def point(self, turn: float) -> TurnPrediction:
        """Turn about the tether by an angle [rad], and hold the heading until another request.

        Returns:
            Prediction of turn and hold.

        Raises:
            Refusal: the swing is unknown, a stop is in progress, or the turn is not possible.
        """
        swing = self.swing
        if swing is None:
            raise Refusal(topics.DESCENT_REQUEST, RefusalCode.STALE, "the swing estimate timed out")
        if not self.parameters.uses_rotors or not self.profile.is_idle:
            raise Refusal(
                topics.DESCENT_REQUEST,
                RefusalCode.WRONG_PHASE,
                f"the descent is in {self.profile.phase}, a turn requires standby"
                if self.parameters.uses_rotors
                else "the rotors are disabled by the parameter uses_rotors",
            )
        prediction = self.pointing.request(
            turn,
            self.turn.angle,
            self.length,
            yaw_error=swing.yaw_error,
            twist=self.turn.twist,
            mass=self.suspended_mass.ratio,
            spin=self._spin_by_bias(swing),
        )
        text = (
            f"turn by {math.degrees(turn):.0f} deg predicted within {prediction.turning:.0f} s, "
            f"hold for {prediction.holding:.0f} s, limited by {prediction.limit}"
        )
        values = prediction._asdict()
        self._changes.append(EventReport(DescentEvent.POINTING_STARTED, text, values))
        return prediction

    def _spin_by_bias(self, swing: SwingEstimate) -> float:
        """Spin [rad/s] after the wheel's bias has ramped up.

        The motor torque tilts the rover, so that the tether pulls past its centre of mass, by an
        offset that depends on the swing phase: the swing gains momentum about the plumb line, the
        rover the opposite.
        """
        hanging, rotors = self.parameters.hanging, self.parameters.rotors
        change = rotors.wheel_pump_bias - self._left_rate
        angle = swing.frequency * 0.5 * abs(change) / rotors.wheel_acceleration
        aside = swing.direction[1] * math.cos(angle)
        aside += swing.direction_rate[1] / swing.frequency * math.sin(angle)
        inertia = self.suspended_mass.ratio * hanging.inertia_about_z
        return hanging.wheel_inertia * change * aside / inertia

    def hold(self, now_ns: int, cause: Reason = Reason.REQUESTED) -> str:
        """Hold the present length."""
        return self.profile.hold(self.length, now_ns / _NANO, cause)

    def resume(self, now_ns: int) -> str:
        """Continue after a hold.

        Raises:
            Refusal: the descent is not held.
        """
        return self.profile.resume(now_ns / _NANO)

    def abort(self, now_ns: int) -> str:
        """Drop all stops and stay."""
        return self.profile.abort(self.length, now_ns / _NANO)

    # --- control step ----------------------------------------------------------------------------

    def step(self, now_ns: int) -> ActuatorCommands:
        """Advance to now; returns the commands to the drives."""
        now = now_ns / _NANO
        h = 0.0 if self._stepped is None else now - self._stepped
        self._stepped = now
        swing = self.swing
        if swing is None or self.waiting_for(now_ns) or h <= 0.0:
            return NO_COMMANDS
        h = min(h, _LONGEST_STEP)
        setpoints = self.profile.step(
            swing,
            self.length,
            winch_rests=not self._brake_is_open,
            transfer=self._momentum_transfer(swing),
            rotors_rest=(self.wheels.is_quiet and self._pump_gain == 0.0)
            or not self.parameters.uses_rotors,
            now=now,
        )
        wheel_rate, torque = self._react(swing, setpoints, now_ns, h)
        request, trim = self._winch(swing, setpoints, now, h)
        exposure = None
        if setpoints.exposes:
            exposure = Exposure(now, self.length, self.heading, swing.camera_rate)
        return ActuatorCommands(wheel_rate, torque, request, trim, exposure)

    def _momentum_transfer(self, swing: SwingEstimate) -> MomentumTransfer:
        transfer = self.yaw.predict_transfer(swing, self.turn.twist, self.length)
        return transfer if self.parameters.uses_rotors else transfer._replace(time=math.inf)

    def _react(
        self, swing: SwingEstimate, setpoints: ProfileSetpoints, now_ns: int, h: float
    ) -> tuple[float | None, float | None]:
        if not self.parameters.uses_rotors:
            return None, None
        # Ramp the pumping: a step would tilt the rover.
        change = h / _PUMP_RAMP
        self._pump_gain = min(
            max(float(setpoints.pumps), self._pump_gain - change), self._pump_gain + change
        )
        if self.estimator.disturbances != self._disturbances:
            self._disturbances = self.estimator.disturbances
            self.swing_filter.restart()
            self.yaw.observer.restart()
        elif swing.swing_error > self.parameters.profile.swing_error_limit:
            # The momentum of a swing that is not known must not stay in its average.
            self.yaw.observer.restart()
        filtered = self.swing_filter.step(swing, self.turn.angle, h)
        torque = self.yaw.step(
            swing,
            self.turn.twist,
            self.length,
            self.pump.largest_torque(filtered, self.length),
            h,
            setpoints.yaw,
        )
        damps = setpoints.yaw is YawTask.HOLD
        if setpoints.yaw is YawTask.RELAX:
            self.turn.correct(self.yaw.correction.twist)
            self.estimator.correct_yaw_bias(self.yaw.correction.yaw_bias)
        pumping = self.pump.momenta(filtered, self.length, torque, damps=damps)
        pumped = RotorMomenta(*(self._pump_gain * each for each in pumping))
        coning = self._cone(swing, h)
        own = self.pointing.induced_tilt_rates(coning)
        own_x = self.pump.induced_tilt_rate(pumped.x, swing.frequency) + own[0]
        own_y = self.pump.induced_tilt_rate(pumped.y, swing.frequency) + own[1]
        pumped = RotorMomenta(*(sum(each) for each in zip(pumped, coning, strict=True)))
        pumps = setpoints.pumps or self.pointing.is_active
        rate = self.wheels.step(swing.tilt_rate[0] - own_x, pumped.x, h, pumps=pumps)
        quiet = setpoints.quiet and not self.flywheel.is_near_end
        torque = self.flywheel.step(
            swing.tilt_rate[1] - own_y,
            pumped.y,
            pumped.y_integral,
            *self._screw,
            max(now_ns - self._screw_ns, 0) / _NANO,
            h,
            quiet=quiet,
        )
        for axis in (self.wheels.axis, self.flywheel.axis):
            if axis.saturation != self._reported_saturation.get(axis.name, ""):
                self._reported_saturation[axis.name] = axis.saturation
                name = (
                    DescentEvent.BUDGET_EXHAUSTED
                    if axis.saturation
                    else DescentEvent.BUDGET_RECOVERED
                )
                text = axis.saturation or f"{axis.name} holds the attitude again"
                self._changes.append(EventReport(name, text, {"rotor": axis.name}))
        return rate, torque

    def _cone(self, swing: SwingEstimate, h: float) -> RotorMomenta:
        """Momenta that turn the rover to its heading; a requested stop ends the pointing."""
        if self.pointing.is_active and not self.profile.is_idle:
            self.pointing.stop()
            text = "heading released: a stop was requested"
            self._changes.append(
                EventReport(DescentEvent.POINTING_RELEASED, text, reason=Reason.SUPERSEDED)
            )
        # The coning's tilt masks the rotation of the swing, over a hundred times as slow.
        self.estimator.freezes_yaw_bias = self.pointing.is_coning
        momenta = self.pointing.step(
            self.turn.angle,
            self.length,
            swing,
            (self._flywheel_momentum.newest, self._wheel_momentum.newest),
            h,
        )
        reached = self.pointing.take_reached()
        if reached is not None:
            text = (
                f"heading reached after {reached.turning:.0f} s; predicted hold "
                f"{reached.holding:.0f} s, limited by {reached.limit}"
            )
            values = reached._asdict()
            self._changes.append(EventReport(DescentEvent.POINTING_REACHED, text, values))
        lost = self.pointing.take_lost()
        if lost is not None:
            text, reason = lost
            self._changes.append(EventReport(DescentEvent.POINTING_LOST, text, reason=reason))
        return momenta

    def _winch(
        self, swing: SwingEstimate, setpoints: ProfileSetpoints, now: float, h: float
    ) -> tuple[WinchRequest | None, float | None]:
        length = setpoints.length
        if math.isnan(length) or self._mode not in _ARMED:
            return None, None
        trims = setpoints.trim != 0.0 and self.parameters.uses_winch
        request = WinchRequest(length, setpoints.rate)
        sends = self._requested is None or self._requested.length != length
        if (
            self._requested is not None
            and not sends
            and now - self._requested_at >= _RENEWAL_PERIOD
        ):
            away = abs(self.length - length) > self.parameters.profile.depth_tolerance
            sends = (trims and self._mode != WinchMode.LENGTH) or (away and not trims)
        trim = None
        if trims and self._mode == WinchMode.LENGTH and not sends:
            trim = self.trim.step(swing, length, self.length - length, h, setpoints.trim)
        elif not trims:
            self.trim.restart()
        if not sends:
            return None, trim
        self._requested, self._requested_at = request, now
        return request, trim
