"""Access rules: tokens, host names, other sites."""

from __future__ import annotations

import contextlib
import tracemalloc
from pathlib import Path

import pytest

from operator_console.page_access import (
    AccessError,
    PageAccess,
    Role,
    TooManyTrialsError,
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
    for beyond in ("€uro-token-0123456789", "tökn-token-0123456789"):
        with pytest.raises(AccessError, match="ASCII"):
            read_token(token_file(tmp_path, beyond))
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
    assert PageAccess(names=frozenset({"pit.example"})).serves(host) is served


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


OPERATOR = "operator-token-0123456789"


def guess(counter: TrialCounter, count: int, address: str, now: float = 0.0) -> int:
    """Try different wrong tokens; returns how many were looked at."""
    looked_at = 0
    for number in range(count):
        with contextlib.suppress(TooManyTrialsError):
            assert counter.role(f"guess {now} {number}", address, now) is None
            looked_at += 1
    return looked_at


def test_the_number_of_wrong_tokens_is_limited_by_who_tries_them():
    counter = TrialCounter(PageAccess(OPERATOR))
    assert guess(counter, 300, "10.0.0.1") == 10
    assert counter.role(OPERATOR, "10.0.0.2", 1.0) is Role.OPERATOR
    with pytest.raises(TooManyTrialsError):
        counter.role(OPERATOR, "10.0.0.1", 59.0)
    assert counter.role(OPERATOR, "10.0.0.1", 61.0) is Role.OPERATOR


def test_a_right_token_is_never_locked_out_where_it_was_entered():
    counter = TrialCounter(PageAccess(OPERATOR))
    assert counter.role(OPERATOR, "10.0.0.1", 0.0) is Role.OPERATOR
    guess(counter, 300, "10.0.0.1")
    assert counter.role(OPERATOR, "10.0.0.1", 1.0) is Role.OPERATOR


def test_an_old_cookie_is_one_trial_however_often_it_is_sent():
    counter = TrialCounter(PageAccess(OPERATOR))
    for second in range(300):
        assert counter.role("the token of yesterday", "10.0.0.1", float(second)) is None
    assert counter.role("", "10.0.0.1", 300.0) is None
    assert counter.role(OPERATOR, "10.0.0.1", 300.0) is Role.OPERATOR


def test_the_addresses_of_one_network_count_as_one():
    counter = TrialCounter(PageAccess(OPERATOR))
    assert sum(guess(counter, 5, f"2001:db8::{n:x}", n * 1e-3) for n in range(100)) == 10
    assert guess(counter, 5, "2001:db8:1::1") == 5


def test_few_addresses_are_remembered():
    counter = TrialCounter(PageAccess(OPERATOR))
    tracemalloc.start()
    for number in range(3000):
        guess(counter, 12, f"10.1.{number // 250}.{number % 250}")
    assert tracemalloc.get_traced_memory()[0] < 10_000_000
    tracemalloc.stop()


@pytest.mark.parametrize("text", ["[", "[::1", "]", "a[b", "http://[", "//[", "\0"])
def test_hosts_and_origins_that_are_none_are_refused(text: str):
    assert not PageAccess().serves(text)
    assert not is_own_origin(text, "127.0.0.1:8642")
    assert not is_own_origin(f"http://{text}", "127.0.0.1:8642")
