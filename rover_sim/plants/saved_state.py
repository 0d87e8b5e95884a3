"""Saved states of a plant, from which a plant of the same scenario starts.

A plant publishes its state as JSON on ``truth/state``. A file holds such a state with the scenario
to which it belongs. Numbers are written with all their digits: a plant that starts from a saved
state continues bit by bit as the one that was saved, with the same commands. Drives start without a
command, and sensors with new errors, as after a reset.
"""

from __future__ import annotations

import dataclasses
import enum
import json
import math
import typing
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from msg_schemas.fields import INFINITY_WORD, LARGEST_SIZE, known_names_hint
from msg_schemas.phases import PlantPhase
from msg_schemas.regular_files import file_problem, new_file, read_text
from rover_sim.scenarios.scenario import AnyScenario, scenario_from_mapping
from rover_sim.scenarios.scenario_parts import ScenarioError

FORMAT = "mother_rover plant state 1"
_LAST_NS = 2**63 - 1  # of a simulated time
STATE = "state"
"""Key of the state in files and messages."""
START = "start_state"
"""Key of the state from which a plant started, in its latched configuration."""
STAMP = "stamp_ns"
"""Key of the simulated time at which it was published [ns]."""
_SCENARIO = "scenario"
_FREE_SECTIONS = ("name", "about", "start", "sensors", "integration")
"""Parts of a scenario that may differ from those of the state's."""

S = TypeVar("S")


# --- states as plain values -----------------------------------------------------------------------


def plain_state(state: Any) -> dict[str, Any]:
    """Return the fields of a plant's state as JSON-ready values; `restore` inverts it."""
    return {item.name: _plain(getattr(state, item.name)) for item in dataclasses.fields(state)}


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return plain_state(value)
    if isinstance(value, enum.Enum):
        return value.value
    if isinstance(value, np.ndarray):
        numbers: list[Any] = value.tolist()
        # Only a vector has a number that may be infinite: the time since the latch tripped.
        return numbers if value.ndim > 1 else [_number(each) for each in numbers]
    return list(value) if isinstance(value, tuple) else value


def _number(value: float) -> float | str:
    return INFINITY_WORD if value == math.inf else value


def restore(kind: type[S], values: object, path: str = STATE, infinite: Collection[str] = ()) -> S:
    """Build a state from plain values.

    Args:
        kind: dataclass of the state: its fields are numbers, arrays, phases and such dataclasses.
        values: as from `plain_state`.
        path: of the values, for messages.
        infinite: paths of the numbers that may be infinite.

    Raises:
        ScenarioError: a value is missing, unknown, of another type, or not finite.
    """
    if not isinstance(values, Mapping):
        raise ScenarioError(path, values, "should be a mapping")
    hints = typing.get_type_hints(kind)
    for name, value in values.items():
        if name not in hints:
            raise ScenarioError(
                f"{path}.{name}", value, f"no such key{known_names_hint(name, hints)}"
            )
    missing = next((name for name in hints if name not in values), None)
    if missing is not None:
        raise ScenarioError(f"{path}.{missing}", None, "should be given")
    return kind(
        **{
            name: _restored(hint, values[name], f"{path}.{name}", infinite)
            for name, hint in hints.items()
        }
    )


def _restored(hint: Any, value: object, path: str, infinite: Collection[str]) -> Any:
    if dataclasses.is_dataclass(hint):
        return restore(typing.cast("type[Any]", hint), value, path, infinite)
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        words = [word.value for word in hint]
        if value not in words:
            raise ScenarioError(path, value, f"should be one of {', '.join(words)}")
        return hint(value)
    if hint is bool:
        if not isinstance(value, bool):
            raise ScenarioError(path, value, "should be true or false")
        return value
    array = _array(value, path, infinite)
    if hint is float:
        require_shape(array, (), path)
        return float(array)
    if typing.get_origin(hint) is tuple:
        require_shape(array, (len(typing.get_args(hint)),), path)
        return tuple(array.tolist())
    return array


def _array(
    value: object, path: str, infinite: Collection[str]
) -> np.ndarray[Any, np.dtype[np.float64]]:
    if isinstance(value, list):
        value = [math.inf if each == INFINITY_WORD else each for each in value]
    try:
        array = np.array(value)
    except ValueError:  # lists of different lengths
        array = np.array(None)
    if array.dtype.kind not in "if":
        raise ScenarioError(path, value, "should hold numbers, in lists of the same length")
    array = array.astype(np.float64)
    for index in np.argwhere(~np.isfinite(array)).tolist():
        place = path + "".join(f"[{each}]" for each in index)
        if place not in infinite or array[tuple(index)] < 0.0:
            raise ScenarioError(place, float(array[tuple(index)]), "should be finite")
    for index in np.argwhere(np.isfinite(array) & (np.abs(array) > LARGEST_SIZE)).tolist():
        place = path + "".join(f"[{each}]" for each in index)
        size = f"should be at most {LARGEST_SIZE:g} in size"
        raise ScenarioError(place, float(array[tuple(index)]), size)
    array.flags.writeable = False
    return array


