"""The winch on the spatial plant: descent, touchdown, load monitoring, safety, modes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from msg_schemas.faults import WinchFault
from msg_schemas.machine import (
    WINCH_AT_RATE,
    WINCH_AT_TENSION,
    WINCH_SLACK,
    WINCH_TO_LENGTH,
)
from msg_schemas.phases import JumpPhase, WinchMode
from msg_schemas.refusal import Refusal
from rover_verify.checks import Batch, Measured
from rover_verify.checks.winch_rig import Readings, SensorErrors, Session
from rover_verify.checks.winch_spatial import SpatialRig, on_floor, trial_rig
from rover_verify.checks.winch_trials import TrialPlan, TrialResult, draw_plan, run_trial
from rover_verify.winch_flight import flight_of_session
from tether_winch.winch import Winch, WinchParameters

_ERRORS = SensorErrors(cell_noise=0.1, cell_bias=0.05, rate_noise=0.002, current_noise=0.01)
_TOP, _BOTTOM, _RATE = 2.2, 45.0, 0.3


def session_on(rig: SpatialRig, errors: SensorErrors = _ERRORS, seed: int = 0) -> Session:
    """An armed winch on a rig."""
    session = Session(Winch(WinchParameters()), rig, errors, np.random.default_rng(seed))
    session.arm()
    session.run(0.5)
    return session


# --- descent ------------------------------------------------------------------------------------


@cache
def descent(seed: int) -> Session:
    """From the top to 45 m and back at 0.3 m/s."""
    session = session_on(SpatialRig({"tether.length": _TOP}), seed=seed)
    session.request(WINCH_TO_LENGTH, _BOTTOM, _RATE)
    session.run_until_rest(200.0)
    session.run(5.0)
    session.request(WINCH_TO_LENGTH, _TOP, _RATE)
    session.run_until_rest(200.0)
    session.run(2.0)
    return session


def length_error(batch: Batch) -> Measured:
    """Largest distance of the drum's length from its reference."""
    flight = flight_of_session(descent(batch.seed))
    note = f"{_TOP:g} to {_BOTTOM:g} m and back at {_RATE:g} m/s"
    curve = flight.distance_from_curve()
    return Measured(flight.length_error(), note, {"from an S-curve that does not wait [m]": curve})


def overshoot(batch: Batch) -> Measured:
    """Overshoot of the drum beyond its setpoints."""
    return Measured(flight_of_session(descent(batch.seed)).overshoot())


def ripple(batch: Batch) -> Measured:
    """Tension about its slow rise in steady payout, RMS over the mean; the worse direction."""
    ripples = flight_of_session(descent(batch.seed)).ripple()
    return Measured(max(ripples.values()), details=ripples)


# --- load monitoring ---------------------------------------------------------------------------


class Trial(NamedTuple):
    """One random descent with its result."""

    plan: TrialPlan
    result: TrialResult
    touches: int  # wall contacts


@cache
def trial(seed: int, index: int) -> Trial:
    """One descent of a batch."""
    rng = np.random.default_rng([seed, index])
    plan = draw_plan(rng)
    rig = trial_rig(plan)
    try:
        return Trial(plan, run_trial(plan, rig, rng), rig.touches)
    except RuntimeError as error:
        raise RuntimeError(f"descent {index} of seed {seed}: {error}") from error


def trials(batch: Batch) -> list[Trial]:
    """The batch's descents."""
    flown = []
    for index in range(batch.runs):
        flown.append(trial(batch.seed, index))
        batch.progress(index + 1, batch.runs)
    return flown


# Rows of the table: conditions of the descents in a row.
_GROUPS: Mapping[str, Callable[[Trial], bool]] = {
    "all": lambda _: True,
    "hard stops": lambda t: t.result.hard_stops > 0,
    "the wall touched": lambda t: t.touches > 0,
    "swing above 5 deg": lambda t: t.plan.swing > math.radians(5.0),
    "a snag": lambda t: t.result.snags > 0,
    "a snag, swing above 0.1 m/s": lambda t: t.result.snags > 0 and t.plan.swing_speed > 0.1,
    "load cell noise above 0.2 N": lambda t: t.plan.errors.cell_noise > 0.2,
    "payload below 0.85": lambda t: t.plan.payload < 0.85,
    "payload above 1.15": lambda t: t.plan.payload > 1.15,
    "friction below 0.8": lambda t: t.plan.friction < 0.8,
    "friction above 1.5": lambda t: t.plan.friction > 1.5,
    "floor deeper than 30 m": lambda t: t.plan.floor_depth > 30.0,
}


