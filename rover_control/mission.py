"""The mission's supervisor: leg after leg by asking other nodes, and never a motor itself. Pure.

===========  ================================================================================
standby      nothing is under way; `go` begins
(a leg's)    looking, turning, approaching, landing, driving, choosing, jumping, returning,
             lifting, ascending, stowing: what the present leg does
holding      all is at rest: asked for, or because a leg cannot go on by itself; `resume` begins
             the leg again, `skip` leaves it out
aborted      the same, and what was planned is forgotten; `go` leads home from where the rover is
===========  ================================================================================

Each trial of a leg has a time limit; a leg that fails is tried again, and after `tries` of them
left out or held at, as `_AFTER` says. On the floor the winch helps first: it hauls the rover below
the fairlead, and sets it down there to try once more, or takes it home. What interlocks forbid is
not asked for. Every change is told with its reason.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import Enum, auto
from typing import Any, NamedTuple

from msg_schemas import topics
from msg_schemas.parameters import parameter
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import Level, Sample
from msg_schemas.transition import Transition
from rover_control.locomotion import LocomotionParameters
from rover_control.mission_floor import Hop, Way
from rover_control.mission_interlocks import Condition, forbidden, remedy
from rover_control.mission_legs import (
    Ask,
    End,
    Hoist,
    Land,
    LegLimits,
    LegTask,
    Lift,
    MissionPhase,
    Notes,
    Stop,
    Stow,
    Turn,
    Verdict,
    Wish,
)
from rover_control.mission_plan import MissionPlan
from rover_control.mission_route import Leg, LegKind, Route
from rover_control.observed_state import ObservedState, Place

_NANO = 1e9
_PAUSE = 2.0  # between two calls of one service [s]


@dataclass(frozen=True)
class MissionParameters:
    """Patience of the mission."""

    tries: int = parameter(3, "-", "trials of a leg", 1, 100)
    pause: float = parameter(
        45.0, "s", "before a hanging leg is tried again: the swing is learnt meanwhile", 0.0, 600.0
    )
    node_timeout: float = parameter(
        2.0, "s", "after which winch or driving count as not there", 0.2, 60.0
    )
    most_rearms: int = parameter(
        3, "-", "times that the mission arms the winch in one leg, before it holds", 0, 100
    )
    resumes_within: float = parameter(
        60.0, "s", "of its own end, a mission that was started again goes on by itself", 0.0, 1e5
    )


@dataclass(frozen=True)
class MissionSettings:
    """All parameters of a mission."""

    mission: MissionParameters = field(default_factory=MissionParameters)
    limits: LegLimits = field(default_factory=LegLimits)
    locomotion: LocomotionParameters = field(default_factory=LocomotionParameters)


class _After(Enum):
    """What follows a leg that was tried often enough."""

    NEXT = auto()
    HOLD = auto()


_AFTER: Mapping[LegKind, _After] = {
    LegKind.LOOK: _After.NEXT,
    LegKind.TURN: _After.NEXT,
    LegKind.APPROACH: _After.NEXT,
    LegKind.CALM: _After.NEXT,
    LegKind.LAND: _After.HOLD,
    LegKind.VISIT: _After.NEXT,
    LegKind.HOP: _After.NEXT,
    LegKind.RETURN: _After.HOLD,
    LegKind.LIFT: _After.HOLD,
    LegKind.ASCEND: _After.HOLD,
    LegKind.STOW: _After.HOLD,
}
_CONDUCTS: Mapping[LegKind, type[LegTask]] = {
    LegKind.LOOK: Stop,
    LegKind.TURN: Turn,
    LegKind.APPROACH: Stop,
    LegKind.CALM: Stop,
    LegKind.LAND: Land,
    LegKind.VISIT: Way,
    LegKind.HOP: Hop,
    LegKind.RETURN: Way,
    LegKind.LIFT: Lift,
    LegKind.ASCEND: Stop,
    LegKind.STOW: Stow,
}
_HANGING = (LegKind.LOOK, LegKind.APPROACH, LegKind.CALM, LegKind.ASCEND)
_CANNOT_BE_SKIPPED = (LegKind.LIFT, LegKind.ASCEND, LegKind.STOW)


class Done(NamedTuple):
    """A leg that is over."""

    leg: str
    verdict: Verdict
    reason: str


class Mission:
    """One mission by a plan.

    Args:
        plan: what is to be done.
        settings: patience.
    """

    def __init__(self, plan: MissionPlan, settings: MissionSettings | None = None) -> None:
        self.plan = plan
        self.settings = settings or MissionSettings()
        self.observed = ObservedState(self.settings.mission.node_timeout)
        self.route = Route(plan)
        self.record: list[Done] = []
        self.notes = Notes()
        self.reason = ""  # of the present phase
        self.waits_for = ""  # what keeps the leg from going on
        self._tries = 0
        self._rearms = 0
        self._conduct: LegTask | None = None
        self._still = MissionPhase.STANDBY  # the phase where no leg is under way
        self._is_calm = True  # what was to be brought to rest, is
        self._pauses_until = -math.inf  # before the leg is tried again [s]
        self._sent: dict[str, float] = {}  # when what was asked for last [s]
        self._told: MissionPhase | None = None
        self._changes: list[Transition] = []

    # --- what is known ---------------------------------------------------------------------------

    @property
    def phase(self) -> MissionPhase:
        """What is done."""
        return self._still if self._conduct is None else self._conduct.phase

    @property
    def is_active(self) -> bool:
        """Whether a leg is under way."""
        return self._conduct is not None

    @property
    def leg(self) -> Leg | None:
        """The leg that is done or comes next; None = none is left."""
        return self.route.leg

    @property
    def tries(self) -> int:
        """Trials of the leg that have failed."""
        return self._tries

    def take_changes(self) -> list[Transition]:
        """Return what changed since the last call, and forget it."""
        taken, self._changes = self._changes, []
        return taken

    def hear(self, topic: str, sample: Sample, now_ns: int) -> None:
        """Take what was said on a topic of `observed_state.HEARD`."""
        self.observed.hear(topic, sample, now_ns)

    # --- asked from outside ----------------------------------------------------------------------

    def go(self, now_ns: int) -> str:
        """Begin the mission; after an abort, the way home.

        Raises:
            Refusal: one is under way or held, or the winch is not heard.
        """
        now = now_ns / _NANO
        if self.is_active or self._still is MissionPhase.HOLDING:
            other = topics.MISSION_RESUME if not self.is_active else topics.MISSION_ABORT
            raise _refused(topics.MISSION_GO, f"a mission is {self.phase}; see {other}")
        self._check_heard(topics.MISSION_GO, now)
        stands = self.observed.stands
        if self._still is MissionPhase.ABORTED:
            self.route.begin_home(stands=stands)
            text = "home from " + ("the floor" if stands else f"{self.observed.length:.2f} m")
        else:
            self.route.begin(stands=stands)
            self.record, self.notes = [], Notes()
            if not stands:
                self.observed.place = None
            elif self.observed.place is None:
                self.observed.place = Place(0.0, 0.0, math.radians(self.plan.heading))
            text = f"{len(self.route.legs)} legs" + (", the rover stands already" if stands else "")
        self._tell("mission_begun", text)
        self._tries = 0
        self._begin(now, text)
        return text

    def hold(self, _now_ns: int) -> str:
        """Bring all to rest; the leg waits.

        Raises:
            Refusal: nothing is under way.
        """
        if not self.is_active:
            if self._still in (MissionPhase.HOLDING, MissionPhase.ABORTED):
                self._is_calm = False
                return f"already {self._still}"
            raise _refused(topics.MISSION_HOLD, "no mission is under way")
        self._stop(MissionPhase.HOLDING, "asked for")
        return "coming to rest"

    def resume(self, now_ns: int) -> str:
        """Begin the leg again that a hold has left.

        Raises:
            Refusal: nothing is held, or the winch is not heard.
        """
        now = now_ns / _NANO
        if self.is_active or self._still is not MissionPhase.HOLDING or self.leg is None:
            raise _refused(topics.MISSION_RESUME, f"the mission is {self.phase}, nothing is held")
        self._check_heard(topics.MISSION_RESUME, now)
        self._tries = 0
        self._begin(now, f"resumed with {self.leg.name}")
        return f"on with {self.leg.name}"

    def skip(self, now_ns: int) -> str:
        """Leave the present leg out.

        Raises:
            Refusal: there is none, or the rover would not come home without it.
        """
        leg = self.leg
        held = self._still is MissionPhase.HOLDING
        if leg is None or not (self.is_active or held):
            raise _refused(topics.MISSION_SKIP, "no leg is under way or held")
        if leg.kind in _CANNOT_BE_SKIPPED:
            raise _refused(topics.MISSION_SKIP, f"{leg.name} cannot be left out on the way home")
        if leg.kind is LegKind.RETURN and not self._may_lift():
            far = self.plan.lift.radius
            text = f"the rover is not known to be within {far:g} m of the plumb line"
            raise _refused(topics.MISSION_SKIP, f"it swings when it is lifted: {text}")
        was_active, now = self.is_active, now_ns / _NANO
        self._note(leg, Verdict.GIVEN_UP, "skipped by the operator")
        self._advance(leg)
        following = self.leg
        assert following is not None  # as the last legs cannot be skipped
        if was_active:
            self._begin(now, f"{leg.name} is skipped")
        return f"next is {following.name}"

    def abort(self, _now_ns: int) -> str:
        """Bring all to rest and forget the plan; `go` leads home. Always done."""
        if self._still is MissionPhase.STANDBY and not self.is_active:
            return "no mission is under way"
        self._stop(MissionPhase.ABORTED, "asked for", Level.WARN)
        return f"coming to rest; {topics.MISSION_GO} leads home"

    def _check_heard(self, subject: str, now: float) -> None:
        if self.observed.silent(topics.WINCH_ESTIMATE, now) or not self.observed.winch:
            raise Refusal(subject, RefusalCode.STALE, "the winch is not heard")

    def _may_lift(self) -> bool:
        return self._is_within(self.plan.lift.radius)

    def _is_within(self, radius: float) -> bool:
        """Whether the rover is known to be so near to the plumb line."""
        place = self.observed.place
        return place is not None and math.hypot(place.x, place.y) <= radius

    # --- stepped by time -------------------------------------------------------------------------

    def step(self, now_ns: int) -> tuple[Ask, ...]:
        """Advance to now; returns what is to be asked for."""
        now = now_ns / _NANO
        news = self.observed.take_news()
        asks: tuple[Ask, ...] = ()
        if self._conduct is None:
            asks = self._calm(now)
        elif now >= self._pauses_until:
            found = self._late(now) or self._conduct.step(self.observed, news, now)
            self._publish_choices()
            if isinstance(found, End):
                self._over(found, now)
            elif isinstance(found, Wish):
                asks = self._allowed(found, now)
            else:
                self.waits_for = ""
        self._publish_phase()
        return asks

    def _late(self, now: float) -> End | None:
        conduct = self._conduct
        assert conduct is not None
        limits = self.settings.limits
        limit = limits.of(conduct.leg.kind)
        why = f", waiting: {self.waits_for}" if self.waits_for else ""
        if now - conduct.begun > limit:
            text = f"not over within {limit:g} s{why}"
            return End(Verdict.FAILED, text, by_others=bool(why))
        if isinstance(conduct, Way) and now - conduct.jumping_for > limits.jump_limit:
            return End(Verdict.FAILED, f"no jump within {limits.jump_limit:g} s{why}")
        return None

    def _allowed(self, wish: Wish, now: float) -> tuple[Ask, ...]:
        """What of a wish may be asked for now: it, what clears its way, or nothing."""
        found = forbidden(wish.act, self.observed, now)
        self._publish_waiting("" if found is None else found.value)
        if found is None:
            if not self._is_due(wish.ask.name, wish.pause, now):
                return ()
            assert self._conduct is not None
            self._conduct.sent(wish.ask, now)
            return (wish.ask,)
        if wish.reels and self.observed.winch == "length":
            return self._call(topics.WINCH_HOLD, now)
        if found is Condition.STOPPED:
            self._stop(MissionPhase.HOLDING, found.value, Level.WARN)
            return ()
        service = remedy(found, self.observed)
        if not service:
            return ()
        if service == topics.WINCH_REARM and self._rearms >= self.settings.mission.most_rearms:
            text = f"{found.value}, and was armed {self._rearms} times in this leg"
            self._stop(MissionPhase.HOLDING, text, Level.WARN)
            return ()
        called = self._call(service, now)
        self._rearms += service == topics.WINCH_REARM and bool(called)
        return called

    def _calm(self, now: float) -> tuple[Ask, ...]:
        """Bring to rest what moves; from then on it is left alone."""
        if self._is_calm:
            return ()
        observed = self.observed
        if observed.compressed and observed.jump != "letting_down":
            return self._call(topics.JUMP_ABORT, now)
        if observed.drives:
            return self._call(topics.DRIVE_STOP, now)
        aborts = self._still is MissionPhase.ABORTED
        # Where the rover still goes to its first stop, it stands by.
        if observed.descent_busy or (aborts and observed.descent == "holding"):
            return self._call(topics.DESCENT_ABORT if aborts else topics.DESCENT_HOLD, now)
        if not observed.descent_engaged and observed.winch_moves:
            return self._call(topics.WINCH_HOLD, now)
        if not observed.compressed and not observed.flies:
            self._is_calm = True
            self._tell("mission_rests", f"all is at rest, {self._still}")
        return ()

    def _call(self, service: str, now: float) -> tuple[Ask, ...]:
        return (Ask(service),) if self._is_due(service, _PAUSE, now) else ()

    def _is_due(self, name: str, pause: float, now: float) -> bool:
        if now - self._sent.get(name, -math.inf) < pause:
            return False
        self._sent[name] = now
        return True

    # --- legs ------------------------------------------------------------------------------------

    def _begin(self, now: float, reason: str) -> None:
        """Begin a trial of the present leg."""
        leg = self.leg
        assert leg is not None
        last = self._tries > 0 and self._tries == self.settings.mission.tries - 1
        alone = leg.kind is LegKind.ASCEND and last and self.observed.length <= self.plan.lift.alone
        kind = Hoist if alone else _CONDUCTS[leg.kind]
        self._conduct = kind(leg, self.plan, self.notes, now)
        if isinstance(self._conduct, Way):
            self._conduct.locomotion = self.settings.locomotion
        self._rearms = 0
        self._pauses_until = -math.inf
        self._sent.clear()
        self.waits_for = ""
        self.reason = reason
        values = {"leg": leg.name, "number": self.route.number, "of": len(self.route.legs)}
        self._tell("mission_leg", f"{leg.name}: {reason}", values=values)

    def _over(self, end: End, now: float) -> None:
        """A trial has ended: on to the next leg, again, or a hold."""
        leg = self.leg
        assert leg is not None
        if end.verdict is Verdict.TAKEN:
            self._stop(MissionPhase.HOLDING, end.reason, Level.WARN)
            return
        if end.verdict is Verdict.FAILED:
            self._tries += 1
            tries = self.settings.mission.tries
            text = f"{leg.name}: {end.reason}"
            self._tell("mission_trial_failed", text, Level.WARN, {"tries": self._tries})
            if self._tries < tries:
                self._begin(now, f"trial {self._tries + 1} of {tries}, as {end.reason}")
                p = self.settings.mission
                # Trials that fail as somebody is gone would be spent before his silence is noticed.
                pause = p.pause if leg.kind in _HANGING else p.node_timeout
                self._pauses_until = now + pause
                return
        if end.verdict is not Verdict.DONE and self._rescue(leg, end, now):
            return
        if end.verdict is Verdict.FAILED:
            goes_on = leg.kind is LegKind.RETURN and self._may_lift()
            if _AFTER[leg.kind] is _After.HOLD and not goes_on:
                self._note(leg, end.verdict, end.reason)
                self._stop(MissionPhase.HOLDING, text, Level.ERROR)
                return
        self._note(leg, end.verdict, end.reason)
        self._advance(leg)
        if self.leg is not None:
            self._begin(now, f"after {leg.name}: {end.reason}")
            return
        self._conduct = None
        self._still = MissionPhase.STANDBY
        self.route.rewind()
        self.reason = end.reason
        missed = [done.leg for done in self.record if done.verdict is not Verdict.DONE]
        text = f"{len(self.record)} legs" + (f", without {', '.join(missed)}" if missed else "")
        values = {"pictures": self.notes.pictures, "jumps": self.notes.jumps, "missed": len(missed)}
        self._tell("mission_done", text, values=values)

    def _rescue(self, leg: Leg, end: End, now: float) -> bool:
        """Let the winch help a rover that cannot go on; whether it may."""
        most, reason = self.plan.rescue.most, end.reason
        if most == 0 or not self._is_within(self.plan.rescue.radius):
            return False
        may_try_again = self.plan.landing is not None and self.route.rescues < most
        if leg.kind is LegKind.RETURN:
            self._note(leg, Verdict.DONE, f"left to the winch: {reason}")
            self._advance(leg)
        elif leg.kind is LegKind.VISIT and may_try_again and not end.by_others:
            self.route.put_rescue()
            self._tries = 0
            values = {"leg": leg.name, "number": self.route.rescues, "of": most}
            self._tell("mission_rescue", f"{leg.name}: {reason}", Level.WARN, values)
        else:
            return False
        self._begin(now, reason)
        return True

    def _advance(self, leg: Leg) -> None:
        """To the next leg; without a landing nothing is done on the floor."""
        self.route.go_on()
        self._tries = 0
        if leg.kind is LegKind.LAND and self.record[-1].verdict is not Verdict.DONE:
            self.route.leave_floor()

    def _note(self, leg: Leg, verdict: Verdict, reason: str) -> None:
        self.record.append(Done(leg.name, verdict, reason))
        level = Level.OK if verdict is Verdict.DONE else Level.WARN
        name = "mission_leg_done" if verdict is Verdict.DONE else "mission_leg_missed"
        self._tell(name, f"{leg.name}: {reason}", level, {"leg": leg.name})

    def _stop(self, still: MissionPhase, reason: str, level: Level = Level.OK) -> None:
        self._conduct = None
        self._still = still
        self._is_calm = False
        self._sent.clear()
        self._publish_waiting("")
        self.reason = reason
        where = f" in {self.leg.name}" if self.leg is not None else ""
        self._tell(f"mission_{still}", f"{reason}{where}", level)

    # --- over a restart --------------------------------------------------------------------------

    def checkpoint(self, now_ns: int) -> dict[str, Any]:
        """What is to be kept, as JSON values, so that `restore` goes on from here."""
        notes = {name: _kept(value) for name, value in asdict(self.notes).items()}
        place = self.observed.place
        return {
            "plan": self.plan.digest,
            "stamp_ns": now_ns,
            "phase": self.phase.value,
            "is_active": self.is_active,
            "route": self.route.checkpoint(),
            "tries": self._tries,
            "notes": notes,
            "place": None if place is None else [place.x, place.y, place.heading],
            "record": [[done.leg, done.verdict.name, done.reason] for done in self.record],
        }

    def restore(self, kept: Mapping[str, Any], now_ns: int) -> None:
        """Go on from a checkpoint, where it is of this plan and of this run's past."""
        age = (now_ns - int(kept["stamp_ns"])) / _NANO
        if kept["plan"] != self.plan.digest or age < 0.0:
            why = "another plan" if age >= 0.0 else "another run, it lies ahead of the clock"
            self._tell("mission_forgotten", f"the checkpoint is of {why}", Level.WARN)
            return
        still = MissionPhase(kept["phase"])
        if still is MissionPhase.STANDBY:
            return
        self.route.restore(kept["route"])
        self._tries = int(kept["tries"])
        self.notes = Notes(**{name: _known(value) for name, value in kept["notes"].items()})
        self.record = [Done(leg, Verdict[name], why) for leg, name, why in kept["record"]]
        if kept["place"] is not None:
            self.observed.place = Place(*kept["place"])
        now = now_ns / _NANO
        if not kept["is_active"]:
            self._stop(still, "started again")
        elif age <= self.settings.mission.resumes_within:
            self._begin(now, f"started again {age:.1f} s after its end")
        else:
            text = f"started again {age:.0f} s after its end, {topics.MISSION_RESUME} goes on"
            self._stop(MissionPhase.HOLDING, text, Level.WARN)

    # --- telling ---------------------------------------------------------------------------------

    def _publish_choices(self) -> None:
        """Between wheels and jump."""
        if not isinstance(self._conduct, Way):
            return
        for choice in self._conduct.take_choices():
            values = {
                "way": choice.way.value,
                "rule": self.settings.locomotion.locomotion_rule,
                "wheels_risk": choice.wheels_risk,
                "jump_risk": choice.jump_risk,
            }
            self._tell("mission_chosen", f"{choice.way}: {choice.reason}", values=values)

    def _publish_waiting(self, reason: str) -> None:
        if reason and reason != self.waits_for:
            self._tell("mission_waits", reason)
        self.waits_for = reason

    def _publish_phase(self) -> None:
        phase = self.phase
        if phase is self._told:
            return
        self._told = phase
        leg = "" if self.leg is None or not self.is_active else f"{self.leg.name}: "
        self._tell("mission_phase", f"{phase}: {leg}{self.reason}", values={"phase": phase.value})

    def _tell(
        self,
        name: str,
        reason: str,
        level: Level = Level.OK,
        values: Mapping[str, object] | None = None,
    ) -> None:
        self._changes.append(Transition(name, reason, level, values or {}))


def _kept(value: float) -> float | None:
    return None if math.isnan(value) else value


def _known(value: Any) -> Any:
    return math.nan if value is None else value


def _refused(subject: str, reason: str) -> Refusal:
    return Refusal(subject, RefusalCode.WRONG_PHASE, reason)
