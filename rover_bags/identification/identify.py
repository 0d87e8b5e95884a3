"""``mother_rover bag identify``: estimate machine parameters from recorded runs by least squares.

The runs are simulated repeatedly with other parameter values until the predicted readings fit the
recorded ones best. The initial state of each run (swing, tilt, angular velocity) and the sensor
biases (`noise`) are estimated as well. Parameters that the runs do not excite are reported with the
reason and stay as configured (`fit`).
"""

import argparse
import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.stats import norm

from msg_schemas.number_arguments import positive, seed
from rover_bags.files.store import BagError
from rover_bags.identification.dry_run import record_dry_run
from rover_bags.identification.fit import CORRELATED, WIDE, Fit, Fitted
from rover_bags.identification.parameters import PARAMETERS, IdentifyError, value_of
from rover_bags.identification.runs import IdentificationRun, read_experiments
from rover_bags.identification.workers import simulations
from rover_bags.reading.read import ReadError
from rover_sim import ScenarioError, available_cores, parse_override

CONFIDENCE: Final = 0.95
_MISFIT_LIMIT: Final = 1.5
"""Misfit, over the specified noise, from which it is reported."""


@dataclass(frozen=True)
class Estimate:
    """Estimate of one parameter.

    Attributes:
        name, unit: name and unit of the parameter.
        guess: first guess: the configured value, unless another was given.
        value: best fit; the guess if the parameter is not identifiable.
        low, high: simultaneous interval: all intervals of one identification hold the true values
            jointly with a probability of 95 % (Bonferroni). 0 and inf if not identifiable.
        individual: 95 % interval of this parameter alone.
        error: relative standard error, enlarged to the width of the individual interval; inf if not
            identifiable.
        identifiable: whether the runs determine it.
        reason: why not, or its correlated parameters.
    """

    name: str
    unit: str
    guess: float
    value: float
    low: float
    high: float
    individual: tuple[float, float]
    error: float
    identifiable: bool
    reason: str = ""

    def covers(self, value: float) -> bool:
        """Return whether the interval contains a value."""
        return self.low <= value <= self.high


@dataclass(frozen=True)
class SignalFit:
    """Fit of one signal.

    Attributes:
        run, signal: run and signal.
        readings: number of readings used.
        excluded: number of readings excluded, as the plant's response is not smooth there.
        misfit: RMS of the innovations; 1 for the specified noise.
        white: whether the innovations are uncorrelated in time.
    """

    run: str
    signal: str
    readings: int
    excluded: int
    misfit: float
    white: bool


@dataclass(frozen=True)
class Identification:
    """Result of an identification.

    Attributes:
        runs: names of the runs.
        estimates: estimates of the parameters.
        signals: fits of the signals.
        singular_values: singular values of the readings' derivatives by the parameters' logarithms,
            over the noise, largest first.
        simulations: number of simulations made.
        converged: whether the search converged.
        notes: limitations of the result.
    """

    runs: tuple[str, ...]
    estimates: tuple[Estimate, ...]
    signals: tuple[SignalFit, ...]
    singular_values: tuple[float, ...]
    simulations: int
    converged: bool
    notes: tuple[str, ...]

    @property
    def complete(self) -> bool:
        """Whether every requested parameter is identifiable and the search converged."""
        return self.converged and all(one.identifiable for one in self.estimates)

    def text(self) -> str:
        """Return the result as text for a terminal."""
        readings = sum(one.readings for one in self.signals)
        interval_head = f"{CONFIDENCE:.0%} interval (simultaneous)"
        lines = [
            *self.runs,
            f"{readings} readings of {len(self.signals)} signals, {self.simulations} simulations",
            f"  {'parameter':16s}{'unit':8s}{'guess':>11s}{'estimate':>11s}   {interval_head}",
        ]
        for one in self.estimates:
            found = f"{one.value:.4g}" if one.identifiable else "-"
            interval = f"{one.low:.4g} .. {one.high:.4g}" if one.identifiable else "unbounded"
            lines.append(f"  {one.name:16s}{one.unit:8s}{one.guess:11.4g}{found:>11s}   {interval}")
        lines += [f"! {one.name}: {one.reason}" for one in self.estimates if one.reason]
        lines += [f"! {note}" for note in self.notes]
        return "\n".join(lines)

    def to_mapping(self) -> dict[str, Any]:
        """Return plain values for JSON; an unknown bound is null."""
        return {
            "runs": list(self.runs),
            "converged": self.converged,
            "complete": self.complete,
            "confidence": CONFIDENCE,
            "simulations": self.simulations,
            "singular_values": list(self.singular_values),
            "parameters": {
                one.name: {
                    "unit": one.unit,
                    "guess": one.guess,
                    "value": one.value if one.identifiable else None,
                    "low": one.low if one.identifiable else None,
                    "high": _finite(one.high),
                    "low_individual": one.individual[0] if one.identifiable else None,
                    "high_individual": _finite(one.individual[1]),
                    "relative_error": _finite(one.error),
                    "identifiable": one.identifiable,
                    "reason": one.reason,
                }
                for one in self.estimates
            },
            "signals": [vars(one) for one in self.signals],
            "notes": list(self.notes),
        }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


