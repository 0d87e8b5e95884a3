"""State of rover and nodes as the mission observes it on their topics. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

from msg_schemas import machine, topics
from msg_schemas.phases import DescentPhase, DrivePhase, JumpPhase, WinchMode
from msg_schemas.samples import (
    JointSample,
    PoseEstimateSample,
    Sample,
    Status,
    StatusSample,
    TextSample,
)
from rover_control.drive.drive_attitude import ROLLOVER_TILT

_NANO = 1e9
_PHASE_TOPICS = (topics.WINCH_MODE, topics.DESCENT_PHASE, topics.DRIVE_PHASE, topics.JUMP_PHASE)
_DRIVES = frozenset(phase for phase in DrivePhase if not phase.is_over)
_NO_JUMP = frozenset({"", *(phase for phase in JumpPhase if phase.is_over)})
_IN_FLIGHT = frozenset({JumpPhase.RELEASING, JumpPhase.FLIGHT, JumpPhase.LANDED, JumpPhase.HOOKING})
_IDLE_DESCENT = frozenset({"", DescentPhase.RELEASED, DescentPhase.STANDBY, DescentPhase.HOLDING})
_WINCH_MOVES = frozenset({WinchMode.LENGTH, WinchMode.RATE, WinchMode.TENSION, WinchMode.RELAX})
NUT_ZERO = 2.0e-3
"""Compression [m] up to which the spring counts as released."""
# Modes in which the winch does not detect touchdown.
_NO_TOUCHDOWN_MODES = frozenset({"", WinchMode.DISARMED, WinchMode.FAULT})
_HANG_TIME = 15.0  # time before a hanging rover counts: a restarted winch detects touchdown [s]
_ROLLOVER_TIME = 3.0  # time before a rollover counts [s]
_MAX_STEP = 0.3  # largest step between two poses of one odometry [m], [rad]
_START_ERROR = 0.03  # distance from a start pose that drive_node has taken over [m], [rad]

OBSERVED_TOPICS = (
    *_PHASE_TOPICS,
    topics.WINCH_ALARMS,
    topics.WINCH_ESTIMATE,
    topics.DESCENT_STATE,
    topics.DRIVE_STATE,
    topics.POSE,
    topics.JUMP_MOTOR_STATE,
    topics.EVENTS,
    topics.COMMANDS,
)
"""Topics that the mission subscribes to."""


@dataclass(frozen=True)
class Place:
    """Pose of base_link on the floor, in map [m, rad]."""

    x: float
    y: float
    heading: float

    def is_near(self, other: Place, distance: float) -> bool:
        """Whether two poses differ by less than a distance [m] and the same angle [rad]."""
        turned = abs(math.remainder(self.heading - other.heading, math.tau))
        return math.hypot(self.x - other.x, self.y - other.y) < distance and turned < distance

    def moved(self, before: Place, after: Place) -> Place:
        """This pose after the motion between two poses of an odometry that has drifted off."""
        turned = self.heading - before.heading
        x, y = after.x - before.x, after.y - before.y
        cosine, sine = math.cos(turned), math.sin(turned)
        heading = math.remainder(turned + after.heading, math.tau)
        return Place(self.x + cosine * x - sine * y, self.y + sine * x + cosine * y, heading)


class ObservedState:
    """Last values received.

    Args:
        timeout: age at which a periodic topic is stale [s].
    """

    def __init__(self, timeout: float) -> None:
        self.timeout = timeout
        self.phases: dict[str, str] = {}
        self.since: dict[str, float] = {}  # time of the last change of each phase [s]
        self.on_floor = False  # whether the winch reports touchdown
        self.on_floor_since = -math.inf
        self.length = math.nan  # paid-out length at the drum [m]
        self.net_tension = math.nan  # tether tension less the tether's weight [N]
        self.nut = math.nan  # position of the nut as compression [m]
        self.heading = math.nan  # of the hanging rover, from the descent controller [rad]
        self.swing = (math.nan, math.nan)  # its amplitudes, major and minor [rad]
        self.slope = math.nan  # inclination of the standing rover [rad]
        self._tilted_since = math.inf  # start of the present rollover [s]
        self.drop = math.nan  # depth of the tether attachment below the fairlead, on the floor [m]
        self.place: Place | None = None  # pose that the mission uses
        self.reported_place: Place | None = None  # by drive_node; None: it knows none
        self._is_set_down = False  # whether drive_node has yet to take over the place
        self._received_at: dict[str, float] = {}
        self._events: list[Status] = []
        self._begun_ns: int | None = None

    # --- inputs ----------------------------------------------------------------------------------

    def receive(self, topic: str, sample: Sample, now_ns: int) -> None:
        """Process a sample on one of `OBSERVED_TOPICS`."""
        now = now_ns / _NANO
        if self._begun_ns is None:
            self._begun_ns = now_ns
        self._received_at[topic] = now
        if isinstance(sample, StatusSample):
            # Past events and records are latched and sent to late subscribers: ignore them.
            if sample.stamp_ns >= self._begun_ns:
                self._events += sample.statuses
        elif isinstance(sample, TextSample):
            if self.phases.get(topic) != sample.text:
                self.phases[topic], self.since[topic] = sample.text, now
        elif isinstance(sample, PoseEstimateSample):
            self._on_place(sample)
        elif isinstance(sample, JointSample):
            self._on_joints(topic, sample, now)

    def _on_joints(self, topic: str, sample: JointSample, now: float) -> None:
        joints = sample.joints
        if topic == topics.WINCH_ALARMS:
            on_floor = joints[machine.TOUCHDOWN].position >= 0.5
            if on_floor is not self.on_floor:
                self.on_floor, self.on_floor_since = on_floor, now
        elif topic == topics.WINCH_ESTIMATE:
            self.length = joints[machine.PAYOUT].position
            is_known = joints[machine.TENSION].position >= 0.5
            self.net_tension = (
                joints[machine.TENSION].effort - joints[machine.TETHER_OUT].effort
                if is_known
                else math.nan
            )
        elif topic == topics.JUMP_MOTOR_STATE:
            self.nut = joints[machine.JUMP_SCREW].position
        elif topic == topics.DESCENT_STATE:
            self.heading = joints[machine.HEADING].position
            self.swing = joints[machine.SWING_MAJOR].position, joints[machine.SWING_MINOR].position
        elif topic == topics.DRIVE_STATE:
            upright = math.cos(joints[machine.PITCH].position) * math.cos(
                joints[machine.ROLL].position
            )
            self.slope = math.acos(upright)
            drop = joints[machine.TETHER_DROP].position
            self.drop = drop if drop > 0.0 else math.nan
            self._tilted_since = (
                min(self._tilted_since, now) if self.slope > ROLLOVER_TILT else math.inf
            )

    def _on_place(self, sample: PoseEstimateSample) -> None:
        x, y, _ = sample.position
        # A restarted drive_node does not know its pose: keep the last one.
        reported = Place(x, y, sample.heading) if sample.is_known else None
        before, self.reported_place = self.reported_place, reported
        if reported is None or self.place is None:
            return
        if before == self.place or self.place_agrees:
            self.place, self._is_set_down = reported, False
        elif before is not None and reported.is_near(before, _MAX_STEP):
            self.place = self.place.moved(before, reported)

    @property
    def place_agrees(self) -> bool:
        """Whether drive_node uses the pose that the mission uses."""
        if self.reported_place is None or self.place is None:
            return False
        error = _START_ERROR if self._is_set_down else _MAX_STEP
        return self.reported_place.is_near(self.place, error)

    def take_events(self) -> list[Status]:
        """Return the events and records since the last call and clear them."""
        taken, self._events = self._events, []
        return taken

    # --- derived state ---------------------------------------------------------------------------

    def is_stale(self, topic: str, now: float) -> bool:
        """Whether a periodic topic has not been received within the timeout."""
        return now - self._received_at.get(topic, -math.inf) > self.timeout

    def has_rolled_over(self, now: float) -> bool:
        """Whether the rover lies on its side or back."""
        return now - self._tilted_since > _ROLLOVER_TIME

    def has_hung(self, now: float, begun: float) -> bool:
        """Whether a rover that should stand since `begun` [s] has been hanging for a while."""
        if self.on_floor or topics.WINCH_ALARMS not in self._received_at:
            return False
        is_known = (
            not self.is_stale(topics.WINCH_ESTIMATE, now) and self.winch not in _NO_TOUCHDOWN_MODES
        )
        return is_known and now - max(self.on_floor_since, begun) > _HANG_TIME

    def is_within(self, radius: float) -> bool:
        """Whether the rover is known to be within a radius [m] of the plumb line."""
        return self.place is not None and math.hypot(self.place.x, self.place.y) <= radius

    def set_down(self, heading: float) -> None:
        """Set the pose to that of a rover just landed below the fairlead.

        Args:
            heading: in map [rad], used if the odometry has not tracked it.
        """
        self.place = Place(0.0, 0.0, heading if self.place is None else self.place.heading)
        self._is_set_down = True

    @property
    def winch(self) -> str:
        """Mode of the winch; empty = never received."""
        return self.phases.get(topics.WINCH_MODE, "")

    @property
    def descent(self) -> str:
        """Phase of the descent controller."""
        return self.phases.get(topics.DESCENT_PHASE, "")

    @property
    def drive(self) -> str:
        """Phase of the drive controller."""
        return self.phases.get(topics.DRIVE_PHASE, "")

    @property
    def jump(self) -> str:
        """Phase of the jump controller."""
        return self.phases.get(topics.JUMP_PHASE, "")

    @property
    def descent_engaged(self) -> bool:
        """Whether the descent controller holds winch, wheels and flywheel."""
        return self.descent not in ("", DescentPhase.RELEASED)

    @property
    def descent_busy(self) -> bool:
        """Whether the descent controller is moving the rover."""
        return self.descent not in _IDLE_DESCENT

    @property
    def is_driving(self) -> bool:
        """Whether the rover is driving."""
        return self.drive in _DRIVES

    @property
    def spring_compressed(self) -> bool:
        """Whether the latch holds the spring, or the nut's position allows it."""
        prepares = self.jump not in _NO_JUMP and not self.in_flight
        return prepares or self.nut > NUT_ZERO

    @property
    def in_flight(self) -> bool:
        """Whether a jump is in progress, from release until the latch is hooked again."""
        return self.jump in _IN_FLIGHT

    @property
    def winch_moving(self) -> bool:
        """Whether the winch moves the tether."""
        return self.winch in _WINCH_MOVES
