"""The lint of commit subjects."""

from pathlib import Path

import pytest
from tool_scripts import load

check_commits = load("check_commits")


@pytest.mark.parametrize(
    "subject",
    ["Reject a trim while the winch is in a fault", "Bring the page up", "x".upper() * 72],
)
def test_a_short_imperative_passes(subject: str):
    assert check_commits.complaint(subject) == ""


@pytest.mark.parametrize(("subject", "status"), [("Reject a trim", 0), ("Rejecting a trim", 1)])
def test_the_hook_judges_the_first_line_of_the_message(tmp_path: Path, subject: str, status: int):
    message = tmp_path / "COMMIT_EDITMSG"
    message.write_text(f"{subject}\n\nRejecting things is what this is about.\n")
    assert check_commits.main(["--message", str(message)]) == status


@pytest.mark.parametrize(
    "subject",
    [
        "X" * 73,
        "reject a trim",
        "Reject a trim.",
        "Rejecting a trim",
        "Rejected a trim",
        "The trim",
    ],
)
def test_anything_else_is_refused(subject: str):
    assert check_commits.complaint(subject) != ""
