"""The lint of commit subjects."""

import pytest
from tool_scripts import load

check_commits = load("check_commits")


@pytest.mark.parametrize(
    "subject",
    ["Reject a trim while the winch is in a fault", "Bring the page up", "x".upper() * 72],
)
def test_a_short_imperative_passes(subject: str):
    assert check_commits.complaint(subject) == ""


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
