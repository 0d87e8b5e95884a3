"""Mapping between contract and objects: commands to setpoints, device values to samples.

The bridge and the emulator use opposite directions of the same mapping. Values are in the units of
`devices`; only `objects.ObjectEntry` converts counts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from msg_schemas import machine, topics
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import ImuSample, JointSample, JointValue, Sample, WrenchSample
from msg_schemas.table import TOPICS
from rover_hil.canopen.devices import (
    BODY_INPUT,
    BRAKE_RELEASED,
    IMU,
    JUMP,
    LOAD_CELL,
    POSITION_MODE,
    RELEASE_BRAKE,
    SCREW_LEAD,
    TORQUE_MODE,
    TRIP_LATCH,
    VELOCITY_MODE,
    WHEEL,
    WHEEL_LEFT_INPUT,
    WHEEL_RIGHT_INPUT,
    WINCH,
)
from rover_hil.canopen.objects import Device

Values = Mapping[str, float]
"""Values by the keys of a device's entries, in their units."""

COMMANDED: Mapping[str, Device] = {
    topics.JUMP_MOTOR_COMMAND: JUMP,
    topics.FLYWHEEL_COMMAND: JUMP,
    topics.WHEEL_COMMAND: WHEEL,
    topics.WHEEL_TORQUE_COMMAND: WHEEL,
    topics.WINCH_COMMAND: WINCH,
}
"""Drive of each command topic."""

PUBLISHED: Mapping[str, tuple[Device, ...]] = {
    topics.IMU: (IMU,),
    topics.CONTACT: (IMU,),
    topics.ROVER_LOAD_CELL: (IMU,),
    topics.LOAD_CELL: (LOAD_CELL,),
    topics.JUMP_MOTOR_STATE: (JUMP,),
    topics.FLYWHEEL_STATE: (JUMP,),
    topics.WHEEL_STATE: (WHEEL,),
    topics.WINCH_STATE: (WINCH,),
    topics.MOTOR_CURRENTS: (JUMP, WHEEL, WINCH),
}
"""Devices whose values each published topic contains."""

AT_REST: Values = {
    "mode": 0,
    "target_velocity": 0.0,
    "target_torque": 0.0,
    "max_torque": 0.0,
    "target_position": 0.0,
    "switches": 0,
}
"""The setpoint without motion."""

_ROUNDING = 1e-3  # of a limit of the contract to counts, relative
_SCREW_PITCH = SCREW_LEAD / math.tau  # of the screw [m/rad]


# ---------------------------------------------------------------------------------------- commands


def setpoint_of(topic: str, sample: JointSample) -> Values:
    """The setpoint of a command of the contract.

    Raises:
        Refusal: a switch is neither 0 nor 1, or a value is beyond the range of its object.
    """
    setpoint = {**AT_REST, **_requested(topic, sample)}
    entries = COMMANDED[topic].by_key
    for key, value in setpoint.items():
        try:
            entries[key].counts(value)
        except ValueError as error:
            raise Refusal(topic, RefusalCode.OUT_OF_LIMITS, str(error)) from None
    # A limit that rounds to 0 would mean no limit.
    setpoint["max_torque"] = max(setpoint["max_torque"], entries["max_torque"].scale)
    return setpoint


def _requested(topic: str, sample: JointSample) -> Values:
    joints = sample.joints
    if topic == topics.WINCH_COMMAND:
        length, rate, tension = joints[machine.WINCH_DRUM]
        released = _switch_value(topic, machine.WINCH_BRAKE, joints[machine.WINCH_BRAKE].position)
        return {
            "mode": VELOCITY_MODE,
            "target_velocity": rate,
            "target_torque": tension,
            "max_torque": joints[machine.WINCH_LIMIT].effort,
            "target_position": length,
            "switches": RELEASE_BRAKE if released else 0,
        }
    if topic == topics.JUMP_MOTOR_COMMAND:
        compression, speed, force = joints[machine.JUMP_SCREW]
        trips = _switch_value(
            topic, machine.JUMP_LATCH, joints.get(machine.JUMP_LATCH, JointValue(1.0)).position
        )
        return {
            "mode": POSITION_MODE,
            "target_velocity": speed,
            "max_torque": force,
            "target_position": compression,
            "switches": TRIP_LATCH if trips else 0,
        }
    if topic == topics.WHEEL_COMMAND:
        _, rate, torque = joints[machine.WHEEL_DRIVE]
        return {"mode": VELOCITY_MODE, "target_velocity": rate, "max_torque": torque}
    joint = machine.FLYWHEEL if topic == topics.FLYWHEEL_COMMAND else machine.WHEEL_DRIVE
    return {
        "mode": TORQUE_MODE,
        "target_torque": joints[joint].effort,
        "max_torque": COMMANDED[topic].by_key["max_torque"].largest,
    }


