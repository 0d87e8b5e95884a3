"""Files of a soil bin: runs of a wheel, indentation, identified soils."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml
from numpy.typing import NDArray

from msg_schemas.csv_reader import number_of
from msg_schemas.fields import FieldError
from msg_schemas.regular_files import read_text
from msg_schemas.yaml_reader import read_yaml
from rover_sim import Soil, Wheel
from rover_validation.refusals import LARGEST_SET, SetError, read_table

Array = NDArray[np.float64]

SETTINGS: Final = ("wheel", "beta_deg", "Vx_mm_s", "Vry_mm_s", "load_N")
MEASURED: Final = ("Fx_N", "Fy_N", "sinkage_mm")
_RANGES: Final[Mapping[str, tuple[float, float, str]]] = {
    "beta_deg": (0.0, 90.0, "an angle from 0 to 90 deg"),
    "Vx_mm_s": (0.1, 1.0e4, "a travel speed from 0.1 to 10000 mm/s"),
    "Vry_mm_s": (0.0, 1.0e5, "a rim speed from 0 to 100000 mm/s"),
    "load_N": (1.0e-2, 1.0e5, "a load from 0.01 to 100000 N"),
    "Fx_N": (-1.0e5, 1.0e5, "a force within 100000 N"),
    "Fy_N": (-1.0e5, 1.0e5, "a force within 100000 N"),
    "sinkage_mm": (-10.0, 2.0e3, "a sinkage from -10 to 2000 mm"),
}


@dataclass(frozen=True)
class Runs:
    """Steady runs of a wheel, one per row of a file.

    Attributes:
        columns: of the file, in its order.
        rows: cells of each row as read.
        wheel: name of the wheel, per row.
        angle: between travel and the wheel's plane [rad], (k,).
        travel: speed [m/s], (k,).
        rim: spin times radius [m/s], (k,).
        load: [N], (k,).
        measured: forward force [N], sideways force [N], sinkage [m], (k, 3); NaN in settings.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    wheel: tuple[str, ...]
    angle: Array
    travel: Array
    rim: Array
    load: Array
    measured: Array

    def settings(self) -> list[tuple[str, ...]]:
        """Return what repeated runs have in common, per row."""
        if {"setting", "beta_deg"} <= set(self.columns):
            at = [self.columns.index(name) for name in ("wheel", "beta_deg", "setting")]
            return [tuple(row[i] for i in at) for row in self.rows]
        return [(str(number),) for number in range(len(self.rows))]


@dataclass(frozen=True)
class Indentation:
    """Vertical force over sinkage.

    Attributes:
        plates: diameter [m], sinkages [m] and forces [N] of each plate.
        standing: wheel's name, sinkages [m] and forces [N] of each standing wheel.
        wheels: the wheels that the file describes.
        weight: of the soil [N/m^3], NaN if not stated.
        repose: angle of repose [deg], NaN if not stated.
    """

    plates: tuple[tuple[float, Array, Array], ...]
    standing: tuple[tuple[str, Array, Array], ...]
    wheels: dict[str, Wheel]
    weight: float
    repose: float


@dataclass(frozen=True)
class IdentifiedSoil:
    """What an identification leaves behind for predictions and scenarios.

    Attributes:
        soil: the soil; a scenario takes it as its section `environment.soil`.
        wheels: the wheels, by name.
        names: of the identified numbers.
        covariance: of these numbers, (n, n).
        scatter: RMS of the residuals of forward force [N], sideways force [N] and sinkage [m].
        notes: further entries of the file.
    """

    soil: Soil
    wheels: dict[str, Wheel]
    names: tuple[str, ...]
    covariance: Array
    scatter: tuple[float, float, float]
    notes: dict[str, Any]


