"""Files of a soil bin: runs of a wheel, indentation, identified soils."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml
from numpy.typing import NDArray

from msg_schemas.fields import FieldError
from msg_schemas.regular_files import read_text
from msg_schemas.yaml_reader import read_yaml
from rover_sim import Soil, Wheel
from rover_validation.refusals import LARGEST_SET, SetError

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
    try:
        text = io.StringIO(read_text(path, LARGEST_SET), newline="")
        lines = [(number, row) for number, row in enumerate(csv.reader(text), 1) if row]
    except (OSError, UnicodeDecodeError) as error:
        raise SetError(f"{path}: cannot be read: {error}") from None
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
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise SetError(f"{path}, line {line}: {name} = {cell.strip()!r}: should be {expected}")
    return value


def read_indentation(path: Path) -> Indentation:
    """Read an indentation file.

    Raises:
        SetError: an entry is missing, damaged or out of range.
    """
    try:
        content = json.loads(read_text(path, LARGEST_SET))
    except (OSError, UnicodeDecodeError) as error:
        raise SetError(f"{path}: cannot be read: {error}") from None
    except json.JSONDecodeError as error:
        raise SetError(f"{path}, line {error.lineno}: no JSON: {error.msg}") from None
    except (ValueError, RecursionError) as error:  # too many digits, or too deep
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
            diameter = entry.get("diameter_mm")
            if not isinstance(diameter, int | float) or not 1.0 <= diameter <= 5e3:
                raise SetError(
                    f"{path}, {name}: diameter_mm = {diameter!r}: should be from 1 to 5000"
                )
            plates.append((diameter * 1e-3, z, force))
        elif entry.get("kind") == "wheel" and isinstance(entry.get("wheel"), str):
            standing.append((entry["wheel"], z, force))
        else:
            raise SetError(
                f"{path}, {name}: kind = {entry.get('kind')!r}: "
                "should be plate, or wheel with a name"
            )
    if not plates and not standing:
        raise SetError(f"{path}: no plate and no standing wheel")
    return Indentation(
        tuple(plates),
        tuple(standing),
        _wheels(path, form, [name for name, _, _ in standing]),
        _positive(path, soil, "specific_weight_N_m3"),
        _positive(path, soil, "repose_deg"),
    )


def _positive(path: Path, soil: Mapping[str, Any], name: str) -> float:
    """A number of the soil; NaN = not given."""
    value = soil.get(name, math.nan)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not (name not in soil or 0.0 < value < 1e9):
        raise SetError(f"{path}, _about.soil: {name} = {value!r:.40}: should be a positive number")
    return float(value)


def _curve(path: Path, name: str, entry: Any) -> tuple[Array, Array]:
    try:
        z, force = np.array(entry["z_mm"], dtype=float), np.array(entry["F_N"], dtype=float)
    except (KeyError, TypeError, ValueError, OverflowError):
        raise SetError(f"{path}, {name}: should have lists of numbers z_mm and F_N") from None
    if z.ndim != 1 or z.shape != force.shape or z.size < 5:
        raise SetError(
            f"{path}, {name}: {z.size} of z_mm, {force.size} of F_N: "
            "should be equally many, 5 or more"
        )
    bad = np.flatnonzero(~(np.isfinite(z) & np.isfinite(force) & (z >= 0.0) & (z < 2e3)))
    if bad.size:
        at = int(bad[0])
        raise SetError(
            f"{path}, {name}: point {at + 1} is {z[at]:g} mm, {force[at]:g} N: "
            "should be finite, 0 to 2000 mm"
        )
    return z * 1e-3, force


def _wheels(path: Path, form: Mapping[str, Any], names: Sequence[str]) -> dict[str, Wheel]:
    """Wheels of one form: those whose name holds `smooth` have no grousers."""
    try:
        radius, width = float(form["radius_m"]), float(form["width_m"])
        height = float(form.get("grouser_height_m", 0.0))
        wheels = {
            name: Wheel(radius, width, 0.0 if "smooth" in name else height, 0.0)
            for name in {*names, "smooth", "grouser"}
        }
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise SetError(f"{path}, _about.wheel: {error}") from None
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
        soil = Soil(**content["soil"])
        wheels = {name: Wheel(**values) for name, values in content["wheels"].items()}
        names = tuple(content["identified"])
        covariance = np.array(content["covariance"], dtype=float)
        forward, sideways, sinkage = (float(x) for x in content["scatter"])
    except FieldError as error:
        raise SetError(str(error)) from None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise SetError(f"{path}: no soil of `identify`: {error}") from None
    if covariance.shape != (len(names), len(names)):
        raise SetError(f"{path}: no soil of `identify`: covariance of {covariance.shape}")
    return IdentifiedSoil(soil, wheels, names, covariance, (forward, sideways, sinkage), {})


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Write a CSV file."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)
