"""States of the spatial plant's drives as numbers of its state vector, and their commands."""

from typing import NamedTuple

from rover_sim.physics.mechanisms.drum import DrumCommand, DrumState
from rover_sim.physics.mechanisms.jump_drive import JumpCommand, JumpState
from rover_sim.physics.mechanisms.wheel_drive import WheelCommand, WheelState
from rover_sim.physics.numerics.compiled import inner
from rover_sim.physics.tether.ancf import Array

LATCH = 0
"""Entry of the latch's state."""
RELEASED_FOR = JumpState._fields.index("released_for")
"""Entry of the time since the latch tripped last."""
DRUM_ANGLE = len(JumpState._fields)
"""Entry of the drum's angle."""
DRIVES_SIZE = len(JumpState._fields) + len(DrumState._fields) + len(WheelState._fields)


class DriveStates(NamedTuple):
    """States of the drives."""

    jump: JumpState
    drum: DrumState
    wheels: WheelState


class DriveCommands(NamedTuple):
    """Commands to the drives, constant during a call."""

    jump: JumpCommand
    drum: DrumCommand
    wheels: WheelCommand


@inner
def read_drives(values: Array) -> DriveStates:
    """States of the drives from their numbers, (DRIVES_SIZE,)."""
    v = values
    return DriveStates(
        JumpState(int(v[0]), v[1], v[2], v[3], v[4], v[5], v[6]),
        DrumState(v[7], v[8], v[9], v[10] != 0.0, v[11], v[12]),
        WheelState(v[13], v[14], v[15], v[16], v[17], v[18]),
    )


@inner
def write_drives(drives: DriveStates, values: Array) -> None:
    """Write the drives' states as numbers, (DRIVES_SIZE,)."""
    jump, drum, wheels = drives.jump, drives.drum, drives.wheels
    values[0] = jump.latch
    values[1], values[2], values[3] = jump.nut, jump.rate, jump.body_rate
    values[4], values[5], values[6] = jump.integral, jump.released_for, jump.trip_force
    values[7], values[8], values[9] = drum.angle, drum.length, drum.rate
    values[10] = 1.0 if drum.braked else 0.0
    values[11], values[12] = drum.brake_clock, drum.integral
    values[13], values[14] = wheels.left_angle, wheels.right_angle
    values[15], values[16] = wheels.left, wheels.right
    values[17], values[18] = wheels.body_rate, wheels.integral