# --- identification -------------------------------------------------------------------------------


def identify(
    bags: Sequence[Path],
    names: Sequence[str] | None = None,
    *,
    guesses: Mapping[str, float] | None = None,
    begin: float = 0.0,
    end: float = math.inf,
    namespace: str | None = None,
    jobs: int = 1,
    show_progress: bool = False,
) -> Identification:
    """Estimate parameters of the machine from recorded runs.

    Args:
        bags: bags of the same machine.
        names: names of `parameters.PARAMETERS` to estimate; None: all that the machine has.
        guesses: first guesses; by default the configured values.
        begin: time after each start from which readings are used [s].
        end: time after each start until which readings are used [s].
        namespace: namespace of the rover, if the bags hold several.
        jobs: number of simulating processes.
        show_progress: whether to show a progress bar.

    Raises:
        IdentifyError: the bags or the request cannot be identified.
        BagError: a bag cannot be read.
    """
    if not bags:
        raise IdentifyError("no bag is given; name at least one")
    experiments = [
        one
        for path in bags
        for one in read_experiments(path, begin=begin, end=end, namespace=namespace)
    ]
    start = _guesses(experiments, names, guesses or {})
    with simulations(experiments, jobs=jobs, show_progress=show_progress) as predictor:
        fitted = Fit(experiments, start, predictor).solve()
        made = predictor.runs
    signals = _signals(experiments, fitted)
    return Identification(
        runs=tuple(one.name for one in experiments),
        estimates=_estimates(start, fitted),
        signals=signals,
        singular_values=tuple(float(value) for value in fitted.singular_values),
        simulations=made,
        converged=fitted.converged,
        notes=(
            *(f"{one.name}: {one.remark}" for one in experiments if one.remark),
            *_notes(signals, converged=fitted.converged),
        ),
    )


def _guesses(
    experiments: Sequence[IdentificationRun],
    names: Sequence[str] | None,
    given: Mapping[str, float],
) -> dict[str, float]:
    own = {name: [value_of(one.scenario, name) for one in experiments] for name in PARAMETERS}
    for name in (*(names or ()), *given):
        if name not in own:
            raise IdentifyError(
                f"unknown parameter {name!r}: it should be one of {', '.join(PARAMETERS)}"
            )
    start = {}
    for name in dict.fromkeys([*names, *given]) if names is not None else PARAMETERS:
        values = own[name]
        first = values[0]
        if first is None or any(value is None for value in values):
            if names is None:
                continue
            raise IdentifyError(
                f"{name} ({PARAMETERS[name].path}) is missing, 0 or infinite in the recorded "
                "scenario: it cannot be estimated"
            )
        if any(value != first for value in values):
            raise IdentifyError(
                f"{name} is {', '.join(f'{value:g}' for value in values if value is not None)} in "
                "the recorded scenarios: record all bags with the same machine"
            )
        start[name] = float(given.get(name, first))
        if not 0.0 < start[name] < math.inf:
            raise IdentifyError(f"the guess of {name} is {start[name]}: it should be above 0")
    if not start:
        raise IdentifyError(
            f"no parameter can be estimated; choose some of {', '.join(PARAMETERS)}"
        )
    return start


