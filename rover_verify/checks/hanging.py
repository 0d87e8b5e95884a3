"""Descent, damping and ascent of the hanging rover: batches on the spatial plant with its sensors.

Each run has random sensor errors, random directions of swing, heading and disturbance, and errors
of mass and friction of up to 20 %.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from msg_schemas import machine
from msg_schemas.events import DescentEvent
from rover_verify.checks import CheckBatch, Measured, per_run
from rover_verify.checks.flights import fly_batch
from rover_verify.checks.hanging_flight import HangingFlight, HangingStart, Picture

STOPS = (7.5, 15.0, 22.5, 30.0, 37.5, 45.0)  # [m]
DISTURBANCE_LENGTH, DISTURBANCE = 30.0, math.radians(1.5)
_STANDING = 1e-3  # payout rate of a standing drum [m/s]
_LEARNT = 10.0  # settling time of the swing estimate after a disturbance [s]
LONGEST = 1200.0  # duration limit of a descent [s]
LOOKS = (2.0, 7.5, 15.0, 30.0, 45.0)  # lengths of the looks with a yaw bias [m]
YAW_BIAS = 3.0  # largest, in standard deviations
_LOOK_LIMIT = 1400.0  # time of a look [s]
_OFF = 0.2  # relative error of mass and friction
ALL = "everything"
MODES = {
    ALL: (True, True),
    "winch only": (True, False),
    "wheels only": (False, True),
    "everything off": (False, False),
}


class HangingDescent(NamedTuple):
    """Result of one descent."""

    duration: float  # [s]; NaN = not done within the limit
    settled: int  # stops with pictures
    reasons: tuple[str, ...]  # of stops without
    unexplained: int  # stops without pictures or reason
    pictures: tuple[Picture, ...]
    budget_reports: int  # reports of a saturated axis
    unreported: int  # axes that left their budget without a report


def draw(rng: np.random.Generator, length: float, major: float, minor: float) -> HangingStart:
    """Random start: directions, sensor errors, mass and friction."""
    plane, heading = rng.uniform(0.0, 360.0, 2)
    tilt = rng.uniform(-1.0, 1.0, 2)
    mass, friction = rng.uniform(1.0 - _OFF, 1.0 + _OFF, 2)
    return HangingStart(
        length=length,
        major=major,
        minor=minor,
        plane=float(plane),
        heading=float(heading),
        tilt=(float(tilt[0]), float(tilt[1])),
        mass=float(mass),
        friction=float(friction),
        seed=int(rng.integers(2**31)),
    )


def descend(seed: int, index: int, mode: str = ALL) -> HangingDescent:
    """One descent from 2 m to 45 m with six stops and a disturbance."""
    rng = np.random.default_rng([seed, index])
    winch, rotors = MODES[mode]
    flight = HangingFlight(draw(rng, 2.0, 3.0, 1.5), {"uses_winch": winch, "uses_rotors": rotors})
    direction = float(rng.uniform(0.0, math.tau))
    flight.begin()
    began = flight.time
    for depth in STOPS:
        flight.stop_at(depth)

    def arrives() -> bool:
        away = abs(flight.state.length - DISTURBANCE_LENGTH)
        return away < 0.02 and abs(flight.plant.payout_rate(flight.state)) < _STANDING

    if flight.run(LONGEST, arrives):
        flight.disturb(DISTURBANCE, direction)
    done = flight.run_until_idle(began + LONGEST - flight.time)
    ended = flight.ended_stops
    reasons = tuple(each.status.message for each in flight.events_named(DescentEvent.STOP_FAILED))
    reports = flight.events_named(DescentEvent.BUDGET_EXHAUSTED)
    unreported = sum(  # rotors that left their budget before a report
        not any(each.time <= spent and each.values["rotor"] == rotor for each in reports)
        for rotor, spent in flight.spent.items()
    )
    return HangingDescent(
        duration=flight.time - began if done else math.nan,
        settled=sum(int(values["pictures"]) > 0 for values in ended),
        reasons=reasons,
        unexplained=len(STOPS) - len(ended),
        pictures=tuple(flight.pictures),
        budget_reports=len(reports),
        unreported=unreported,
    )


def damp(seed: int, index: int, length: float) -> float:
    """Time [s] until 3 deg of plane swing have decayed below 0.3 deg; NaN = not in 1500 s."""
    rng = np.random.default_rng([seed, index])
    # On a long tether pictures need less damping: require a steady rover without a time limit.
    steady = {"damped_swing_rate": 0.0008, "steady_dwell": 60.0, "stop_timeout": 1500.0}
    flight = HangingFlight(draw(rng, length, 3.0, 0.0), steady)
    flight.begin()
    flight.stop_at(length)
    damped = flight.run(1500.0, lambda: flight.true_swing().major < math.radians(0.3))
    return flight.time if damped else math.nan


def watch(seed: int, index: int) -> tuple[float, float]:
    """RMS errors of the swing's amplitudes and of the yaw rate, 40 s to 60 s after the start."""
    rng = np.random.default_rng([seed, index])
    length, major = float(rng.uniform(2.0, 45.0)), float(rng.uniform(0.3, 3.0))
    minor = float(rng.uniform(-0.8, 0.8)) * major
    flight = HangingFlight(draw(rng, length, major, minor))
    flight.run(40.0)
    amplitudes, yaws = [], []
    for _ in range(40):
        flight.run(0.5)
        true, estimate = flight.true_swing(), flight.swing
        amplitudes += [estimate.ellipse.major - true.major, estimate.ellipse.minor - true.minor]
        yaws.append(estimate.yaw_rate - float(flight.state.omega[2]))
    return (
        math.sqrt(float(np.mean(np.square(amplitudes)))),
        math.sqrt(float(np.mean(np.square(yaws)))),
    )


