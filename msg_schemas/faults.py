"""Faults and the reasons for which a motion, a phase or a control authority ends."""

from __future__ import annotations

from msg_schemas.described import Described


class WinchFault(Described):
    """Why the winch has braked and stays braked until it is armed again."""

    COMMAND_TIMEOUT = "command_timeout", "a rate or tension request was not renewed in time"
    DRUM_LOST = (
        "drum_lost",
        "the drum's encoder is silent, or its length and rate contradict each other",
    )
    TENSION_LOST = "tension_lost", "no valid tension while the drum moves"
    OVERSPEED = "overspeed", "the drum is faster than its limit"
    OVER_TENSION = "over_tension", "the tension exceeds its limit"
    TETHER_END = "tether_end", "the drum has passed an end of the tether"
    NOT_FOLLOWING = "not_following", "the drum does not follow its setpoint"
    BRAKE_STUCK = "brake_stuck", "the brake does not open"
    OVERHEATED = "overheated", "the motor cannot hold the load without overheating"
    BAD_READING = "bad_reading", "a sensor's message was refused as invalid"
    CLOCK_JUMP = "clock_jump", "the clock jumped"
    NODE_LATE = "node_late", "the controller was late while the drum moved"

    @property
    def stops_before_braking(self) -> bool:
        """Whether the drum is sound, so that it may slow down before the brake closes."""
        return self in (
            WinchFault.COMMAND_TIMEOUT,
            WinchFault.NODE_LATE,
            WinchFault.TENSION_LOST,
        )


class JumpFault(Described):
    """Why the jump sequence is in `fault`."""

    SPRING_NOT_LET_DOWN = "spring_not_let_down", "the nut did not relax the spring in time"
    LATCH_NOT_HOOKED = "latch_not_hooked", "the nut did not reach the latch in time"
    NO_LANDING = "no_landing", "no ground contact in time"
    NOT_AT_REST = "not_at_rest", "the rover did not come to rest in time after the landing"
    TOPPLED = "toppled", "the rover has toppled"


class DriveFault(Described):
    """Why the drive controller is in `failed`."""

    UNREACHABLE = "unreachable", "the goal was not reached in the permitted number of motions"
    INPUT_LOST = "input_lost", "a sensor or the winch is missing, or the rover is off the floor"


class StuckCause(Described):
    """What shows that the rover does not follow its wheels; an event names it as `cause`."""

    MOTOR_BLOCKED = "motor_blocked", "the wheel turns slower than commanded"
    DIGGING_IN = "digging_in", "the wheel torque stays above its limit"
    TOO_STEEP = "too_steep", "the ground is steeper than allowed"
    NO_TURN = "no_turn", "the gyro shows less rotation than the wheel's turn implies"
    NO_START = "no_start", "the accelerometer shows less speed than the wheels"
    NO_TRAVEL = "no_travel", "the taut tether shows less travel than the wheels"
    TOO_SLOW = "too_slow", "the motion took longer than its limit"


class JumpFailure(Described):
    """Why a spring is let down without a jump; an event names it as `cause`."""

    NOT_HOOKED = "not_hooked", "the latch has not hooked Body 2"
    NOT_COMPRESSED = "not_compressed", "the nut did not compress the spring in time"
    NOT_QUIET = "not_quiet", "the rover did not come to rest in time"
    TILTED = "tilted", "the tilt exceeds its limit"
    TAUT = "taut", "the tension of the tether exceeds its limit"
    LIFTED = "lifted", "the rover lost the ground with the spring held"
    NOT_TRIPPED = "not_tripped", "the latch did not trip in time"
    SENSOR_TIMEOUT = "sensor_timeout", "required samples are missing"


class DriveFaultCause(Described):
    """Cause of a fault of a drive on the link; an injected impairment names it as `cause`."""

    UNDERVOLTAGE = "undervoltage", "the supply voltage is too low"
    OVERTEMPERATURE = "overtemperature", "the drive is too hot"
    ENCODER = "encoder", "the encoder is faulty"


class Reason(Described):
    """Why a motion or a phase began or ended; the value `reason` of an event."""

    COMPLETED = "completed", "the requested motion is complete"
    REQUESTED = "requested", "by request of an operator or another node"
    SUPERSEDED = "superseded", "replaced by a newer request"
    RENEWAL_TIMEOUT = "renewal_timeout", "the request was not renewed in time"
    SENSOR_TIMEOUT = "sensor_timeout", "required samples are missing"
    TIME_LIMIT = "time_limit", "the motion took longer than its limit"
    TOUCHDOWN = "touchdown", "the ground carries the rover"
    SNAG = "snag", "the tether is snagged"
    LANDED = "landed", "the rover has landed after a jump"
    ARMED = "armed", "the drive was armed"
    FAULT = "fault", "another part is in a fault or was stopped"
    OUT_OF_LIMITS = "out_of_limits", "a condition or prediction lies outside its limits"
    TWIST = "twist", "the twist of the tether turns the rover away"
    GYRO_BIAS = "gyro_bias", "the gyro bias leaves the heading uncertain"
    TAKEN_OVER = "taken_over", "another command source moves the machine"
    NOT_ACCEPTED = "not_accepted", "another node did not accept a request in time"
    RESTARTED = "restarted", "the node has started again"
    SHUTDOWN = "shutdown", "the node stops"
    CLOCK_JUMP = "clock_jump", "the clock jumped"
