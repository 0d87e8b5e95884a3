"""CONTRIBUTING.md is true: the files of its table define what the table names."""

import ast
import re
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
ROW = re.compile(r"^\| (.+?) \| `(.+?)` \| `(.+?)` \|$", re.MULTILINE)
ROWS = ROW.findall((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"))


def defined(path: Path) -> set[str]:
    """Return the names that a file defines: of a module, keys of YAML, or a table's identifiers."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".yaml":
        content = yaml.safe_load(text)
        return (
            set(content)
            if isinstance(content, dict)
            else {row["id"] for area in content for row in area["rows"]}
        )
    names: set[str] = set()
    for node in ast.parse(text).body:
        match node:
            case ast.ClassDef(name=name) | ast.FunctionDef(name=name):
                names.add(name)
            case ast.Assign(targets=[ast.Name(id=name)]) | ast.AnnAssign(target=ast.Name(id=name)):
                names.add(name)
    return names


def test_the_table_answers_twenty_questions():
    assert len(ROWS) >= 20
    assert len({what for what, _, _ in ROWS}) == len(ROWS)


@pytest.mark.parametrize(("what", "file", "name"), ROWS, ids=[name for _, _, name in ROWS])
def test_the_file_defines_what_the_table_names(what: str, file: str, name: str):
    assert name in defined(ROOT / file), what
