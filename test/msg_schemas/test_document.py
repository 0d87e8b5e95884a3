"""docs/contract.md is the table, nothing else."""

from pathlib import Path

from msg_schemas.document import render
from rover_cli.command_line import main

DOCUMENT = Path(__file__).parents[2] / "docs" / "contract.md"


def test_committed_document_is_what_the_table_generates():
    assert DOCUMENT.read_text(encoding="utf-8") == render(), "run: make contract"


def test_command_writes_to_the_given_path(tmp_path: Path):
    target = tmp_path / "new" / "contract.md"
    assert main(["contract", str(target)]) == 0
    assert target.read_text(encoding="utf-8") == render()