class Tally(NamedTuple):
    """A row of the table: descents with a condition, and errors of the load monitor."""

    name: str
    descents: int
    hard_stops: int
    touches: int  # wall contacts
    snags: int
    touchdowns_missed: int  # descents, as the rest
    touchdowns_false: int
    snags_missed: int
    snags_false: int
    slack_false: int

    def __str__(self) -> str:
        """One line of text."""
        counts = [f"{name.replace('_', ' ')} {n}" for name, n in self._asdict().items()]
        return ", ".join(counts[1:])


def as_table(lines: Sequence[Tally]) -> str:
    """The table as text, in columns."""
    heads = (
        ("descents", "with ..."), ("", "descents"), ("hard", "stops"), ("touches", "of the wall"),
        ("", "snags"), ("touchdown", "missed"), ("touchdown", "false"), ("snag", "missed"),
        ("snag", "false"), ("slack", "false"),
    )  # fmt: skip
    widths = [max(len(line.name) for line in lines)]
    widths += [max(map(len, head)) for head in heads[1:]]

    def row(cells: Sequence[object]) -> str:
        first, *rest = zip(cells, widths, strict=True)
        return "  ".join([f"{first[0]:<{first[1]}}", *(f"{cell!s:>{w}}" for cell, w in rest)])

    return "\n".join([row([h[0] for h in heads]), row([h[1] for h in heads]), *map(row, lines)])


def tally(trials: Sequence[Trial]) -> list[Tally]:
    """Errors of the load monitor by the conditions of a descent."""
    lines = []
    for name, belongs in _GROUPS.items():
        chosen = [trial for trial in trials if belongs(trial)]
        results = [trial.result for trial in chosen]
        lines.append(
            Tally(
                name,
                len(results),
                sum(r.hard_stops for r in results),
                sum(trial.touches for trial in chosen),
                sum(r.snags for r in results),
                sum(r.touchdown_missed for r in results),
                sum(r.touchdown_false for r in results),
                sum(r.snag_missed for r in results),
                sum(r.snag_false for r in results),
                sum(r.slack_false for r in results),
            )
        )
    return lines


def _counted(batch: Batch, what: Callable[[TrialResult], bool], *, share: bool) -> Measured:
    flown = trials(batch)
    wrong = [index for index, one in enumerate(flown) if what(one.result)]
    lines = tally(flown)
    every = lines[0]
    note = (
        f"{len(wrong)} of {len(flown)} descents with {every.hard_stops} hard stops, "
        f"{every.touches} wall contacts and {every.snags} snags"
    )
    if wrong:
        note += f"; descents {', '.join(map(str, wrong))}"
    value = len(wrong) / len(flown) if share else float(len(wrong))
    return Measured(value, note, {line.name: str(line) for line in lines})


def touchdown_missed(batch: Batch) -> Measured:
    """Descents with a missed touchdown."""
    return _counted(batch, lambda result: result.touchdown_missed, share=False)


def touchdown_false(batch: Batch) -> Measured:
    """Share of descents with a false touchdown."""
    return _counted(batch, lambda result: result.touchdown_false, share=True)


def snag_missed(batch: Batch) -> Measured:
    """Descents with a missed snag."""
    return _counted(batch, lambda result: result.snag_missed, share=False)


def snag_false(batch: Batch) -> Measured:
    """Share of descents with a false snag."""
    return _counted(batch, lambda result: result.snag_false, share=True)


def touchdown_slack(batch: Batch) -> Measured:
    """Most slack after touchdowns at 0.1 m/s, high, in the middle and at 46 m."""
    slack = {}
    for depth in (6.0, 16.0, 46.0):
        rig = SpatialRig({"tether.length": depth - 1.0, **on_floor(depth)})
        session = session_on(rig, seed=batch.seed)
        session.request(WINCH_TO_LENGTH, depth + 4.0, 0.1)
        session.run(20.0)
        found = session.winch.load.is_supported and session.winch.servo.is_at_rest
        slack[f"{depth:g} m"] = rig.slack if found else math.inf
    return Measured(max(slack.values()), details=slack)


