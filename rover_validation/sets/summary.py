"""``mother_rover validate summary``: what the laws predict of a folder of measured sets.

The folder holds `cables/NAME/identify/*.csv` and `cables/NAME/check/*.csv`, and
`wheels/NAME/measured.csv` with `wheels/NAME/indentation.json`; either may be missing. `source.txt`
in `cables/` and `wheels/` states by whom the sets were measured. A cable is identified from the
takes in `identify`, unless `cables/NAME/cable.yaml` holds what `validate cable identify` wrote, and
judged by the takes in `check`. Runs of a wheel are predicted from the other runs.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import yaml

from msg_schemas.regular_files import read_text
from rover_validation.cable import comparison as cable_comparison
from rover_validation.cable.comparison import CableErrors, has_free_markers
from rover_validation.cable.identification import identify as identify_cable
from rover_validation.cable.model import Cable, check_distances
from rover_validation.cable.takes import read_takes
from rover_validation.refusals import OK, SetError, refusing
from rover_validation.wheel.comparison import (
    GroupErrors,
    compare,
    largest_errors,
    predicted_by_others,
)
from rover_validation.wheel.fitting import NUMBER_UNITS
from rover_validation.wheel.fitting import identify as identify_soil
from rover_validation.wheel.sets import read_indentation, read_runs

NOT_STATED: Final = "not stated"
_LONGEST_SOURCE: Final = 4000
"""Size of the largest `source.txt` [byte]."""


@dataclass(frozen=True)
class SummaryNumber:
    """An identified number.

    Attributes:
        name: of the number.
        value: best fit.
        low, high: 95 % interval.
        unit: of the three.
        remark: why it is no property that was measured; empty if it is one.
    """

    name: str
    value: float
    low: float
    high: float
    unit: str
    remark: str


@dataclass(frozen=True)
class CableSummary:
    """An identified cable and its predictions.

    Attributes:
        name: of the set's folder.
        takes: that it was identified from.
        numbers: identified.
        errors: of the takes that it predicts.
    """

    name: str
    takes: int
    numbers: tuple[SummaryNumber, ...]
    errors: CableErrors


@dataclass(frozen=True)
class WheelSummary:
    """A measured wheel and its predictions.

    Attributes:
        name: of the set's folder.
        runs: their number.
        settings: number of different settings.
        numbers: identified from all runs.
        errors: of runs predicted from the others.
        largest: descriptions of the largest errors.
    """

    name: str
    runs: int
    settings: int
    numbers: tuple[SummaryNumber, ...]
    errors: tuple[GroupErrors, ...]
    largest: tuple[str, ...]


@dataclass(frozen=True)
class Summary:
    """What the laws predict of measured sets.

    Attributes:
        cable_source, wheel_source: by whom the sets were measured.
        cables: by name.
        wheels: by name.
    """

    cable_source: str
    wheel_source: str
    cables: tuple[CableSummary, ...]
    wheels: tuple[WheelSummary, ...]

    def to_mapping(self) -> dict[str, Any]:
        """Plain values for YAML, numbers with five digits."""
        mapping = _rounded(asdict(self))
        assert isinstance(mapping, dict)
        return mapping

    @classmethod
    def from_mapping(cls, content: Mapping[str, Any]) -> Summary:
        """Read what `to_mapping` returned.

        Raises:
            KeyError, TypeError, ValueError: it is none.
        """
        return cls(
            str(content["cable_source"]),
            str(content["wheel_source"]),
            tuple(
                CableSummary(
                    **{**each, "numbers": _numbers(each), "errors": CableErrors(**each["errors"])}
                )
                for each in content["cables"]
            ),
            tuple(
                WheelSummary(
                    **{
                        **each,
                        "numbers": _numbers(each),
                        "errors": tuple(
                            GroupErrors(**{**group, "rms": tuple(group["rms"])})
                            for group in each["errors"]
                        ),
                        "largest": tuple(each["largest"]),
                    }
                )
                for each in content["wheels"]
            ),
        )


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _rounded(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(each) for each in value]
    return float(f"{value:.5g}") if isinstance(value, float) else value


def _numbers(content: Mapping[str, Any]) -> tuple[SummaryNumber, ...]:
    return tuple(SummaryNumber(**each) for each in content["numbers"])


def summarise_cable(folder: Path, keep: Path) -> CableSummary:
    """Identify a cable where `cable.yaml` is missing, and predict its check takes.

    Args:
        folder: `cables/NAME` of a folder of sets.
        keep: folder in which an identified cable is kept, and found again.

    Raises:
        SetError: takes are missing or damaged.
    """
    identified = read_takes(folder / "identify")
    takes = [take for take in read_takes(folder / "check") if has_free_markers(take)]
    if not takes:
        raise SetError(f"{folder / 'check'}: no take has free markers to compare with")
    path = folder / "cable.yaml"
    if not path.exists():
        path = keep / f"{folder.name}.yaml"
    if not path.exists():
        keep.mkdir(parents=True, exist_ok=True)
        path.write_text(identify_cable(identified).cable.to_yaml(), encoding="utf-8")
    cable = Cable.read(path)
    for take in takes:
        check_distances(folder / "check" / f"{take.name}.csv", cable.geometry.arcs, take)
    numbers = tuple(
        SummaryNumber(each.name, each.value, each.low, each.high, each.unit, each.remark)
        for each in cable.numbers
    )
    return CableSummary(
        folder.name, len(identified), numbers, cable_comparison.compare(cable, takes)
    )


def summarise_wheel(folder: Path) -> WheelSummary:
    """Identify the soil of a measured wheel, and predict its runs from each other.

    Args:
        folder: `wheels/NAME` of a folder of sets.

    Raises:
        SetError: a file is missing or damaged.
    """
    runs = read_runs(folder / "measured.csv")
    indentation = read_indentation(folder / "indentation.json")
    whole = identify_soil(runs, indentation)
    centre, half = predicted_by_others(runs, indentation)
    numbers = []
    for name in whole.found.names:
        low, high = whole.interval[name]
        value, remark = float(getattr(whole.found.soil, name)), whole.remarks.get(name, "")
        unit = NUMBER_UNITS.get(name, "-")
        numbers.append(SummaryNumber(name, value, float(low), float(high), unit, remark))
    return WheelSummary(
        folder.name,
        len(runs.wheel),
        len(set(runs.settings())),
        tuple(numbers),
        tuple(compare(runs, centre, half)),
        tuple(largest_errors(runs, centre - runs.measured, whole.found.scatter)),
    )


def set_folders(folder: Path, kind: str) -> Sequence[Path]:
    """Folders of the sets of a kind, `cables` or `wheels`, by name."""
    return sorted(path for path in (folder / kind).glob("*") if path.is_dir())


def summarise(folder: Path, keep: Path) -> Summary:
    """Summarise all sets of a folder.

    Raises:
        SetError: it holds no set, or one is damaged.
    """
    cables, wheels = (set_folders(folder, kind) for kind in ("cables", "wheels"))
    if not cables and not wheels:
        raise SetError(f"{folder}: holds neither cables/NAME nor wheels/NAME")
    return Summary(
        _source(folder / "cables"),
        _source(folder / "wheels"),
        tuple(summarise_cable(each, keep) for each in cables),
        tuple(summarise_wheel(each) for each in wheels),
    )


def _source(folder: Path) -> str:
    path = folder / "source.txt"
    if not path.exists():
        return NOT_STATED
    try:
        return " ".join(read_text(path, _LONGEST_SOURCE).split())
    except UnicodeDecodeError as error:
        raise SetError(f"{path}: cannot be read as text: {error}") from None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "Identify and predict all measured sets of a folder: cables/NAME/identify/*.csv, "
        "cables/NAME/check/*.csv, wheels/NAME/measured.csv and wheels/NAME/indentation.json. "
        "A cables/NAME/cable.yaml that `validate cable identify` wrote is used as it is. Exit "
        "codes: 0 written, 2 a file is refused."
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="summary.yaml",
        help="file to write; cables that are identified are kept beside it",
    )  # fmt: skip


@refusing("summary")
def run(options: argparse.Namespace) -> int:
    """Summarise; 2 after a refusal."""
    summary = summarise(options.folder, options.out.parent / "cables")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    text = yaml.safe_dump(summary.to_mapping(), sort_keys=False, allow_unicode=True, width=100)
    options.out.write_text(text, encoding="utf-8")
    for cable in summary.cables:
        errors = cable.errors
        print(
            f"{cable.name}: {errors.takes} takes, error {errors.mean:.1f} mm, "
            f"{errors.coverage:.0%} in the band, {errors.width:.1f} mm wide"
        )
    for wheel in summary.wheels:
        for group in wheel.errors:
            forward, sideways, sinkage = group.rms
            print(
                f"{wheel.name}, {group.label}: {group.runs} runs, RMS error {forward:.2f} N, "
                f"{sideways:.2f} N, {sinkage:.2f} mm, {group.coverage:.0%} in the band"
            )
    print(f"Written: {options.out}")
    return OK
