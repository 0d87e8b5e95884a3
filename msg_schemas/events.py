"""Events: their names, severities and values, and the report of one event."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import Self

from msg_schemas.faults import Reason
from msg_schemas.samples import Level


class EventName(StrEnum):
    """Base of the names of events; a node of its own declares its events as a subclass.

    A member is declared as ``NAME = "name", severity, "description", "name of a value", ...``.
    """

    level: Level
    about: str
    values: tuple[str, ...]

    def __new__(cls, value: str, level: Level, about: str, *values: str) -> Self:
        """Make a member from its name, severity, description and the names of its values."""
        member = str.__new__(cls, value)
        member._value_ = value
        member.level = level
        member.about = about
        member.values = values
        return member


class NodeEvent(EventName):
    """Events of every node."""

    ACTIVE = "node_active", Level.OK, "the node was activated"
    INACTIVE = "node_inactive", Level.OK, "the node was deactivated"
    REALTIME_DENIED = (
        "realtime_priority_denied",
        Level.WARN,
        "the kernel denied it; the node runs without it",
    )
    PARTICIPANT_EXCLUDED = (
        "participant_excluded", Level.ERROR, "simulated time waits for a process no longer",
        "process",
    )  # fmt: skip
    PARTICIPANT_JOINED = (
        "participant_joined", Level.OK, "simulated time waits for a process again", "process",
    )  # fmt: skip


class SimulationEvent(EventName):
    """Events of the simulation."""

    PAUSED = "simulation_paused", Level.OK, "simulated time was paused"
    RESUMED = "simulation_resumed", Level.OK, "simulated time goes on"
    RESET = "simulation_reset", Level.OK, "plant and clock were reset"
    PLANT_RESET = "plant_reset", Level.OK, "the plant was reset; the clock goes on"
    FINISHED = "simulation_finished", Level.OK, "the requested duration was simulated"
    COMMAND_TIMEOUT = (
        "drive_command_timeout", Level.ERROR,
        "a working drive got no commands and makes its quick stop",
        "drive", "age", "torque", "compression", "length", "rate",
    )  # fmt: skip


class PlantEvent(EventName):
    """Events of the simulated plant, located in time; those of the spatial plant have x, y, z."""

    TAKE_OFF = "take_off", Level.OK, "the rover left the ground", "speed", "x", "y", "z"
    APEX = (
        "apex", Level.OK, "highest point of a flight", "height", "flight_time", "x", "y", "z",
    )  # fmt: skip
    TOUCHDOWN = (
        "touchdown", Level.OK, "the rover touched the ground", "height", "speed", "load",
        "attitude_variation", "travel", "flight_time", "x", "y", "z",
    )  # fmt: skip
    DRUM_STOP = (
        "drum_stop", Level.OK, "the drum reached a mechanical stop", "side", "tension",
        "x", "y", "z",
    )  # fmt: skip
    LATCH_FREE = (
        "latch_free", Level.OK, "the nut is clear of the latch", "speed", "x", "y", "z",
    )  # fmt: skip
    LATCH_HOOKING = (
        "latch_hooking", Level.OK, "the nut climbs past the latch", "speed", "x", "y", "z",
    )  # fmt: skip
    LATCH_ENGAGED = (
        "latch_engaged", Level.OK, "nut and latch are engaged", "speed", "x", "y", "z",
    )  # fmt: skip
    LATCH_COMPRESSING = (
        "latch_compressing", Level.OK, "the nut compresses the spring", "speed", "x", "y", "z",
    )  # fmt: skip
    LATCH_RELEASED = (
        "latch_released", Level.OK, "the latch has tripped", "speed", "x", "y", "z",
    )  # fmt: skip
    ENERGY_DRIFT = (
        "energy_drift", Level.WARN,
        "the simulation's energy balance is open by more than 1 %: take a shorter time step",
        "drift", "turnover", "x", "y", "z",
    )  # fmt: skip
    TETHER_PUSH = (
        "tether_push", Level.WARN,
        "the tether pushes more than it carries: set tether.buckling, or take shorter elements",
        "push", "limit", "x", "y", "z",
    )  # fmt: skip
    TETHER_BROKEN = (
        "tether_broken", Level.ERROR, "the tether parted; the plant has stopped", "tension",
        "x", "y", "z",
    )  # fmt: skip
    DIVERGED = (
        "diverged", Level.ERROR, "the integration diverged; the plant has stopped",
        "plant_time", "newton_iterations", "h", "tolerance", "max_halvings", "x", "y", "z",
    )  # fmt: skip


class WinchEvent(EventName):
    """Events of the winch: changes of its mode, and alarms."""

    HOLD = (
        "winch_hold", Level.OK, "a motion was completed or ended by request; the brake closes",
        "length", "reason",
    )  # fmt: skip
    MOTION_ABORTED = (
        "winch_motion_aborted", Level.WARN, "the winch ended a motion before its goal and holds",
        "length", "reason",
    )  # fmt: skip
    LENGTH = "winch_length", Level.OK, "a motion to a length has started", "length", "reason"
    RATE = "winch_rate", Level.OK, "a motion at a rate has started", "length", "reason"
    TENSION = "winch_tension", Level.OK, "holding a tension has started", "length", "reason"
    SLACK = "winch_slack", Level.OK, "giving or taking up slack has started", "length", "reason"
    SLACK_REACHED = (
        "winch_slack_reached", Level.OK, "the requested slack is given or taken up", "length",
        "slack", "reason",
    )  # fmt: skip
    RELAX = "winch_relax", Level.OK, "relaxing the tether has started", "length", "reason"
    STOP = "winch_stop", Level.OK, "the brake was closed at once by request", "length", "reason"
    FAULT = (
        "winch_fault", Level.ERROR, "the winch braked because of a fault", "length", "reason",
        "fault", "rate",
    )  # fmt: skip
    TOUCHDOWN = (
        "alarm_touchdown", Level.OK, "the ground carries the rover", "tension", "length",
        "load_mean",
    )  # fmt: skip
    TOUCHDOWN_CLEARED = (
        "alarm_touchdown_cleared", Level.OK, "the tether carries the rover again", "tension",
        "length", "load_mean",
    )  # fmt: skip
    SLACK_ALARM = (
        "alarm_slack", Level.OK, "the tether is slack", "tension", "length", "load_mean",
    )  # fmt: skip
    SLACK_CLEARED = (
        "alarm_slack_cleared", Level.OK, "the tether is taut again", "tension", "length",
        "load_mean",
    )  # fmt: skip
    SNAG = (
        "alarm_snag", Level.WARN, "the tether is snagged", "tension", "length", "load_mean",
    )  # fmt: skip
    SNAG_CLEARED = (
        "alarm_snag_cleared", Level.OK, "the tether is free again", "tension", "length",
        "load_mean",
    )  # fmt: skip
    OVER_TENSION = (
        "alarm_over_tension", Level.ERROR, "the tension exceeds its limit", "tension", "length",
        "load_mean",
    )  # fmt: skip
    OVER_TENSION_CLEARED = (
        "alarm_over_tension_cleared", Level.OK, "the tension is below its limit again", "tension",
        "length", "load_mean",
    )  # fmt: skip


class DescentEvent(EventName):
    """Events of the descent controller."""

    ENGAGED = "descent_engaged", Level.OK, "the controller took winch, wheels and flywheel"
    RELEASED = "descent_released", Level.OK, "the controller released them", "reason"
    STANDBY = "descent_standby", Level.OK, "no stop is under way", "reason"
    TRAVELLING = "descent_travelling", Level.OK, "the motion to a depth has started"
    DAMPING = "descent_damping", Level.OK, "damping of the swing has started"
    SETTLING = "descent_settling", Level.OK, "the controller waits until the rover is steady"
    EXPOSING = "descent_exposing", Level.OK, "the camera takes pictures"
    HOLDING = "descent_holding", Level.OK, "the descent comes to rest; the stops wait", "reason"
    INTERRUPTED = (
        "descent_interrupted", Level.WARN, "the controller holds by itself", "reason",
    )  # fmt: skip
    STOP_ACCEPTED = "stop_accepted", Level.OK, "a stop was appended", "depth", "stops"
    STOP_COMPLETED = (
        "stop_completed", Level.OK, "the stop is complete", "depth", "length", "pictures", "reason",
    )  # fmt: skip
    STOP_ABORTED = (
        "stop_aborted", Level.OK, "the stop was discarded by request", "depth", "length",
        "pictures", "reason",
    )  # fmt: skip
    STOP_FAILED = (
        "stop_failed", Level.WARN, "the stop cannot be completed", "depth", "length", "pictures",
        "reason",
    )  # fmt: skip
    POINTING_STARTED = (
        "pointing_started", Level.OK, "a turn to a heading has started", "turning", "holding",
        "limit",
    )  # fmt: skip
    POINTING_REACHED = (
        "pointing_reached", Level.OK, "the heading is reached and held", "turning", "holding",
        "limit",
    )  # fmt: skip
    POINTING_RELEASED = (
        "pointing_released", Level.OK, "the heading was released for a stop", "reason",
    )  # fmt: skip
    POINTING_LOST = (
        "pointing_lost", Level.WARN, "the heading cannot be reached or held", "reason",
    )  # fmt: skip
    NUT_CLEARING_STARTED = (
        "nut_clearing_started", Level.OK, "the nut moves clear of the latch",
    )  # fmt: skip
    NUT_CLEARING_COMPLETED = (
        "nut_clearing_completed", Level.OK, "the jump motor works as a reaction wheel",
    )  # fmt: skip
    ROTORS_SUSPENDED = (
        "rotor_control_suspended", Level.WARN, "the gyro is too late; the rotors do not follow it",
    )  # fmt: skip
    ROTORS_RESUMED = "rotor_control_resumed", Level.OK, "the gyro is in time again"
    SWING_LOST = (
        "swing_estimate_lost", Level.WARN, "the estimate does not fit the sensors; it restarts",
    )  # fmt: skip
    SWING_RECOVERED = "swing_estimate_recovered", Level.OK, "the swing estimate has settled again"
    BUDGET_EXHAUSTED = (
        "attitude_budget_exhausted", Level.WARN, "a rotor cannot hold the attitude", "rotor",
    )  # fmt: skip
    BUDGET_RECOVERED = (
        "attitude_budget_recovered", Level.OK, "a rotor holds the attitude again", "rotor",
    )  # fmt: skip


class DriveEvent(EventName):
    """Events of the drive controller."""

    STARTED = "drive_started", Level.OK, "driving to a goal or along a path has started", "goals"
    GOAL_REACHED = (
        "goal_reached", Level.OK, "a pose of the path is reached", "x", "y", "heading",
        "goals_left",
    )  # fmt: skip
    COMPLETED = (
        "drive_completed", Level.OK, "all goals are reached", "x", "y", "heading", "goals_left",
        "reason",
    )  # fmt: skip
    STOPPED = (
        "drive_stopped", Level.OK, ("the rover stopped before its goal, by request or because "
        "steering ended"), "x", "y", "heading", "goals_left", "reason",
    )  # fmt: skip
    STUCK = (
        "drive_stuck", Level.WARN, "the rover does not follow its wheels", "x", "y", "heading",
        "goals_left", "turning", "cause", "reason",
    )  # fmt: skip
    FAILED = (
        "drive_failed", Level.WARN, "the goal cannot be reached", "x", "y", "heading",
        "goals_left", "fault", "reason",
    )  # fmt: skip
    POSE_SET = (
        "pose_set", Level.OK, "the pose was set by a message on `initialpose`", "x", "y",
        "heading",
    )  # fmt: skip


class JumpEvent(EventName):
    """Events of the jump sequence."""

    PREDICTING = (
        "jump_predicting", Level.OK, "the prediction of a jump has started", "clearance", "tilt",
    )  # fmt: skip
    PREDICTED = (
        "jump_predicted", Level.OK, "a prediction without a jump is complete", "height",
        "upright", "stroke", "reason",
    )  # fmt: skip
    REJECTED = (
        "jump_rejected", Level.WARN, "the jump does not start, because of its prediction",
        "height", "upright", "stroke", "reason",
    )  # fmt: skip
    NOT_STARTED = (
        "jump_not_started", Level.WARN, ("the jump does not start: no prediction or no slack in "
        "time, or the conditions have changed"), "reason",
    )  # fmt: skip
    GIVING_SLACK = (
        "jump_giving_slack", Level.OK, "more slack was requested from the winch", "height",
        "upright", "stroke",
    )  # fmt: skip
    COMPRESSING = (
        "jump_compressing", Level.OK, "compression of the spring has started", "stroke", "speed",
    )  # fmt: skip
    SETTLING = (
        "jump_settling", Level.OK, "the spring is compressed", "compression", "force",
    )  # fmt: skip
    RELEASING = "jump_releasing", Level.OK, "the latch is tripped", "tilt", "tension"
    FLIGHT = "jump_flight", Level.OK, "the latch has tripped", "compression"
    LANDED = "jump_landed", Level.OK, "ground contact after the flight", "flight_time"
    NO_TAKE_OFF = (
        "jump_no_take_off", Level.WARN, ("the spring was released, but the rover did not leave the "
        "ground"), "flight_time", "reason",
    )  # fmt: skip
    HOOKING = "jump_hooking", Level.OK, "the nut moves above the latch", "tilt"
    ABORTED = "jump_aborted", Level.OK, "the jump was aborted; a spring is let down", "reason"
    CANCELLED = (
        "jump_cancelled", Level.WARN, ("the conditions for the release are not met; the spring is "
        "let down"), "cause", "compression", "force", "rate", "tilt", "tension", "reason",
    )  # fmt: skip
    FAILED = (
        "jump_failed", Level.ERROR, "compression or release failed; the spring is let down",
        "cause", "compression", "reason",
    )  # fmt: skip
    FAULT = "jump_fault", Level.ERROR, "the sequence is in a fault", "fault", "tilt", "reason"
    STANDBY = "jump_standby", Level.OK, "the sequence is complete; the rover is at rest", "tilt"
    RESET = "jump_reset", Level.WARN, "the clock jumped; the sequence starts over", "reason"


class MissionEvent(EventName):
    """Events of the mission."""

    STARTED = "mission_started", Level.OK, "a mission or its return has started"
    LEG_STARTED = (
        "mission_leg_started", Level.OK, "a trial of a leg has started", "leg", "number", "of",
    )  # fmt: skip
    TRIAL_FAILED = (
        "mission_trial_failed", Level.WARN, "a trial of a leg has failed", "failed_trials",
    )  # fmt: skip
    LEG_COMPLETED = "mission_leg_completed", Level.OK, "a leg is complete", "leg"
    LEG_SKIPPED = "mission_leg_skipped", Level.OK, "a leg was skipped by request", "leg"
    LEG_FAILED = "mission_leg_failed", Level.WARN, "a leg was not completed", "leg"
    RECOVERY_STARTED = (
        "mission_recovery_started", Level.WARN, "the winch hauls a stuck rover below the fairlead",
        "leg", "number", "of",
    )  # fmt: skip
    COMPLETED = (
        "mission_completed", Level.OK, "all legs are over", "pictures", "jumps", "missed",
    )  # fmt: skip
    HOLDING = "mission_holding", Level.OK, "the mission holds by request", "reason"
    INTERRUPTED = "mission_interrupted", Level.WARN, "the mission holds by itself", "reason"
    BLOCKED = (
        "mission_blocked", Level.ERROR, ("a mandatory leg has failed; the mission "
        "holds"), "reason",
    )  # fmt: skip
    ABORTED = "mission_aborted", Level.OK, "the mission was aborted by request", "reason"
    AT_REST = "mission_at_rest", Level.OK, "all motions have ended after a hold or an abort"
    CHECKPOINT_DISCARDED = (
        "checkpoint_discarded", Level.WARN, "the checkpoint does not fit this plan or run",
    )  # fmt: skip
    LOCOMOTION_CHOSEN = (
        "locomotion_chosen", Level.OK, "wheels or jump were chosen for a stuck rover", "mode",
        "rule", "wheels_risk", "jump_risk",
    )  # fmt: skip
    WAITING = "mission_waiting", Level.OK, "an interlock forbids the next request"
    PHASE_CHANGED = "mission_phase_changed", Level.OK, "the phase has changed", "phase"


class BridgeEvent(EventName):
    """Events of the hardware bridge; the value `device` names the device."""

    DRIVES_ARMED = "drives_armed", Level.OK, "all drives were armed"
    DISARMED = "drive_disarmed", Level.OK, "a drive was disarmed by request", "device"
    TRIPPED = "drive_tripped", Level.ERROR, "a drive was disarmed by a fault", "device"
    RESTARTED = "device_restarted", Level.WARN, "a device has restarted", "device"
    FAULT_RESET = (
        "device_fault_reset",
        Level.OK,
        "a device reports that its fault is gone",
        "device",
    )
    SETPOINT_REJECTED = (
        "setpoint_rejected", Level.WARN, "a drive rejected its setpoint and switched off", "device",
    )  # fmt: skip
    EMERGENCY = (
        "device_emergency", Level.ERROR, "a device sent an emergency message", "device",
        "error_code",
    )  # fmt: skip
    SILENT = "device_silent", Level.ERROR, "a device sent nothing within its limit", "device"
    COMMANDS_CEASED = (
        "commands_ceased", Level.ERROR, "no command came for a moving drive; it is switched off",
        "device", "timeout",
    )  # fmt: skip
    FEEDBACK_LOST = (
        "feedback_lost", Level.ERROR, "no feedback came from a drive; it is switched off", "device",
    )  # fmt: skip
    IDENTIFIED = "device_identified", Level.OK, "a device matches its dictionary", "device"
    MISMATCH = (
        "device_mismatch", Level.ERROR, "a device differs from its dictionary", "device",
    )  # fmt: skip


class EmulatorEvent(EventName):
    """Events of the drive emulator; the value `device` names the device."""

    DRIVE_STATE = (
        "emulated_drive_state", Level.OK, "state of an emulated drive", "device", "state",
        "error_code",
    )  # fmt: skip
    DRIVE_FAULT = (
        "emulated_drive_fault", Level.ERROR, "an emulated drive is in a fault", "device",
        "state", "error_code",
    )  # fmt: skip
    SETPOINT_REFUSED = (
        "emulated_setpoint_refused", Level.WARN, "the plant refused a setpoint", "device",
    )  # fmt: skip
    IMPAIRMENT_STARTED = (
        "impairment_started", Level.OK, ("an injected impairment has started; its values are its "
        "settings"), "kind", "target", "direction", "seed", "magnitude", "unit", "cause", "start",
        "duration",
    )  # fmt: skip
    IMPAIRMENT_ENDED = (
        "impairment_ended", Level.OK, ("an injected impairment has ended; its values are its "
        "settings"), "kind", "target", "direction", "seed", "magnitude", "unit", "cause", "start",
        "duration", "frames", "frames_affected",
    )  # fmt: skip
    KILL_FAILED = "bridge_kill_failed", Level.WARN, "the bridge process cannot be killed"


EVENT_GROUPS: Mapping[str, type[EventName]] = MappingProxyType(
    {
        "every node": NodeEvent,
        "sim_node": SimulationEvent,
        "plant": PlantEvent,
        "winch_node": WinchEvent,
        "descent_node": DescentEvent,
        "drive_node": DriveEvent,
        "jump_node": JumpEvent,
        "mission_node": MissionEvent,
        "hil_bridge": BridgeEvent,
        "drive_emulator": EmulatorEvent,
    }
)
"""The enumerations of event names by their publisher."""

EVENTS: Mapping[str, EventName] = MappingProxyType(
    {str(name): name for group in EVENT_GROUPS.values() for name in group}
)
"""All event names of the suite."""


@dataclass(frozen=True)
class EventReport:
    """Report of one event.

    Attributes:
        name: the event; its severity is that of the report.
        message: what happened, for people; software decides by the name and the values.
        values: by the names that the event declares.
        reason: why it happened; published as the value ``reason``.
        stamp_ns: when it happened [ns]; None = now.
    """

    name: EventName
    message: str
    values: Mapping[str, object] = field(default_factory=dict)
    reason: Reason | None = None
    stamp_ns: int | None = None

    def __post_init__(self) -> None:
        """Refuse values that the event does not declare.

        Raises:
            ValueError: a value is undeclared; the message lists the declared names.
        """
        for name in (*self.values, *(() if self.reason is None else ("reason",))):
            if name not in self.name.values:
                declared = ", ".join(self.name.values) or "none"
                raise ValueError(
                    f"event {self.name} does not declare the value {name!r}, it declares {declared}"
                )

    @property
    def level(self) -> Level:
        """Severity of the event."""
        return self.name.level

    def texts(self) -> dict[str, str]:
        """The values as texts, numbers with full precision, the reason included."""
        texts = {key: _text(value) for key, value in self.values.items()}
        return texts if self.reason is None else {"reason": self.reason.value, **texts}


def _text(value: object) -> str:
    return repr(value) if isinstance(value, float) else str(value)
