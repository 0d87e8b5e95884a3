"""The one reader of YAML: what it reads, and what it refuses at once and with the line."""

from __future__ import annotations

import copy
import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
import yaml
from damage import damaged_text, little_time
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from msg_schemas.fields import FieldError
from msg_schemas.yaml_reader import read_yaml
from rover_bags.files.folder import bag_files, stored_metadata
from rover_control.mission.mission_plan import load_plan as load_mission
from rover_hil.canopen.impairment import read_impairments
from rover_hil.rehearsal.procedure import load_procedure
from rover_launch.parameter_files import read_parameters
from rover_sim import load_scenario
from rover_studies.sweep.sweep_plan import load_plan as load_sweep


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e4", 1e4), ("0x1F", 31), ("0o17", 15), ("-7", -7), (".inf", float("inf")),
        ("true", True), ("~", None), ("on", "on"), ("010", "010"), ("1_000", "1_000"),
        ("1:30", "1:30"), ("2001-01-01", "2001-01-01"), ("2001-99-99", "2001-99-99"),
        ("0x_", "0x_"), ("=", "="), ("!!str 3", "3"),
        ("{a: [1, {b: 2.5}]}", {"a": [1, {"b": 2.5}]}),
        ("a: &x [1]\nb: *x", {"a": [1], "b": [1]}),
    ],
)  # fmt: skip
def test_values_are_those_of_yaml_1_2(text: str, value: object):
    read = read_yaml(text)
    assert read == value
    assert type(read) is type(value)


def alias_bomb(levels: int, width: int) -> str:
    aliases = (", ".join([f"*a{level}"] * width) for level in range(levels))
    lines = (f"a{level}: &a{level} [{each}]" for level, each in enumerate(aliases, 1))
    return "\n".join(("a0: &a0 [x]", *lines))


REFUSED = {
    "no integer": ("a: 1\nb: !!int abc", "no int", 2),
    "no float": ("!!float 1x", "no float", 1),
    "no boolean": ("- 1\n- !!bool maybe", "no bool", 2),
    "digits": ("a:\n  " + "9" * 10_000, "no int", 2),
    "timestamp": ("!!timestamp 2001-99-99", "is not accepted", 1),
    "binary": ("!!binary x", "is not accepted", 1),
    "set": ("!!set {a, b}", "is not accepted", 1),
    "object": ("!!python/object:os.system {}", "is not accepted", 1),
    "depth": ("[" * 100_000, "deeper than 32", 1),
    "mappings": ("{a: " * 100_000, "deeper than 32", 1),
    "aliases": (alias_bomb(12, 12), "more than 100000 values", 6),
    "alias in itself": ("a: 1\nb: &x [*x]", "lies in itself", 2),
    "a key twice": ("a: 1\na: 2", "stands twice", 2),
    "a key that is no text": ("1: 2", "should be text", 1),
    "values": ("[" + "0," * 100_001 + "]", "more than 100000 values", 1),
}


@pytest.mark.parametrize(("text", "words", "line"), REFUSED.values(), ids=REFUSED)
def test_what_is_refused_is_refused_with_its_line(text: str, words: str, line: int):
    with pytest.raises(FieldError) as error:
        read_yaml(text, "plan.yaml")
    assert words in str(error.value)
    assert f"(line {line}, " in str(error.value)
    assert len(str(error.value)) < 300


@given(st.recursive(
    st.none() | st.booleans() | st.integers(-(10**18), 10**18) | st.floats(allow_nan=False)
    | st.text(st.characters(codec="utf-8")),
    lambda part: st.lists(part, max_size=3)
    | st.dictionaries(st.text(max_size=5), part, max_size=3),
    max_leaves=12,
))  # fmt: skip
def test_any_text_is_read_or_refused(content: Any):
    with suppress(FieldError):
        read_yaml(yaml.safe_dump(content, allow_unicode=True))


@pytest.mark.fuzz
@given(st.text(st.sampled_from("[]{}:,-?&*!|>'\"#%@`ab01._~ \n\t<="), max_size=40))
def test_any_characters_are_read_or_refused(text: str):
    with suppress(FieldError):
        read_yaml(text)


# --- every file of YAML is read by it ----------------------------------------------------------

READERS: dict[str, Callable[[Path], object]] = {
    "scenario": lambda path: load_scenario(str(path)),
    "sweep": load_sweep,
    "mission": lambda path: load_mission(str(path)),
    "procedure": lambda path: load_procedure(str(path)),
    "impairments": lambda path: read_impairments(str(path)),
    "parameters": lambda path: read_parameters([path], "winch_node"),
}


ROOT = Path(__file__).parents[2]
SHIPPED = {
    "scenario": ("rover_sim/scenarios/taut_jump.yaml", "rover_sim/scenarios/lab_rig.yaml"),
    "sweep": ("docs/tutorials/storm.yaml", "docs/tutorials/rubble_edge.yaml"),
    "mission": ("rover_control/mission/plans/demonstration.yaml",),
    "procedure": (
        "docs/tutorials/own_procedure.yaml", "rover_hil/rehearsal/procedures/faults.yaml",
        "rover_hil/rehearsal/procedures/interface_check.yaml",
    ),
    "impairments": (),
    "parameters": ("config/winch_node.yaml",),
}  # fmt: skip
TEXTS = [
    (reader, (ROOT / name).read_text("utf-8")) for reader, names in SHIPPED.items()
    for name in names
]  # fmt: skip
TEXTS.append(("impairments", "- {kind: loss, target: rover, magnitude: 0.3, start: 5.0}\n"))