def disturbed_error(seed: int, index: int) -> float:
    """Largest error of the swing amplitude [rad], 10 s to 25 s after a disturbance."""
    rng = np.random.default_rng([seed, index])
    length, swing = float(rng.uniform(7.5, 45.0)), math.radians(rng.uniform(0.5, 2.0))
    flight = HangingFlight(draw(rng, length, 0.15, 0.05))
    flight.begin()
    flight.stop_at(length, observes=False)
    flight.run(45.0)
    flight.disturb(swing, float(rng.uniform(0.0, math.tau)))
    flight.run(_LEARNT)
    worst = 0.0
    for _ in range(150):
        flight.run(0.1)
        worst = max(worst, abs(flight.swing.ellipse.major - flight.true_swing().major))
    return worst


def ascend(seed: int, index: int) -> float:
    """Swing [rad] after an ascent from 45 m to 2 m that began with a cone of 0.3 by 0.3 deg."""
    rng = np.random.default_rng([seed, index])
    flight = HangingFlight(draw(rng, 45.0, 0.3, 0.3))
    flight.begin()
    flight.stop_at(2.0, observes=False)
    flight.run_until_idle(3000.0)
    return flight.true_swing().major


class LookResult(NamedTuple):
    """Result of one observation stop."""

    length: float  # [m]
    swings: bool
    duration: float  # [s]
    is_taken: bool  # all pictures, each within the smear limit
    error: float  # of the yaw bias at the end [rad/s]
    reason: str  # of a stop without pictures