def _switch_value(topic: str, joint: str, position: float) -> bool:
    if position not in (0.0, 1.0):
        raise Refusal(
            topic,
            RefusalCode.OUT_OF_LIMITS,
            f"{joint}.position is {position!r}, it must be 1 or 0",
        )
    return position == 1.0


def requests_rest(topic: str, setpoint: Values) -> bool:
    """Whether a setpoint equals the drive's state without power: it need not be refused."""
    return (
        topic == topics.WINCH_COMMAND
        and not setpoint["switches"]
        and setpoint["target_velocity"] == 0.0
    )


def command_of(device: Device, setpoint: Values) -> tuple[str, dict[str, JointValue]] | None:
    """The command of the contract for a setpoint, which may be out of its limits.

    Returns:
        Topic and joints; None: an unsupported mode.
    """
    command = _command_of(device, setpoint)
    if command is None:
        return None
    topic, joints = command
    limited = TOPICS[topic].saturated(0, joints).joints
    return topic, {
        name: JointValue(
            *(
                limit if math.isclose(number, limit, rel_tol=_ROUNDING) else number
                for number, limit in zip(value, limited[name], strict=True)
            )
        )
        for name, value in joints.items()
    }


def _command_of(device: Device, setpoint: Values) -> tuple[str, dict[str, JointValue]] | None:
    mode = round(setpoint["mode"])
    velocity, torque = setpoint["target_velocity"], setpoint["target_torque"]
    limit, position = setpoint["max_torque"], setpoint["target_position"]
    switches = round(setpoint["switches"])
    if device is WINCH and mode == VELOCITY_MODE:
        return topics.WINCH_COMMAND, {
            machine.WINCH_DRUM: JointValue(position, velocity, torque),
            machine.WINCH_BRAKE: JointValue(float(bool(switches & RELEASE_BRAKE))),
            machine.WINCH_LIMIT: JointValue(0.0, 0.0, limit),
        }
    if device is JUMP and mode == POSITION_MODE:
        return topics.JUMP_MOTOR_COMMAND, {
            machine.JUMP_SCREW: JointValue(position, velocity, limit),
            machine.JUMP_LATCH: JointValue(float(bool(switches & TRIP_LATCH))),
        }
    if device is JUMP and mode == TORQUE_MODE:
        torque = _bounded(torque, limit * _SCREW_PITCH)
        return topics.FLYWHEEL_COMMAND, {machine.FLYWHEEL: JointValue(0.0, 0.0, torque)}
    if device is WHEEL and mode == VELOCITY_MODE:
        return topics.WHEEL_COMMAND, {machine.WHEEL_DRIVE: JointValue(0.0, velocity, limit)}
    if device is WHEEL and mode == TORQUE_MODE:
        torque = _bounded(torque, limit)
        return topics.WHEEL_TORQUE_COMMAND, {machine.WHEEL_DRIVE: JointValue(0.0, 0.0, torque)}
    return None


def _bounded(torque: float, limit: float) -> float:
    return min(max(torque, -limit), limit)


# ----------------------------------------------------------------------------------------- samples


def sample_of(topic: str, stamp_ns: int, values: Mapping[str, Values]) -> Sample:
    """A sample of a topic in `PUBLISHED`, from the values of its devices by name."""
    if topic in {topics.IMU, topics.CONTACT, topics.ROVER_LOAD_CELL}:
        return _rover_sample(topic, stamp_ns, values[IMU.name])
    if topic == topics.LOAD_CELL:
        return WrenchSample(stamp_ns, (0.0, 0.0, -values[LOAD_CELL.name]["tension"]))
    if topic == topics.MOTOR_CURRENTS:
        motors = (
            (machine.JUMP_MOTOR, JUMP),
            (machine.WHEEL_MOTOR, WHEEL),
            (machine.WINCH_MOTOR, WINCH),
        )
        return JointSample(
            stamp_ns,
            {name: JointValue(0.0, 0.0, values[device.name]["current"]) for name, device in motors},
        )
    read = values[PUBLISHED[topic][0].name]
    if topic == topics.WHEEL_STATE:
        joints = {
            machine.WHEEL_LEFT: JointValue(read["position"], read["velocity"]),
            machine.WHEEL_RIGHT: JointValue(read["right_position"], read["right_velocity"]),
        }
    elif topic == topics.WINCH_STATE:
        joints = {
            machine.WINCH_DRUM: JointValue(read["position"], read["velocity"], read["torque"]),
            machine.WINCH_BRAKE: JointValue(float(bool(round(read["inputs"]) & BRAKE_RELEASED))),
        }
    elif topic == topics.JUMP_MOTOR_STATE:
        joints = {
            machine.JUMP_SCREW: JointValue(read["position"], read["velocity"], read["torque"])
        }
    else:
        angle = JointValue(read["position"] / _SCREW_PITCH, read["velocity"] / _SCREW_PITCH)
        joints = {machine.FLYWHEEL: angle}
    # Rounding to counts may exceed the contract's limit by half a count.
    return TOPICS[topic].saturated(stamp_ns, joints)


