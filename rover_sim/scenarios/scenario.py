"""Load and save scenarios, the package's and the user's own, as YAML files.

A scenario holds all inputs of a simulation. The keys of its YAML file are the field names of
`planar_scenario.Scenario` or `spatial_scenario.SpatialScenario`; the key `model` selects one of the
two (default: planar). The key `base` names a file with default values: one of the package (without
.yaml) or a path relative to the file (with .yaml). Sections are merged, other values are replaced.
"""

from __future__ import annotations

import importlib.resources
import math
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import yaml

from msg_schemas import configuration
from msg_schemas.csv_reader import CsvError, number_of, read_rows
from msg_schemas.yaml_reader import read_yaml
from rover_sim.scenarios.planar_scenario import Scenario
from rover_sim.scenarios.scenario_parts import ScenarioError
from rover_sim.scenarios.spatial_scenario import CURVATURE_COLUMNS, MOTION_COLUMNS, SpatialScenario

__all__ = [
    "AnyScenario",
    "Scenario",
    "ScenarioError",
    "SpatialScenario",
    "dump_scenario",
    "list_scenarios",
    "load_overridden",
    "load_planar",
    "load_scenario",
    "load_spatial",
    "parse_override",
    "scenario_from_mapping",
]

AnyScenario: TypeAlias = Scenario | SpatialScenario

_TYPES: dict[str, type[Scenario] | type[SpatialScenario]] = {
    "planar": Scenario,
    "spatial": SpatialScenario,
}
_BASES = "bases"
_TABLES = {
    ("root",): MOTION_COLUMNS,
    ("tip", "motion"): MOTION_COLUMNS,
    ("tether", "natural_curvature"): CURVATURE_COLUMNS,
}
"""Sections that may name a CSV file in place of rows, with its columns."""


def list_scenarios(model: str | None = None) -> tuple[str, ...]:
    """Return the sorted names of the package's scenarios, of one model or of all."""
    names = sorted(
        entry.name.removesuffix(".yaml")
        for entry in _package_folder().iterdir()
        if entry.name.endswith(".yaml")
    )
    if model is None:
        return tuple(names)
    return tuple(name for name in names if _mapping_of(name).get("model", "planar") == model)


def load_scenario(
    name_or_path: str | PathLike[str], overrides: Mapping[str, object] | None = None
) -> AnyScenario:
    """Load a scenario of the package or from a YAML file.

    Args:
        name_or_path: A name of `list_scenarios`, or the path of a file ending in .yaml or .yml.
        overrides: Values by dotted path, e.g. ``{"start.geometry": "+K", "tether.elements": 20}``.

    Raises:
        ScenarioError: a value is invalid; names the dotted path (or the file) and what is expected.
    """
    mapping = _mapping_of(name_or_path)
    return scenario_from_mapping(configuration.with_overrides(mapping, overrides or {}))


def load_overridden(name_or_path: str, overrides: str) -> AnyScenario:
    """Load a scenario with overrides given as YAML or JSON text, as in a node's parameter.

    Raises:
        ScenarioError: as `load_scenario`; or the overrides are not a mapping.
    """
    read = read_yaml(overrides, name="overrides") if overrides.strip() else {}
    if not isinstance(read, Mapping):
        raise ScenarioError("overrides", read, 'should be a mapping, such as {"start.slack": 2.0}')
    return load_scenario(name_or_path, read)


def load_planar(
    name_or_path: str | PathLike[str], overrides: Mapping[str, object] | None = None
) -> Scenario:
    """Load a planar scenario.

    Raises:
        ScenarioError: as `load_scenario`; or the scenario is of another model.
    """
    scenario = load_scenario(name_or_path, overrides)
    if not isinstance(scenario, Scenario):
        raise ScenarioError("model", scenario.model, "should be planar here")
    return scenario


def load_spatial(
    name_or_path: str | PathLike[str], overrides: Mapping[str, object] | None = None
) -> SpatialScenario:
    """Load a spatial scenario.

    Raises:
        ScenarioError: as `load_scenario`; or the scenario is of another model.
    """
    scenario = load_scenario(name_or_path, overrides)
    if not isinstance(scenario, SpatialScenario):
        raise ScenarioError("model", scenario.model, "should be spatial here")
    return scenario


def scenario_from_mapping(mapping: object) -> AnyScenario:
    """Build a scenario of the model that the mapping names.

    Raises:
        ScenarioError: a value is invalid; names the dotted path and what is expected.
    """
    model = mapping.get("model", "planar") if isinstance(mapping, Mapping) else "planar"
    scenario_type = _TYPES.get(model) if isinstance(model, str) else None
    if scenario_type is None:
        raise ScenarioError("model", model, f"should be one of {', '.join(_TYPES)}")
    return scenario_type.from_mapping(mapping)


