"""The drives' side of the plant: commands judged against it, and stopped when they cease.

The contract has already refused what is no number, out of limits or out of date. Here is refused
what only the drives can judge, such as a reaction wheel's torque while the nut is hooked. Each
drive has a watchdog of its own, with the contract's times: it needs nobody to be told that the
commands have ceased. Time is simulated time; a tick is begun stopped if it would end too late.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Generic, NamedTuple, TypeVar

from msg_schemas import topics
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, JointValue
from msg_schemas.table import (
    FLYWHEEL,
    JUMP_LATCH,
    JUMP_SCREW,
    TOPICS,
    WHEEL_DRIVE,
    WINCH_BRAKE,
    WINCH_DRUM,
    WINCH_LIMIT,
)
from rover_sim.plant import (
    Command,
    FlywheelCommand,
    JumpMotorCommand,
    Phase,
    WheelRateCommand,
    WheelTorqueCommand,
    WinchCommand,
)

_NANO = 1e9
# A drum without a motor is told to hold the length that it has; so near counts as that.
_SAME_LENGTH = 1e-3
# A nut so near to where it was sent has arrived [m].
_ARRIVED = 1e-4
# A drum that pays out no faster counts as standing [m/s].
_STANDING = 1e-3
# A command that was on its way when the latch tripped is no mistake of its sender's.
_ON_THE_WAY_NS = 100_000_000
_TRIPS = JointValue(1.0)

COMMANDS = (
    topics.JUMP_MOTOR_COMMAND,
    topics.FLYWHEEL_COMMAND,
    topics.WHEEL_COMMAND,
    topics.WHEEL_TORQUE_COMMAND,
    topics.WINCH_COMMAND,
)


@dataclass(frozen=True)
class Nut:
    """The nut of the jump motor's screw."""

    spring_rate: float  # that it works against [N/m]
    stroke: float = math.inf  # how far it can compress [m]
    free_travel: float = 0.0  # above the latch [m]
    holds: bool = False  # whether its drive can hold it against the spring, and must
    needs_ground: bool = False  # whether it only works while the ground holds the rover
    trip_event: str = "take_off"  # of the plant, when the latch trips


@dataclass(frozen=True)
class Equipment:
    """Which drives a plant has."""

    scenario: str  # its name
    nut: Nut | None = None
    flywheel: bool = False
    wheels: bool = False
    fixed_length: float | None = None  # of a drum without a motor [m]; None: it has one


class DriveFeedback(NamedTuple):
    """What the drives feel at the start of a tick."""

    phase: Phase
    compression: float = 0.0  # where the nut stands, counted as compression [m]
    nut_free: bool = True  # clear of the latch
    spring_held: bool = False  # the latch holds the spring compressed so far
    length: float = 0.0  # paid out [m]
    payout_rate: float = 0.0  # [m/s]


class CommandTimeout(NamedTuple):
    """A drive that was stopped because its commands have ceased."""

    name: str  # of the event
    message: str
    values: Mapping[str, object]


C = TypeVar("C")


class _LatestCommand(Generic[C]):
    """The last command of one motor, while it holds."""

    def __init__(self) -> None:
        self.command: C | None = None
        self._topic = ""
        self._received_ns = 0

    def take(self, topic: str, command: C, now_ns: int) -> None:
        self.command, self._topic, self._received_ns = command, topic, now_ns

    def drop(self) -> None:
        self.command = None

    def hold(self, command: C) -> None:
        """Go on with a command that needs no renewal."""
        self.command, self._topic = command, ""

    def silence(self, now_ns: int, tick_ns: int, *, moves: bool) -> float | None:
        """Drop a command that would be too old at the tick's end; returns its age [s]."""
        if self.command is None or not self._topic:
            return None
        stale = TOPICS[self._topic].stale
        limit = min(stale.timeout, stale.timeout_moving) if moves else stale.timeout
        if now_ns + tick_ns - self._received_ns <= round(limit * _NANO):
            return None
        self.drop()
        return (now_ns - self._received_ns) / _NANO


