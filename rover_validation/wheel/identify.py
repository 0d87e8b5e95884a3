"""``mother_rover validate wheel identify``: the soil of a measured wheel."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from rover_validation.refusals import OK, refusing
from rover_validation.wheel.comparison import groups
from rover_validation.wheel.fitting import CONFIDENCE, SoilIdentification, identify
from rover_validation.wheel.sets import (
    MEASURED,
    IdentifiedSoil,
    Runs,
    read_indentation,
    read_runs,
    write_soil,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.description = (
        "Fit the wheel-soil law to steady runs of a wheel. The plate law is taken from the "
        "indentation alone, all other numbers from the runs."
    )
    parser.add_argument("measured", type=Path, metavar="MEASURED.csv")
    parser.add_argument("--soil", type=Path, required=True, metavar="INDENTATION.json")
    parser.add_argument("--out", type=Path, required=True, metavar="soil.yaml")


@refusing("wheel identify")
def run(options: argparse.Namespace) -> int:
    """Identify, print the numbers and write the soil; 2 after a refusal."""
    runs = read_runs(options.measured)
    result = identify(runs, read_indentation(options.soil))
    found = result.found
    notes = {
        "measured": options.measured.name,
        "runs": len(runs.wheel),
        "intervals": {
            name: [float(f"{x:.4g}") for x in result.interval[name]] for name in found.names
        },
        "remarks": result.remarks,
    }
    write_soil(
        options.out,
        IdentifiedSoil(
            found.soil, found.wheels, found.names, found.covariance, found.scatter, notes
        ),
    )
    _print(result, runs)
    return OK


def _print(result: SoilIdentification, runs: Runs) -> None:
    soil = result.found.soil
    print(
        f"plate law of the indentation: k_phi = {soil.frictional_modulus:.4g} N/m^(n+2), "
        f"k_c = {soil.cohesive_modulus:.4g} N/m^(n+1), n = {soil.exponent:.4g}"
    )
    print(
        f"{len(result.found.names)} numbers of {len(runs.wheel)} runs, {CONFIDENCE:.0%} intervals:"
    )
    for name in result.found.names:
        low, high = result.interval[name]
        remark = result.remarks.get(name, "")
        print(f"  {name:16} {getattr(soil, name):11.5g}  [{low:.4g}, {high:.4g}]  {remark}")
    print("RMS of the residuals: " + ", ".join(MEASURED))
    for label, group in groups(runs):
        rms = np.sqrt(np.mean(result.residuals[group] ** 2, axis=0)) * [1.0, 1.0, 1e3]
        print(f"  {label:28} {rms[0]:6.2f} N {rms[1]:6.2f} N {rms[2]:6.2f} mm")
