"""The table of requirements is well-formed, its checks exist, and a bad table is refused."""

import ast
import re
from pathlib import Path

import pytest
import yaml

from rover_verify.checks import CheckBatch, Measured, planar
from rover_verify.requirements.matrix import find_check
from rover_verify.requirements.requirements import (
    Limit,
    Requirement,
    RequirementError,
    document,
    load_requirements,
)

ROOT = Path(__file__).resolve().parents[2]
ROWS = load_requirements()


def test_identifiers_are_unique_and_every_area_has_rows():
    identifiers = [row.id for row in ROWS]
    assert len(set(identifiers)) == len(identifiers) > 100
    assert {"Tether", "Planar jump", "Contract", "Nodes", "Bags", "Winch"} <= {
        row.area for row in ROWS
    }


@pytest.mark.parametrize("row", [row for row in ROWS if row.check], ids=lambda row: row.id)
def test_the_check_that_a_row_names_exists_and_states_what_it_measures(row: Requirement):
    assert row.check is not None
    check = find_check(row.check)
    assert check.__doc__


@pytest.mark.parametrize("row", [row for row in ROWS if row.tests], ids=lambda row: row.id)
def test_the_tests_that_a_row_names_exist(row: Requirement):
    for each in row.tests:
        file, *names = each.partition("[")[0].split("::")
        text = (ROOT / file).read_text(encoding="utf-8")
        assert all(re.search(rf"(def|class) {name}\b", text) for name in names), each


def checks_in(path: Path) -> set[str]:
    """Names of the public functions of a module that measure in a batch."""
    return {
        f"{path.stem}.{node.name}"
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.FunctionDef)
        and not node.name.startswith("_")
        and [each.arg.lstrip("_") for each in node.args.args][:1] == ["batch"]
        and node.returns is not None
        and ast.unparse(node.returns) == "Measured"
    }


def test_every_check_is_named_by_a_row():
    named = {row.check.partition("(")[0] for row in ROWS if row.check}
    found = set().union(*map(checks_in, (ROOT / "rover_verify" / "checks").glob("[a-z]*.py")))
    assert len(found) > 90
    assert found <= named, f"never run: {found - named}"


def test_each_requirement_is_verified_and_each_open_one_states_its_remedy():
    assert all(row.is_verified for row in ROWS if row.status == "required")
    assert all(row.milestone for row in ROWS if row.status == "open")


def test_the_document_matches_the_table():
    path = ROOT / "docs" / "requirements.md"
    assert path.read_text(encoding="utf-8") == document(ROWS), "run: mother_rover requirements"


@pytest.mark.parametrize(
    ("operator", "value", "inside", "outside"),
    [("<=", 1e-6, 1e-6, 1.1e-6), (">=", 4.0, 4.0, 3.9), ("==", 0.0, 0.0, 1.0)],
)
def test_a_limit_lets_through_what_is_inside_and_nothing_else(
    operator: str, value: float, inside: float, outside: float
):
    limit = Limit(operator, value, "m")
    assert limit.holds(inside)
    assert not limit.holds(outside)
    assert not limit.holds(float("nan"))


GOOD: dict[str, object] = {
    "id": "AREA-TOPIC-01",
    "statement": "It is so.",
    "method": "test",
    "limit": ["<=", 1.0, "m"],
    "check": "planar.mirror",
}


def table(*rows: dict[str, object]) -> str:
    return yaml.safe_dump([{"area": "Area", "rows": list(rows)}])


def test_a_good_row_is_read():
    (row,) = load_requirements(table(GOOD))
    assert (row.id, row.area, str(row.limit)) == ("AREA-TOPIC-01", "Area", "<= 1 m")
    assert row.command == "mother_rover verify --only AREA-TOPIC-01"


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"id": "area 1"}, "should look like"),
        ({"method": "hope"}, "method 'hope'"),
        ({"status": "done"}, "status 'done'"),
        ({"check": "no_module"}, "should read module.function"),
        ({"check": None}, "required, and has neither check nor tests"),
        ({"limit": ["<", 1.0, "m"]}, "operator '<'"),
        ({"limit": ["<=", "1", "m"]}, "should be a finite number"),
        ({"limit": ["<=", float("nan"), "m"]}, "should be a finite number"),
        ({"limit": [1.0]}, "should be"),
        ({"colour": "red"}, "unknown \\['colour'\\]"),
        ({"tests": ["test/test_config.py"]}, "so no check"),
        ({"quantity": "error"}, "so tests that record it"),
        ({"check": None, "tests": ["test/test_config.py"]}, "a limit is of a check"),
        ({"tests": "test/test_config.py"}, "should be a list of pytest arguments"),
    ],
)
def test_a_malformed_row_is_refused_by_name(change: dict[str, object], complaint: str):
    with pytest.raises(RequirementError, match=complaint):
        load_requirements(table({**GOOD, **change}))


def test_a_missing_key_and_a_repeated_identifier_are_refused():
    with pytest.raises(RequirementError, match="a limit is of a check, or of a quantity"):
        load_requirements(table({key: value for key, value in GOOD.items() if key != "limit"}))
    with pytest.raises(RequirementError, match="occurs twice"):
        load_requirements(table(GOOD, GOOD))
    with pytest.raises(RequirementError, match="list of areas"):
        load_requirements("rows: 3")


@pytest.mark.parametrize(
    "name", ["nothing.at_all", "planar.no_such_check", "planar.mirror(1.0)", "hanging.damping_time"]
)
def test_a_check_that_does_not_exist_or_takes_other_arguments_is_named(name: str):
    with pytest.raises(LookupError, match=re.escape(name)):
        find_check(name)


def test_a_check_is_given_the_arguments_of_its_row(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    def shown(batch: CheckBatch, name: str, count: int, ratio: float) -> Measured:
        return Measured(count * ratio, name)

    monkeypatch.setattr(planar, "mirror", shown)
    measured = find_check('planar.mirror("a, b", 3, 0.5)')(CheckBatch(1, 1, tmp_path))
    assert (measured.value, measured.note) == (1.5, "a, b")
