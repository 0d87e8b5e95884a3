"""Use of the wheels: to drive, to balance the rover in a jump, or by another controller. Pure."""

from __future__ import annotations

from msg_schemas import topics
from msg_schemas.phases import DescentPhase, DrivePhase, JumpPhase
from rover_control.coordination.motor_handover import MotorHandover
from rover_control.drive.drive_follower import DriveFollower

_NANO = 1e9
_JUMPING = frozenset(phase for phase in JumpPhase if phase.uses_motor)
_HELD = _JUMPING - {JumpPhase.LETTING_DOWN}  # phases in which the rover stands or flies


class WheelUse:
    """What the wheels are used for at present.

    Args:
        follower: of the goals, which drives.

    Attributes:
        jump: phase of the jump; empty = unknown.
        motors: handover of the wheels between the controllers.
    """

    def __init__(self, follower: DriveFollower) -> None:
        self.follower = follower
        self.jump = ""
        self.motors = MotorHandover()
        self._descent = ""

    def on_descent(self, phase: str, now_ns: int) -> None:
        """Process the descent phase: the descent uses the same wheels and winch."""
        self._descent = phase
        self.motors.on_phase(topics.DESCENT_PHASE, phase, now_ns / _NANO)

    @property
    def phase(self) -> DrivePhase:
        """Present phase of the drive."""
        return DrivePhase.BALANCING if self.is_balancing else self.follower.phase

    @property
    def is_driving(self) -> bool:
        """Whether the rover is driving."""
        return not self.follower.phase.is_over

    @property
    def is_commanded(self) -> bool:
        """Whether the wheels are commanded: after a stop, until they are at rest."""
        return self.is_driving or self.follower.rate != 0.0

    @property
    def is_balancing(self) -> bool:
        """Whether the wheels are held during a jump, and balance the rover in its flight."""
        is_free = not self.motors.is_used_by(topics.DESCENT_PHASE)
        return self.jump in _HELD and is_free and not self.is_commanded

    @property
    def is_jumping(self) -> bool:
        """Whether a jump is in progress."""
        return self.jump in _JUMPING

    def conflict(self) -> str:
        """Which other controller uses the actuators; empty = none."""
        if self.is_jumping:
            return f"the rover is jumping ({self.jump})"
        if self._descent not in ("", DescentPhase.RELEASED):
            return (
                f"the descent controller holds wheels and winch (phase {self._descent}); call "
                f"{topics.DESCENT_RELEASE} first"
            )
        return ""
