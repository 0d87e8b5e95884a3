"""Access rules of the page: who may view and who may command.

Three checks apply to every request:

- ``Host``: is the request for this server? Another site may point a name of its own here.
- ``Origin``: does it come from this server's page? Browsers send cookies with requests of other
  sites.
- Token: which role has the requester? Without tokens everyone on this machine is the operator.
"""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import secrets
import stat
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from msg_schemas.regular_files import file_problem, read_text

SHORTEST_TOKEN: Final = 16
_LOCAL_NAMES: Final = frozenset({"localhost", "localhost.localdomain"})
_MOST_TRIALS: Final = 10
_TRIAL_PERIOD: Final = 60.0  # [s]
_MOST_ADDRESSES: Final = 1000  # that are remembered


class AccessError(ValueError):
    """Settings that would open the console to others; the text states the remedy."""


class Role(Enum):
    """Permissions of a requester."""

    OPERATOR = "operator"
    VIEWER = "viewer"


@dataclass(frozen=True)
class PageAccess:
    """Access rules of one server.

    Attributes:
        operator_token: token of the operator; empty: everyone is the operator.
        viewer_token: token of viewers; empty: none.
        view_only: whether nobody may command.
        names: host names of the server, besides its addresses.
    """

    operator_token: str = ""
    viewer_token: str = ""
    view_only: bool = False
    names: frozenset[str] = field(default_factory=frozenset)

    @property
    def needs_token(self) -> bool:
        """Whether the page requires a token."""
        return bool(self.operator_token or self.viewer_token)

    def role(self, token: str) -> Role | None:
        """Role of the bearer of a token; None: no access."""
        if not self.needs_token:
            return Role.VIEWER if self.view_only else Role.OPERATOR
        if _same(token, self.operator_token):
            return Role.VIEWER if self.view_only else Role.OPERATOR
        if _same(token, self.viewer_token):
            return Role.VIEWER
        return None

    def serves(self, host: str) -> bool:
        """Whether a ``Host`` header names this server: an address, or one of its names."""
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        return is_address(name) or name in _LOCAL_NAMES or name in self.names


def is_own_origin(origin: str | None, host: str) -> bool:
    """Whether a request comes from this server's page.

    Other programs than browsers send no ``Origin``; a page cannot make a browser omit it.
    """
    if origin is None:
        return True
    try:
        parts = urlsplit(origin)
    except ValueError:
        return False
    return parts.scheme in {"http", "https"} and parts.netloc.lower() == host.lower()


def is_address(name: str) -> bool:
    """Whether a host name is an IP address, which DNS cannot redirect."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def is_local(address: str) -> bool:
    """Whether only this machine reaches a listening address."""
    return address in _LOCAL_NAMES or (
        is_address(address) and ipaddress.ip_address(address).is_loopback
    )


def read_token(path: str) -> str:
    """Read a token file: one line, readable by its owner alone.

    Raises:
        AccessError: it is missing, too short, or readable by others.
    """
    file = Path(path).expanduser()
    try:
        mode = file.stat().st_mode
        token = read_text(file).strip()
    except OSError as error:
        raise AccessError(f"the token file cannot be read: {file_problem(error)}") from error
    except UnicodeDecodeError as error:
        raise AccessError(f"the token file {path!r} is not UTF-8 text") from error
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise AccessError(f"others may read the token file {path!r}; run chmod 600 {path}")
    is_word = len(token.split()) == 1 and token.isascii() and token.isprintable()
    if len(token) < SHORTEST_TOKEN or not is_word:
        example = secrets.token_urlsafe(24)
        raise AccessError(
            f"the token in {path!r} should be one word of at least {SHORTEST_TOKEN} characters, "
            f"all of them ASCII, such as {example}"
        )
    return token


def open_access(
    address: str,
    token_file: str,
    viewer_token_file: str,
    view_only: bool,
    names: tuple[str, ...] = (),
) -> PageAccess:
    """Access rules of a server that listens on an address.

    Raises:
        AccessError: others could reach it without a token, or a token file is bad.
    """
    operator = read_token(token_file) if token_file else ""
    viewer = read_token(viewer_token_file) if viewer_token_file else ""
    if operator and _same(operator, viewer):
        raise AccessError("operator and viewer must have different tokens")
    if viewer and not operator and not view_only:
        raise AccessError("a viewer token requires an operator token, or view_only")
    if not is_local(address) and not (operator or viewer):
        raise AccessError(f"other machines reach {address}: set token_file, or listen on 127.0.0.1")
    return PageAccess(
        operator, viewer, view_only, frozenset(name.lower() for name in names if name)
    )


class TooManyTrialsError(Exception):
    """Too many wrong tokens from one address."""


class TrialCounter:
    """Checks tokens, and limits the number of different wrong ones that an address may try.

    The same wrong token again, such as an old cookie, is no further trial. A token that an address
    has once entered rightly is accepted whatever else comes from there.

    Args:
        access: has the tokens.
    """

    def __init__(self, access: PageAccess) -> None:
        self._access = access
        self._wrong: dict[str, dict[bytes, float]] = {}  # time of each token [s], by address
        self._accepted: set[tuple[str, bytes]] = set()

    def role(self, token: str, address: str, now: float) -> Role | None:
        """Role of the bearer of a token; None: no access.

        Args:
            token: as given; empty = none.
            address: of the requester.
            now: steady time [s].

        Raises:
            TooManyTrialsError: the token was not looked at.
        """
        if not self._access.needs_token or not token:
            return self._access.role(token)
        who, digest = _network(address), hashlib.sha256(token.encode(errors="replace")).digest()
        wrong = self._wrong.get(who, {})
        wrong = {each: at for each, at in wrong.items() if now - at <= _TRIAL_PERIOD}
        if (who, digest) not in self._accepted:
            if digest in wrong:
                return None
            if len(wrong) >= _MOST_TRIALS:
                raise TooManyTrialsError
        role = self._access.role(token)
        if role is None:
            _keep_newest(self._wrong, who, {**wrong, digest: now})
        elif len(self._accepted) < _MOST_ADDRESSES:
            self._accepted.add((who, digest))
        return role


def _network(address: str) -> str:
    """Where a requester comes from: its address, or the network of one with IPv6."""
    try:
        parsed = ipaddress.ip_address(address)
    except ValueError:
        return address
    if parsed.version == 4:
        return address
    return str(ipaddress.ip_network((parsed, 64), strict=False))


def _keep_newest(
    wrong: dict[str, dict[bytes, float]], who: str, trials: dict[bytes, float]
) -> None:
    wrong.pop(who, None)
    wrong[who] = trials
    if len(wrong) > _MOST_ADDRESSES:
        del wrong[next(iter(wrong))]


def _same(given: str, expected: str) -> bool:
    """Compare tokens in constant time."""
    return bool(expected) and hmac.compare_digest(given.encode(errors="replace"), expected.encode())
