"""Drives of the plant: validation of commands, and a watchdog for each drive.

The contract has already refused samples that are not finite, out of limits or outdated. This module
refuses commands that the state of the drives does not permit, such as a reaction-wheel torque while
the nut is on the latch. Each drive's watchdog stops it when its commands cease, with the contract's
timeouts in simulated time; a command that would expire during a tick is dropped at its start.

A drive stops by its quick stop (`quick_stop`):

winch      ramps its rate to zero, closes the brake, then switches its motor off. Until then it
           refuses commands but those that close the brake. Before the next motion it needs a
           command with the rate 0: a command source that sends again, still with the rate of
           before, must not jerk a hanging rover.
wheels     ramp the rate to zero, then the motor is off
flywheel   the same
nut        comes to rest, without passing its setpoint, and holds there; the latch does not trip

Wheels and flywheel are stopped too if the last command was zero and they still turn. That is not
reported: the command source has released them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Generic, NamedTuple, TypeVar

from msg_schemas import machine, topics
from msg_schemas.events import PlantEvent
from msg_schemas.phases import PlantPhase
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, JointValue
from msg_schemas.table import TOPICS
from rover_sim.devices.equipment import Equipment
from rover_sim.devices.quick_stop import QuickStop
from rover_sim.plants.plant import (
    FlywheelCommand,
    FlywheelRateCommand,
    JumpMotorCommand,
    PlantCommand,
    WheelRateCommand,
    WheelTorqueCommand,
    WinchCommand,
)

_NANO = 1e9
# Tolerance of the length commanded to a drum without a motor [m].
_SAME_LENGTH = 1e-3
# Tolerance of the nut's position at its setpoint [m].
_ARRIVED = 1e-4
# Rates up to which a drive stands still: payout [m/s], wheels and flywheel [rad/s].
_AT_REST = 1e-3
_WHEELS_AT_REST = 0.01
_FLYWHEEL_AT_REST = 0.5
# Nut commands sent up to this time after the latch has tripped are ignored, not refused.
_IN_TRANSIT_NS = 100_000_000
_TRIPS = JointValue(1.0)

COMMANDS = (
    topics.JUMP_MOTOR_COMMAND,
    topics.FLYWHEEL_COMMAND,
    topics.WHEEL_COMMAND,
    topics.WHEEL_TORQUE_COMMAND,
    topics.WINCH_COMMAND,
)


class DriveFeedback(NamedTuple):
    """State of the drives at the start of a tick."""

    phase: PlantPhase
    compression: float = 0.0  # position of the nut as compression of the spring [m]
    nut_free: bool = True  # clear of the latch
    spring_held: bool = False  # the latch holds the compressed spring
    length: float = 0.0  # paid out [m]
    payout_rate: float = 0.0  # [m/s]
    brake_closed: bool = True  # of the winch
    nut_rate: float = 0.0  # > 0 compresses [m/s]
    flywheel_rate: float = 0.0  # [rad/s]
    wheel_rate: float = 0.0  # of the left wheel [rad/s]


class CommandTimeout(NamedTuple):
    """A drive stopped by its watchdog."""

    message: str
    values: Mapping[str, object]


C = TypeVar("C")


class _Drive(Generic[C]):
    """One motor: its latest command until it expires, or its quick stop."""

    def __init__(self) -> None:
        self.command: C | None = None
        self.stop: QuickStop | None = None
        self._topic = ""
        self._received_ns = 0

    def set(self, topic: str, command: C, now_ns: int) -> None:
        self.command, self._topic, self._received_ns = command, topic, now_ns
        self.stop = None

    def clear(self) -> None:
        self.command = self.stop = None

    def hold(self, command: C) -> None:
        """Keep a command that does not expire."""
        self.command, self._topic = command, ""

    def expired(self, now_ns: int, tick_ns: int, *, moves: bool) -> float | None:
        """Age [s] of a command that would be too old at the end of the tick; None: it is not."""
        if self.command is None or not self._topic:
            return None
        stale = TOPICS[self._topic].stale
        limit = min(stale.timeout, stale.timeout_moving) if moves else stale.timeout
        if now_ns + tick_ns - self._received_ns <= round(limit * _NANO):
            return None
        return (now_ns - self._received_ns) / _NANO


class Actuators:
    """The drives' commands, until they expire.

    Args:
        equipment: the drives of the plant.
        tick_ns: control tick [ns].
    """

    def __init__(self, equipment: Equipment, tick_ns: int) -> None:
        self._equipment = equipment
        self._tick_ns = tick_ns
        self._tripped_ns: int | None = None
        self._jump: _Drive[JumpMotorCommand | FlywheelCommand | FlywheelRateCommand] = _Drive()
        self._wheel: _Drive[WheelRateCommand | WheelTorqueCommand] = _Drive()
        self._winch: _Drive[WinchCommand] = _Drive()
        self._winch_must_rest = False  # a quick stop has ended the last motion
        self._handlers: dict[str, Callable[[JointSample, DriveFeedback, int], None]] = {
            topics.JUMP_MOTOR_COMMAND: self._set_nut,
            topics.FLYWHEEL_COMMAND: self._set_flywheel,
            topics.WHEEL_COMMAND: self._set_wheel_rate,
            topics.WHEEL_TORQUE_COMMAND: self._set_wheel_torque,
            topics.WINCH_COMMAND: self._set_winch,
        }
        jump, wheels = (self._jump, self._stop_jump_motor), (self._wheel, self._stop_wheels)
        self._drives: dict[str, tuple[_Drive[Any], Callable[[DriveFeedback], None]]] = {
            topics.JUMP_MOTOR_COMMAND: jump,
            topics.FLYWHEEL_COMMAND: jump,
            topics.WHEEL_COMMAND: wheels,
            topics.WHEEL_TORQUE_COMMAND: wheels,
            topics.WINCH_COMMAND: (self._winch, self._stop_winch),
        }

    @property
    def trip_event(self) -> PlantEvent | None:
        """Name of the plant event when the latch trips."""
        nut = self._equipment.nut
        return None if nut is None else nut.trip_event

    @property
    def command(self) -> PlantCommand:
        """Command of the plant for the next tick."""
        return PlantCommand(self._jump.command, self._winch.command, self._wheel.command)

    def clear(self) -> None:
        """Clear all commands, at a reset of the plant."""
        for drive in (self._jump, self._wheel, self._winch):
            drive.clear()
        self._winch_must_rest = False
        self._tripped_ns = None

    def on_latch_trip(self, now_ns: int) -> None:
        """Clear the nut's command, completed by the trip of the latch."""
        self._jump.clear()
        self._tripped_ns = now_ns

    def accept_command(
        self, topic: str, sample: JointSample, states: DriveFeedback, now_ns: int
    ) -> None:
        """Accept a command.

        Args:
            topic: one of ``COMMANDS``.
            sample: of the topic, valid by the contract.
            states: of the drives.
            now_ns: simulated time of reception.

        Raises:
            Refusal: the plant lacks the drive, or its state does not permit the command.
        """
        if states.phase.final:
            raise Refusal(topic, RefusalCode.WRONG_PHASE, stopped(states.phase))
        self._handlers[topic](sample, states, now_ns)

    # --- jump motor ------------------------------------------------------------------------------

    def _set_nut(self, sample: JointSample, states: DriveFeedback, now_ns: int) -> None:
        topic, nut = topics.JUMP_MOTOR_COMMAND, self._equipment.nut
        if nut is None:
            raise self._missing(topic, "rover", "jump motor")
        if self._tripped_ns is not None and sample.stamp_ns <= self._tripped_ns + _IN_TRANSIT_NS:
            return
        if nut.needs_ground and states.phase not in (PlantPhase.HELD, PlantPhase.LANDED):
            raise Refusal(
                topic,
                RefusalCode.WRONG_PHASE,
                f"the phase is {states.phase.value}; the nut can be driven only while the rover"
                f" is on the ground ({PlantPhase.HELD.value} or {PlantPhase.LANDED.value})",
            )
        setpoint, rate, effort = sample.joints[machine.JUMP_SCREW]
        if setpoint < -nut.free_travel:
            raise Refusal(
                topic,
                RefusalCode.OUT_OF_LIMITS,
                f"{machine.JUMP_SCREW}.position is {setpoint!r} m, the nut's free travel is "
                f"{nut.free_travel:g} m: it must be at least {0.0 - nut.free_travel:g} m",
            )
        if setpoint > nut.stroke:
            raise Refusal(
                topic,
                RefusalCode.OUT_OF_LIMITS,
                f"{machine.JUMP_SCREW}.position is {setpoint!r} m: it must be at most the stroke "
                f"of {nut.stroke:g} m",
            )
        if states.spring_held and 0.0 < setpoint < states.compression - _ARRIVED:
            raise Refusal(
                topic,
                RefusalCode.OUT_OF_LIMITS,
                f"{machine.JUMP_SCREW}.position is {setpoint!r} m: it must be at least the "
                f"present compression of {states.compression:.4g} m, or 0 to unload the spring",
            )
        force = nut.spring_rate * max(setpoint, 0.0)
        if force > effort:
            raise Refusal(
                topic,
                RefusalCode.OUT_OF_LIMITS,
                f"{machine.JUMP_SCREW}.effort is {effort!r} N: it must be at least {force:.4g} N, "
                f"the spring's force at {setpoint:.4g} m, or the setpoint cannot be reached",
            )
        trips = self._trips(sample)
        if not (trips or nut.holds):
            raise Refusal(
                topic,
                RefusalCode.NOT_SUPPORTED,
                f"{machine.JUMP_LATCH}.position is 0, but this plant's latch always trips at the "
                "setpoint",
            )
        self._jump.set(topic, JumpMotorCommand(setpoint, rate, effort, trips), now_ns)

    def _trips(self, sample: JointSample) -> bool:
        latch = sample.joints.get(machine.JUMP_LATCH, _TRIPS).position
        return bool(_switch(topics.JUMP_MOTOR_COMMAND, machine.JUMP_LATCH, latch, "trip", "hold"))

    def _set_flywheel(self, sample: JointSample, states: DriveFeedback, now_ns: int) -> None:
        topic = topics.FLYWHEEL_COMMAND
        if not self._equipment.flywheel:
            raise self._missing(topic, "rover with a free screw", "reaction wheel")
        if not states.nut_free:
            raise Refusal(
                topic,
                RefusalCode.WRONG_PHASE,
                f"the nut is on the latch, at {states.compression:.4g} m; it must be driven clear "
                f"first ({topics.JUMP_MOTOR_COMMAND} below 0)",
            )
        self._jump.set(topic, FlywheelCommand(sample.joints[machine.FLYWHEEL].effort), now_ns)

    # --- wheels ----------------------------------------------------------------------------------

    def _set_wheel_rate(self, sample: JointSample, _states: DriveFeedback, now_ns: int) -> None:
        topic = topics.WHEEL_COMMAND
        if not self._equipment.wheels:
            raise self._missing(topic, "wheels", "wheel motor")
        _, rate, torque = sample.joints[machine.WHEEL_DRIVE]
        self._wheel.set(topic, WheelRateCommand(rate, torque), now_ns)

    def _set_wheel_torque(self, sample: JointSample, _states: DriveFeedback, now_ns: int) -> None:
        topic = topics.WHEEL_TORQUE_COMMAND
        if not self._equipment.wheels:
            raise self._missing(topic, "wheels", "wheel motor")
        torque = sample.joints[machine.WHEEL_DRIVE].effort
        self._wheel.set(topic, WheelTorqueCommand(torque), now_ns)

    # --- winch -----------------------------------------------------------------------------------

    def _set_winch(self, sample: JointSample, _states: DriveFeedback, now_ns: int) -> None:
        topic, fixed = topics.WINCH_COMMAND, self._equipment.fixed_length
        length, rate, tension = sample.joints[machine.WINCH_DRUM]
        brake = sample.joints[machine.WINCH_BRAKE].position
        brake = _switch(topic, machine.WINCH_BRAKE, brake, "release", "close")
        if fixed is not None:
            if rate != 0.0 or brake or abs(length - fixed) > _SAME_LENGTH:
                raise Refusal(
                    topic,
                    RefusalCode.NOT_SUPPORTED,
                    f"{machine.WINCH_DRUM} is commanded to {length!r} m at {rate!r} m/s, brake "
                    f"{'released' if brake else 'closed'}; this plant's drum has no motor: it must "
                    f"be {fixed:g} m at 0 m/s, brake closed",
                )
            return
        if brake and self._winch.stop is not None:
            raise Refusal(
                topic,
                RefusalCode.WRONG_PHASE,
                "the drive is in its quick stop; it accepts a motion when the brake is closed",
            )
        if brake and rate != 0.0 and self._winch_must_rest:
            raise Refusal(
                topic,
                RefusalCode.WRONG_PHASE,
                f"{machine.WINCH_DRUM}.velocity is {rate!r} m/s after a quick stop, it must "
                "be 0 first",
            )
        if rate == 0.0:
            self._winch_must_rest = False
        limit = sample.joints[machine.WINCH_LIMIT].effort
        command = WinchCommand(length, rate, tension, bool(brake), limit)
        self._winch.set(topic, command, now_ns)

    def _missing(self, topic: str, part: str, drive: str) -> Refusal:
        return Refusal(
            topic,
            RefusalCode.NOT_SUPPORTED,
            f"the scenario {self._equipment.scenario} has no {part} and therefore no {drive}",
        )

    # --- stopping --------------------------------------------------------------------------------

    def quick_stop(self, topic: str, states: DriveFeedback) -> None:
        """Stop a drive by its quick stop, as its watchdog does.

        Args:
            topic: of the drive, one of ``COMMANDS``.
            states: of the drives.
        """
        _, stop = self._drives[topic]
        stop(states)

    def switch_off(self, topic: str, states: DriveFeedback) -> None:
        """Switch a drive off at once: the winch's brake closes, the nut is held, rotors coast."""
        drive, stop = self._drives[topic]
        if isinstance(drive.command, JumpMotorCommand):
            stop(states)
            return
        drive.clear()
        if drive is self._winch:
            self._winch_must_rest = False

    def is_stopping(self, topic: str) -> bool:
        """Whether the drive of a topic is in its quick stop."""
        drive, _ = self._drives[topic]
        return drive.stop is not None

    def _stop_winch(self, states: DriveFeedback) -> None:
        drive, command = self._winch, self._winch.command
        if command is None or not command.brake_released:
            drive.clear()
        elif drive.stop is None:
            deceleration = self._equipment.quick_stop.winch
            drive.stop = QuickStop(states.payout_rate, deceleration, _AT_REST)
            # A limit that the command source has set for its motion does not bound the stop.
            drive.hold(replace(command, rate=states.payout_rate, max_tension=math.inf))
            self._winch_must_rest = True

    def _stop_wheels(self, states: DriveFeedback) -> None:
        drive, rate = self._wheel, states.wheel_rate
        if drive.command is not None and drive.stop is None:
            drive.stop = QuickStop(rate, self._equipment.quick_stop.wheels, _WHEELS_AT_REST)
            drive.hold(WheelRateCommand(rate))

    def _stop_jump_motor(self, states: DriveFeedback) -> None:
        drive, command = self._jump, self._jump.command
        if isinstance(command, JumpMotorCommand):
            drive.clear()
            self._hold_nut(command, states)
        elif command is not None and drive.stop is None:
            rate = states.flywheel_rate
            drive.stop = QuickStop(rate, self._equipment.quick_stop.flywheel, _FLYWHEEL_AT_REST)
            drive.hold(FlywheelRateCommand(rate))

    def _hold_nut(self, command: JumpMotorCommand, states: DriveFeedback) -> None:
        """Hold the nut where it comes to rest, at its setpoint at the latest."""
        nut = self._equipment.nut
        if nut is None or not nut.holds:
            return
        at, rate = states.compression, states.nut_rate
        distance = command.compression - at
        run_out = rate * abs(rate) / (2.0 * self._equipment.quick_stop.nut)
        if run_out * distance > 0.0:
            run_out = math.copysign(min(abs(run_out), abs(distance)), run_out)
        setpoint = min(max(at + run_out, -nut.free_travel), nut.stroke)
        self._jump.hold(replace(command, compression=setpoint, trips=False))

    # --- a tick ----------------------------------------------------------------------------------

    def step(self, states: DriveFeedback, now_ns: int) -> list[CommandTimeout]:
        """Step the watchdogs and the quick stops; returns the active drives that timed out.

        Args:
            states: of the drives.
            now_ns: start of the tick.
        """
        found = [
            *self._check_jump_motor(states, now_ns),
            *self._check_wheels(states, now_ns),
            *self._check_winch(states, now_ns),
        ]
        self._slow_winch(states)
        h = self._tick_ns / _NANO
        wheels, flywheel = self._wheel.stop, self._jump.stop
        if wheels is not None:
            is_over = wheels.step(states.wheel_rate, h)
            self._wheel.clear() if is_over else self._wheel.hold(WheelRateCommand(wheels.rate))
        if flywheel is not None:
            is_over = flywheel.step(states.flywheel_rate, h)
            self._jump.clear() if is_over else self._jump.hold(FlywheelRateCommand(flywheel.rate))
        return found

    def _slow_winch(self, states: DriveFeedback) -> None:
        drive, stop, command = self._winch, self._winch.stop, self._winch.command
        if stop is None or command is None:
            return
        if command.brake_released:
            is_over = stop.step(states.payout_rate, self._tick_ns / _NANO)
            drive.hold(replace(command, rate=stop.rate, brake_released=not is_over))
        elif states.brake_closed:
            drive.clear()

    def _check_jump_motor(self, states: DriveFeedback, now_ns: int) -> list[CommandTimeout]:
        command, at = self._jump.command, states.compression
        age = self._jump.expired(now_ns, self._tick_ns, moves=False)
        if age is None:
            return []
        self._stop_jump_motor(states)
        if isinstance(command, JumpMotorCommand) and _is_moving(command, at):
            return [_timeout("jump_motor", age, f"the nut stops at {at:.4g} m", compression=at)]
        if isinstance(command, FlywheelCommand) and command.torque != 0.0:
            what, rate = "the flywheel stops", states.flywheel_rate
            return [_timeout("flywheel", age, what, torque=command.torque, rate=rate)]
        return []

    def _check_wheels(self, states: DriveFeedback, now_ns: int) -> list[CommandTimeout]:
        command = self._wheel.command
        age = self._wheel.expired(now_ns, self._tick_ns, moves=False)
        if age is None or command is None:
            return []
        self._stop_wheels(states)
        if not _commands_motion(command):
            return []
        return [_timeout("wheel_motor", age, "the wheels stop", rate=states.wheel_rate)]

    def _check_winch(self, states: DriveFeedback, now_ns: int) -> list[CommandTimeout]:
        command, rate, length = self._winch.command, states.payout_rate, states.length
        moves = abs(rate) > _AT_REST or (command is not None and command.rate != 0.0)
        age = self._winch.expired(now_ns, self._tick_ns, moves=moves)
        if age is None or command is None:
            return []
        self._stop_winch(states)
        if not command.brake_released:
            return []
        what = f"the drum stops at {length:.4g} m, {rate:+.3g} m/s"
        return [_timeout("winch", age, what, length=length, rate=rate)]


