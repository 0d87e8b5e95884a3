"""Serves the console's page and speaks with it; runs in a thread of its own.

The page is package data: nothing is loaded from elsewhere, and the browser is told so. What
happens on the ROS side comes in by ``Server.tell`` and ``Server.keep``; what operators ask for
goes out by ``on_command``, which answers with a future.
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
from operator_console.page_access import Access, Role, TrialCounter, is_own_origin

PAGE: Final = Path(__file__).parent / "page"
_COOKIE: Final = "console"
_LARGEST_MESSAGE: Final = 65_536  # [B]
_PING: Final = 5.0  # [s]
_START_PATIENCE: Final = 20.0  # [s]
_TYPES: Final = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)

Content = Mapping[str, Any]
"""What can be written as JSON."""

OnCommand = Callable[[Content], "Future[Content]"]
"""Takes what a page asks for, in the server's thread; the future bears the answer."""

Past = Callable[[], Content]
"""What a page that is opened now shall know of the last minutes."""


class ServerError(OSError):
    """The server cannot listen; the text says why."""


@dataclass(frozen=True)
class ServerSettings:
    """Where a server listens, and what it has to show.

    Attributes:
        address: To listen on.
        port: 0: any that is free.
        access: Who may do what.
        shelf: The bags that can be replayed.
        certificate, key: Files for https; empty: http.
    """

    address: str
    port: int
    access: Access
    shelf: BagShelf
    certificate: str = ""
    key: str = ""


class Server:
    """Starts with ``start``, ends with ``stop``; everything else may be called from any thread."""

    def __init__(self, settings: ServerSettings, on_command: OnCommand, past: Past) -> None:
        self.settings = settings
        self.on_command = on_command
        self.past = past
        self.trials = TrialCounter()
        self.workers = ThreadPoolExecutor(1, "console-bags")
        self.kept: dict[str, str] = {}
        self.pages: set[LiveHandler] = set()
        self.answering: set[asyncio.Future[None]] = set()
        self.port = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stop: asyncio.Event | None = None
        self._started: Future[int] = Future()
        self._thread = threading.Thread(target=self._run, name="console-server", daemon=True)

    @property
    def address(self) -> str:
        """Where a browser finds the page."""
        scheme = "https" if self.settings.certificate else "http"
        host = self.settings.address
        return f"{scheme}://{f'[{host}]' if ':' in host else host}:{self.port}/"

    def start(self) -> None:
        """Listen.

        Raises:
            ServerError: It cannot.
        """
        self._thread.start()
        try:
            self.port = self._started.result(_START_PATIENCE)
        except OSError as error:
            where = f"{self.settings.address} port {self.settings.port}"
            raise ServerError(f"the console cannot listen on {where}: {error}") from error

    def stop(self) -> None:
        """Let go of pages and port."""
        if self._loop is not None and self._stop is not None and self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stop.set)
            self._thread.join()
        self.workers.shutdown(wait=False, cancel_futures=True)

    def tell(self, kind: str, content: Content, *, may_drop: bool = False) -> None:
        """Tell all pages that look; a page that lags behind may lose what is said anew soon."""
        if self.pages:
            self._soon(_text({"kind": kind, **content}), may_drop)

    def keep(self, kind: str, content: Content) -> None:
        """Tell all pages, and those that come later too; the last of each kind is kept."""
        text = _text({"kind": kind, **content})
        self.kept[kind] = text
        self._soon(text, may_drop=False)

    def _soon(self, text: str, may_drop: bool) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._broadcast, text, may_drop)

    def _broadcast(self, text: str, may_drop: bool) -> None:
        for page in tuple(self.pages):
            page.tell(text, may_drop)

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except OSError as error:
            if not self._started.done():
                self._started.set_exception(error)

    async def _serve(self) -> None:
        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        settings = self.settings
        options = None
        if settings.certificate:
            options = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
            options.load_cert_chain(settings.certificate, settings.key or None)
        sockets = netutil.bind_sockets(
            settings.port, settings.address, family=_family(settings.address)
        )
        serving = httpserver.HTTPServer(
            application(self),
            ssl_options=options,
            max_body_size=_LARGEST_MESSAGE,
            max_buffer_size=_LARGEST_MESSAGE,
        )
        serving.add_sockets(sockets)
        self._started.set_result(int(sockets[0].getsockname()[1]))
        await self._stop.wait()
        serving.stop()
        for page in tuple(self.pages):
            page.close(1001, "the console's node has ended")
        await serving.close_all_connections()


def application(server: Server) -> web.Application:
    """The handlers of a server."""
    own = {"server": server}
    return web.Application(
        [
            (r"/", PageHandler, own),
            (r"/enter", EnterHandler, own),
            (r"/leave", LeaveHandler, own),
            (r"/live", LiveHandler, own),
            (r"/bags", BagsHandler, own),
            (r"/bags/([^/]+)", BagHandler, own),
            (r"/page/(.*)", FileHandler, {"path": str(PAGE), **own}),
        ],
        default_handler_class=NothingHandler,
        default_handler_args=own,
        compress_response=True,
        websocket_ping_interval=_PING,
        websocket_max_message_size=_LARGEST_MESSAGE,
        log_function=lambda _handler: None,
    )


