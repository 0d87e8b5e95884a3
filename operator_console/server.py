"""HTTP and WebSocket server of the operators' page, in its own thread.

The page is package data; a content security policy forbids the browser to load anything else. The
node sends state with ``Server.send`` and ``Server.latch``. ``on_command`` receives the operators'
commands and returns a future with the answer.
"""

from __future__ import annotations

import asyncio
import json
import socket
import ssl
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from tornado import httpserver, iostream, netutil, web, websocket

from operator_console.bag_shelf import BagShelf, ShelfError
from operator_console.page_access import (
    PageAccess,
    Role,
    TooManyTrialsError,
    TrialCounter,
    is_own_origin,
)

PAGE: Final = Path(__file__).parent / "page"
_COOKIE: Final = "console"
_LARGEST_MESSAGE: Final = 65_536  # [B]
_PING: Final = 5.0  # [s]
_START_TIMEOUT: Final = 20.0  # [s]
_TYPES: Final = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)

Content = Mapping[str, Any]
"""Content of a JSON message."""

OnCommand = Callable[[Content], "Future[Content]"]
"""Handles a command of a page, in the server thread; the future holds the answer."""

GetHistory = Callable[[], Content]
"""Returns the state of the last minutes for a page that connects."""


class ServerError(OSError):
    """The server cannot listen."""


@dataclass(frozen=True)
class ServerSettings:
    """Where a server listens and what it shows.

    Attributes:
        address: address to listen on.
        port: port to listen on; 0: any free one.
        access: roles and their tokens.
        shelf: replayable bags.
        certificate: certificate file for https; empty: http.
        key: private key file of the certificate.
    """

    address: str
    port: int
    access: PageAccess
    shelf: BagShelf
    certificate: str = ""
    key: str = ""


class Server:
    """Starts with ``start`` and ends with ``stop``; any thread may call the other methods."""

    def __init__(
        self, settings: ServerSettings, on_command: OnCommand, history: GetHistory
    ) -> None:
        self.settings = settings
        self.on_command = on_command
        self.history = history
        self.trials = TrialCounter(settings.access)
        self.workers = ThreadPoolExecutor(1, "console-bags")
        self.latched: dict[str, str] = {}
        self.pages: set[LiveHandler] = set()
        self.answering: set[asyncio.Future[None]] = set()
        self.port = 0
        self._tls: ssl.SSLContext | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stop: asyncio.Event | None = None
        self._started: Future[int] = Future()
        self._thread = threading.Thread(target=self._run, name="console-server", daemon=True)

    @property
    def address(self) -> str:
        """URL of the page."""
        scheme = "https" if self.settings.certificate else "http"
        host = self.settings.address
        return f"{scheme}://{f'[{host}]' if ':' in host else host}:{self.port}/"

    def start(self) -> None:
        """Listen.

        Raises:
            ServerError: the certificate, the address or the port cannot be used.
        """
        self._tls = _tls(self.settings)
        self._thread.start()
        try:
            self.port = self._started.result(_START_TIMEOUT)
        except OSError as error:
            where = f"{self.settings.address} port {self.settings.port}"
            why = error.strerror or error
            raise ServerError(
                f"the console cannot listen on {where}: {why}; choose another port or address"
            ) from error

    def stop(self) -> None:
        """Close all connections and the port."""
        if self._loop is not None and self._stop is not None and self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stop.set)
            self._thread.join()
        self.workers.shutdown(wait=False, cancel_futures=True)

    def send(self, kind: str, content: Content, *, may_drop: bool = False) -> None:
        """Send to all connected pages; a slow page may miss content that may be dropped."""
        if self.pages:
            self._schedule(_text({"kind": kind, **content}), may_drop)

    def latch(self, kind: str, content: Content) -> None:
        """Send to all connected pages and to later ones; the last content of each kind is kept."""
        text = _text({"kind": kind, **content})
        self.latched[kind] = text
        self._schedule(text, may_drop=False)

    def _schedule(self, text: str, may_drop: bool) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._broadcast, text, may_drop)

    def _broadcast(self, text: str, may_drop: bool) -> None:
        for page in tuple(self.pages):
            page.send(text, may_drop)

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except OSError as error:
            if not self._started.done():
                self._started.set_exception(error)

    async def _serve(self) -> None:
        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        settings = self.settings
        sockets = netutil.bind_sockets(
            settings.port, settings.address, family=_family(settings.address)
        )
        serving = httpserver.HTTPServer(
            application(self),
            ssl_options=self._tls,
            max_body_size=_LARGEST_MESSAGE,
            max_buffer_size=_LARGEST_MESSAGE,
        )
        serving.add_sockets(sockets)
        self._started.set_result(int(sockets[0].getsockname()[1]))
        await self._stop.wait()
        serving.stop()
        for page in tuple(self.pages):
            page.close(1001, "the console node has stopped")
        await serving.close_all_connections()


