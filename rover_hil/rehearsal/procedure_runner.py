"""Runs a procedure step by step: acts, listens, judges.

A step that fails, or that measures times, says something of the machine only if the test itself was
sound. Where the rehearsal was held up, its commands came late, or an emulated machine did not keep
time, the attempt says nothing: it is repeated, and at last not run, with the reason.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

from msg_schemas import topics
from msg_schemas.refusal import RefusalCode
from msg_schemas.samples import JointValue, Level
from rover_hil.rehearsal.actions import (
    Action,
    Amount,
    Ask,
    BeyondLimits,
    Call,
    Impair,
    Look,
    Mark,
    Publish,
    Reading,
    SetParameter,
    Wait,
)
from rover_hil.rehearsal.disturbance import disturbance
from rover_hil.rehearsal.event_expectations import is_refusal
from rover_hil.rehearsal.finding import TIMED, Finding, Rule, Verdict
from rover_hil.rehearsal.history import Window
from rover_hil.rehearsal.outcome import StepOutcome
from rover_hil.rehearsal.procedure import Procedure, Step
from rover_hil.rehearsal.stand import CannotDoError, Outgoing, Sending, Stand

EMULATOR = "drive_emulator"
"""The node that impairs the machine that it emulates."""

_LOOK = 0.05  # how often it is looked whether what is awaited has come [s]
_STATUS = 1.5  # wall time within which the machine tells how it kept time [s]
_LATE = 0.05  # of a command, beyond its period: the machine is not to be blamed [s]


class RehearsalEnded(Exception):
    """The operator has ended the rehearsal."""


@dataclass
class _Attempt:
    """One attempt at a step, as it goes."""

    begin_ns: int
    steady_ns: int
    end_ns: int | None = None
    mark_ns: int = -1
    findings: list[Finding] = field(default_factory=list)
    sendings: list[tuple[Sending, float]] = field(default_factory=list)
    going_on: list[Sending] = field(default_factory=list)
    to_put_back: list[tuple[str, str, object]] = field(default_factory=list)


class ProcedureRunner:
    """Runs one procedure.

    Args:
        stand: where it runs.
        attempts: how often a step is tried at most; 0: as the procedure says.
        patience: wall time for which something is awaited beyond its own time [s].
        confirmed: motion is confirmed already.
        is_over: whether the operator has ended the rehearsal.
    """

    def __init__(
        self,
        stand: Stand,
        *,
        attempts: int = 0,
        patience: float = 3.0,
        confirmed: bool = False,
        is_over: Callable[[], bool] = lambda: False,
    ) -> None:
        self._stand = stand
        self._attempts = attempts
        self._patience = patience
        self._motion: bool | None = True if confirmed else None
        self._is_over = is_over
        self._has_armed = False
        self._outcomes: dict[str, StepOutcome] = {}

    def run(self, procedure: Procedure) -> tuple[tuple[StepOutcome, ...], bool]:
        """Run all steps, and take the power away at the end if it was given.

        Returns:
            What came of each step, and whether all had their turn.
        """
        completed = False
        try:
            for number, (name, step) in enumerate(procedure.steps.items(), 1):
                self._stand.tell(f"[{number}/{len(procedure.steps)}] {name}: {step.title}")
                attempts = self._attempts or step.attempts or procedure.attempts
                outcome = self._run_step(name, step, attempts)
                self._outcomes[name] = outcome
                self._tell(outcome)
            completed = True
        except RehearsalEnded:
            self._stand.tell("ended by the operator")
        finally:
            self._disarm()
        for name, step in procedure.steps.items():
            self._outcomes.setdefault(name, _not_run(name, step, "the rehearsal ended before it"))
        return tuple(self._outcomes[name] for name in procedure.steps), completed

    # --- one step --------------------------------------------------------------------------------

    def _run_step(self, name: str, step: Step, attempts: int) -> StepOutcome:
        stand = self._stand
        disturbances: list[str] = []
        try:
            self._check_before(step)
            self._listen(step.heard_on)
            while True:
                stand.history.forget_old()
                wall_ns = stand.wall_ns()
                attempt = self._attempt(step)
                failed = any(each.verdict is Verdict.FAIL for each in attempt.findings)
                if failed:
                    self._check_alone(step, attempt)
                judged = failed or Rule(step.rule) in TIMED
                why = self._disturbance(attempt) if judged else ""
                if why:
                    disturbances.append(why)
                    if len(disturbances) < attempts:
                        stand.tell(f"    again: {why}")
                        continue
                return StepOutcome(
                    name,
                    step.title,
                    Rule(step.rule),
                    f"disturbed {len(disturbances)} times, at last: {why}" if why else "",
                    _void(attempt.findings) if why else tuple(attempt.findings),
                    tuple(disturbances),
                    attempt.begin_ns,
                    max([stand.now_ns(), *(each.end_ns for each in attempt.findings)]),
                    wall_ns,
                    stand.wall_ns(),
                )
        except CannotDoError as error:
            return _not_run(name, step, str(error))

    def _listen(self, names: tuple[str, ...]) -> None:
        """Hear what a step needs, before it begins."""
        stand = self._stand
        stand.listen(names)
        self._wait_for(
            lambda: all(stand.history.of(name) or not stand.is_offered(name) for name in names)
        )

    def _check_before(self, step: Step) -> None:
        for name in step.after:
            if self._outcomes[name].verdict is not Verdict.PASS:
                raise CannotDoError(f"step {name} has not passed")
        for name in step.needs:
            if not self._wait_for(lambda name=name: self._stand.is_offered(name)):  # type: ignore[misc]
                raise CannotDoError(f"nobody offers {name}")
        if step.moves and self._motion is None:
            try:
                self._motion = self._stand.question(
                    "confirm_motion",
                    "From here on the machine may move. Is the area clear, and may it move?",
                )
            except CannotDoError:
                self._motion = False
        if step.moves and not self._motion:
            raise CannotDoError("motion was not confirmed")

    def _check_alone(self, step: Step, attempt: _Attempt) -> None:
        """What failed says nothing where somebody else had the topic that it commands on."""
        window = Window(self._stand.history, attempt.begin_ns)
        for topic in step.published:
            owned = partial(is_refusal, subject=topic, code=RefusalCode.OWNED)
            told = next(window.statuses(topics.DIAGNOSTICS, attempt.begin_ns, owned), None)
            if told is not None:
                raise CannotDoError(f"another commander should be ended first: {told[1].message}")

    def _attempt(self, step: Step) -> _Attempt:
        stand = self._stand
        attempt = _Attempt(stand.now_ns(), stand.steady_ns())
        with contextlib.ExitStack() as afterwards:
            afterwards.callback(self._put_back, attempt)
            afterwards.callback(self._fall_silent, attempt)
            for action in step.do:
                attempt.end_ns = None
                self._act(action, attempt)
            self._fall_silent(attempt)
            end_ns = stand.now_ns() if attempt.end_ns is None else attempt.end_ns
            window = Window(stand.history, attempt.begin_ns, end_ns, attempt.mark_ns)
            self._wait_for(
                lambda: all(each.is_decided(window, stand.now_ns()) for each in step.expect),
                self._longest(step),
            )
            for expectation in step.expect:
                attempt.findings += expectation.judge(window)
        return attempt

    def _longest(self, step: Step) -> float:
        """How long may be waited for what a step expects [s]."""
        within = [getattr(each, "within", 0.0) for each in step.expect]
        return max([0.0, *within]) + self._patience

    def _wait_for(self, condition: Callable[[], bool], timeout: float | None = None) -> bool:
        """Wait until something is so; returns whether it came to be."""
        limit = self._patience if timeout is None else timeout
        since_ns = self._stand.steady_ns()
        while not condition():
            self._go_on()
            if (self._stand.steady_ns() - since_ns) * 1e-9 > limit:
                return False
            self._stand.wait(_LOOK)
        return True

    def _go_on(self) -> None:
        if self._is_over():
            raise RehearsalEnded

    def _pause(self, time: float) -> None:
        """Let so much time of the machine pass [s]; where its clock stands, by the steady one."""
        stand = self._stand
        end_ns, since_ns = stand.now_ns() + round(time * 1e9), stand.steady_ns()
        while (left := (end_ns - stand.now_ns()) * 1e-9) > 0.0:
            self._go_on()
            if (stand.steady_ns() - since_ns) * 1e-9 > time + self._patience:
                return
            stand.wait(min(left, _LOOK))

    # --- what is done ----------------------------------------------------------------------------

    def _act(self, action: Action, attempt: _Attempt) -> None:
        self._go_on()
        if isinstance(action, Wait):
            self._pause(action.time)
        elif isinstance(action, Mark):
            attempt.mark_ns = self._stand.now_ns()
        elif isinstance(action, Publish):
            self._publish(action, attempt)
        elif isinstance(action, BeyondLimits):
            attempt.findings.append(self._go_beyond_limits(action))
        elif isinstance(action, Call):
            attempt.findings.append(self._call(action))
        elif isinstance(action, SetParameter):
            self._set(action.node, action.parameter, action.value, attempt, keep=action.keep)
        elif isinstance(action, Impair):
            self._set(EMULATOR, "impairments", action.text, attempt)
        elif isinstance(action, Ask):
            self._stand.ask(action.key, action.what)
        elif isinstance(action, Look):
            attempt.findings.append(self._look(action))

    def _set(
        self, node: str, name: str, value: object, attempt: _Attempt, *, keep: bool = False
    ) -> None:
        before = self._stand.parameter(node, name)
        if not keep:
            attempt.to_put_back.append((node, name, before))
        self._stand.set_parameter(node, name, value)

    def _publish(self, action: Publish, attempt: _Attempt) -> None:
        stand = self._stand
        if not self._wait_for(lambda: stand.is_heard(action.topic)):
            raise CannotDoError(f"nobody listens to {action.topic}")
        joints = {
            name: JointValue(*(self._value(amount) for amount in joint.amounts()))
            for name, joint in action.joints.items()
        }

        def make(now_ns: int) -> Outgoing:
            stamp_ns = 0 if action.unstamped else max(1, now_ns - round(action.age * 1e9))
            return Outgoing(stamp_ns, joints, action.omit)

        if not action.time and not action.throughout:
            now_ns = stand.now_ns()
            stand.send(action.topic, make(now_ns))
            attempt.end_ns = now_ns
            return
        sending = stand.send_steadily(action.topic, make, action.period)
        attempt.sendings.append((sending, action.period))
        attempt.going_on.append(sending)
        if not action.throughout:
            self._pause(action.time)
            sending.stop()
            attempt.going_on.remove(sending)
            attempt.end_ns = sending.last_ns

    def _value(self, amount: Amount) -> float:
        if not isinstance(amount, Reading):
            return amount
        if not self._wait_for(lambda: self._stand.history.last(amount.topic) is not None):
            raise CannotDoError(f"nothing came on {amount.topic}, of which {amount.field} is used")
        heard = self._stand.history.last(amount.topic)
        if heard is None:
            raise AssertionError("it was there just now")
        told: float = dict(heard.sample.scalars())[amount.field]
        return amount.times * told + amount.plus

    def _go_beyond_limits(self, action: BeyondLimits) -> Finding:
        stand, topic = self._stand, action.topic
        if not self._wait_for(lambda: stand.is_heard(topic)):
            raise CannotDoError(f"nobody listens to {topic}")
        begin_ns = stand.now_ns()
        sent = action.messages()
        for _, joints in sent:
            stand.send(topic, Outgoing(stand.now_ns(), joints))
            self._pause(action.pause)

        def refused() -> list[str]:
            window = Window(stand.history, begin_ns)
            told = window.statuses(
                topics.DIAGNOSTICS, begin_ns, lambda s: is_refusal(s, topic, "out_of_limits")
            )
            return [status.message for _, status in told]

        def missing() -> list[str]:
            told = refused()
            left = []
            for path, joints in sent:
                name, _, part = path.partition(".")
                value = getattr(joints[name], part)
                if not any(f"{path} is {value!r}" in message for message in told):
                    left.append(f"{path} {value:g}")
            return left

        self._wait_for(lambda: not missing(), action.within + self._patience)
        left = missing()
        measured = f"{len(sent) - len(left)} of {len(sent)}"
        if left:
            measured += f"; not {', '.join(left)}"
        return Finding(
            Verdict.FAIL if left else Verdict.PASS,
            f"values of {topic} just beyond each limit of the contract that are refused",
            "all, with the field's name and out_of_limits",
            measured,
            (topic, topics.DIAGNOSTICS),
            begin_ns,
            stand.now_ns(),
        )

    def _call(self, action: Call) -> Finding:
        stand = self._stand
        begin_ns = stand.now_ns()
        if action.service == topics.DRIVES_ARM and action.data:
            self._has_armed = True
        answer = stand.call(action.service, action.data, action.within + self._patience)
        right = answer.success is action.success
        given = "" if action.data is None else f"({str(action.data).lower()})"
        return Finding(
            Verdict.PASS if right else Verdict.FAIL,
            f"answer of {action.service}{given}",
            "done" if action.success else "refused",
            f"{'done' if answer.success else 'refused'}: {answer.message}",
            (topics.EVENTS, topics.DIAGNOSTICS),
            begin_ns,
            stand.now_ns(),
        )

    def _look(self, action: Look) -> Finding:
        begin_ns = self._stand.now_ns()
        right = self._stand.question(action.key, action.question)
        return Finding(
            Verdict.PASS if right else Verdict.FAIL,
            action.question,
            "yes, by the operator",
            "yes" if right else "no",
            (),
            begin_ns,
            self._stand.now_ns(),
        )

    def _fall_silent(self, attempt: _Attempt) -> None:
        for sending in attempt.going_on:
            sending.stop()
        attempt.going_on.clear()

    def _put_back(self, attempt: _Attempt) -> None:
        for node, name, before in reversed(attempt.to_put_back):
            try:
                self._stand.set_parameter(node, name, before)
            except CannotDoError as error:
                self._stand.tell(f"    {node} {name} was not put back: {error}")
        if attempt.to_put_back:
            self._let_recover()
        attempt.to_put_back.clear()

    def _let_recover(self) -> None:
        """Wait until the link's devices answer again, where somebody tells of them.

        What follows would else meet a machine that still suffers from what was taken away.
        """
        history, since_ns = self._stand.history, self._stand.steady_ns()

        def is_well() -> bool:
            last = history.last(topics.LINK_STATUS)
            if last is None or last.sample is None:
                return True
            links = [each for each in last.sample.statuses if each.name.endswith(": link")]
            return last.steady_ns > since_ns and all(each.level is Level.OK for each in links)

        self._wait_for(is_well)

    def _disarm(self) -> None:
        """Take the power away, if it was given: no rehearsal leaves a machine that may move."""
        if not self._has_armed:
            return
        try:
            answer = self._stand.call(topics.DRIVES_ARM, False, self._patience)
        except CannotDoError as error:
            self._stand.tell(f"NOT DISARMED: {error}")
            return
        done = "disarmed" if answer.success else f"NOT DISARMED: {answer.message}"
        self._stand.tell(f"at the end: {done}")

    # --- whether the test was sound --------------------------------------------------------------

    def _disturbance(self, attempt: _Attempt) -> str:
        """Why an attempt says nothing of the machine; empty: it does."""
        stand = self._stand
        held_up = stand.held_up(attempt.steady_ns)
        for sending, period in attempt.sendings:
            late = sending.longest - period
            if late > _LATE:
                return f"a command was sent {late:.2g} s late by the rehearsal itself"
        if held_up > _LATE:
            return f"the rehearsal itself was held up for {held_up:.2g} s"
        last = stand.history.last(topics.SIM_STATUS)
        if last is None:
            return ""
        end_ns = stand.steady_ns()

        def told() -> bool:
            reports = (stand.history.last(name) for name in (topics.SIM_STATUS, topics.LINK_STATUS))
            return all(each is not None and each.steady_ns > end_ns for each in reports)

        self._wait_for(told, _STATUS)
        return disturbance(stand.history, attempt.steady_ns)

    def _tell(self, outcome: StepOutcome) -> None:
        verdict = outcome.verdict
        why = f": {outcome.reason}" if outcome.reason else ""
        self._stand.tell(f"    {verdict.value}{why}")
        for finding in outcome.findings:
            if finding.verdict is Verdict.FAIL:
                self._stand.tell(
                    f"      {finding.what}: {finding.measured} (required: {finding.required})"
                )


def _void(findings: list[Finding]) -> tuple[Finding, ...]:
    """What a disturbed attempt found, which says nothing."""
    return tuple(replace(finding, verdict=Verdict.NOT_RUN) for finding in findings)


def _not_run(name: str, step: Step, reason: str) -> StepOutcome:
    return StepOutcome(name, step.title, Rule(step.rule), reason)
