"""The five devices on the link, object by object: three CiA 402 drives, the IMU, the load cell.

A *command set* consists of all RPDOs of a drive with the same sequence number. It includes the
reference time: the sample time, by the drive's clock, of the newest sample that the sender had. A
drive executes only complete sets that are newer than the last one and whose reference time is not
old. So lost, repeated, late and reordered frames have no effect, and clocks need not agree.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Self

from canopen.emcy import EmcyError

from rover_hil.canopen.objects import Device, Kind, ObjectEntry, Pdo

SYNC_RATE = 200.0  # [Hz]
SYNC_PERIOD = 1.0 / SYNC_RATE  # [s]
BRIDGE_NODE = 127
"""The bridge's node identifier, for its heartbeat; it has no object dictionary."""
VENDOR = 0x0000_0000
"""Not a vendor number assigned by CiA."""
REVISION = 0x0001_0000
LOCKSTEP_ID = 0x7F0
"""In lockstep, the devices' end reports by it that it has sent all answers to a SYNC; the bridge
requests the report by an empty frame, which is also its sign of life."""
HEARTBEAT_PERIOD = 0.1  # of every device and of the bridge [s]
HEARTBEAT_TIMEOUT = 0.5  # of heartbeats [s]
ANSWER_TIMEOUT = 0.2  # of an active drive: it stops before its own watchdog would stop it [s]