def require_shape(
    array: np.ndarray[Any, np.dtype[np.float64]], shape: tuple[int, ...], path: str
) -> None:
    """Refuse an array of another shape.

    Raises:
        ScenarioError: the shape differs.
    """
    if array.shape != shape:
        raise ScenarioError(f"shape of {path}", list(array.shape), f"should be {list(shape)}")


def require_phase(phase: PlantPhase, allowed: Collection[PlantPhase]) -> None:
    """Refuse a phase in which the plant cannot start.

    Raises:
        ScenarioError: the plant has no such phase, or has stopped for good in it.
    """
    if phase not in allowed:
        words = ", ".join(each.value for each in allowed)
        raise ScenarioError(
            f"{STATE}.phase", phase.value, f"should be one of {words} to start from"
        )


# --- messages and files ---------------------------------------------------------------------------


def state_message(state: Any, stamp_ns: int) -> str:
    """Return the text of ``truth/state``: the state and its simulated time [ns]."""
    return json.dumps({STAMP: stamp_ns, STATE: plain_state(state)})


def is_state(content: Mapping[str, Any]) -> bool:
    """Whether the content of a ``truth/state`` has a simulated time and a state."""
    stamp = content.get(STAMP)
    return type(stamp) is int and 0 <= stamp <= _LAST_NS and isinstance(content.get(STATE), Mapping)


def write_state(path: Path, scenario: Mapping[str, Any], message: Mapping[str, Any]) -> None:
    """Write a new file of a state.

    Args:
        path: of the file.
        scenario: of the plant, as in its latched configuration.
        message: content of ``truth/state``.

    Raises:
        OSError: the file exists or cannot be written.
    """
    content = {"format": FORMAT, _SCENARIO: scenario, **message}
    with new_file(path) as file:
        json.dump(content, file)
        file.write("\n")


def read_state(path: str, scenario: AnyScenario) -> Mapping[str, Any]:
    """Read the state of a file, as plain values for a plant's `restored_state`.

    Args:
        path: of the file.
        scenario: of the plant that starts from it.

    Raises:
        ScenarioError: the file cannot be read, or its state belongs to another scenario. Name,
            start, sensors and integration may differ, the rest shapes the state.
    """
    try:
        content = json.loads(read_text(Path(path).expanduser()))
    except OSError as error:
        raise ScenarioError(START, path, f"cannot be read: {file_problem(error)}") from error
    except (ValueError, RecursionError) as error:
        reason = str(error).partition("\n")[0]
        raise ScenarioError(START, path, f"cannot be read: {reason}") from error
    if not isinstance(content, Mapping) or content.get("format") != FORMAT:
        found = content.get("format") if isinstance(content, Mapping) else None
        raise ScenarioError(
            f"{path}: format", found, f"should be {FORMAT!r}: a file of `mother_rover state save`"
        )
    saved = scenario_from_mapping(content.get(_SCENARIO)).to_mapping()
    difference = _first_difference(saved, scenario.to_mapping())
    if difference is not None:
        name, there, here = difference
        raise ScenarioError(
            name,
            here,
            f"the state of {path} belongs to a scenario with {there!r}: should be the same",
        )
    state: Mapping[str, Any] = content.get(STATE, {})
    return state


def _first_difference(
    saved: Mapping[str, Any], scenario: Mapping[str, Any]
) -> tuple[str, object, object] | None:
    """Return path and both values of the first difference that shapes the state."""
    one, other = _flat(saved), _flat(scenario)
    for path in ("model", *one, *(path for path in other if path not in one)):
        if path.partition(".")[0] not in _FREE_SECTIONS and one.get(path) != other.get(path):
            return path, one.get(path), other.get(path)
    return None


def _flat(mapping: Mapping[str, Any], prefix: str = "") -> dict[str, object]:
    found: dict[str, object] = {}
    for key, value in mapping.items():
        if isinstance(value, Mapping):
            found |= _flat(value, f"{prefix}{key}.")
        else:
            found[f"{prefix}{key}"] = value
    return found