def _switch(topic: str, joint: str, position: float, one: str, zero: str) -> float:
    """Return a position that is 1 or 0; refuse any other."""
    if position not in (0.0, 1.0):
        raise Refusal(
            topic,
            RefusalCode.OUT_OF_LIMITS,
            f"{joint}.position is {position!r}, it must be 1 ({one}) or 0 ({zero})",
        )
    return position


def _is_moving(command: JumpMotorCommand, compression: float) -> bool:
    return abs(command.compression - compression) > _ARRIVED


def _commands_motion(command: WheelRateCommand | WheelTorqueCommand) -> bool:
    setpoint = command.rate if isinstance(command, WheelRateCommand) else command.torque
    return not math.isclose(setpoint, 0.0, abs_tol=1e-12)


def _timeout(drive: str, age: float, what: str, **values: object) -> CommandTimeout:
    message = f"no command for {age:.3g} s while the drive was active: {what}"
    return CommandTimeout(message, {"drive": drive, "age": age, **values})


def stopped(phase: PlantPhase) -> str:
    """Return a message with the reason why the simulation has stopped, and the remedy."""
    reason = {
        PlantPhase.DIVERGED: "the integration diverged",
        PlantPhase.TETHER_BROKEN: "the tether is broken",
    }[phase]
    return f"{reason}; restart with {topics.SIM_RESET} or {topics.SIM_RESET_PLANT}"