def _rover_sample(topic: str, stamp_ns: int, read: Values) -> Sample:
    if topic == topics.IMU:
        return ImuSample(
            stamp_ns,
            (read["gyro_x"], read["gyro_y"], read["gyro_z"]),
            (read["force_x"], read["force_y"], read["force_z"]),
        )
    if topic == topics.ROVER_LOAD_CELL:
        return WrenchSample(stamp_ns, (0.0, 0.0, read["rover_tension"]))
    closed = round(read["inputs"])
    switches = {
        machine.FLOOR_SWITCH: closed != 0,
        machine.WHEEL_LEFT: bool(closed & WHEEL_LEFT_INPUT),
        machine.WHEEL_RIGHT: bool(closed & WHEEL_RIGHT_INPUT),
        machine.BODY_SWITCH: bool(closed & BODY_INPUT),
    }
    return JointSample(stamp_ns, {name: JointValue(float(on)) for name, on in switches.items()})


def values_of(samples: Mapping[str, Sample]) -> dict[str, dict[str, float]]:
    """Values of the devices from samples by topic; the inverse of `sample_of`.

    Raises:
        KeyError: a topic of `PUBLISHED` is missing.
        TypeError: a sample has the wrong type.
    """
    joints = {topic: _joints(samples[topic]) for topic in PUBLISHED if topic not in _NOT_JOINTS}
    imu, cell = samples[topics.IMU], samples[topics.LOAD_CELL]
    rover_cell = samples[topics.ROVER_LOAD_CELL]
    if not (
        isinstance(imu, ImuSample)
        and isinstance(cell, WrenchSample)
        and isinstance(rover_cell, WrenchSample)
    ):
        raise TypeError("samples of sensors should have their topics' types")
    currents, touched = joints[topics.MOTOR_CURRENTS], joints[topics.CONTACT]
    nut = joints[topics.JUMP_MOTOR_STATE][machine.JUMP_SCREW]
    wheels, winch = joints[topics.WHEEL_STATE], joints[topics.WINCH_STATE]
    left, right, drum = (
        wheels[machine.WHEEL_LEFT],
        wheels[machine.WHEEL_RIGHT],
        winch[machine.WINCH_DRUM],
    )
    bits = ((machine.WHEEL_LEFT, WHEEL_LEFT_INPUT), (machine.WHEEL_RIGHT, WHEEL_RIGHT_INPUT))
    inputs = sum(
        bit for name, bit in (*bits, (machine.BODY_SWITCH, BODY_INPUT)) if touched[name].position
    )
    return {
        JUMP.name: _of_drive(nut, currents[machine.JUMP_MOTOR]) | {"torque": nut.effort},
        WHEEL.name: _of_drive(left, currents[machine.WHEEL_MOTOR])
        | {"right_position": right.position, "right_velocity": right.velocity},
        WINCH.name: _of_drive(drum, currents[machine.WINCH_MOTOR])
        | {
            "torque": drum.effort,
            "inputs": BRAKE_RELEASED if winch[machine.WINCH_BRAKE].position else 0,
        },
        IMU.name: {
            **dict(zip(("gyro_x", "gyro_y", "gyro_z"), imu.angular_velocity, strict=True)),
            **dict(zip(("force_x", "force_y", "force_z"), imu.linear_acceleration, strict=True)),
            "inputs": inputs,
            "rover_tension": rover_cell.force[2],
        },
        LOAD_CELL.name: {"tension": -cell.force[2]},
    }


def _of_drive(joint: JointValue, current: JointValue) -> dict[str, float]:
    return {
        "position": joint.position,
        "velocity": joint.velocity,
        "current": current.effort,
        "inputs": 0,
    }


_NOT_JOINTS = (topics.IMU, topics.LOAD_CELL, topics.ROVER_LOAD_CELL)


def _joints(sample: Sample) -> Mapping[str, JointValue]:
    if not isinstance(sample, JointSample):
        raise TypeError(f"should be a JointSample, is {type(sample).__name__}")
    return sample.joints