def _tls(settings: ServerSettings) -> ssl.SSLContext | None:
    """Options of https; None without a certificate."""
    certificate, key = settings.certificate, settings.key
    if not certificate:
        if key:
            raise ServerError(f"key_file {key!r} is given without certificate_file: give both")
        return None
    options = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        options.load_cert_chain(
            Path(certificate).expanduser(),
            Path(key).expanduser() if key else None,
            password="",  # do not ask for one
        )
    except OSError as error:
        files = f"certificate_file {certificate!r} and key_file {key!r}"
        raise ServerError(
            f"{files} cannot be used: {error.strerror or error}; give PEM files without a password"
        ) from error
    return options


def application(server: Server) -> web.Application:
    """URL handlers of a server."""
    own = {"server": server}
    return web.Application(
        [
            (r"/", PageHandler, own),
            (r"/enter", EnterHandler, own),
            (r"/leave", LeaveHandler, own),
            (r"/live", LiveHandler, own),
            (r"/bags", BagsHandler, own),
            (r"/bags/([^/]+)", BagHandler, own),
            (r"/page/([\w./-]*)", FileHandler, {"path": str(PAGE), **own}),
        ],
        default_handler_class=NotFoundHandler,
        default_handler_args=own,
        compress_response=True,
        websocket_ping_interval=_PING,
        websocket_max_message_size=_LARGEST_MESSAGE,
        log_function=lambda _handler: None,
    )


class Handler(web.RequestHandler):
    """Checks the Host, Origin and token of every request."""

    server: Server
    needs_role = True

    def initialize(self, server: Server, **_: Any) -> None:
        """Store the server."""
        self.server = server

    @property
    def role(self) -> Role | None:
        """Role of the requester."""
        return self.role_of(self.get_cookie(_COOKIE) or "")

    def role_of(self, token: str) -> Role | None:
        """Role of the bearer of a token."""
        try:
            return self.server.trials.role(token, self.request.remote_ip or "", time.monotonic())
        except TooManyTrialsError:
            reason = "too many wrong tokens; try again in a minute"
            raise web.HTTPError(429, reason=reason) from None

    def set_default_headers(self) -> None:
        """Forbid other sites, framing and content sniffing."""
        self.set_header("Content-Security-Policy", _POLICY)
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Referrer-Policy", "no-referrer")
        self.set_header("Cross-Origin-Resource-Policy", "same-origin")
        self.set_header("Cache-Control", "no-store")
        self.clear_header("Server")

    def prepare(self) -> None:
        """Refuse requests for other hosts, from other sites or without a token."""
        request = self.request
        if not self.server.settings.access.serves(request.host):
            raise web.HTTPError(421, reason="unknown host name; add it to host_names")
        if not is_own_origin(request.headers.get("Origin"), request.host):
            raise web.HTTPError(403, reason="request from another site")
        if self.needs_role and self.role is None:
            raise web.HTTPError(401, reason="token required")

    def write_error(self, status_code: int, **_: Any) -> None:
        """Answer with one line of text."""
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status_code}: {self._reason}\n")


class NotFoundHandler(Handler):
    """Every other URL."""

    def prepare(self) -> None:
        """Answer with 404."""
        super().prepare()
        raise web.HTTPError(404)


class PageHandler(Handler):
    """The page, or the form for a token."""

    needs_role = False

    async def get(self) -> None:
        """Send the page."""
        name = "enter.html" if self.role is None else "index.html"
        self.set_header("Content-Type", "text/html; charset=utf-8")
        await self.finish((PAGE / name).read_bytes())


class EnterHandler(Handler):
    """Accepts a token and stores it in a cookie."""

    needs_role = False

    async def post(self) -> None:
        """Check the token."""
        token = self.get_body_argument("token", "").strip()
        if self.role_of(token) is None:
            self.redirect("/?wrong")
            return
        self.set_cookie(
            _COOKIE, token, httponly=True, samesite="Strict",
            secure=self.request.protocol == "https",
        )  # fmt: skip
        self.redirect("/")


class LeaveHandler(Handler):
    """Deletes the token cookie."""

    async def post(self) -> None:
        """Delete the cookie."""
        self.clear_cookie(_COOKIE)
        self.redirect("/")