def read_runs(path: Path, measured: bool = True) -> Runs:
    """Read runs; without `measured`, forces and sinkage may be missing or empty.

    Raises:
        SetError: a column is missing, or a cell is no number or out of its range.
    """
    lines = read_table(path)
    if len(lines) < 2:
        raise SetError(f"{path}: {len(lines)} lines: should be a header and at least one run")
    columns = tuple(name.strip() for name in lines[0][1])
    required = SETTINGS + (MEASURED if measured else ())
    missing = [name for name in required if name not in columns]
    if missing:
        raise SetError(
            f"{path}, line 1: no column {', '.join(missing)}: should be {', '.join(required)}"
        )
    numbers = []
    for number, row in lines[1:]:
        if len(row) != len(columns):
            raise SetError(
                f"{path}, line {number}: {len(row)} cells: should be {len(columns)}, as in line 1"
            )
        cells = dict(zip(columns, row, strict=True))
        if not cells["wheel"].strip():
            raise SetError(f"{path}, line {number}: no wheel's name")
        numbers.append(
            [_number(path, number, name, cells[name]) for name in SETTINGS[1:]]
            + [_number(path, number, n, cells[n]) if measured else math.nan for n in MEASURED]
        )
    table = np.array(numbers)
    return Runs(
        columns=columns,
        rows=tuple(tuple(row) for _, row in lines[1:]),
        wheel=tuple(row[columns.index("wheel")].strip() for _, row in lines[1:]),
        angle=np.radians(table[:, 0]),
        travel=table[:, 1] * 1e-3,
        rim=table[:, 2] * 1e-3,
        load=table[:, 3],
        measured=table[:, 4:] * [1.0, 1.0, 1e-3],
    )


def _number(path: Path, line: int, name: str, cell: str) -> float:
    low, high, expected = _RANGES[name]
    value = number_of(cell)
    if not low <= value <= high:
        raise SetError(f"{path}, line {line}: {name} = {cell.strip()!r:.60}: should be {expected}")
    return value


def read_indentation(path: Path) -> Indentation:
    """Read an indentation file.

    Raises:
        SetError: an entry is missing, damaged or out of range.
    """
    try:
        text = read_text(path, LARGEST_SET)
        content = json.loads(text.removeprefix("\ufeff"), object_pairs_hook=_without_repeats)
    except OSError as error:
        raise SetError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise SetError(f"{path}: cannot be read: {error}") from None
    except json.JSONDecodeError as error:
        raise SetError(f"{path}, line {error.lineno}: no JSON: {error.msg}") from None
    except (ValueError, RecursionError) as error:  # repeated names, too many digits, or too deep
        raise SetError(f"{path}: no JSON that can be read: {error}") from None
    if not (isinstance(content, dict) and isinstance(content.get("_about"), dict)):
        raise SetError(f"{path}: no object `_about` with `wheel` and `soil`")
    about = content["_about"]
    form, soil = about.get("wheel"), about.get("soil", {})
    if not isinstance(form, dict):
        raise SetError(f"{path}: `_about.wheel` is missing: should have radius_m, width_m")
    if not isinstance(soil, dict):
        raise SetError(f"{path}: `_about.soil` is {soil!r:.40}: should be an object")
    plates, standing = [], []
    for name, entry in content.items():
        if name == "_about":
            continue
        z, force = _curve(path, name, entry)
        if entry.get("kind") == "plate":
            diameter = _number_in(path, name, entry, "diameter_mm", 1.0, 5e3)
            plates.append((diameter * 1e-3, z, force))
        elif entry.get("kind") == "wheel" and isinstance(entry.get("wheel"), str):
            standing.append((entry["wheel"], z, force))
        else:
            raise SetError(
                f"{path}, {name}: kind = {entry.get('kind')!r:.60}: "
                "should be plate, or wheel with a name"
            )
    if not plates and not standing:
        raise SetError(f"{path}: no plate and no standing wheel")
    where = "_about.soil"
    return Indentation(
        tuple(plates),
        tuple(standing),
        _wheels(path, form, [name for name, _, _ in standing]),
        _number_in(path, where, soil, "specific_weight_N_m3", 1.0, 1e6, math.nan),
        _number_in(path, where, soil, "repose_deg", 1.0, 89.0, math.nan),
    )


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        names = [name for name, _ in pairs]
        repeated = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the name {repeated!r:.60} stands twice in an object")
    return content


def _number_in(
    path: Path, where: str, content: Mapping[str, Any], name: str, low: float, high: float,
    default: float | None = None,
) -> float:  # fmt: skip
    """A number of a JSON object within limits, or its default where none is given."""
    if name not in content and default is not None:
        return default
    value = content.get(name)
    if isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= high:
        return float(value)
    raise SetError(
        f"{path}, {where}: {name} = {value!r:.40}: should be a number from {low:g} to {high:g}"
    )


