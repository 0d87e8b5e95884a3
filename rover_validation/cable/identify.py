"""``mother_rover validate cable identify``: the laws of a cable from takes of its motion."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from rover_validation.cable.identification import FEW, MANY, CableIdentification, identify
from rover_validation.cable.model import arcs_of, arcs_of_shape
from rover_validation.cable.takes import Floats, Take, read_rest_shapes, read_takes
from rover_validation.refusals import OK, SetError, refusing


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "Identify stiffness, damping, drag and natural curvature per mass from takes of a cable "
        "whose ends are held and moved: CSV files with the columns time_s, x0_m, y0_m, z0_m, "
        "x1_m ..., z up; the first two and the last two markers are held. Exit codes: 0 "
        "identified, 2 a file is refused."
    )
    parser.add_argument("folder", type=Path, help="folder of CSV files, one a take")
    parser.add_argument("--out", type=Path, required=True, help="YAML file of the cable to write")
    parser.add_argument(
        "--rest-shape", type=Path, help="CSV file: marker, x_m, y_m, z_m of the cable lying at rest"
    )
    parser.add_argument(
        "--numbers", type=int, choices=(FEW, MANY), default=MANY,
        help=f"identified numbers: {FEW} (laws, and curvature or tilts) or {MANY} (default)",
    )  # fmt: skip


@refusing("cable identify")
def run(options: argparse.Namespace) -> int:
    """Identify; return the exit code."""
    takes = read_takes(options.folder)
    shape = None
    if options.rest_shape is not None:
        shape = own_shape(options.rest_shape, takes)
    found = identify(takes, shape, options.numbers)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(found.cable.to_yaml(), encoding="utf-8")
    print(as_text(found))
    return OK


def own_shape(path: Path, takes: list[Take]) -> Floats:
    """The shape of the cable of the takes, by the distances between its markers.

    Raises:
        SetError: the file is damaged, or none of its cables has such markers.
    """
    arcs = arcs_of(takes)
    shapes = [each for each in read_rest_shapes(path) if len(each) == len(arcs) + 1]
    if not shapes:
        raise SetError(f"{path}: no cable has {len(arcs) + 1} markers as the takes")
    return min(shapes, key=lambda each: float(np.abs(arcs_of_shape(each) - arcs).mean()))


def as_text(found: CableIdentification) -> str:
    """The result for a terminal."""
    cable = found.cable
    lines = [
        f"{len(found.errors)} takes, {found.simulations} simulations; per mass per length",
        f"  {'number':24s}{'value':>11s}  {'95 % interval':24s}unit",
    ]
    for each in cable.numbers:
        interval = f"{each.low:.4g} .. {each.high:.4g}"
        line = f"  {each.name:24s}{each.value:11.4g}  {interval:24s}{each.unit:6s}{each.remark}"
        lines.append(line.rstrip())
    fixed = ", ".join(f"{name} {value:g}" for name, value in cable.fixed.items())
    lines += [
        f"  fixed: {fixed}",
        f"  mean distance {1e3 * float(np.mean([*found.errors.values()])):.1f} mm",
    ]
    lines += [f"! {name} is not used: {reason}" for name, reason in found.excluded.items()]
    return "\n".join(lines)