class FileHandler(web.StaticFileHandler):
    """Scripts and styles of the page; nothing outside its folder."""

    def initialize(self, path: str, server: Server) -> None:  # type: ignore[override]
        """Store the server."""
        super().initialize(path)
        self._access = server.settings.access

    def prepare(self) -> None:
        """Refuse requests for other hosts."""
        if not self._access.serves(self.request.host):
            raise web.HTTPError(421, reason="unknown host name; add it to host_names")

    def set_extra_headers(self, path: str) -> None:
        """Set the content type independently of the system; browsers revalidate their cache."""
        kind = _TYPES.get(Path(path).suffix)
        if kind:
            self.set_header("Content-Type", f"{kind}; charset=utf-8")
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Cache-Control", "no-cache")


class BagsHandler(Handler):
    """The list of bags."""

    async def get(self) -> None:
        """Send the list."""
        shelf = self.server.settings.shelf
        self.finish({"bags": await self._read(shelf.listed), "folder": str(shelf.folder or "")})

    async def _read(self, call: Callable[[], Any]) -> Any:
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self.server.workers, call)


class BagHandler(BagsHandler):
    """One bag as JSON."""

    async def get(self, name: str = "") -> None:
        """Send the bag."""
        shelf = self.server.settings.shelf
        try:
            text = await self._read(lambda: shelf.replay(name))
        except ShelfError as error:
            self.set_status(404)
            self.finish({"error": str(error)})
            return
        self.set_header("Content-Type", "application/json")
        self.finish(text)


class LiveHandler(Handler, websocket.WebSocketHandler):
    """WebSocket: live state and commands."""

    _pending: asyncio.Future[None] | None = None

    def check_origin(self, origin: str) -> bool:
        """Accept only this server's own page."""
        return is_own_origin(origin, self.request.host)

    def open(self, *_: str, **__: str) -> None:
        """Send role, latched content and history."""
        self.set_nodelay(True)
        role = self.role
        self._may_command = role is Role.OPERATOR
        access = self.server.settings.access
        self._send(
            _text({
                "kind": "welcome",
                "may_command": self._may_command,
                "by_token": access.needs_token,
            })
        )  # fmt: skip
        for text in tuple(self.server.latched.values()):
            self._send(text)
        self.server.pages.add(self)  # what is sent from here on follows the history
        self._send(_text({"kind": "history", **self.server.history()}))

    def on_close(self) -> None:
        """Remove the page."""
        self.server.pages.discard(self)

    def send(self, text: str, may_drop: bool) -> None:
        """Send, unless the text may be dropped and an earlier one is still pending."""
        lags = self._pending is not None and not self._pending.done()
        if not (lags and may_drop):
            self._send(text)

    def _send(self, text: str) -> None:
        try:
            self._pending = asyncio.ensure_future(_ignoring_closed(self.write_message(text)))
        except websocket.WebSocketClosedError:
            self.server.pages.discard(self)

    def on_message(self, message: str | bytes) -> None:
        """Execute a command; later commands do not wait for its answer."""
        try:
            request = json.loads(message)
            _text({"id": request.get("id") if isinstance(request, dict) else None})
        except (ValueError, RecursionError):
            request = None
        if not isinstance(request, dict) or not isinstance(request.get("command"), str):
            self.close(1008, "not a command")
            return
        answering = asyncio.ensure_future(self._answer(request))
        self.server.answering.add(answering)  # keeps a reference until it is done
        answering.add_done_callback(self.server.answering.discard)

    async def _answer(self, request: Content) -> None:
        reply: dict[str, Any] = {
            "kind": "outcome",
            "id": request.get("id"),
            "name": request["command"],
            "done": False,
            "reason": "the console failed; its log has the reason",
        }
        try:
            if self._may_command:
                answer: Content = await asyncio.wrap_future(self.server.on_command(request))
                reply.update(answer)
            else:
                reply["reason"] = "view only: this page accepts no commands"
        except asyncio.CancelledError:
            reply["reason"] = "the console node is stopping"
        finally:
            self._send(_text(reply))


async def _ignoring_closed(sending: Any) -> None:
    try:
        await sending
    except (websocket.WebSocketClosedError, iostream.StreamClosedError):
        return


def _family(address: str) -> socket.AddressFamily:
    return socket.AF_INET6 if ":" in address else socket.AF_INET


def _text(content: Content) -> str:
    return json.dumps(content, allow_nan=False)
