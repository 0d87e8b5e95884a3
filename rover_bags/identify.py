"""``mother_rover bag identify``: estimates machine parameters from recorded runs by least squares.

The recorded runs are simulated again and again, with other values of the parameters that are
sought, until the sensors' readings come out as well as they can. How each run began (its swing, its
tilt, its turning) is sought with them, and so are the sensors' biases (`noise`). What the
runs do not show is named with the reason instead of being estimated (`fit`).
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

from rover_bags.files.store import BagError
from rover_bags.identification.dry_run import rehearse
from rover_bags.identification.fit import TIED, WIDE, Fit, Fitted
from rover_bags.identification.parameters import PARAMETERS, IdentifyError, value_of
from rover_bags.identification.runs import Experiment, read_experiments
from rover_bags.identification.workers import simulations
from rover_bags.read import ReadError
from rover_sim import ScenarioError, available_cores, parse_override

CONFIDENCE: Final = 0.95
_LOUD: Final = 1.5
"""Times the sensors' stated noise: misfits that are told."""


@dataclass(frozen=True)
class Estimate:
    """What was found of one parameter.

    Attributes:
        name, unit: which.
        guess: where the search began: the configured value, or the one that was given.
        value: best fit; the guess where the runs do not show the parameter.
        low, high: interval; all those of one identification hold the true values together with a
            probability of 95 % (Bonferroni). 0 and inf where the runs do not show the parameter.
        alone: 95 % interval of this parameter alone.
        error: standard error, relative to the value, or what the interval makes of it where that
            is wider than derivatives say; inf where it is not shown.
        shown: whether the runs show it.
        words: why not, or with what it is tied.
    """

    name: str
    unit: str
    guess: float
    value: float
    low: float
    high: float
    alone: tuple[float, float]
    error: float
    shown: bool
    words: str = ""

    def covers(self, value: float) -> bool:
        """Whether the interval holds a value."""
        return self.low <= value <= self.high


@dataclass(frozen=True)
class SignalFit:
    """How the readings of one signal come out.

    Attributes:
        run, signal: which.
        readings: that were used.
        left_out: that were not, as the plant's answer is not smooth there.
        misfit: root mean square of what remains, over the sensor's stated noise.
        white: whether it is not correlated in time.
    """

    run: str
    signal: str
    readings: int
    left_out: int
    misfit: float
    white: bool


