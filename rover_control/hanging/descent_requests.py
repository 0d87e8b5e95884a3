"""Requests of an operator to a descent: what is executed, and why the rest is refused. Pure."""

from __future__ import annotations

from msg_schemas import topics
from msg_schemas.faults import Reason
from msg_schemas.refusal import Refusal, RefusalCode
from rover_control.coordination.winch_link import FREE
from rover_control.hanging.descent import DescentController
from rover_control.hanging.descent_stop import DescentStop

_NANO = 1e9


class DescentRequests:
    """Executes or refuses each request to a descent.

    Args:
        descent: that executes them.
    """

    def __init__(self, descent: DescentController) -> None:
        self.descent = descent

    def add_stop(self, stop: DescentStop, now_ns: int) -> None:
        """Add a stop; the first one engages the drives.

        Raises:
            Refusal: out of limits, during a jump or drive, or the controller refuses.
        """
        descent, p = self.descent, self.descent.settings.descent
        if not p.min_depth <= stop.depth <= p.max_depth:
            raise Refusal(
                topics.DESCENT_REQUEST,
                RefusalCode.OUT_OF_LIMITS,
                f"depth is {stop.depth!r} m, it must be {p.min_depth:g} .. {p.max_depth:g} m",
            )
        self._check_rotors(now_ns)
        descent.controller.request(stop)
        descent.engage("stop requested")
        descent.acquire_winch()

    def turn(self, angle: float, now_ns: int) -> None:
        """Turn about the plumb line by an angle [rad], and hold the heading until another request.

        Raises:
            Refusal: stops are left, during a jump or drive, or the heading cannot be reached or
                held.
        """
        self._check_rotors(now_ns)
        self.descent.controller.point(angle)
        self.descent.engage("heading requested")

    def hold(self, now_ns: int) -> str:
        """Hold the present length.

        Raises:
            Refusal: the descent is released.
        """
        self._check_engaged(topics.DESCENT_HOLD)
        return self.descent.controller.hold(now_ns)

    def resume(self, now_ns: int) -> str:
        """Continue after a hold.

        Raises:
            Refusal: not held, a sensor has timed out, or the winch is in another mode.
        """
        self._check_engaged(topics.DESCENT_RESUME)
        self._check_sensors(topics.DESCENT_RESUME, now_ns)
        mode = self.descent.link.mode
        if mode not in FREE:
            raise Refusal(
                topics.DESCENT_RESUME,
                RefusalCode.NOT_ARMED,
                f"the winch is in {mode or 'no known mode'}, it must be in hold",
            )
        done = self.descent.controller.resume(now_ns)
        self.descent.acquire_winch()
        return done

    def abort(self, now_ns: int) -> str:
        """Drop all stops, stay, and release the heading."""
        self.descent.interruption = ""
        self.descent.controller.pointing.stop()
        return self.descent.controller.abort(now_ns)

    def release(self) -> str:
        """Release the drives.

        Raises:
            Refusal: stops are left.
        """
        descent = self.descent
        if descent.is_engaged and not descent.controller.profile.is_idle:
            raise Refusal(
                topics.DESCENT_RELEASE,
                RefusalCode.WRONG_PHASE,
                f"the descent is in {descent.phase}; {topics.DESCENT_ABORT} drops the remaining "
                "stops",
            )
        if descent.is_engaged:
            descent.disengage("release requested", Reason.REQUESTED)
        return "winch, wheels and flywheel released"

    def _check_engaged(self, subject: str) -> None:
        if not self.descent.is_engaged:
            raise Refusal(subject, RefusalCode.WRONG_PHASE, "no descent is in progress")

    def _check_rotors(self, now_ns: int) -> None:
        descent = self.descent
        conflict = descent.rotors.conflict()
        if conflict:
            raise Refusal(topics.DESCENT_REQUEST, RefusalCode.WRONG_PHASE, conflict)
        nut, limit = descent.nut.position, descent.settings.descent.nut_unloaded_position
        if descent.settings.hanging_controller.uses_rotors and nut > limit:
            raise Refusal(
                topics.DESCENT_REQUEST,
                RefusalCode.WRONG_PHASE,
                f"the nut is at {nut:.4g} m and may bear the spring, the limit is {limit:g} m; "
                f"{topics.JUMP_ABORT} relaxes the spring",
            )
        self._check_sensors(topics.DESCENT_REQUEST, now_ns)
        if not descent.is_engaged:
            descent.controller.restart_estimation()

    def _check_sensors(self, subject: str, now_ns: int) -> None:
        descent = self.descent
        missing = descent.waiting_for(now_ns)
        if missing:
            raise Refusal(subject, RefusalCode.STALE, f"{', '.join(missing)} timed out")
        left = descent.settings.hanging_controller.profile.estimator_settling_time - (
            now_ns / _NANO - descent.sensors_since
        )
        if left > 0.0:
            text = f"a sensor had timed out, the swing estimate settles in {left:.1f} s"
            raise Refusal(subject, RefusalCode.STALE, text)