class Actuators:
    """What the drives were last told, while it holds.

    Args:
        equipment: the drives that there are.
        tick_ns: control tick [ns].
    """

    def __init__(self, equipment: Equipment, tick_ns: int) -> None:
        self._equipment = equipment
        self._tick_ns = tick_ns
        self._tripped_ns: int | None = None
        self._jump: _LatestCommand[JumpMotorCommand | FlywheelCommand] = _LatestCommand()
        self._wheel: _LatestCommand[WheelRateCommand | WheelTorqueCommand] = _LatestCommand()
        self._winch: _LatestCommand[WinchCommand] = _LatestCommand()
        self._takers: dict[str, Callable[[JointSample, DriveFeedback, int], None]] = {
            topics.JUMP_MOTOR_COMMAND: self._take_nut,
            topics.FLYWHEEL_COMMAND: self._take_flywheel,
            topics.WHEEL_COMMAND: self._take_wheel_rate,
            topics.WHEEL_TORQUE_COMMAND: self._take_wheel_torque,
            topics.WINCH_COMMAND: self._take_winch,
        }

    @property
    def trip_event(self) -> str | None:
        """Name of the plant's event when the latch trips."""
        nut = self._equipment.nut
        return None if nut is None else nut.trip_event

    @property
    def command(self) -> Command:
        """What the plant is to do in the next tick."""
        return Command(self._jump.command, self._winch.command, self._wheel.command)

    def clear(self) -> None:
        """Forget everything: the plant starts again."""
        for drive in (self._jump, self._wheel, self._winch):
            drive.drop()
        self._tripped_ns = None

    def on_latch_trip(self, now_ns: int) -> None:
        """The latch has tripped: what was commanded is done."""
        self._jump.drop()
        self._tripped_ns = now_ns

    def accept_command(
        self, topic: str, sample: JointSample, states: DriveFeedback, now_ns: int
    ) -> None:
        """Take a command.

        Args:
            topic: one of ``COMMANDS``.
            sample: an accepted sample of it.
            states: what the drives feel now.
            now_ns: simulated time of arrival.

        Raises:
            Refusal: the drive cannot do it now, or is not there.
        """
        if states.phase.final:
            raise Refusal(topic, RefusalCode.WRONG_PHASE, stopped(states.phase))
        self._takers[topic](sample, states, now_ns)

    # --- jump motor ------------------------------------------------------------------------------

    def _take_nut(self, sample: JointSample, states: DriveFeedback, now_ns: int) -> None:
        topic, nut = topics.JUMP_MOTOR_COMMAND, self._equipment.nut
        if nut is None:
            raise self._missing(topic, "rover", "jump motor")
        if self._tripped_ns is not None and sample.stamp_ns <= self._tripped_ns + _ON_THE_WAY_NS:
            return
        if nut.needs_ground and states.phase not in (Phase.HELD, Phase.LANDED):
            raise Refusal(
                topic,
                RefusalCode.WRONG_PHASE,
                f"the nut cannot be driven in phase {states.phase.value}, the rover must stand",
            )
        setpoint, rate, effort = sample.joints[JUMP_SCREW]
        if setpoint < -nut.free_travel:
            raise Refusal(
                topic,
                RefusalCode.OUT_OF_LIMITS,
                f"{JUMP_SCREW}.position is {setpoint!r} m, the nut's free travel is "
                f"{nut.free_travel:g} m: it must be at least {0.0 - nut.free_travel:g} m",
            )
        if setpoint > nut.stroke:
            raise Refusal(
                topic,
                RefusalCode.OUT_OF_LIMITS,
                f"{JUMP_SCREW}.position is {setpoint!r} m, the stroke is {nut.stroke:g} m: it must "
                "be at most that",
            )
        if states.spring_held and 0.0 < setpoint < states.compression - _ARRIVED:
            raise Refusal(
                topic,
                RefusalCode.OUT_OF_LIMITS,
                f"{JUMP_SCREW}.position is {setpoint!r} m, the spring is compressed by "
                f"{states.compression:.4g} m already: it must be at least that, or 0 to let it "
                "down",
            )
        force = nut.spring_rate * max(setpoint, 0.0)
        if force > effort:
            raise Refusal(
                topic,
                RefusalCode.OUT_OF_LIMITS,
                f"{JUMP_SCREW}.effort is {effort!r} N, holding the spring at {setpoint:.4g} m "
                f"takes {force:.4g} N: the setpoint cannot be reached",
            )
        trips = self._trips(sample)
        if not (trips or nut.holds):
            raise Refusal(
                topic,
                RefusalCode.NOT_SUPPORTED,
                f"{JUMP_LATCH}.position is 0; this plant's latch always trips at the setpoint",
            )
        self._jump.take(topic, JumpMotorCommand(setpoint, rate, effort, trips), now_ns)

    def _trips(self, sample: JointSample) -> bool:
        latch = sample.joints.get(JUMP_LATCH, _TRIPS).position
        return bool(_switch(topics.JUMP_MOTOR_COMMAND, JUMP_LATCH, latch, "trip", "hold"))

    def _take_flywheel(self, sample: JointSample, states: DriveFeedback, now_ns: int) -> None:
        topic = topics.FLYWHEEL_COMMAND
        if not self._equipment.flywheel:
            raise self._missing(topic, "rover with a free screw", "reaction wheel")
        if not states.nut_free:
            raise Refusal(
                topic,
                RefusalCode.WRONG_PHASE,
                f"the nut stands at {states.compression:.4g} m and works on the latch; it must be "
                f"driven clear first ({topics.JUMP_MOTOR_COMMAND} below 0)",
            )
        self._jump.take(topic, FlywheelCommand(sample.joints[FLYWHEEL].effort), now_ns)

    # --- wheels ----------------------------------------------------------------------------------

    def _take_wheel_rate(self, sample: JointSample, _states: DriveFeedback, now_ns: int) -> None:
        topic = topics.WHEEL_COMMAND
        if not self._equipment.wheels:
            raise self._missing(topic, "wheels", "wheel motor")
        _, rate, torque = sample.joints[WHEEL_DRIVE]
        self._wheel.take(topic, WheelRateCommand(rate, torque), now_ns)

    def _take_wheel_torque(self, sample: JointSample, _states: DriveFeedback, now_ns: int) -> None:
        topic = topics.WHEEL_TORQUE_COMMAND
        if not self._equipment.wheels:
            raise self._missing(topic, "wheels", "wheel motor")
        torque = sample.joints[WHEEL_DRIVE].effort
        self._wheel.take(topic, WheelTorqueCommand(torque), now_ns)

    # --- winch -----------------------------------------------------------------------------------

    def _take_winch(self, sample: JointSample, _states: DriveFeedback, now_ns: int) -> None:
        topic, held = topics.WINCH_COMMAND, self._equipment.fixed_length
        length, rate, tension = sample.joints[WINCH_DRUM]
        brake = sample.joints[WINCH_BRAKE].position
        brake = _switch(topic, WINCH_BRAKE, brake, "release", "close")
        if held is not None:
            if rate != 0.0 or brake or abs(length - held) > _SAME_LENGTH:
                raise Refusal(
                    topic,
                    RefusalCode.NOT_SUPPORTED,
                    f"{WINCH_DRUM} is told {length!r} m at {rate!r} m/s, brake "
                    f"{'released' if brake else 'closed'}; this plant's drum has no motor and "
                    f"only holds: {held:g} m at 0 m/s, brake closed",
                )
            return
        limit = sample.joints[WINCH_LIMIT].effort
        command = WinchCommand(length, rate, tension, bool(brake), limit)
        self._winch.take(topic, command, now_ns)

    def _missing(self, topic: str, part: str, drive: str) -> Refusal:
        return Refusal(
            topic,
            RefusalCode.NOT_SUPPORTED,
            f"the scenario {self._equipment.scenario} has no {part}, so it has no {drive}",
        )

    # --- stopping --------------------------------------------------------------------------------

    def stop_drive(self, topic: str, states: DriveFeedback) -> None:
        """Stop a drive at once, as its watchdog would: its controller tells it to do nothing.

        Args:
            topic: one of ``COMMANDS``, of the drive.
            states: what the drives feel now.
        """
        if topic == topics.WINCH_COMMAND:
            self._winch.drop()
        elif topic in {topics.WHEEL_COMMAND, topics.WHEEL_TORQUE_COMMAND}:
            self._wheel.drop()
        else:
            jump = self._jump.command
            self._jump.drop()
            if isinstance(jump, JumpMotorCommand):
                self._hold_nut(jump, states.compression)

    def _hold_nut(self, jump: JumpMotorCommand, at: float) -> None:
        nut = self._equipment.nut
        if nut is not None and nut.holds:
            within = min(max(at, -nut.free_travel), nut.stroke)
            self._jump.hold(replace(jump, compression=within, trips=False))

    # --- watchdogs -------------------------------------------------------------------------------

    def expire_commands(self, states: DriveFeedback, now_ns: int) -> list[CommandTimeout]:
        """Stop the drives whose commands have ceased; returns those that were at work.

        Args:
            states: what the drives feel now.
            now_ns: start of the tick.
        """
        found = []
        jump, wheel, winch = self._jump.command, self._wheel.command, self._winch.command
        age = self._jump.silence(now_ns, self._tick_ns, moves=False)
        if age is not None and isinstance(jump, FlywheelCommand) and jump.torque != 0.0:
            found.append(_timeout("flywheel", age, "the motor is off", torque=jump.torque))
        if age is not None and isinstance(jump, JumpMotorCommand):
            at = states.compression
            if _on_its_way(jump, at):
                what = f"the nut stops at {at:.4g} m"
                found.append(_timeout("jump_motor", age, what, compression=at))
            self._hold_nut(jump, at)
        age = self._wheel.silence(now_ns, self._tick_ns, moves=False)
        if age is not None and wheel is not None and _asks_for_motion(wheel):
            found.append(_timeout("wheel_motor", age, "the motor is off"))
        moves = abs(states.payout_rate) > _STANDING or (winch is not None and winch.rate != 0.0)
        age = self._winch.silence(now_ns, self._tick_ns, moves=moves)
        if age is not None and winch is not None and winch.brake_released:
            rate = states.payout_rate
            found.append(
                _timeout(
                    "winch",
                    age,
                    f"the brake closes at {states.length:.4g} m, {rate:+.3g} m/s",
                    length=states.length,
                    rate=rate,
                )
            )
        return found