def _estimates(start: Mapping[str, float], fitted: Fitted) -> tuple[Estimate, ...]:
    count = max(1, int(np.count_nonzero(fitted.identifiable)))
    together = float(norm.ppf(1.0 - 0.5 * (1.0 - CONFIDENCE) / count))
    alone = float(norm.ppf(1.0 - 0.5 * (1.0 - CONFIDENCE)))
    errors = np.sqrt(np.diag(fitted.covariance))
    found = []
    for place, (name, guess) in enumerate(start.items()):
        unit, error = PARAMETERS[name].unit, float(errors[place])
        value = guess * math.exp(float(fitted.logs[place]))
        correlations = _correlations(place, list(start), fitted)
        if not fitted.identifiable[place]:
            words = _reason(float(fitted.strength[place]), error, correlations)
            unbounded = (0.0, math.inf)
            found.append(
                Estimate(name, unit, guess, guess, *unbounded, unbounded, math.inf, False, words)
            )
            continue
        low, high = (guess * math.exp(bound) for bound in fitted.interval(place, together))
        bounds = fitted.interval(place, alone)
        own = (guess * math.exp(bounds[0]), guess * math.exp(bounds[1]))
        error = max(error, (bounds[1] - bounds[0]) / (2.0 * alone))
        words = "; ".join(
            [
                *([f"correlated with {', '.join(correlations)}"] if correlations else []),
                *(
                    f"{value * math.exp(offset):.4g} fits nearly as well and is in the interval"
                    for offset in _other_values(place, fitted, together)
                ),
            ]
        )
        found.append(Estimate(name, unit, guess, value, low, high, own, error, True, words))
    return tuple(found)


def _other_values(place: int, fitted: Fitted, limit: float) -> list[float]:
    """Offsets of further minima that fit, separated from the best one."""
    profile = fitted.profiles.get(place)
    return [] if profile is None else [float(each) for each in profile.others(limit)]


def _correlations(place: int, names: Sequence[str], fitted: Fitted) -> list[str]:
    errors = np.sqrt(np.diag(fitted.covariance))
    tied = fitted.covariance[place] / (errors[place] * errors)
    moved = fitted.strength > 0.0
    return [
        f"{name} (correlation {tied[other]:+.2f})"
        for other, name in enumerate(names)
        if other != place and moved[place] and moved[other] and abs(tied[other]) > CORRELATED
    ]


def _reason(strength: float, error: float, correlations: Sequence[str]) -> str:
    if strength * WIDE < 1.0:
        return (
            "not identifiable: it has no effect on the recorded readings; a change by a factor of "
            f"e moves them by {strength:.2g} times their noise in total"
        )
    if correlations:
        return f"not identifiable separately from {', '.join(correlations)}"
    if error <= WIDE:
        return "not identifiable: values more than a factor of two apart fit equally well"
    return (
        "not identifiable: other parameters or the unknown initial state have the same effect; the "
        f"standard error is a factor of {math.exp(min(error, 30.0)):.2g}"
    )


def _signals(experiments: Sequence[IdentificationRun], fitted: Fitted) -> tuple[SignalFit, ...]:
    coloured = set(fitted.coloured)
    return tuple(
        SignalFit(
            one.name,
            str(signal),
            int(fitted.counts[number][place]),
            int(fitted.excluded[number][place]),
            float(fitted.scales[number][place]),
            (number, place) not in coloured,
        )
        for number, one in enumerate(experiments)
        for place, signal in enumerate(one.signals)
    )