# --- safety -------------------------------------------------------------------------------------


class _Case(NamedTuple):
    """One case of an unsafe motion.

    Attributes:
        fault: what must be latched; None = the winch must be stopped.
        spoil: corrupts the sensor readings; None = no reading.
        act: what else happens.
    """

    fault: WinchFault | None
    spoil: Callable[[Readings], Readings | None] = lambda readings: readings
    act: Callable[[Session], None] = lambda _session: None


class _Spoilt(Session):
    """A session with corruptible sensors."""

    spoil: Callable[[Readings], Readings | None] = staticmethod(lambda readings: readings)

    def _on_readings(self, readings: Readings) -> None:
        spoilt = self.spoil(readings)
        if spoilt is not None:
            super()._on_readings(spoilt)


def _run_away() -> Callable[[Readings], Readings]:
    begun: list[float] = []

    def spoil(readings: Readings) -> Readings:
        begun.append(readings.length)
        return readings._replace(rate=1.0, length=begun[0] + 0.01 * len(begun))

    return spoil


def _end_here(session: Session) -> None:
    winch = session.winch
    values = winch.parameters
    ended = _replaced(values, longest_length=winch.payout.length, soft_margin=0.0)
    winch.retune(ended)


def _replaced(parameters: WinchParameters, **values: float) -> WinchParameters:
    return replace(parameters, servo=replace(parameters.servo, **values))


def _cases() -> dict[str, _Case]:
    return {
        "drum silent": _Case(WinchFault.DRUM_LOST, lambda _: None),
        "length NaN": _Case(
            WinchFault.BAD_READING,
            act=lambda s: s.winch.latch(WinchFault.BAD_READING, "length is not a number", s.now_ns),
        ),
        "clock jump": _Case(WinchFault.CLOCK_JUMP, act=lambda s: s.winch.clock_jumped(s.now_ns)),
        "overspeed": _Case(WinchFault.OVERSPEED, _run_away()),
        "over-tension": _Case(WinchFault.OVER_TENSION, lambda r: r._replace(tension=80.0)),
        "tension NaN": _Case(WinchFault.TENSION_LOST, lambda r: r._replace(tension=math.nan)),
        "tether end": _Case(WinchFault.TETHER_END, act=_end_here),
        "node stop": _Case(None, act=lambda s: s.winch.stop("the node stops", s.now_ns)),
        "command timeout": _Case(WinchFault.COMMAND_TIMEOUT),
    }


def _in_fault(case: _Case) -> tuple[_Spoilt, SpatialRig]:
    """Pay out at 0.3 m/s, apply the case, and run for some seconds."""
    rig = SpatialRig({"tether.length": 10.0})
    session = _Spoilt(Winch(WinchParameters()), rig)
    session.arm()
    joint, value = WINCH_TO_LENGTH, (40.0, _RATE)
    if case.fault is WinchFault.COMMAND_TIMEOUT:
        joint, value = WINCH_AT_RATE, (0.0, _RATE)
    session.request(joint, *value)
    session.run(0.9)
    if joint == WINCH_AT_RATE:
        session.request(joint, *value)
    session.run(0.9)
    case.act(session)
    session.spoil = case.spoil
    session.run(3.0)
    return session, rig


def unsafe_cases(_batch: Batch) -> Measured:
    """Cases that do not end braked, without torque, in a latched fault with its reason."""
    wrong = []
    for name, case in _cases().items():
        session, rig = _in_fault(case)
        winch, drum = session.winch, rig.state.drives.drum
        safe = (
            winch.mode is (WinchMode.STOP if case.fault is None else WinchMode.FAULT)
            and winch.fault is case.fault
            and bool(session.transitions[-1][1].message)
            and drum.braked
            and drum.rate == 0.0
            and session.ticks[-1].torque == 0.0
        )
        if not safe:
            wrong.append(f"{name}: {winch.mode} {winch.fault} {winch.fault_reason}")
    return Measured(float(len(wrong)), "; ".join(wrong) or f"{len(_cases())} cases")