def _switch(topic: str, joint: str, position: float, one: str, zero: str) -> float:
    """A position that is 1 or 0; refuses anything between."""
    if position not in (0.0, 1.0):
        raise Refusal(
            topic,
            RefusalCode.OUT_OF_LIMITS,
            f"{joint}.position is {position!r}, it must be 1 ({one}) or 0 ({zero})",
        )
    return position


def _on_its_way(command: JumpMotorCommand, compression: float) -> bool:
    return abs(command.compression - compression) > _ARRIVED


def _asks_for_motion(command: WheelRateCommand | WheelTorqueCommand) -> bool:
    wanted = command.rate if isinstance(command, WheelRateCommand) else command.torque
    return not math.isclose(wanted, 0.0, abs_tol=1e-12)


def _timeout(drive: str, age: float, what: str, **values: object) -> CommandTimeout:
    message = f"no command for {age:.3g} s while the drive worked: {what}"
    return CommandTimeout(f"{drive}_silent", message, {"silence": age, **values})


def stopped(phase: Phase) -> str:
    """Say why nothing moves any more and what would help."""
    why = {
        Phase.DIVERGED: "the integration has diverged",
        Phase.TETHER_BROKEN: "the tether is broken",
    }[phase]
    return f"{why}, nothing moves; {topics.SIM_RESET} or {topics.SIM_RESET_PLANT} starts again"
