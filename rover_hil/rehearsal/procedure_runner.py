"""Runs a procedure step by step: performs its actions and evaluates its expectations.

An attempt at a step that fails or measures times is valid only if the test itself kept its times.
If the rehearsal stalled, published a command late, or the emulated machine lost real time, the
attempt is invalid: it is repeated, and in the end reported as NOT RUN with the reason.
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
    BeyondLimits,
    CallAction,
    Impair,
    Inspection,
    MachineReading,
    Mark,
    Prompt,
    Publish,
    SetParameter,
    Wait,
)
from rover_hil.rehearsal.environment import (
    OutgoingMessage,
    PeriodicPublisher,
    PreconditionError,
    ProcedureEnvironment,
)
from rover_hil.rehearsal.event_expectations import is_refusal
from rover_hil.rehearsal.expectation_result import TIMED, ExpectationResult, InterfaceRule, Result
from rover_hil.rehearsal.message_history import EvaluationWindow
from rover_hil.rehearsal.procedure import Procedure, Step
from rover_hil.rehearsal.procedure_result import ProcedureStepResult
from rover_hil.rehearsal.timing_validity import timing_fault

EMULATOR = "drive_emulator"
"""The node with the parameter `impairments`."""

_POLL_PERIOD = 0.05  # of conditions that are awaited [s]
_STATUS_TIMEOUT = 1.5  # for the next reports on real time [s]
_JITTER_LIMIT = 0.05  # a longer stall or delay of a command makes an attempt invalid [s]


class RehearsalStoppedError(Exception):
    """The operator has stopped the rehearsal."""


@dataclass
class _Attempt:
    """State of one attempt at a step."""

    begin_ns: int
    steady_ns: int
    end_ns: int | None = None
    mark_ns: int = -1
    results: list[ExpectationResult] = field(default_factory=list)
    publishers: list[tuple[PeriodicPublisher, float]] = field(default_factory=list)
    active_publishers: list[PeriodicPublisher] = field(default_factory=list)
    to_restore: list[tuple[str, str, object]] = field(default_factory=list)


class ProcedureRunner:
    """Runs one procedure.

    Args:
        environment: what it runs against.
        attempts: largest number of attempts at a step; 0: as the procedure defines.
        timeout_margin: wall time added to each timeout [s].
        confirmed: whether motion is confirmed already.
        is_stopped: whether the operator has stopped the rehearsal.
    """

    def __init__(
        self,
        environment: ProcedureEnvironment,
        *,
        attempts: int = 0,
        timeout_margin: float = 3.0,
        confirmed: bool = False,
        is_stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        self._environment = environment
        self._attempts = attempts
        self._timeout_margin = timeout_margin
        self._motion_confirmed: bool | None = True if confirmed else None
        self._is_stopped = is_stopped
        self._armed = False
        self._step_results: dict[str, ProcedureStepResult] = {}

    def run(self, procedure: Procedure) -> tuple[tuple[ProcedureStepResult, ...], bool]:
        """Run all steps; disarm the drives at the end if a step armed them.

        Returns:
            The result of each step, and whether all steps had their turn.
        """
        completed = False
        try:
            for number, (name, step) in enumerate(procedure.steps.items(), 1):
                self._environment.report_progress(
                    f"[{number}/{len(procedure.steps)}] {name}: {step.title}"
                )
                attempts = self._attempts or step.attempts or procedure.attempts
                step_result = self._run_step(name, step, attempts)
                self._step_results[name] = step_result
                self._report_result(step_result)
            completed = True
        except RehearsalStoppedError:
            self._environment.report_progress("stopped by the operator")
        finally:
            self._disarm()
        for name, step in procedure.steps.items():
            self._step_results.setdefault(
                name, _step_not_run(name, step, "the rehearsal was stopped before this step")
            )
        return tuple(self._step_results[name] for name in procedure.steps), completed

    # --- one step --------------------------------------------------------------------------------

    def _run_step(self, name: str, step: Step, attempts: int) -> ProcedureStepResult:
        environment = self._environment
        invalid_attempts: list[str] = []
        try:
            self._check_preconditions(step)
            self._listen(step.subscribed_topics)
            while True:
                environment.history.discard_old()
                wall_ns = environment.wall_ns()
                attempt = self._attempt(step)
                failed = any(each.result is Result.FAIL for each in attempt.results)
                if failed:
                    self._check_command_source(step, attempt)
                depends_on_time = failed or InterfaceRule(step.rule) in TIMED
                why = self._invalidity(attempt) if depends_on_time else ""
                if why:
                    invalid_attempts.append(why)
                    if len(invalid_attempts) < attempts:
                        environment.report_progress(f"    repeated: {why}")
                        continue
                return ProcedureStepResult(
                    name,
                    step.title,
                    InterfaceRule(step.rule),
                    f"{len(invalid_attempts)} invalid attempts, last: {why}" if why else "",
                    _invalidated(attempt.results) if why else tuple(attempt.results),
                    tuple(invalid_attempts),
                    attempt.begin_ns,
                    max([environment.now_ns(), *(each.end_ns for each in attempt.results)]),
                    wall_ns,
                    environment.wall_ns(),
                )
        except PreconditionError as error:
            return _step_not_run(name, step, str(error))

    def _listen(self, names: tuple[str, ...]) -> None:
        """Subscribe to the topics of a step, and wait for a message on each available one."""
        environment = self._environment
        environment.listen(names)
        self._wait_for(
            lambda: all(
                environment.history.of(name) or not environment.is_available(name) for name in names
            )
        )

    def _check_preconditions(self, step: Step) -> None:
        for name in step.after:
            if self._step_results[name].result is not Result.PASS:
                raise PreconditionError(f"step {name} has not passed")
        for name in step.needs:
            if not self._wait_for(lambda name=name: self._environment.is_available(name)):  # type: ignore[misc]
                raise PreconditionError(f"{name} is not available")
        if step.moves and self._motion_confirmed is None:
            try:
                self._motion_confirmed = self._environment.request_answer(
                    "confirm_motion",
                    "The following steps may move the machine. Is the area clear, and may it move?",
                )
            except PreconditionError:
                self._motion_confirmed = False
        if step.moves and not self._motion_confirmed:
            raise PreconditionError("motion was not confirmed")

    def _check_command_source(self, step: Step, attempt: _Attempt) -> None:
        """A failure is invalid where another command source owns a commanded topic."""
        window = EvaluationWindow(self._environment.history, attempt.begin_ns)
        for topic in step.published:
            owned = partial(is_refusal, subject=topic, code=RefusalCode.OWNED)
            refusal = next(window.statuses(topics.DIAGNOSTICS, attempt.begin_ns, owned), None)
            if refusal is not None:
                raise PreconditionError(
                    f"stop the other command source first: {refusal[1].message}"
                )

    def _attempt(self, step: Step) -> _Attempt:
        environment = self._environment
        attempt = _Attempt(environment.now_ns(), environment.steady_ns())
        with contextlib.ExitStack() as afterwards:
            afterwards.callback(self._restore, attempt)
            afterwards.callback(self._stop_publishers, attempt)
            for action in step.do:
                attempt.end_ns = None
                self._perform(action, attempt)
            self._stop_publishers(attempt)
            end_ns = environment.now_ns() if attempt.end_ns is None else attempt.end_ns
            window = EvaluationWindow(
                environment.history, attempt.begin_ns, end_ns, attempt.mark_ns
            )
            self._wait_for(
                lambda: all(each.is_decided(window, environment.now_ns()) for each in step.expect),
                self._longest_wait(step),
            )
            for expectation in step.expect:
                attempt.results += expectation.evaluate(window)
        return attempt

    def _longest_wait(self, step: Step) -> float:
        """Longest wait for the expectations of a step [s]."""
        within = [getattr(each, "within", 0.0) for each in step.expect]
        return max([0.0, *within]) + self._timeout_margin

    def _wait_for(self, condition: Callable[[], bool], timeout: float | None = None) -> bool:
        """Wait for a condition; returns whether it was met in time."""
        limit = self._timeout_margin if timeout is None else timeout
        since_ns = self._environment.steady_ns()
        while not condition():
            self._check_stopped()
            if (self._environment.steady_ns() - since_ns) * 1e-9 > limit:
                return False
            self._environment.wait(_POLL_PERIOD)
        return True

    def _check_stopped(self) -> None:
        if self._is_stopped():
            raise RehearsalStoppedError

    def _wait(self, time: float) -> None:
        """Wait for a time of the machine's clock [s], bounded by the steady clock."""
        environment = self._environment
        end_ns, since_ns = environment.now_ns() + round(time * 1e9), environment.steady_ns()
        while (left := (end_ns - environment.now_ns()) * 1e-9) > 0.0:
            self._check_stopped()
            if (environment.steady_ns() - since_ns) * 1e-9 > time + self._timeout_margin:
                return
            environment.wait(min(left, _POLL_PERIOD))

    # --- actions ---------------------------------------------------------------------------------

    def _perform(self, action: Action, attempt: _Attempt) -> None:
        self._check_stopped()
        if isinstance(action, Wait):
            self._wait(action.duration)
        elif isinstance(action, Mark):
            attempt.mark_ns = self._environment.now_ns()
        elif isinstance(action, Publish):
            self._publish(action, attempt)
        elif isinstance(action, BeyondLimits):
            attempt.results.append(self._test_limits(action))
        elif isinstance(action, CallAction):
            attempt.results.append(self._call(action))
        elif isinstance(action, SetParameter):
            self._set(action.node, action.parameter, action.value, attempt, keep=action.keep)
        elif isinstance(action, Impair):
            self._set(EMULATOR, "impairments", action.text, attempt)
        elif isinstance(action, Prompt):
            self._environment.request_action(action.key, action.instruction)
        elif isinstance(action, Inspection):
            attempt.results.append(self._inspect(action))

    def _set(
        self, node: str, name: str, value: object, attempt: _Attempt, *, keep: bool = False
    ) -> None:
        before = self._environment.parameter(node, name)
        if not keep:
            attempt.to_restore.append((node, name, before))
        self._environment.set_parameter(node, name, value)

    def _publish(self, action: Publish, attempt: _Attempt) -> None:
        environment = self._environment
        if not self._wait_for(lambda: environment.has_subscriber(action.topic)):
            raise PreconditionError(f"{action.topic} has no subscriber")
        joints = {
            name: JointValue(*(self._value(amount) for amount in joint.amounts()))
            for name, joint in action.joints.items()
        }

        def make(now_ns: int) -> OutgoingMessage:
            stamp_ns = 0 if action.unstamped else max(1, now_ns - round(action.age * 1e9))
            return OutgoingMessage(stamp_ns, joints, action.omit)

        if not action.duration and not action.throughout:
            now_ns = environment.now_ns()
            environment.send(action.topic, make(now_ns))
            attempt.end_ns = now_ns
            return
        publisher = environment.send_periodically(action.topic, make, action.period)
        attempt.publishers.append((publisher, action.period))
        attempt.active_publishers.append(publisher)
        if not action.throughout:
            self._wait(action.duration)
            publisher.stop()
            attempt.active_publishers.remove(publisher)
            attempt.end_ns = publisher.last_stamp_ns

    def _value(self, amount: Amount) -> float:
        if not isinstance(amount, MachineReading):
            return amount
        if not self._wait_for(lambda: self._environment.history.last(amount.topic) is not None):
            raise PreconditionError(f"no message on {amount.topic}, whose {amount.field} is used")
        message = self._environment.history.last(amount.topic)
        if message is None:
            raise AssertionError("the message was received before")
        value: float = dict(message.sample.scalars())[amount.field]
        return amount.scale * value + amount.offset

    def _test_limits(self, action: BeyondLimits) -> ExpectationResult:
        environment, topic = self._environment, action.topic
        if not self._wait_for(lambda: environment.has_subscriber(topic)):
            raise PreconditionError(f"{topic} has no subscriber")
        begin_ns = environment.now_ns()
        is_beyond = partial(is_refusal, subject=topic, code=RefusalCode.OUT_OF_LIMITS)

        def refusals() -> int:
            window = EvaluationWindow(environment.history, begin_ns)
            return len(list(window.statuses(topics.DIAGNOSTICS, 0, is_beyond)))

        messages, accepted = action.messages(), []
        for path, joints in messages:
            # A node reports only the last of the refusals that it holds back: one at a time, each
            # is reported.
            before = refusals()
            environment.send(topic, OutgoingMessage(environment.now_ns(), joints))
            if not self._wait_for(
                lambda before=before: refusals() > before,  # type: ignore[misc]
                action.timeout + self._timeout_margin,
            ):
                name, _, part = path.partition(".")
                accepted.append(f"{path} {getattr(joints[name], part):g}")
        measured = f"{len(messages) - len(accepted)} of {len(messages)}"
        if accepted:
            measured += f"; not refused: {', '.join(accepted)}"
        return ExpectationResult(
            Result.FAIL if accepted else Result.PASS,
            f"refused values of {topic} just beyond each limit of the contract",
            "all, as out_of_limits",
            measured,
            (topic, topics.DIAGNOSTICS),
            begin_ns,
            environment.now_ns(),
        )

    def _call(self, action: CallAction) -> ExpectationResult:
        environment = self._environment
        begin_ns = environment.now_ns()
        if action.service == topics.DRIVES_ARM and action.data:
            self._armed = True
        answer = environment.call(
            action.service, action.data, action.timeout + self._timeout_margin
        )
        passed = answer.success is action.success
        given = "" if action.data is None else f"({str(action.data).lower()})"
        return ExpectationResult(
            Result.PASS if passed else Result.FAIL,
            f"response of {action.service}{given}",
            "accepted" if action.success else "refused",
            f"{'accepted' if answer.success else 'refused'}: {answer.message}",
            (topics.EVENTS, topics.DIAGNOSTICS),
            begin_ns,
            environment.now_ns(),
        )

    def _inspect(self, action: Inspection) -> ExpectationResult:
        begin_ns = self._environment.now_ns()
        passed = self._environment.request_answer(action.key, action.question)
        return ExpectationResult(
            Result.PASS if passed else Result.FAIL,
            action.question,
            "yes (operator)",
            "yes" if passed else "no",
            (),
            begin_ns,
            self._environment.now_ns(),
        )

    def _stop_publishers(self, attempt: _Attempt) -> None:
        for publisher in attempt.active_publishers:
            publisher.stop()
        attempt.active_publishers.clear()

    def _restore(self, attempt: _Attempt) -> None:
        for node, name, before in reversed(attempt.to_restore):
            try:
                self._environment.set_parameter(node, name, before)
            except PreconditionError as error:
                self._environment.report_progress(f"    {node} {name} was not restored: {error}")
        if attempt.to_restore:
            self._wait_for_recovery()
        attempt.to_restore.clear()

    def _wait_for_recovery(self) -> None:
        """Wait until all devices on the link answer again, so that the next step finds them so."""
        history, since_ns = self._environment.history, self._environment.steady_ns()

        def is_recovered() -> bool:
            last = history.last(topics.LINK_STATUS)
            if last is None or last.sample is None:
                return True
            links = [each for each in last.sample.statuses if each.name.endswith(": link")]
            return last.steady_ns > since_ns and all(each.level is Level.OK for each in links)

        self._wait_for(is_recovered)

    def _disarm(self) -> None:
        """Disarm the drives if a step armed them: a rehearsal leaves no armed machine."""
        if not self._armed:
            return
        try:
            answer = self._environment.call(topics.DRIVES_ARM, False, self._timeout_margin)
        except PreconditionError as error:
            self._environment.report_progress(f"NOT DISARMED: {error}")
            return
        done = "disarmed" if answer.success else f"NOT DISARMED: {answer.message}"
        self._environment.report_progress(f"after the last step: {done}")

    # --- validity of an attempt ------------------------------------------------------------------

    def _invalidity(self, attempt: _Attempt) -> str:
        """Why an attempt is invalid; empty: it is valid."""
        environment = self._environment
        longest_stall = environment.longest_stall(attempt.steady_ns)
        for publisher, period in attempt.publishers:
            late = publisher.longest_interval - period
            if late > _JITTER_LIMIT:
                return f"the rehearsal published a command {late:.2g} s late"
        if longest_stall > _JITTER_LIMIT:
            return f"the rehearsal stalled for {longest_stall:.2g} s"
        last = environment.history.last(topics.SIM_STATUS)
        if last is None:
            return ""
        end_ns = environment.steady_ns()

        def are_reported() -> bool:
            reports = (
                environment.history.last(name) for name in (topics.SIM_STATUS, topics.LINK_STATUS)
            )
            return all(each is not None and each.steady_ns > end_ns for each in reports)

        self._wait_for(are_reported, _STATUS_TIMEOUT)
        return timing_fault(environment.history, attempt.steady_ns)

    def _report_result(self, step_result: ProcedureStepResult) -> None:
        why = f": {step_result.reason}" if step_result.reason else ""
        self._environment.report_progress(f"    {step_result.result.value}{why}")
        for result in step_result.results:
            if result.result is Result.FAIL:
                self._environment.report_progress(
                    f"      {result.description}: {result.measured} (expected: {result.expected})"
                )


def _invalidated(results: list[ExpectationResult]) -> tuple[ExpectationResult, ...]:
    """Results of an invalid attempt: all NOT RUN."""
    return tuple(replace(result, result=Result.NOT_RUN) for result in results)


def _step_not_run(name: str, step: Step, reason: str) -> ProcedureStepResult:
    return ProcedureStepResult(name, step.title, InterfaceRule(step.rule), reason)