def parse_override(assignment: str) -> tuple[str, object]:
    """Parse an override of a command line, such as ``start.slack=2``.

    Raises:
        ScenarioError: there is no ``=``, or no YAML value after it.
    """
    path, sign, value = assignment.partition("=")
    if not sign or not path.strip():
        raise ScenarioError("override", assignment, "should read dotted.path=value")
    return path.strip(), read_yaml(value, name=path.strip())


def dump_scenario(scenario: AnyScenario) -> str:
    """Write a scenario as YAML text that `load_scenario` reads back."""
    return yaml.safe_dump(scenario.to_mapping(), sort_keys=False, allow_unicode=True)


def _package_folder() -> Any:
    return importlib.resources.files("rover_sim.scenarios")


def _source_of(name_or_path: str | PathLike[str]) -> Path | Any:
    name = str(name_or_path)
    if isinstance(name_or_path, str) and name in list_scenarios():
        return _package_folder().joinpath(f"{name}.yaml")
    path = Path(name).expanduser()
    if path.suffix in {".yaml", ".yml"}:
        return path
    raise ScenarioError(
        "scenario",
        name,
        f"should be one of {', '.join(list_scenarios())}, or the path of a .yaml file",
    )


def _mapping_of(name_or_path: str | PathLike[str]) -> dict[str, Any]:
    """Return a file's keys and values, merged over those of its bases."""
    source = _source_of(name_or_path)
    return _merged_with_bases(source, str(name_or_path), ())


def _merged_with_bases(source: Path | Any, label: str, derived: tuple[str, ...]) -> dict[str, Any]:
    mapping = read_yaml(source)
    if not isinstance(mapping, Mapping):
        raise ScenarioError(label, mapping, "should hold a mapping of keys to values")
    own = _with_tables(dict(mapping), source)
    base = own.pop("base", None)
    if base is None:
        return own
    found = _base(source, base)
    if str(found) in derived:
        raise ScenarioError(f"{label}: base", base, "should not refer back to the file itself")
    return configuration.merged(_merged_with_bases(found, str(base), (*derived, str(source))), own)


def _with_tables(own: dict[str, Any], source: Path | Any) -> dict[str, Any]:
    """Read the tables that name a CSV file, relative to the scenario's file."""
    for path, columns in _TABLES.items():
        section: Any = own
        for name in path:
            section = section.get(name) if isinstance(section, Mapping) else None
        if not isinstance(section, Mapping) or "file" not in section:
            continue
        at = ".".join((*path, "file"))
        if set(section) != {"file"} or not isinstance(section["file"], str):
            raise ScenarioError(at, section["file"], "should be the name of a file, and no rows")
        rows = _rows_of(Path(str(source)).parent / section["file"], at, columns)
        own = configuration.with_overrides(own, {".".join(path): {"rows": rows}})
    return own


def _rows_of(path: Path, at: str, columns: tuple[str, ...]) -> list[list[float]]:
    """Read a table of numbers."""
    expected = "should be a CSV file of numbers"
    try:
        rows = read_rows(path)
    except CsvError as error:
        raise ScenarioError(at, path.name, f"{expected}; {error}") from None
    if not rows or tuple(name.strip() for name in rows[0][1]) != columns:
        raise ScenarioError(
            at, path.name, f"{expected}; {path}: its columns should be {', '.join(columns)}"
        )
    numbers = []
    for line, cells in rows[1:]:
        numbers.append([number_of(cell) for cell in cells])
        if not all(map(math.isfinite, numbers[-1])):
            raise ScenarioError(
                at, path.name, f"{expected}; {path}, line {line}: {','.join(cells)!r:.60}"
            )
    return numbers


def _base(source: Path | Any, base: object) -> Path | Any:
    names = tuple(
        sorted(
            entry.name.removesuffix(".yaml")
            for entry in _package_folder().joinpath(_BASES).iterdir()
            if entry.name.endswith(".yaml")
        )
    )
    if isinstance(base, str):
        if base in names:
            return _package_folder().joinpath(_BASES, f"{base}.yaml")
        if base in list_scenarios():
            return _package_folder().joinpath(f"{base}.yaml")
        if base.endswith((".yaml", ".yml")) and isinstance(source, Path):
            return source.parent / base
    raise ScenarioError(
        "base",
        base,
        f"should be one of {', '.join((*names, *list_scenarios()))}, or the path of a .yaml file",
    )
