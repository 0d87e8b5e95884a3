"""``mother_rover validate wheel predict``: forces and sinkage in given settings."""

from __future__ import annotations

import argparse
from pathlib import Path

from rover_sim import STEEPEST_WHEEL
from rover_validation.refusals import OK, check_target, refusing
from rover_validation.wheel.fitting import bands, check_wheels, within_validity
from rover_validation.wheel.sets import MEASURED, read_runs, read_soil, write_table

VALIDITY = "within_validity"
_LIMIT = f"{STEEPEST_WHEEL:g} deg"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.description = (
        "Predict forward force, sideways force and sinkage of a wheel, with 90 % bands, in columns "
        f"of the same names and ..._lo, ..._hi. Beyond {_LIMIT} between travel and wheel plane the "
        f"law does not hold: the column {VALIDITY} is 0 there."
    )
    parser.add_argument("soil", type=Path, metavar="soil.yaml")
    parser.add_argument("settings", type=Path, metavar="SETTINGS.csv")
    parser.add_argument("--out", type=Path, required=True, metavar="PREDICTED.csv")


@refusing("wheel predict")
def run(options: argparse.Namespace) -> int:
    """Predict and write the table; 2 after a refusal."""
    check_target(options.out, options.settings)
    found = read_soil(options.soil)
    runs = read_runs(options.settings, measured=False)
    check_wheels(found.wheels, runs, str(options.settings))
    centre, half = bands(found, runs)
    valid = within_validity(runs)
    added = [*(f"{name}{end}" for name in MEASURED for end in ("", "_lo", "_hi")), VALIDITY]
    kept = [i for i, name in enumerate(runs.columns) if name not in added]
    rows = []
    for i, row in enumerate(runs.rows):
        cells = [row[j] for j in kept]
        for j, scale in enumerate((1.0, 1.0, 1e3)):
            value, width = centre[i, j] * scale, half[i, j] * scale
            cells += [f"{x:.4f}" for x in (value, value - width, value + width)]
        rows.append([*cells, str(int(valid[i]))])
    write_table(options.out, [*(runs.columns[j] for j in kept), *added], rows)
    outside = int((~valid).sum())
    print(f"{len(rows)} runs predicted, {outside} of them beyond {_LIMIT}: {options.out}")
    return OK