@dataclass(frozen=True)
class Identification:
    """What recorded runs tell of the machine.

    Attributes:
        runs: their names.
        estimates: of the parameters sought.
        signals: how their readings come out.
        singular: singular values of the readings' derivatives by the parameters' logarithms, over
            the noise, largest first.
        simulations: that were made.
        converged: whether the search came to its end.
        notes: what limits the result.
    """

    runs: tuple[str, ...]
    estimates: tuple[Estimate, ...]
    signals: tuple[SignalFit, ...]
    singular: tuple[float, ...]
    simulations: int
    converged: bool
    notes: tuple[str, ...]

    @property
    def complete(self) -> bool:
        """Whether every parameter sought is shown and the search came to its end."""
        return self.converged and all(one.shown for one in self.estimates)

    def text(self) -> str:
        """For a terminal."""
        readings = sum(one.readings for one in self.signals)
        interval_head = f"{CONFIDENCE:.0%} interval (all together)"
        lines = [
            *self.runs,
            f"{readings} readings of {len(self.signals)} signals, {self.simulations} simulations",
            f"  {'parameter':16s}{'unit':8s}{'guess':>11s}{'found':>11s}   {interval_head}",
        ]
        for one in self.estimates:
            found = f"{one.value:.4g}" if one.shown else "not shown"
            interval = f"{one.low:.4g} .. {one.high:.4g}" if one.shown else "unbounded"
            lines.append(f"  {one.name:16s}{one.unit:8s}{one.guess:11.4g}{found:>11s}   {interval}")
        lines += [f"! {one.name}: {one.words}" for one in self.estimates if one.words]
        lines += [f"! {note}" for note in self.notes]
        return "\n".join(lines)

    def to_mapping(self) -> dict[str, Any]:
        """For machines; an unknown bound is null."""
        return {
            "runs": list(self.runs),
            "converged": self.converged,
            "complete": self.complete,
            "confidence": CONFIDENCE,
            "simulations": self.simulations,
            "singular_values": list(self.singular),
            "parameters": {
                one.name: {
                    "unit": one.unit,
                    "guess": one.guess,
                    "value": one.value if one.shown else None,
                    "low": one.low if one.shown else None,
                    "high": _finite(one.high),
                    "low_alone": one.alone[0] if one.shown else None,
                    "high_alone": _finite(one.alone[1]),
                    "relative_error": _finite(one.error),
                    "shown": one.shown,
                    "words": one.words,
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
    sought: Sequence[str] | None = None,
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
        bags: recorded with the same machine; what one does not show another may.
        sought: names of `parameters.PARAMETERS`; None: all that the machine has.
        guesses: where to begin the search; by default the configured values.
        begin: use what was recorded from so long after each start on [s].
        end: and until so long after it [s].
        namespace: which rover, where the bags hold several.
        jobs: processes that simulate.
        show_progress: whether a progress bar is drawn.

    Raises:
        IdentifyError: nothing can be identified from these bags, or no such parameter.
        BagError: a bag cannot be read.
    """
    if not bags:
        raise IdentifyError("no bag is given")
    experiments = [
        one
        for path in bags
        for one in read_experiments(path, begin=begin, end=end, namespace=namespace)
    ]
    start = _guesses(experiments, sought, guesses or {})
    with simulations(experiments, jobs=jobs, show_progress=show_progress) as predictor:
        fitted = Fit(experiments, start, predictor).solve()
        made = predictor.runs
    signals = _signals(experiments, fitted)
    return Identification(
        runs=tuple(one.name for one in experiments),
        estimates=_estimates(start, fitted),
        signals=signals,
        singular=tuple(float(value) for value in fitted.singular),
        simulations=made,
        converged=fitted.converged,
        notes=(
            *(f"{one.name}: {one.remark}" for one in experiments if one.remark),
            *_notes(signals, converged=fitted.converged),
        ),
    )


def _guesses(
    experiments: Sequence[Experiment], sought: Sequence[str] | None, given: Mapping[str, float]
) -> dict[str, float]:
    own = {name: [value_of(one.scenario, name) for one in experiments] for name in PARAMETERS}
    for name in (*(sought or ()), *given):
        if name not in own:
            raise IdentifyError(f"{name!r} should be one of {', '.join(PARAMETERS)}")
    start = {}
    for name in dict.fromkeys([*sought, *given]) if sought is not None else PARAMETERS:
        values = own[name]
        first = values[0]
        if first is None or any(value is None for value in values):
            if sought is None:
                continue
            raise IdentifyError(
                f"{name} ({PARAMETERS[name].path}) is missing, 0 or infinite in the recorded "
                "scenario: it cannot be sought"
            )
        if any(value != first for value in values):
            raise IdentifyError(
                f"{name} is {', '.join(f'{value:g}' for value in values if value is not None)} in "
                "the recorded scenarios: they should be of the same machine"
            )
        start[name] = float(given.get(name, first))
        if not 0.0 < start[name] < math.inf:
            raise IdentifyError(f"the guess of {name} is {start[name]}, it should be above 0")
    if not start:
        raise IdentifyError(f"nothing can be sought; it should be some of {', '.join(PARAMETERS)}")
    return start


def _estimates(start: Mapping[str, float], fitted: Fitted) -> tuple[Estimate, ...]:
    count = max(1, int(np.count_nonzero(fitted.shown)))
    together = float(norm.ppf(1.0 - 0.5 * (1.0 - CONFIDENCE) / count))
    alone = float(norm.ppf(1.0 - 0.5 * (1.0 - CONFIDENCE)))
    errors = np.sqrt(np.diag(fitted.covariance))
    found = []
    for place, (name, guess) in enumerate(start.items()):
        unit, error = PARAMETERS[name].unit, float(errors[place])
        value = guess * math.exp(float(fitted.logs[place]))
        ties = _ties(place, list(start), fitted)
        if not fitted.shown[place]:
            words = _reason(float(fitted.strength[place]), error, ties)
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
                *([f"tied to {', '.join(ties)}"] if ties else []),
                *(
                    f"{value * math.exp(offset):.4g} fits nearly as well and lies in the interval"
                    for offset in _other_values(place, fitted, together)
                ),
            ]
        )
        found.append(Estimate(name, unit, guess, value, low, high, own, error, True, words))
    return tuple(found)


def _other_values(place: int, fitted: Fitted, limit: float) -> list[float]:
    """Offsets of values that fit, though not all between them and the best one do."""
    profile = fitted.profiles.get(place)
    return [] if profile is None else [float(each) for each in profile.others(limit)]


def _ties(place: int, names: Sequence[str], fitted: Fitted) -> list[str]:
    errors = np.sqrt(np.diag(fitted.covariance))
    tied = fitted.covariance[place] / (errors[place] * errors)
    moved = fitted.strength > 0.0
    return [
        f"{name} (correlation {tied[other]:+.2f})"
        for other, name in enumerate(names)
        if other != place and moved[place] and moved[other] and abs(tied[other]) > TIED
    ]


def _reason(strength: float, error: float, ties: Sequence[str]) -> str:
    if strength * WIDE < 1.0:
        return (
            "not shown: it moves nothing that was recorded; a change by a factor of e moves the "
            f"readings by {strength:.2g} of their noise, all together"
        )
    if ties:
        return f"not shown by itself, only together with {', '.join(ties)}"
    if error <= WIDE:
        return "not shown: values far apart fit alike, by more than a factor of two either way"
    return (
        "not shown by itself: what it moves, other parameters or the unknown start move as well; "
        f"a standard error of a factor {math.exp(min(error, 30.0)):.2g} remains"
    )


def _signals(experiments: Sequence[Experiment], fitted: Fitted) -> tuple[SignalFit, ...]:
    coloured = set(fitted.coloured)
    return tuple(
        SignalFit(
            one.name,
            str(signal),
            int(fitted.counts[number][place]),
            int(fitted.left_out[number][place]),
            float(fitted.scales[number][place]),
            (number, place) not in coloured,
        )
        for number, one in enumerate(experiments)
        for place, signal in enumerate(one.signals)
    )


def _notes(signals: Sequence[SignalFit], *, converged: bool) -> tuple[str, ...]:
    notes = [] if converged else ["the search did not come to its end"]
    for one in signals:
        misfits = []
        if one.misfit > _LOUD and one.readings:
            misfits.append(f"misses by {one.misfit:.2g} times its sensor's stated noise")
        if not one.white:
            misfits.append("is missed in a way that is correlated in time")
        if misfits:
            notes.append(
                f"{one.signal} of {one.run} {' and '.join(misfits)}: the model does not explain "
                "this signal fully; check for a delayed command, another wrong parameter, or a "
                "sensor noisier than specified"
            )
    return tuple(notes)


# --- the executable -------------------------------------------------------------------------------


class ExitCode(IntEnum):
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
        help="what is sought; may be given more than once (default: all that there is)")
    add("--from", dest="begin", type=float, default=0.0, metavar="S",
        help="use readings from so long after each start on")
    add("--until", dest="end", type=float, default=math.inf, metavar="S",
        help="use readings until so long after each start")
    add("--namespace", metavar="NS", help="which rover, if the bags hold several")
    add("--jobs", type=int, default=available_cores(), metavar="N",
        help="processes that simulate (default: %(default)d)")
    add("--json", action="store_true", help="print the result as JSON")
    add("--rehearse", type=Path, metavar="FOLDER",
        help="simulate the procedure first and record its bags into this new folder")
    add("--seed", type=int, default=0, help="of a rehearsal's sensors (default: %(default)d)")
    add("--set", action="append", default=[], metavar="PATH=VALUE",
        help="a value that the rehearsed machine really has, other than configured")
# fmt: on


def _sought(texts: Sequence[str] | None) -> tuple[list[str] | None, dict[str, float]]:
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
    """Run the command; return an :class:`ExitCode`."""
    try:
        if options.jobs < 1:
            raise IdentifyError(f"--jobs is {options.jobs}, it should be at least 1")
        if not 0.0 <= options.begin < options.end:
            raise IdentifyError(
                f"--from is {options.begin:g} and --until {options.end:g}: they should be at least "
                "0 and in this order"
            )
        names, guesses = _sought(options.parameter)
        bags = list(options.bags)
        if options.rehearse is not None:
            really = dict(parse_override(text) for text in options.set)
            bags += rehearse(options.rehearse, really, seed=options.seed)
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
        return ExitCode.REFUSED
    print(json.dumps(found.to_mapping(), indent=2) if options.json else found.text())
    return ExitCode.IDENTIFIED if found.complete else ExitCode.NOT_ALL