def reference_count(time_ns: int) -> int:
    """Bits 10 to 25 of a device's time in microseconds, which wraps at 32."""
    return (time_ns // 1000 >> 10) & 0xFFFF


# Scales of the objects below.
SCREW_LEAD = 2.0e-3  # of the jump motor's ball screw [m]
WHEEL_COUNT = math.tau / 16384.0  # of the wheels' encoders [rad]
_NUT_COUNT = SCREW_LEAD / 4096.0  # [m]
_SHAFT_TORQUE = 5.0e-5  # 1/1000 of the jump motor's rated torque [N m]
_NUT_FORCE = _SHAFT_TORQUE * math.tau / SCREW_LEAD  # the same, along the screw [N]
_WHEEL_TORQUE = 1.0e-3  # 1/1000 of the wheel drive's rated torque, at the wheel [N m]
_TENSION = 0.1  # 1/1000 of the winch's rated torque, at the drum's innermost radius [N]
_SHAFT_RATE = 1.0e-3  # [rad/s]
_NUT_SPEED = _SHAFT_RATE * SCREW_LEAD / math.tau  # [m/s]

# Modes of operation, 6060h.
POSITION_MODE = 1
VELOCITY_MODE = 9
TORQUE_MODE = 10

# Bits of the command switches, 2010h:03.
RELEASE_BRAKE = 1  # winch
TRIP_LATCH = 1  # jump motor
NUMBER_SHIFT, NUMBERS = 1, 128  # of commands, in the bits above

# Bits of the inputs, 2013h of the winch and 6000h of the IMU.
BRAKE_RELEASED = 1
WHEEL_LEFT_INPUT, WHEEL_RIGHT_INPUT, BODY_INPUT = 1, 2, 4


class ErrorCode(IntEnum):
    """Codes of emergencies and of object 603Fh, as CiA 301 and CiA 402 define them.

    A member is declared as ``NAME = code, "meaning"``.
    """

    about: str

    def __new__(cls, code: int, about: str = "") -> Self:
        """Make a member from its code and its meaning."""
        member = int.__new__(cls, code)
        member._value_ = code
        member.about = about
        return member

    NO_ERROR = 0x0000, "error reset or no error"
    DC_LINK_UNDERVOLTAGE = 0x3220, "DC link undervoltage"
    DRIVE_OVERTEMPERATURE = 0x4310, "excess temperature of the drive"
    INCREMENTAL_SENSOR_FAULT = 0x7305, "fault of the incremental sensor 1"
    HEARTBEAT_ERROR = 0x8130, "life guard or heartbeat error: no heartbeat of the bridge"
    BUS_OFF_RECOVERED = 0x8140, "recovered from bus off"
    RPDO_TIMEOUT = 0x8250, "RPDO timeout: no complete command set in time"
    SETPOINT_REJECTED = 0xFF01, "device-specific: the drive cannot execute its setpoint"


def error_text(code: int) -> str:
    """Return an error code for people, as ``4310h (excess temperature of the drive)``."""
    try:
        about = ErrorCode(code).about
    except ValueError:
        about = EmcyError(code, 0, b"", 0.0).get_desc().lower()
    return f"{code:04X}h ({about or 'not defined by CiA 301'})"


_U8, _U16, _U32, _I8, _I16, _I32 = Kind.U8, Kind.U16, Kind.U32, Kind.I8, Kind.I16, Kind.I32

_SEQUENCE = ObjectEntry(
    "sequence", 0x2010, 1, "Sequence number", _U16, "rw",
    about="of a command set, the same in all its RPDOs; increments, wraps",
)  # fmt: skip
_REFERENCE_TIME = ObjectEntry(
    "reference_time", 0x2010, 2, "Reference time", _U16, "rw", scale=1.024e-3, unit="s",
    about="sample time of the newest sample that the sender had: bits 10 to 25 of its count",
)  # fmt: skip
_SWITCHES = ObjectEntry(
    "switches", 0x2010, 3, "Switches", _U8, "rw",
    about="bit 0: release the brake (winch), trip the latch at the target (jump); bits 1 to 7: "
    "command number, kept by repetitions",
)  # fmt: skip
_SAMPLE_TIME = ObjectEntry(
    "sample_time", 0x2011, 1, "Sample time", _U32, scale=1e-6, unit="s",
    about="time of the last SYNC, at which all values are sampled; by the device's clock, wraps",
)  # fmt: skip
_REPLY_DELAY = ObjectEntry(
    "reply_delay", 0x2011, 2, "Reply delay", _U8, scale=2e-5, unit="s",
    about="from the SYNC to the sending of this PDO, rounded down; saturates",
)  # fmt: skip
_EXECUTED_SEQUENCE = ObjectEntry(
    "executed_sequence",
    0x2011,
    3,
    "Executed sequence",
    _U16,
    about="of the last command set executed",
)
_EXECUTION_AGE = ObjectEntry(
    "execution_age", 0x2011, 4, "Time since execution", _U16, scale=1e-5, unit="s",
    about="from the execution of the last set to the sample; saturates",
)  # fmt: skip
_REJECTED_SETS = ObjectEntry(
    "rejected_sets",
    0x2011,
    5,
    "Rejected sets",
    _U8,
    about="stale or older than executed ones; wraps",
)
_SYNC_COUNTER = ObjectEntry(
    "sync_counter", 0x2011, 6, "SYNC counter", _U8, about="counter of the answered SYNC"
)

_CONTROL = ObjectEntry("controlword", 0x6040, 0, "Controlword", _U16, "rw")
_STATUS = ObjectEntry("statusword", 0x6041, 0, "Statusword", _U16)
_MODE = ObjectEntry("mode", 0x6060, 0, "Modes of operation", _I8, "rw")
_MODE_SHOWN = ObjectEntry("mode_shown", 0x6061, 0, "Modes of operation display", _I8)
_ERROR_CODE = ObjectEntry("error_code", 0x603F, 0, "Error code", _U16)
_QUICK_STOP = ObjectEntry(
    "quick_stop", 0x605A, 0, "Quick stop option code", _I16, "rw", 2,
    about="2: slow down, then switch on disabled; other values are not supported",
)  # fmt: skip
_INPUTS = ObjectEntry("inputs", 0x2013, 0, "Inputs", _U8, about="bit 0: brake released (winch)")
_CURRENT = ObjectEntry("current", 0x6078, 0, "Current actual value", _I16, scale=1e-3, unit="A")


def _target_velocity(index: int, name: str, kind: Kind, scale: float, unit: str) -> ObjectEntry:
    return ObjectEntry("target_velocity", index, 0, name, kind, "rw", scale=scale, unit=unit)


def _target_torque(index: int, name: str, scale: float, unit: str) -> ObjectEntry:
    return ObjectEntry("target_torque", index, 0, name, _I16, "rw", scale=scale, unit=unit)


def _quick_stop_deceleration(deceleration: float, scale: float, unit: str) -> ObjectEntry:
    return ObjectEntry(
        "quick_stop_deceleration", 0x6085, 0, "Quick stop deceleration", _U32, "rw",
        round(deceleration / scale), scale, f"{unit}^2",
        "when the commands or the bridge time out",
    )  # fmt: skip


def _modes(*modes: int) -> ObjectEntry:
    bits = sum(1 << (mode - 1) for mode in modes)
    return ObjectEntry("modes", 0x6502, 0, "Supported drive modes", _U32, "const", bits)


def _clock_pdo(number: int, last: ObjectEntry) -> Pdo:
    return Pdo(number, True, (_SAMPLE_TIME, _REPLY_DELAY, _SYNC_COUNTER, last))


def _drive(  # noqa: PLR0913 - the columns of a table of drives
    name: str,
    node_id: int,
    product: str,
    *,
    on_rover: bool,
    modes: tuple[int, ...],
    position: tuple[float, str, str],
    velocity: tuple[float, str],
    deceleration: float,
    force: tuple[float, str],
    rated_torque: int,
    target_velocity: ObjectEntry,
    target_torque: ObjectEntry,
    second: tuple[ObjectEntry, ...] = (),
) -> Device:
    """A drive: all three have the same objects and PDOs, in different units.

    Args:
        name: see `Device`.
        node_id: see `Device`.
        product: see `Device`.
        on_rover: see `Device.is_on_rover`.
        modes: supported modes of operation.
        position: size of a count, unit, and meaning.
        velocity: size of a count, and unit.
        deceleration: of the quick stop, in that unit per second.
        force: size of a count, and unit, of the actual torque and of its limit.
        rated_torque: object 6076h [mN m].
        target_velocity: object that commands the velocity.
        target_torque: object that commands the torque.
        second: angle and rate of a second encoder; empty: none.
    """
    p_scale, p_unit, p_about = position
    v_scale, v_unit = velocity
    f_scale, f_unit = force
    max_torque = ObjectEntry(
        "max_torque", 0x6072, 0, "Max torque", _U16, "rw", scale=f_scale, unit=f_unit
    )
    target_position = ObjectEntry(
        "target_position", 0x607A, 0, "Target position", _I32, "rw", scale=p_scale, unit=p_unit,
        about=p_about,
    )  # fmt: skip
    position_actual = ObjectEntry(
        "position", 0x6064, 0, "Position actual value", _I32, scale=p_scale, unit=p_unit,
        about=p_about,
    )  # fmt: skip
    velocity_kind = _I16 if second else _I32
    velocity_actual = ObjectEntry(
        "velocity", 0x606C, 0, "Velocity actual value", velocity_kind, scale=v_scale, unit=v_unit
    )
    torque_actual = ObjectEntry(
        "torque", 0x6077, 0, "Torque actual value", _I16, scale=f_scale, unit=f_unit
    )
    rated = ObjectEntry(
        "rated_torque", 0x6076, 0, "Motor rated torque", _U32, "const", rated_torque, 1e-3, "N m"
    )
    pdos = (
        # A command set.
        Pdo(1, False, (_CONTROL, target_velocity, _SEQUENCE)),
        Pdo(2, False, (target_torque, max_torque, _SWITCHES, _MODE, _SEQUENCE)),
        Pdo(3, False, (target_position, _REFERENCE_TIME, _SEQUENCE)),
        # Answers to SYNC.
        Pdo(1, True, (_STATUS, position_actual, _INPUTS, _SYNC_COUNTER)),
        Pdo(2, True, (velocity_actual, *second[1:], _CURRENT, _MODE_SHOWN, _SYNC_COUNTER)),
        _clock_pdo(3, _EXECUTED_SEQUENCE),
        Pdo(
            4, True,
            (second[0] if second else torque_actual, _EXECUTION_AGE, _REJECTED_SETS, _SYNC_COUNTER),
        ),
    )  # fmt: skip
    entries = (
        _SEQUENCE, _REFERENCE_TIME, _SWITCHES, _SAMPLE_TIME, _REPLY_DELAY, _EXECUTED_SEQUENCE,
        _EXECUTION_AGE, _REJECTED_SETS, _SYNC_COUNTER,
        *second, _INPUTS, _ERROR_CODE, _CONTROL, _STATUS, _QUICK_STOP,
        _quick_stop_deceleration(deceleration, v_scale, v_unit), _MODE, _MODE_SHOWN,
        position_actual, velocity_actual, target_torque, max_torque, rated, torque_actual,
        _CURRENT, target_position, target_velocity, _modes(*modes),
    )  # fmt: skip
    return Device(name, node_id, product, node_id, 0x0002_0192, entries, pdos, True, on_rover)


JUMP = _drive(
    "jump", 1, "Jump motor drive: ball screw and flywheel", on_rover=True,
    modes=(POSITION_MODE, TORQUE_MODE),
    position=(_NUT_COUNT, "m", "compression by the nut; 4096 counts per turn of the shaft"),
    velocity=(_NUT_SPEED, "m/s"), deceleration=75.0 * SCREW_LEAD / math.tau,
    force=(_NUT_FORCE, "N"), rated_torque=50,
    target_velocity=_target_velocity(0x6081, "Profile velocity", _U32, _NUT_SPEED, "m/s"),
    target_torque=_target_torque(0x6071, "Target torque", _SHAFT_TORQUE, "N m"),
)  # fmt: skip

WHEEL = _drive(
    "wheel", 2, "Wheel motor drive: one motor, two wheels", on_rover=True,
    modes=(VELOCITY_MODE, TORQUE_MODE),
    position=(WHEEL_COUNT, "rad", "of the left wheel"), velocity=(1e-3, "rad/s"),
    deceleration=3.0, force=(_WHEEL_TORQUE, "N m"), rated_torque=1000,
    target_velocity=_target_velocity(0x60FF, "Target velocity", _I32, 1e-3, "rad/s"),
    target_torque=_target_torque(0x6071, "Target torque", _WHEEL_TORQUE, "N m"),
    second=(
        ObjectEntry(
            "right_position", 0x2012, 1, "Second position", _I32, scale=WHEEL_COUNT, unit="rad",
            about="of the right wheel",
        ),
        ObjectEntry(
            "right_velocity", 0x2012, 2, "Second velocity", _I16, scale=1e-3, unit="rad/s",
            about="of the right wheel",
        ),
    ),
)  # fmt: skip

WINCH = _drive(
    "winch", 3, "Winch drive: drum and holding brake", on_rover=False, modes=(VELOCITY_MODE,),
    position=(1e-6, "m", "length paid out; as a target for information only"),
    velocity=(1e-6, "m/s"), deceleration=0.4, force=(_TENSION, "N"), rated_torque=5000,
    target_velocity=_target_velocity(0x60FF, "Target velocity", _I32, 1e-6, "m/s"),
    target_torque=_target_torque(0x60B2, "Torque offset", _TENSION, "N"),
)  # fmt: skip


def _axes(key: str, index: int, name: str, scale: float, unit: str) -> tuple[ObjectEntry, ...]:
    return tuple(
        ObjectEntry(f"{key}_{axis}", index, sub, f"{name} {axis}", _I16, scale=scale, unit=unit)
        for sub, axis in enumerate("xyz", start=1)
    )


_GYRO = _axes("gyro", 0x7133, "Angular rate", 3.0e-4, "rad/s")
_FORCE = _axes("force", 0x7131, "Specific force", 2.5e-3, "m/s^2")
_SWITCH_INPUTS = ObjectEntry(
    "inputs", 0x6000, 1, "Contact switches", _U8,
    about="bit 0: left wheel, 1: right wheel, 2: body",
)  # fmt: skip
_ROVER_TENSION = ObjectEntry(
    "rover_tension", 0x7132, 1, "Tension at the rover", _I16, scale=0.02, unit="N",
    about="of the rover's load cell, an analogue input of this device",
)  # fmt: skip
IMU = Device(
    "imu", 4, "Rover sensors: IMU, contact switches, load cell", 4, 0x0005_0191,
    (_SAMPLE_TIME, _REPLY_DELAY, _SYNC_COUNTER, _SWITCH_INPUTS, *_GYRO, *_FORCE, _ROVER_TENSION),
    (
        Pdo(1, True, (*_GYRO, _SWITCH_INPUTS, _SYNC_COUNTER)),
        Pdo(2, True, (*_FORCE, _SYNC_COUNTER)),
        _clock_pdo(3, _ROVER_TENSION),
    ),
    is_drive=False, is_on_rover=True,
)  # fmt: skip

_TENSION_ENTRY = ObjectEntry(
    "tension", 0x7130, 1, "Tension at the fairlead", _I16, scale=0.02, unit="N"
)  # fmt: skip
LOAD_CELL = Device(
    "load_cell", 5, "Load cell at the fairlead", 5, 0x0002_0194,
    (_SAMPLE_TIME, _REPLY_DELAY, _SYNC_COUNTER, _TENSION_ENTRY),
    (_clock_pdo(1, _TENSION_ENTRY),),
    is_drive=False, is_on_rover=False,
)  # fmt: skip

DEVICES = (JUMP, WHEEL, WINCH, IMU, LOAD_CELL)
DRIVES = tuple(device for device in DEVICES if device.is_drive)
BY_NAME = {device.name: device for device in DEVICES}
