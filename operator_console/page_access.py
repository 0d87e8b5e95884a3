"""Who may look at the console, and who may command.

Pure: no sockets, no files but those that hold tokens. Three questions are asked of every request:

- Is it meant for this server (``Host``)? A page elsewhere may make a name of its own point here.
- Does it come from this server's own page (``Origin``)? Browsers send cookies along for others.
- Whose is it (token)? Without tokens everyone on this machine is the operator.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import stat
from collections import deque
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

SHORTEST_TOKEN: Final = 16
_LOCAL_NAMES: Final = frozenset({"localhost", "localhost.localdomain"})
_MOST_TRIALS: Final = 10
_TRIAL_PERIOD: Final = 60.0  # [s]


class AccessError(ValueError):
    """Settings under which the console would be open to others; the text says what to change."""


class Role(Enum):
    """What someone may do."""

    OPERATOR = "operator"
    VIEWER = "viewer"


@dataclass(frozen=True)
class Access:
    """The rules of one server.

    Attributes:
        operator_token: Makes its bearer the operator; empty: everyone is.
        viewer_token: Lets its bearer look; empty: there is none.
        view_only: Nobody commands.
        names: Under which the server is reached, besides its addresses.
    """

    operator_token: str = ""
    viewer_token: str = ""
    view_only: bool = False
    names: frozenset[str] = field(default_factory=frozenset)

    @property
    def needs_token(self) -> bool:
        """Whether nothing is shown without a token."""
        return bool(self.operator_token or self.viewer_token)

    def role(self, token: str) -> Role | None:
        """What the bearer of a token may do; None: nothing, not even look."""
        if not self.needs_token:
            return Role.VIEWER if self.view_only else Role.OPERATOR
        if _same(token, self.operator_token):
            return Role.VIEWER if self.view_only else Role.OPERATOR
        if _same(token, self.viewer_token):
            return Role.VIEWER
        return None

    def serves(self, host: str) -> bool:
        """Whether a ``Host`` header names this server: an address, or one of its names."""
        name = urlsplit(f"//{host}").hostname or ""
        return is_address(name) or name in _LOCAL_NAMES or name in self.names


def is_own_origin(origin: str | None, host: str) -> bool:
    """Whether a request comes from the page of the server that it is sent to.

    Programs that are no browser send no ``Origin``; no page can make a browser leave it out.
    """
    if origin is None:
        return True
    parts = urlsplit(origin)
    return parts.scheme in {"http", "https"} and parts.netloc.lower() == host.lower()


def is_address(name: str) -> bool:
    """Whether a host's name is an IP address: no name service can turn it elsewhere."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def is_local(address: str) -> bool:
    """Whether only this machine reaches an address that is listened on."""
    return address in _LOCAL_NAMES or (
        is_address(address) and ipaddress.ip_address(address).is_loopback
    )


def read_token(path: str) -> str:
    """Read a token's file: one line that nobody else may read.

    Raises:
        AccessError: It is not there, too short, or others may read it.
    """
    file = Path(path).expanduser()
    try:
        mode = file.stat().st_mode
        token = file.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise AccessError(f"the token's file {path!r} cannot be read: {error}") from error
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise AccessError(f"others may read the token's file {path!r}: chmod 600 {path}")
    if len(token) < SHORTEST_TOKEN or len(token.split()) != 1:
        example = secrets.token_urlsafe(24)
        raise AccessError(
            f"the token in {path!r} must be one word of at least {SHORTEST_TOKEN} characters, "
            f"such as {example}"
        )
    return token


def open_access(
    address: str,
    token_file: str,
    viewer_token_file: str,
    view_only: bool,
    names: tuple[str, ...] = (),
) -> Access:
    """The rules of a server that listens on an address.

    Raises:
        AccessError: Others could reach it without a token, or a token's file is not good.
    """
    operator = read_token(token_file) if token_file else ""
    viewer = read_token(viewer_token_file) if viewer_token_file else ""
    if operator and _same(operator, viewer):
        raise AccessError("operator and viewer must have different tokens")
    if viewer and not operator and not view_only:
        raise AccessError("with a viewer's token an operator's is needed too, or view_only")
    if not is_local(address) and not (operator or viewer):
        raise AccessError(
            f"other machines reach {address}: give a token by token_file, or listen on 127.0.0.1"
        )
    return Access(operator, viewer, view_only, frozenset(name.lower() for name in names if name))


class TrialCounter:
    """Counts wrong tokens, so that they cannot be tried by the thousand."""

    def __init__(self) -> None:
        self._wrong: deque[float] = deque(maxlen=_MOST_TRIALS)

    def may_try(self, now: float) -> bool:
        """Whether another token is looked at now [s]."""
        return len(self._wrong) < _MOST_TRIALS or now - self._wrong[0] > _TRIAL_PERIOD

    def failed(self, now: float) -> None:
        """Count a wrong one."""
        self._wrong.append(now)


def _same(given: str, wanted: str) -> bool:
    """Whether tokens are equal, in a time that does not tell where they differ."""
    return bool(wanted) and hmac.compare_digest(given.encode(), wanted.encode())