def _curve(path: Path, name: str, entry: Any) -> tuple[Array, Array]:
    lists = [entry.get(each) for each in ("z_mm", "F_N")] if isinstance(entry, dict) else [None]
    if not all(isinstance(each, list) and set(map(type, each)) <= {int, float} for each in lists):
        raise SetError(f"{path}, {name}: should have lists of numbers z_mm and F_N")
    try:
        z, force = (np.array(each, dtype=float) for each in lists)
    except OverflowError:
        raise SetError(f"{path}, {name}: a number of z_mm or F_N is beyond 1e308") from None
    if z.shape != force.shape or z.size < 5:
        raise SetError(
            f"{path}, {name}: {z.size} of z_mm, {force.size} of F_N: "
            "should be equally many, 5 or more"
        )
    bad = np.flatnonzero(~((np.abs(force) < 1e6) & (z >= 0.0) & (z < 2e3)))
    if bad.size:
        at = int(bad[0])
        raise SetError(
            f"{path}, {name}: point {at + 1} is {z[at]:g} mm, {force[at]:g} N: "
            "should be 0 to 2000 mm, within 1e6 N"
        )
    if not (np.ptp(z) > 0.0 and force[np.argmax(z)] > 0.0):
        deepest = int(np.argmax(z))
        raise SetError(
            f"{path}, {name}: z_mm from {z.min():g} to {z.max():g}, with {force[deepest]:g} N at "
            "the deepest point: should be several depths, with a force above 0 at the deepest"
        )
    return z * 1e-3, force


def _wheels(path: Path, form: Mapping[str, Any], names: Sequence[str]) -> dict[str, Wheel]:
    """Wheels of one form: those whose name holds `smooth` have no grousers."""
    where = "_about.wheel"
    radius = _number_in(path, where, form, "radius_m", 1e-3, 10.0)
    width = _number_in(path, where, form, "width_m", 1e-3, 10.0)
    height = _number_in(path, where, form, "grouser_height_m", 0.0, 10.0, 0.0)
    try:
        wheels = {
            name: Wheel(radius, width, 0.0 if "smooth" in name else height, 0.0)
            for name in {*names, "smooth", "grouser"}
        }
    except ValueError as error:
        raise SetError(f"{path}, {where}: {error}") from None
    return dict(sorted(wheels.items()))


def write_soil(path: Path, found: IdentifiedSoil) -> None:
    """Write an identified soil as YAML."""
    content = {
        "soil": asdict(found.soil),
        "wheels": {name: asdict(wheel) for name, wheel in found.wheels.items()},
        "identified": list(found.names),
        "covariance": [[float(f"{x:.6g}") for x in row] for row in found.covariance],
        "scatter": [float(f"{x:.6g}") for x in found.scatter],
        **found.notes,
    }
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def read_soil(path: Path) -> IdentifiedSoil:
    """Read an identified soil.

    Raises:
        SetError: the file is no identified soil.
    """
    try:
        content: Any = read_yaml(path)
    except FieldError as error:
        raise SetError(str(error)) from None
    try:
        soil = Soil(**content["soil"])
        wheels = {name: Wheel(**values) for name, values in content["wheels"].items()}
        names = tuple(content["identified"])
        covariance = np.array(content["covariance"], dtype=float)
        forward, sideways, sinkage = (float(x) for x in content["scatter"])
        unknown = set(names) - {each.name for each in fields(Soil)}
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise SetError(f"{path}: no soil of `identify`: {error}") from None
    if unknown or covariance.shape != (len(names), len(names)):
        raise SetError(
            f"{path}: no soil of `identify`: {', '.join(names):.200} identified, with a covariance "
            f"of {covariance.shape}: should be numbers of the soil, with as many rows and columns"
        )
    numbers = [*covariance.ravel(), forward, sideways, sinkage]
    if not (np.isfinite(numbers).all() and min(*np.diag(covariance), *numbers[-3:]) >= 0.0):
        raise SetError(
            f"{path}: no soil of `identify`: covariance and scatter should be finite, with "
            "variances and scatter of 0 or more"
        )
    return IdentifiedSoil(soil, wheels, names, covariance, (forward, sideways, sinkage), {})


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Write a CSV file."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)