def motions_after_fault(_batch: Batch) -> Measured:
    """Requests after a fault that move the drum before it is armed again."""
    moved = 0
    requests = (
        (WINCH_TO_LENGTH, 5.0, 0.2, 0.0),
        (WINCH_AT_RATE, 0.0, -0.1, 0.0),
        (WINCH_AT_TENSION, 0.0, 0.1, 20.0),
        (WINCH_SLACK, 0.0, 0.1, 0.0),
    )
    for case in _cases().values():
        session, rig = _in_fault(case)
        session.spoil = lambda readings: readings
        length = rig.state.length
        for request in requests:
            try:
                session.request(*request)
                moved += 1
            except Refusal:
                pass
            session.run(0.2)
        moved += rig.state.length != length
    return Measured(float(moved))


def refusals_without_reason(_batch: Batch) -> Measured:
    """Refused requests whose reason does not name the cause."""
    session = session_on(SpatialRig({"tether.length": 10.0}))
    requests: list[tuple[str, float, float, float, str]] = [
        (WINCH_TO_LENGTH, 59.0, 0.2, 0.0, "59.0"),
        (WINCH_TO_LENGTH, 20.0, 0.45, 0.0, "0.45"),
        (WINCH_AT_RATE, 0.0, -0.45, 0.0, "-0.45"),
        (WINCH_AT_RATE, 0.0, 0.1, 900.0, "900.0"),
        (WINCH_AT_TENSION, 0.0, 0.1, 0.05, "without end"),
        (WINCH_AT_TENSION, 0.0, 0.1, 2.0, "hangs"),
        (WINCH_SLACK, 1.0, 0.1, 0.0, "set it down first"),
    ]
    lacking = [request for request in requests if not _is_refused(session, request)]
    session.winch.on_jump(JumpPhase.FLIGHT, session.now_ns)
    if not _is_refused(session, (WINCH_TO_LENGTH, 5.0, 0.2, 0.0, "a jump is in progress")):
        lacking.append((WINCH_TO_LENGTH, 5.0, 0.2, 0.0, "a jump is in progress"))
    session.winch.stop("a test", session.now_ns)
    requests += [(WINCH_TO_LENGTH, 20.0, 0.2, 0.0, "rearm")]
    if not _is_refused(session, requests[-1]):
        lacking.append(requests[-1])
    return Measured(float(len(lacking)), ", ".join(str(item) for item in lacking))


def _is_refused(session: Session, request: tuple[str, float, float, float, str]) -> bool:
    joint, position, velocity, effort, words = request
    try:
        session.request(joint, position, velocity, effort)
    except Refusal as refusal:
        return words in refusal.reason
    return False


def mode_step(batch: Batch) -> Measured:
    """Largest step of the motor's torque from tick to tick at a change of mode, over its limit."""
    session = session_on(SpatialRig({"tether.length": 10.0}), SensorErrors(), batch.seed)
    winch = session.winch
    for joint, position, velocity, effort, time in (
        (WINCH_TO_LENGTH, 14.0, 0.2, 0.0, 3.0),
        (WINCH_AT_RATE, 0.0, 0.1, 0.0, 0.8),
        (WINCH_AT_TENSION, 0.0, 0.1, 16.0, 0.8),
        (WINCH_AT_RATE, 0.0, -0.2, 0.0, 0.8),
        (WINCH_TO_LENGTH, 9.0, 0.3, 0.0, 2.0),
        (WINCH_AT_RATE, 0.0, 0.3, 0.0, 0.9),
    ):
        session.request(joint, position, velocity, effort)
        session.run(time)
    winch.hold(session.now_ns)
    session.run(3.0)
    torque, times = session.column("torque"), session.column("time")
    steps = np.abs(np.diff(torque)) / winch.parameters.drum.motor_torque
    near = np.zeros(steps.shape, dtype=bool)
    for at, _ in session.transitions:
        near |= (times[1:] >= at - 0.005) & (times[1:] <= at + 0.05)
    return Measured(float(steps[near].max()), f"{len(session.transitions)} changes")