def look(seed: int, index: int, turns: float) -> LookResult:
    """One stop with a yaw bias, calm and swinging in turn; a wound tether begins at 2 m."""
    rng = np.random.default_rng([seed, index])
    lengths = LOOKS[1:] if turns > 0.0 else LOOKS
    length, swings = lengths[index // 2 % len(lengths)], index % 2 == 1
    major, minor = rng.uniform(0.1, 0.5), rng.uniform(-0.5, 0.5)
    start = draw(rng, length, major * swings, major * minor * swings)
    bias = math.copysign(YAW_BIAS, rng.uniform(-1.0, 1.0))
    if index // (2 * len(LOOKS)) % 2 == 1:
        bias = rng.uniform(-YAW_BIAS, YAW_BIAS)
    if turns > 0.0:
        start = replace(start, length=LOOKS[0], turns=float(rng.uniform(-turns, turns)))
    flight = HangingFlight(
        replace(start, yaw_bias=float(bias), tilt=start.tilt if swings else (0.0, 0.0))
    )
    flight.begin()
    began = flight.time
    flight.stop_at(length)
    flight.run_until_idle(_LOOK_LIMIT)
    failed = flight.events_named(DescentEvent.STOP_FAILED)
    exposures = flight.descent.settings.hanging_controller.profile.exposures
    sharp = sum(picture.smear <= machine.SHARP_SMEAR for picture in flight.pictures)
    return LookResult(
        length,
        swings,
        flight.time - began,
        sharp == exposures,
        flight.swing.yaw_rate - float(flight.state.omega[2]),
        failed[0].status.message if failed else "",
    )


# --- batches ------------------------------------------------------------------------------------


def _descents(batch: CheckBatch) -> Sequence[HangingDescent]:
    return fly_batch(batch, batch.runs, descend)


def estimate_error(batch: CheckBatch) -> Measured:
    """Worst RMS error of the swing's two amplitudes."""
    errors = np.degrees(fly_batch(batch, batch.runs, watch))
    return Measured(
        float(errors[:, 0].max()),
        f"{len(errors)} runs, median {np.median(errors[:, 0]):.3f} deg; yaw rate worst "
        f"{errors[:, 1].max():.3f} deg/s",
    )


def error_after_disturbance(batch: CheckBatch) -> Measured:
    """Worst error of the swing amplitude from 10 s after a disturbance on."""
    errors = np.degrees(fly_batch(batch, batch.runs, disturbed_error))
    return Measured(
        float(errors.max()), f"{len(errors)} disturbances, median {np.median(errors):.3f} deg"
    )


def missed_looks(batch: CheckBatch, turns: float) -> Measured:
    """Observation stops with a yaw bias that did not take all their pictures sharp."""
    looks = fly_batch(batch, max(batch.runs, 2 * len(LOOKS)), look, turns)
    missed = [each for each in looks if not each.is_taken]
    worst = math.degrees(max(abs(each.error) for each in looks))
    note = f"{len(looks)} looks, error of the yaw rate at the end at most {worst:.3f} deg/s, "
    note += f"longest {max(each.duration for each in looks):.0f} s"
    return Measured(len(missed), note, per_run(looks))


def unexplained_stops(batch: CheckBatch) -> Measured:
    """Stops that neither settled nor gave a reason."""
    flown = _descents(batch)
    settled = sum(each.settled for each in flown)
    return Measured(
        sum(each.unexplained for each in flown),
        f"{len(flown)} descents: {settled} of {len(STOPS) * len(flown)} stops settled, "
        f"{sum(len(each.reasons) for each in flown)} stops ended with a reason",
    )


def steady_pictures(batch: CheckBatch) -> Measured:
    """Share of the pictures within the smear limit; NaN without pictures."""
    smears = [picture.smear for each in _descents(batch) for picture in each.pictures]
    if not smears:
        return Measured(math.nan, "no pictures were taken")
    good = float(np.mean(np.array(smears) <= machine.SHARP_SMEAR))
    return Measured(
        good,
        f"{len(smears)} pictures, smear median {np.median(smears):.2f} px, worst "
        f"{max(smears):.2f} px, limit {machine.SHARP_SMEAR:.2f} px",
    )


def longest_descent(batch: CheckBatch) -> Measured:
    """Duration of the longest descent."""
    times = [each.duration for each in _descents(batch)]
    worst = math.nan if any(math.isnan(each) for each in times) else max(times)
    return Measured(worst, f"median {np.nanmedian(times):.0f} s")


def modes_as_good(batch: CheckBatch) -> Measured:
    """Number of reduced modes that settle as many stops as winch and wheels together."""
    settled: dict[str, int] = {}
    lines: dict[str, float | str] = {}
    for mode in MODES:
        flown = _descents(batch) if mode == ALL else fly_batch(batch, batch.runs, descend, mode)
        smears = [picture.smear for each in flown for picture in each.pictures]
        good = sum(smear <= machine.SHARP_SMEAR for smear in smears)
        times = [LONGEST if math.isnan(each.duration) else each.duration for each in flown]
        settled[mode] = sum(each.settled for each in flown)
        lines[mode] = (
            f"{settled[mode]} of {len(STOPS) * len(flown)} stops settled, {good} of {len(smears)} "
            f"pictures within the limit, {np.median(times):.0f} s, at worst {max(times):.0f} s"
        )
    rivals = [mode for mode in MODES if mode != ALL and settled[mode] >= settled[ALL]]
    return Measured(len(rivals), f"{len(MODES)} times {batch.runs} descents", lines)


def damping_time(batch: CheckBatch, length: float) -> Measured:
    """Worst time for 3 deg of plane swing at a length [m]."""
    times = fly_batch(batch, batch.runs, damp, length)
    return Measured(float(np.max(times)), f"{len(times)} runs, median {np.nanmedian(times):.0f} s")


def attitude_error(batch: CheckBatch) -> Measured:
    """RMS of the tilt against the tether in all pictures, the worse axis."""
    tilts = [picture.tilt for each in _descents(batch) for picture in each.pictures]
    if not tilts:
        return Measured(math.nan, "no pictures were taken")
    rms = np.degrees(np.sqrt(np.mean(np.square(tilts), axis=0)))
    return Measured(float(rms.max()), f"{rms[0]:.3f} deg about x, {rms[1]:.3f} deg about y")


def unsaid_budgets(batch: CheckBatch) -> Measured:
    """Descents in which a rotor left its budget without a report."""
    flown = _descents(batch)
    reports = sum(each.budget_reports for each in flown)
    return Measured(sum(each.unreported > 0 for each in flown), f"{reports} reports")


def swing_after_ascent(batch: CheckBatch) -> Measured:
    """Worst swing at the end of an ascent."""
    swings = np.degrees(fly_batch(batch, batch.runs, ascend))
    return Measured(float(np.max(swings)), f"median {np.median(swings):.2f} deg")


def cone_momentum(batch: CheckBatch) -> Measured:
    """Relative difference of the momentum lost by a pumped cone and gained by the spin."""
    flight = HangingFlight(HangingStart(2.5, 2.0, 1.9, swivel_friction=0.0, seed=batch.seed))
    flight.begin()
    flight.stop_at(2.5, observes=False)
    flight.run(12.0)
    before = flight.true_momentum()
    flight.run(60.0)
    after = flight.true_momentum()
    lost, gained = before[0] - after[0], after[1] - before[1]
    note = f"the cone lost {lost:.4f} N m s, the rover's spin gained {gained:.4f} N m s"
    return Measured(abs(lost - gained) / abs(lost), note)