def _notes(signals: Sequence[SignalFit], *, converged: bool) -> tuple[str, ...]:
    notes = [] if converged else ["the search did not converge"]
    for one in signals:
        misfits = []
        if one.misfit > _MISFIT_LIMIT and one.readings:
            misfits.append(f"has a misfit of {one.misfit:.2g} times its specified noise")
        if not one.white:
            misfits.append("has residuals that are correlated in time")
        if misfits:
            notes.append(
                f"{one.signal} of {one.run} {' and '.join(misfits)}: the model does not explain "
                "this signal fully; check for a delayed command, another wrong parameter, or a "
                "sensor noisier than specified"
            )
    return tuple(notes)


# --- the executable -------------------------------------------------------------------------------


class IdentifyExitCode(IntEnum):
    """Exit codes of ``mother_rover bag identify``."""

    IDENTIFIED = 0
    NOT_ALL = 1
    REFUSED = 2


# fmt: off
def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    listed = "\n".join(f"  {name}: {one.about} [{one.unit}]" for name, one in PARAMETERS.items())
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.description = (
        "Estimate parameters of the machine from recorded runs, by least squares of the sensor\n"
        "readings against the simulated plant, with intervals that contain all true values\n"
        "jointly with a probability of 95 %. Parameters that the runs do not excite are listed,\n"
        "not estimated."
    )
    parser.epilog = (
        f"parameters:\n{listed}\n\nexit codes: 0 every parameter is identified, 1 the runs do not "
        "excite all of them, 2 refused"
    )
    add = parser.add_argument
    add("bags", nargs="*", type=Path, metavar="BAG", help="bags of one machine: folders or files")
    add("-p", "--parameter", action="append", metavar="NAME[=GUESS]",
        help="parameter to estimate, with an optional first guess; repeatable (default: all)")
    add("--from", dest="begin", type=float, default=0.0, metavar="S",
        help="use readings from S seconds after each start")
    add("--until", dest="end", type=float, default=math.inf, metavar="S",
        help="use readings until S seconds after each start")
    add("--namespace", metavar="NS", help="namespace of the rover, if the bags hold several")
    add("--jobs", type=positive, default=available_cores(), metavar="N",
        help="number of simulating processes (default: %(default)d)")
    add("--json", action="store_true", help="print the result as JSON")
    add("--dry-run", type=Path, metavar="FOLDER",
        help="simulate the identification procedure first; record its bags into this folder")
    add("--seed", type=seed, help="seed of the dry run's sensors (default: 0)")
    add("--set", action="append", default=[], metavar="PATH=VALUE",
        help="true value of the machine in a dry run, if not as configured")
# fmt: on


def _requested(texts: Sequence[str] | None) -> tuple[list[str] | None, dict[str, float]]:
    if texts is None:
        return None, {}
    names, guesses = [], {}
    for text in texts:
        name, sign, guess = text.partition("=")
        names.append(name)
        if sign:
            try:
                guesses[name] = float(guess)
            except ValueError:
                raise IdentifyError(f"the guess in {text!r} should be a number") from None
    return names, guesses


def run(options: argparse.Namespace) -> int:
    """Run the command; return an :class:`IdentifyExitCode`."""
    try:
        if options.dry_run is None and (options.set or options.seed is not None):
            raise IdentifyError("--set and --seed are those of a dry run: give --dry-run as well")
        if not 0.0 <= options.begin < options.end:
            raise IdentifyError(
                f"--from is {options.begin:g} and --until {options.end:g}: they should be at least "
                "0 and in this order"
            )
        names, guesses = _requested(options.parameter)
        bags = list(options.bags)
        if options.dry_run is not None:
            true_values = dict(parse_override(text) for text in options.set)
            bags += record_dry_run(options.dry_run, true_values, seed=options.seed or 0)
        found = identify(
            bags,
            names,
            guesses=guesses,
            begin=options.begin,
            end=options.end,
            namespace=options.namespace,
            jobs=options.jobs,
            show_progress=sys.stderr.isatty(),
        )
    except (BagError, ReadError, ScenarioError) as error:
        print(f"mother_rover bag identify: {error}", file=sys.stderr)
        return IdentifyExitCode.REFUSED
    print(json.dumps(found.to_mapping(), indent=2) if options.json else found.text())
    return IdentifyExitCode.IDENTIFIED if found.complete else IdentifyExitCode.NOT_ALL
