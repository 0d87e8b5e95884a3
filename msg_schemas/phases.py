"""Phases, modes and states: the words of the latched text topics, each with its description."""

from __future__ import annotations

from msg_schemas.described import Described


class PlantPhase(Described):
    """Motion of the simulated rover, or why the simulation has stopped."""

    HELD = "held", "planar plant: the rover stands, held by the ground"
    FLIGHT = "flight", "neither ground nor tether carries the rover"
    LANDED = "landed", "planar plant: the rover is held again where it landed"
    FREE = "free", "no rover, or a rover that was never held"
    HANGING = "hanging", "spatial plant: the tether carries the rover"
    GROUNDED = "grounded", "spatial plant: a wheel or a body touches the ground"
    DIVERGED = "diverged", "the integration diverged; the state stays at the last converged step"
    TETHER_BROKEN = "tether_broken", "the tether parted; the state no longer changes"

    @property
    def final(self) -> bool:
        """Whether further steps leave the state unchanged."""
        return self in (PlantPhase.DIVERGED, PlantPhase.TETHER_BROKEN)


class WinchMode(Described):
    """Mode of the winch."""

    DISARMED = "disarmed", "brake closed since the start; armed by service"
    HOLD = "hold", "brake closed, or closing after a motion"
    LENGTH = "length", "moves to a length, then holds"
    RATE = "rate", "moves at a rate while the request is renewed"
    TENSION = "tension", "holds a tension while the request is renewed"
    SLACK = "slack", "gives slack and keeps it, or takes it up and holds"
    RELAX = "relax", "pays out until the tether carries little more than its own weight"
    STOP = "stop", "brake closed at once by request; armed by service"
    FAULT = "fault", "brake closed because of a fault; armed by service"

    @property
    def is_armed(self) -> bool:
        """Whether requests are accepted."""
        return self not in (WinchMode.DISARMED, WinchMode.STOP, WinchMode.FAULT)


class LoadState(Described):
    """State of the load on the tether; the most severe condition that holds."""

    UNKNOWN = "unknown", "no valid tension"
    NORMAL = "normal", "within the limits"
    TOUCHDOWN = "touchdown", "the ground carries most of the rover"
    SLACK = "slack", "the tether carries no load"
    SNAG = "snag", "the tether or the rover is snagged"
    OVER_TENSION = "over_tension", "above the limit"

    @property
    def tension_state(self) -> LoadState:
        """The state on `winch/tension_watch`: touchdown and snag have tensions within limits."""
        if self in (LoadState.TOUCHDOWN, LoadState.SNAG):
            return LoadState.NORMAL
        return self


class DescentPhase(Described):
    """Phase of the descent controller."""

    RELEASED = "released", "commands no drive until a stop is requested"
    STANDBY = "standby", "keeps the attitude; no stop is under way"
    TRAVELLING = "travelling", "the winch moves to the depth of the stop"
    DAMPING = "damping", "the winch damps the swing at the depth of the stop"
    SETTLING = "settling", "waits until the rover is steady"
    EXPOSING = "exposing", "the camera takes pictures"
    HOLDING = "holding", "at rest after a hold; the stops wait for a resume"


class DrivePhase(Described):
    """Phase of the drive controller."""

    RELEASED = "released", "commands no drive until a motion is requested"
    STANDING = "standing", "at rest between two motions of a path"
    TURNING = "turning", "turns left about the right wheel"
    DRIVING = "driving", "drives straight ahead"
    STEERED = "steered", "follows the velocity commands of an operator"
    BALANCING = "balancing", "holds the wheels during a jump; in flight they balance the rover"
    STUCK = "stuck", "stopped because the rover does not follow the wheels"
    FAILED = "failed", "stopped because the goal cannot be reached"

    @property
    def is_over(self) -> bool:
        """Whether no motion is under way."""
        return self in (DrivePhase.RELEASED, DrivePhase.STUCK, DrivePhase.FAILED)


class JumpPhase(Described):
    """Phase of the jump sequence."""

    STANDBY = "standby", "at rest; accepts a request"
    PREDICTING = "predicting", "predicts the requested jump"
    GIVING_SLACK = "giving_slack", "waits until the winch has given slack"
    COMPRESSING = "compressing", "the nut compresses the spring"
    SETTLING = "settling", "the latch holds the spring; waits until the rover is quiet"
    RELEASING = "releasing", "trips the latch"
    FLIGHT = "flight", "the latch has tripped; waits for the landing"
    LANDED = "landed", "waits until the rover is at rest"
    HOOKING = "hooking", "moves the nut above the latch"
    LETTING_DOWN = "letting_down", "relaxes the spring without a jump"
    FAULT = "fault", "a motion did not end in time, or the rover has toppled; needs an abort"

    @property
    def is_over(self) -> bool:
        """Whether no jump is in progress."""
        return self in (JumpPhase.STANDBY, JumpPhase.FAULT)

    @property
    def uses_motor(self) -> bool:
        """Whether a jump is under way or the spring is let down: the jump motor is not free."""
        return self not in (
            JumpPhase.STANDBY, JumpPhase.PREDICTING, JumpPhase.GIVING_SLACK, JumpPhase.FAULT
        )  # fmt: skip


class MissionPhase(Described):
    """Phase of the mission."""

    STANDBY = "standby", "no mission is under way"
    LOOKING = "looking", "a stop with pictures"
    TURNING = "turning", "a turn about the plumb line"
    APPROACHING = "approaching", "a stop without pictures"
    LANDING = "landing", "the winch lowers the rover to the floor"
    DRIVING = "driving", "drives to a waypoint"
    CHOOSING = "choosing", "predicts a jump to choose between wheels and jump"
    JUMPING = "jumping", "gives slack, jumps and settles"
    RETURNING = "returning", "drives back below the fairlead"
    LIFTING = "lifting", "the winch lifts the rover off the floor"
    ASCENDING = "ascending", "ascends to the stow"
    STOWING = "stowing", "releases winch, wheels and flywheel"
    HOLDING = "holding", "at rest; the leg waits for a resume or a skip"
    ABORTED = "aborted", "at rest; the plan is discarded, a go leads home"


class HealthState(Described):
    """Readiness of a node, as `diagnostics` reports it."""

    INACTIVE = "inactive", "the node is not active"
    WAITING = "waiting", "required inputs are missing; the value `waiting_for` lists them"
    READY = "ready", "the node can do its work"
