"""``mother_rover validate cable predict``: free markers from two frames and the ends."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from rover_validation.cable.comparison import coverage, error_of, has_free_markers
from rover_validation.cable.model import Cable, check_distances
from rover_validation.cable.takes import read_takes, write_prediction
from rover_validation.refusals import OK, check_target, refusing


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "Predict the free markers of each take from its first two frames and its held markers, "
        "with a 90 % band: the columns ..._lo and ..._hi beside each free one. Empty cells are "
        "predicted; free markers that are given from the third frame on are compared. Exit codes: "
        "0 predicted, 2 a file is refused."
    )
    parser.add_argument("cable", type=Path, help="YAML file that identify wrote")
    parser.add_argument("folder", type=Path, help="folder of CSV files, one a take")
    parser.add_argument("--out", type=Path, required=True, help="folder of the predictions")


@refusing("cable predict")
def run(options: argparse.Namespace) -> int:
    """Predict; return the exit code."""
    cable = Cable.read(options.cable)
    assert cable.band is not None
    takes = read_takes(options.folder)
    for take in takes:
        check_distances(options.folder / f"{take.name}.csv", cable.geometry.arcs, take)
    check_target(options.out, options.folder)
    errors = []
    cable.predict(takes[0])  # compiles or loads the simulation: not part of a prediction's time
    for take in takes:
        start = time.perf_counter()
        predicted = cable.predict(take)
        took = time.perf_counter() - start
        low, high = cable.band.bounds(predicted, take.period)
        write_prediction(options.out / f"{take.name}.csv", take, predicted, low, high)
        line = f"{take.name}: {take.times[-1] - take.times[0]:.2f} s in {took:.3f} s"
        if has_free_markers(take):
            inside, width = coverage(take, low, high)
            errors.append((error_of(take, predicted), inside, width))
            line += (
                f", error {1e3 * errors[-1][0]:.1f} mm, {inside:.0%} in the band, "
                f"{1e3 * width:.1f} mm wide"
            )
        print(line)
    if errors:
        mean, inside, width = np.mean(errors, axis=0).tolist()
        print(
            f"mean: error {1e3 * mean:.1f} mm, {inside:.0%} in the band, {1e3 * width:.1f} mm wide"
        )
    return OK