def check_read_or_refused(reader: str, text: str) -> None:
    """A reader reads a file of this text, or refuses it in a few words, and soon."""
    refused = "read"
    with TemporaryDirectory() as folder:
        path = Path(folder) / "file.yaml"
        path.write_text(text, "utf-8", "surrogatepass")
        try:
            with little_time(5.0):
                READERS[reader](path)
        except ValueError as error:
            refused = str(error)
    assert 0 < len(refused) < 4000


@pytest.mark.fuzz
@given(given=st.sampled_from(TEXTS), data=st.data())
@settings(max_examples=150, suppress_health_check=[HealthCheck.too_slow])
def test_a_damaged_file_is_read_or_refused_by_its_reader(
    given: tuple[str, str], data: st.DataObject
):
    reader, good = given
    check_read_or_refused(reader, data.draw(damaged_text(good, ":[{,-")))


HOSTILE_VALUES: tuple[Any, ...] = (
    0, -1, 10**30, 1e308, 1e-308, -0.0, math.nan, math.inf, True, None, "", "x", "1e3", "\0",
    "\u202e", "../../etc/passwd", "a" * 5000, [], [[]], [1, 2], {}, {"a": 1},
)  # fmt: skip


def places(content: object) -> Iterator[tuple[Any, ...]]:
    """Keys that lead to each value of a file, and to each group of values."""
    yield ()
    items = content.items() if isinstance(content, dict) else ()
    for key, value in enumerate(content) if isinstance(content, list) else items:
        yield from ((key, *rest) for rest in places(value))


def replaced(content: Any, place: tuple[Any, ...], value: object) -> Any:
    """The content of a file with another value at a place."""
    if not place:
        return value
    changed = copy.copy(content)
    changed[place[0]] = replaced(content[place[0]], place[1:], value)
    return changed


@pytest.mark.fuzz
@given(given=st.sampled_from(TEXTS), value=st.sampled_from(HOSTILE_VALUES), data=st.data())
@settings(max_examples=300, suppress_health_check=[HealthCheck.too_slow])
def test_a_file_with_any_value_at_any_place_is_read_or_refused(
    given: tuple[str, str], value: object, data: st.DataObject
):
    reader, good = given
    content = yaml.safe_load(good)
    place = data.draw(st.sampled_from(list(places(content))))
    check_read_or_refused(reader, yaml.safe_dump(replaced(content, place, value)))


def fifo(path: Path) -> None:
    os.mkfifo(path)


def device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def too_large(path: Path) -> None:
    with path.open("wb") as stream:
        stream.truncate(1 << 34)


FILES: dict[str, tuple[Callable[[Path], object], str]] = {
    "fifo": (fifo, "no regular file"),
    "device": (device, "no regular file"),
    "folder": (Path.mkdir, "no regular file"),
    "too large": (too_large, "more than 1048576 bytes"),
    "bomb": (lambda path: path.write_text(alias_bomb(12, 12)), "more than 100000 values"),
    "depth": (lambda path: path.write_text("[" * 100_000), "deeper than"),
    "scalar": (lambda path: path.write_text("a: !!int abc"), "no int"),
    "bytes": (lambda path: path.write_bytes(b"\xff\xfe\x00"), "not UTF-8"),
}


@pytest.mark.parametrize("reader", READERS.values(), ids=READERS)
@pytest.mark.parametrize(("make", "words"), FILES.values(), ids=FILES)
def test_no_file_blocks_or_fills_the_memory(
    tmp_path: Path, reader: Callable[[Path], object], make: Callable[[Path], object], words: str
):
    path = tmp_path / "file.yaml"
    make(path)
    with pytest.raises(ValueError, match=words) as error:
        reader(path)
    assert str(path) in str(error.value)


@pytest.mark.parametrize(("make", "_words"), FILES.values(), ids=FILES)
def test_metadata_that_cannot_be_read_are_damaged(
    tmp_path: Path, make: Callable[[Path], object], _words: str
):
    make(tmp_path / "metadata.yaml")
    (tmp_path / "bag_0.mcap").write_bytes(b"")
    assert stored_metadata(tmp_path) is None
    assert [path.name for path in bag_files(tmp_path)] == ["bag_0.mcap"]


def test_the_time_grows_with_the_length_alone():
    def took(entries: int) -> float:
        text = "\n".join(f"k{number}: [1.5, abc, {{d: true}}]" for number in range(entries))
        started = time.process_time()
        read_yaml(text)
        return time.process_time() - started

    took(100)
    assert took(4000) < 4000 / 500 * 3.0 * took(500)


@pytest.mark.parametrize("name", ["a\0b.yaml", "n" * 5000, "."])
def test_a_name_that_no_file_has_is_refused(tmp_path: Path, name: str):
    with pytest.raises(FieldError, match=r"^[^=]*: cannot be read: ") as refused:
        read_yaml(tmp_path / name)
    assert len(str(refused.value)) < 600
