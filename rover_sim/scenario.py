"""Scenarios as files: those that come with the package, and one's own.

A scenario says everything that a simulation starts from. Scenarios are written as YAML files whose
keys are the field names of `planar_scenario.Scenario` or `spatial_scenario.SpatialScenario`; the
key `model` says of which (planar, if it is missing). The key `base` names another file, without
.yaml of the package or with it relative to the file itself, whose values hold where the scenario
gives none: sections are joined, anything else replaced.
"""

from __future__ import annotations

import importlib.resources
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import yaml

from msg_schemas import configuration
from msg_schemas.yaml_reader import read_yaml
from rover_sim.planar_scenario import Scenario
from rover_sim.scenario_parts import ScenarioError
from rover_sim.spatial_scenario import SpatialScenario

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

_KINDS: dict[str, type[Scenario] | type[SpatialScenario]] = {
    "planar": Scenario,
    "spatial": SpatialScenario,
}
_BASES = "bases"


def list_scenarios(model: str | None = None) -> tuple[str, ...]:
    """Names of the scenarios that come with the package, sorted; of one model, or of all."""
    names = sorted(
        entry.name.removesuffix(".yaml")
        for entry in _shipped().iterdir()
        if entry.name.endswith(".yaml")
    )
    if model is None:
        return tuple(names)
    return tuple(name for name in names if _mapping_of(name).get("model", "planar") == model)


def load_scenario(
    name_or_path: str | PathLike[str], overrides: Mapping[str, object] | None = None
) -> AnyScenario:
    """Load a scenario that comes with the package, or one from a YAML file.

    Args:
        name_or_path: A name of `list_scenarios`, or the path of a file ending in .yaml or .yml.
        overrides: Values by dotted path, e.g. ``{"start.geometry": "+K", "tether.elements": 20}``.

    Raises:
        ScenarioError: Naming the dotted path (or the file), the value and what would be right.
    """
    mapping = _mapping_of(name_or_path)
    return scenario_from_mapping(configuration.with_overrides(mapping, overrides or {}))


def load_overridden(name_or_path: str, overrides: str) -> AnyScenario:
    """`load_scenario` with overrides as a node's parameter has them: YAML or JSON, or nothing.

    Raises:
        ScenarioError: as `load_scenario`; or the overrides are no mapping.
    """
    read = read_yaml(overrides, name="overrides") if overrides.strip() else {}
    if not isinstance(read, Mapping):
        raise ScenarioError("overrides", read, 'should be a mapping, such as {"start.slack": 2.0}')
    return load_scenario(name_or_path, read)


def load_planar(
    name_or_path: str | PathLike[str], overrides: Mapping[str, object] | None = None
) -> Scenario:
    """`load_scenario` for those who want a planar one.

    Raises:
        ScenarioError: As `load_scenario`, and if the scenario is of another model.
    """
    scenario = load_scenario(name_or_path, overrides)
    if not isinstance(scenario, Scenario):
        raise ScenarioError("model", scenario.model, "should be planar here")
    return scenario


def load_spatial(
    name_or_path: str | PathLike[str], overrides: Mapping[str, object] | None = None
) -> SpatialScenario:
    """`load_scenario` for those who want a spatial one.

    Raises:
        ScenarioError: As `load_scenario`, and if the scenario is of another model.
    """
    scenario = load_scenario(name_or_path, overrides)
    if not isinstance(scenario, SpatialScenario):
        raise ScenarioError("model", scenario.model, "should be spatial here")
    return scenario


def scenario_from_mapping(mapping: object) -> AnyScenario:
    """Build a scenario of the model that the mapping names.

    Raises:
        ScenarioError: Naming the dotted path, the value and what would be right.
    """
    model = mapping.get("model", "planar") if isinstance(mapping, Mapping) else "planar"
    kind = _KINDS.get(model) if isinstance(model, str) else None
    if kind is None:
        raise ScenarioError("model", model, f"should be one of {', '.join(_KINDS)}")
    return kind.from_mapping(mapping)


def parse_override(assignment: str) -> tuple[str, object]:
    """Read an override as written on a command line, ``start.slack=2``.

    Raises:
        ScenarioError: If there is no ``=``, or what follows it is no YAML value.
    """
    path, sign, value = assignment.partition("=")
    if not sign or not path.strip():
        raise ScenarioError("override", assignment, "should read dotted.path=value")
    return path.strip(), read_yaml(value, name=path.strip())


def dump_scenario(scenario: AnyScenario) -> str:
    """Write a scenario as YAML text that `load_scenario` reads back."""
    return yaml.safe_dump(scenario.to_mapping(), sort_keys=False, allow_unicode=True)


def _shipped() -> Any:
    return importlib.resources.files("rover_sim").joinpath("scenarios")


def _source_of(name_or_path: str | PathLike[str]) -> Path | Any:
    name = str(name_or_path)
    if isinstance(name_or_path, str) and name in list_scenarios():
        return _shipped().joinpath(f"{name}.yaml")
    path = Path(name)
    if path.suffix in {".yaml", ".yml"}:
        return path
    raise ScenarioError(
        "scenario",
        name,
        f"should be one of {', '.join(list_scenarios())}, or the path of a .yaml file",
    )


def _mapping_of(name_or_path: str | PathLike[str]) -> dict[str, Any]:
    """A file's keys and values, joined with those of its bases."""
    source = _source_of(name_or_path)
    return _joined_with_bases(source, str(name_or_path), ())


def _joined_with_bases(source: Path | Any, label: str, above: tuple[str, ...]) -> dict[str, Any]:
    mapping = read_yaml(source)
    if not isinstance(mapping, Mapping):
        raise ScenarioError(label, mapping, "should hold a mapping of keys to values")
    own = dict(mapping)
    base = own.pop("base", None)
    if base is None:
        return own
    found = _base(source, base)
    if str(found) in above:
        raise ScenarioError(f"{label}: base", base, "should not lead back to the file itself")
    return _joined(_joined_with_bases(found, str(base), (*above, str(source))), own)


def _base(source: Path | Any, base: object) -> Path | Any:
    names = tuple(
        sorted(
            entry.name.removesuffix(".yaml")
            for entry in _shipped().joinpath(_BASES).iterdir()
            if entry.name.endswith(".yaml")
        )
    )
    if isinstance(base, str):
        if base in names:
            return _shipped().joinpath(_BASES, f"{base}.yaml")
        if base in list_scenarios():
            return _shipped().joinpath(f"{base}.yaml")
        if base.endswith((".yaml", ".yml")) and isinstance(source, Path):
            return source.parent / base
    raise ScenarioError(
        "base",
        base,
        f"should be one of {', '.join((*names, *list_scenarios()))}, or the path of a .yaml file",
    )


def _joined(under: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Values of `over`, and where it has none those of `under`, section by section."""
    result = dict(under)
    for key, value in over.items():
        below = result.get(key)
        if isinstance(value, Mapping) and isinstance(below, Mapping):
            result[key] = _joined(below, value)
        else:
            result[key] = value
    return result