class Handler(web.RequestHandler):
    """Asks of every request whether it is meant for this server, its own page's, and whose."""

    server: Server
    needs_role = True

    def initialize(self, server: Server, **_: Any) -> None:
        """Know the server."""
        self.server = server

    @property
    def role(self) -> Role | None:
        """What who asks may do."""
        return self.server.settings.access.role(self.get_cookie(_COOKIE) or "")

    def set_default_headers(self) -> None:
        """Nothing from elsewhere, nowhere else, nothing guessed."""
        self.set_header("Content-Security-Policy", _POLICY)
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Referrer-Policy", "no-referrer")
        self.set_header("Cross-Origin-Resource-Policy", "same-origin")
        self.set_header("Cache-Control", "no-store")
        self.clear_header("Server")

    def prepare(self) -> None:
        """Refuse what is not to be answered."""
        request = self.request
        if not self.server.settings.access.serves(request.host):
            raise web.HTTPError(421, reason="not a name of this server")
        if not is_own_origin(request.headers.get("Origin"), request.host):
            raise web.HTTPError(403, reason="from another site")
        if self.needs_role and self.role is None:
            raise web.HTTPError(401, reason="a token is needed")

    def write_error(self, status_code: int, **_: Any) -> None:
        """A plain sentence."""
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status_code}: {self._reason}\n")


class NothingHandler(Handler):
    """All other addresses."""

    def prepare(self) -> None:
        """There is nothing."""
        super().prepare()
        raise web.HTTPError(404)


class PageHandler(Handler):
    """The page itself, or the question for a token."""

    needs_role = False

    async def get(self) -> None:
        """Show it."""
        name = "enter.html" if self.role is None else "index.html"
        self.set_header("Content-Type", "text/html; charset=utf-8")
        await self.finish((PAGE / name).read_bytes())


class EnterHandler(Handler):
    """Takes a token and remembers it in the browser."""

    needs_role = False

    async def post(self) -> None:
        """Let in who has one."""
        now = time.monotonic()
        if not self.server.trials.may_try(now):
            raise web.HTTPError(429, reason="too many wrong tokens, wait a minute")
        token = self.get_body_argument("token", "").strip()
        if self.server.settings.access.role(token) is None:
            self.server.trials.failed(now)
            self.redirect("/?wrong")
            return
        self.set_cookie(
            _COOKIE, token, httponly=True, samesite="Strict",
            secure=self.request.protocol == "https",
        )  # fmt: skip
        self.redirect("/")


class LeaveHandler(Handler):
    """Forgets the token."""

    async def post(self) -> None:
        """Let go."""
        self.clear_cookie(_COOKIE)
        self.redirect("/")


class FileHandler(web.StaticFileHandler):
    """Scripts and styles of the page: nothing secret, nothing beyond the page's folder."""

    def initialize(self, path: str, server: Server) -> None:  # type: ignore[override]
        """Know the server."""
        super().initialize(path)
        self._access = server.settings.access

    def prepare(self) -> None:
        """Refuse what is not meant for this server."""
        if not self._access.serves(self.request.host):
            raise web.HTTPError(421, reason="not a name of this server")

    def set_extra_headers(self, path: str) -> None:
        """Types do not depend on the machine; what is cached is asked for again."""
        kind = _TYPES.get(Path(path).suffix)
        if kind:
            self.set_header("Content-Type", f"{kind}; charset=utf-8")
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Cache-Control", "no-cache")


class BagsHandler(Handler):
    """What can be replayed."""

    async def get(self) -> None:
        """List it."""
        shelf = self.server.settings.shelf
        self.finish({"bags": await self._read(shelf.listed), "folder": str(shelf.folder or "")})

    async def _read(self, call: Callable[[], Any]) -> Any:
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self.server.workers, call)


class BagHandler(BagsHandler):
    """One bag, as the page replays it."""

    async def get(self, name: str = "") -> None:
        """Read it."""
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
    """What happens now, and commands."""

    _pending: asyncio.Future[None] | None = None

    def check_origin(self, origin: str) -> bool:
        """Only this server's own page."""
        return is_own_origin(origin, self.request.host)

    def open(self, *_: str, **__: str) -> None:
        """Tell what is so, from now on."""
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
        for text in tuple(self.server.kept.values()):
            self._send(text)
        self._send(_text({"kind": "past", **self.server.past()}))
        self.server.pages.add(self)

    def on_close(self) -> None:
        """Forget the page."""
        self.server.pages.discard(self)

    def tell(self, text: str, may_drop: bool) -> None:
        """Send, unless the page has not even taken what came before and gets the next one."""
        lags = self._pending is not None and not self._pending.done()
        if not (lags and may_drop):
            self._send(text)

    def _send(self, text: str) -> None:
        try:
            self._pending = asyncio.ensure_future(_quietly(self.write_message(text)))
        except websocket.WebSocketClosedError:
            self.server.pages.discard(self)

    def on_message(self, message: str | bytes) -> None:
        """A command. It is answered when its outcome is known; others need not wait for that."""
        try:
            asked = json.loads(message)
        except (ValueError, RecursionError):
            asked = None
        if not isinstance(asked, dict) or not isinstance(asked.get("command"), str):
            self.close(1008, "no command")
            return
        answering = asyncio.ensure_future(self._answer(asked))
        self.server.answering.add(answering)  # or nobody keeps it alive
        answering.add_done_callback(self.server.answering.discard)

    async def _answer(self, asked: Content) -> None:
        told: dict[str, Any] = {"kind": "outcome", "id": asked.get("id"), "name": asked["command"]}
        if not self._may_command:
            told |= {"done": False, "reason": "view only: commands are not taken here"}
        else:
            try:
                answer: Content = await asyncio.wrap_future(self.server.on_command(asked))
                told.update(answer)
            except asyncio.CancelledError:
                told |= {"done": False, "reason": "the console's node is ending"}
        self._send(_text(told))


async def _quietly(sending: Any) -> None:
    try:
        await sending
    except (websocket.WebSocketClosedError, iostream.StreamClosedError):
        return


def _family(address: str) -> socket.AddressFamily:
    return socket.AF_INET6 if ":" in address else socket.AF_INET


def _text(content: Content) -> str:
    return json.dumps(content, allow_nan=False)
