"""Access rules: tokens, host names, other sites."""

from __future__ import annotations

from pathlib import Path

import pytest

from operator_console.page_access import (
    Access,
    AccessError,
    Role,
    TrialCounter,
    is_own_origin,
    open_access,
    read_token,
)

OPERATOR, VIEWER = "operator-token-0123456789", "viewer-token-0123456789"


def token_file(folder: Path, token: str, mode: int = 0o600) -> str:
    path = folder / f"token{len(list(folder.iterdir()))}"
    path.write_text(token + "\n", encoding="utf-8")
    path.chmod(mode)
    return str(path)


def test_without_tokens_everyone_on_this_computer_is_the_operator():
    access = open_access("127.0.0.1", "", "", view_only=False)
    assert access.role("") is Role.OPERATOR
    assert not access.needs_token


@pytest.mark.parametrize("address", ["0.0.0.0", "192.168.1.7", "::", "pit.example"])
def test_other_computers_need_a_token(address: str, tmp_path: Path):
    with pytest.raises(AccessError, match=r"set token_file, or listen on 127\.0\.0\.1"):
        open_access(address, "", "", view_only=False)
    with pytest.raises(AccessError, match="token"):
        open_access(address, "", "", view_only=True)
    access = open_access(address, token_file(tmp_path, OPERATOR), "", view_only=False)
    assert access.role("") is None
    assert access.role(OPERATOR[:-1]) is None
    assert access.role(OPERATOR) is Role.OPERATOR


def test_a_viewer_cannot_command_and_view_only_applies_to_all(tmp_path: Path):
    files = token_file(tmp_path, OPERATOR), token_file(tmp_path, VIEWER)
    access = open_access("0.0.0.0", *files, view_only=False)
    assert access.role(VIEWER) is Role.VIEWER
    assert access.role(OPERATOR) is Role.OPERATOR
    watched = open_access("0.0.0.0", *files, view_only=True)
    assert watched.role(OPERATOR) is Role.VIEWER
    assert open_access("127.0.0.1", "", "", view_only=True).role("") is Role.VIEWER


def test_weak_or_readable_tokens_are_refused(tmp_path: Path):
    with pytest.raises(AccessError, match="at least 16 characters"):
        read_token(token_file(tmp_path, "short"))
    with pytest.raises(AccessError, match="chmod 600"):
        read_token(token_file(tmp_path, OPERATOR, 0o644))
    with pytest.raises(AccessError, match="cannot be read"):
        read_token(str(tmp_path / "none"))
    same = token_file(tmp_path, OPERATOR), token_file(tmp_path, OPERATOR)
    with pytest.raises(AccessError, match="different tokens"):
        open_access("127.0.0.1", *same, view_only=False)
    with pytest.raises(AccessError, match="requires an operator token"):
        open_access("127.0.0.1", "", token_file(tmp_path, VIEWER), view_only=False)


@pytest.mark.parametrize(
    ("host", "served"),
    [
        ("127.0.0.1:8642", True),
        ("localhost:8642", True),
        ("[::1]:8642", True),
        ("10.0.0.7", True),
        ("pit.example:8642", True),
        ("evil.example:8642", False),
        ("localhost.evil.example", False),
        ("", False),
    ],
)
def test_only_names_of_this_server_are_served(host: str, served: bool):
    assert Access(names=frozenset({"pit.example"})).serves(host) is served


@pytest.mark.parametrize(
    ("origin", "own"),
    [
        (None, True),
        ("http://127.0.0.1:8642", True),
        ("https://127.0.0.1:8642", True),
        ("http://127.0.0.1:8643", False),
        ("http://127.0.0.1:8642.evil.example", False),
        ("http://localhost:8642", False),
        ("null", False),
        ("file://127.0.0.1:8642", False),
    ],
)
def test_only_the_servers_own_page_is_its_origin(origin: str | None, own: bool):
    assert is_own_origin(origin, "127.0.0.1:8642") is own


def test_the_rate_of_wrong_tokens_is_limited():
    counter = TrialCounter()
    for trial in range(10):
        assert counter.may_try(float(trial))
        counter.failed(float(trial))
    assert not counter.may_try(30.0)
    assert counter.may_try(61.0)
