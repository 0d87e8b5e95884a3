"""The server, as a browser or another site accesses it; without ROS."""

from __future__ import annotations

import asyncio
import json
import math
import os
import re
import socket
from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest
from tornado import httpclient, websocket

from operator_console.bag_shelf import BagShelf
from operator_console.page_access import PageAccess
from operator_console.server import PAGE, Content, Server, ServerError, ServerSettings

OPERATOR, VIEWER = "operator-token-0123456789", "viewer-token-0123456789"


class Desk:
    """A server that records its commands."""

    def __init__(self, access: PageAccess, folder: Path | None = None, port: int = 0) -> None:
        self.requests: list[Content] = []
        settings = ServerSettings("127.0.0.1", port, access, BagShelf(folder))
        self.server = Server(settings, self._on_command, lambda: {"frames": [], "journal": []})
        self.server.latch("commands", {"commands": []})
        self.server.start()

    def _on_command(self, request: Content) -> Future[Content]:
        self.requests.append(request)
        answer: Future[Content] = Future()
        if request["command"] == "never_answered":
            return answer
        if request["command"] == "fails":
            raise KeyError(request["command"])
        answer.set_result({"done": False, "reason": "too deep", "code": "out_of_limits"})
        return answer

    def get(self, path: str, **options: Any) -> httpclient.HTTPResponse:
        """Send one request; return the response with any status."""

        async def fetch() -> httpclient.HTTPResponse:
            client = httpclient.AsyncHTTPClient()
            url = f"http://127.0.0.1:{self.server.port}{path}"
            options.setdefault("follow_redirects", False)
            return await client.fetch(url, raise_error=False, **options)

        return asyncio.run(fetch())

    def talk(
        self, *sent: object, headers: dict[str, str] | None = None, unanswered: int = 0
    ) -> list[dict[str, Any]]:
        """Send messages; return everything received until all but `unanswered` have answers."""

        async def speak() -> list[dict[str, Any]]:
            url = f"ws://127.0.0.1:{self.server.port}/live"
            request = httpclient.HTTPRequest(url, headers=headers or {})
            socket = await websocket.websocket_connect(request)
            for message in sent:
                await socket.write_message(json.dumps(message))
            received: list[dict[str, Any]] = []
            expected = len(sent) - unanswered + 3  # welcome, commands, history
            while len(received) < expected:
                text = await socket.read_message()
                if text is None:
                    break
                received.append(json.loads(text))
            socket.close()
            return received

        return asyncio.run(asyncio.wait_for(speak(), 60.0))


@pytest.fixture
def desks() -> Iterator[list[Desk]]:
    made: list[Desk] = []
    yield made
    for desk in made:
        desk.server.stop()


def opened(desks: list[Desk], access: PageAccess | None = None, folder: Path | None = None) -> Desk:
    desks.append(Desk(access or PageAccess(), folder))
    return desks[-1]


def test_the_page_loads_only_files_of_this_server(desks: list[Desk]):
    desk = opened(desks)
    page = desk.get("/")
    assert page.code == 200
    policy = page.headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "http" not in policy
    names = re.findall(r'(?:src|href)="([^"]+)"', page.body.decode())
    assert len(names) >= 4
    for name in names:
        assert name.startswith("/page/"), name
        assert desk.get(name).code == 200, name
    for script in PAGE.glob("*.js"):
        for name in re.findall(r'from "([^"]+)"', script.read_text(encoding="utf-8")):
            assert (script.parent / name).is_file(), f"{script.name} imports {name}"


@pytest.mark.parametrize(
    "file", [path for path in PAGE.rglob("*") if path.suffix in {".js", ".css", ".html"}],
    ids=lambda path: path.name,
)  # fmt: skip
def test_no_file_of_the_page_refers_to_another_server(file: Path):
    text = file.read_text(encoding="utf-8")
    assert not re.findall(
        r"""(?:url\(|src=|href=|fetch\(|import\()\s*["'`]?\s*(?:https?:)?//""", text
    )
    assert "@import" not in text


def test_the_licence_of_third_party_code_is_included():
    assert "MIT" in (PAGE / "vendor" / "uplot" / "LICENSE").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "path",
    [
        "/page/../access.py",
        "/page/%2e%2e/access.py",
        "/page/..%2faccess.py",
        "/page//etc/passwd",
        "/page/vendor/",
        "/bags/..%2f..%2fetc%2fpasswd",
        "/bags/%2e%2e",
        "/access.py",
    ],
)
def test_no_file_outside_the_page_is_served(desks: list[Desk], path: str, tmp_path: Path):
    answer = opened(desks, folder=tmp_path).get(path)
    assert answer.code in {403, 404}
    assert b"root:" not in answer.body
    assert b"def " not in answer.body


def test_other_host_names_and_sites_are_refused(desks: list[Desk]):
    desk = opened(desks)
    assert desk.get("/", headers={"Host": "evil.example"}).code == 421
    assert desk.get("/page/main.js", headers={"Host": "evil.example"}).code == 421
    assert desk.get("/bags", headers={"Origin": "http://evil.example"}).code == 403
    own = f"http://127.0.0.1:{desk.server.port}"
    assert desk.get("/bags", headers={"Origin": own}).code == 200
    for origin in ("http://evil.example", "null", "http://127.0.0.1:1"):
        with pytest.raises(httpclient.HTTPClientError, match="403"):
            desk.talk({"command": "arm"}, headers={"Origin": origin})
    assert not desk.requests
    assert desk.talk({"command": "arm"}, headers={"Origin": own})[0]["may_command"]


def test_a_refused_command_returns_the_reason(desks: list[Desk]):
    desk = opened(desks)
    *_, outcome = desk.talk({"id": 7, "command": "descend", "arguments": {"depth": 900}})
    assert outcome["kind"] == "outcome"
    assert (outcome["id"], outcome["name"]) == (7, "descend")
    assert (outcome["done"], outcome["reason"]) == (False, "too deep")
    assert desk.requests[0]["arguments"] == {"depth": 900}


@pytest.mark.parametrize("message", [[], "arm", {}, {"command": 3}, 5])
def test_a_bad_message_closes_the_connection(desks: list[Desk], message: object):
    desk = opened(desks)
    received = desk.talk(message)
    assert all(content["kind"] != "outcome" for content in received)
    assert not desk.requests
    assert desk.get("/").code == 200


def test_hold_does_not_wait_for_the_answer_to_another_command(desks: list[Desk]):
    desk = opened(desks)
    received = desk.talk(
        {"command": "never_answered", "id": 1}, {"command": "hold", "id": 2}, unanswered=1
    )
    assert [request["command"] for request in desk.requests] == ["never_answered", "hold"]
    assert received[-1]["id"] == 2


def test_view_only_accepts_no_command(desks: list[Desk]):
    desk = opened(desks, PageAccess(view_only=True))
    welcome, *_, outcome = desk.talk({"id": 1, "command": "arm"})
    assert welcome["may_command"] is False
    assert outcome["done"] is False
    assert "view only" in outcome["reason"]
    assert not desk.requests


def test_nothing_is_shown_without_the_token(desks: list[Desk], tmp_path: Path):
    desk = opened(desks, PageAccess(OPERATOR, VIEWER), tmp_path)
    assert b'name="token"' in desk.get("/").body
    assert desk.get("/bags").code == 401
    with pytest.raises(httpclient.HTTPClientError, match="401"):
        desk.talk({"command": "arm"})
    for token, may in ((OPERATOR, True), (VIEWER, False)):
        entered = desk.get("/enter", method="POST", body=f"token={token}")
        assert entered.code == 302
        cookie = entered.headers["Set-Cookie"]
        assert "HttpOnly" in cookie
        assert "SameSite=Strict" in cookie
        headers = {"Cookie": cookie.split(";")[0]}
        assert desk.get("/bags", headers=headers).code == 200
        welcome, *_ = desk.talk({"command": "arm"}, headers=headers)
        assert welcome["may_command"] is may
    assert len(desk.requests) == 1


def raw(desk: Desk, *headers: str, source: str = "127.0.0.1", path: str = "/bags") -> int:
    """Status of a request from an address of this machine."""
    there = ("127.0.0.1", desk.server.port)
    with socket.create_connection(there, 20.0, (source, 0)) as connection:
        lines = (f"GET {path} HTTP/1.1", "Connection: close", *headers, "", "")
        connection.sendall("\r\n".join(lines).encode())
        return int(connection.makefile("rb").readline().split()[1])


def cookie(token: str) -> str:
    return f"Cookie: console={token}"


def test_wrong_tokens_are_counted_by_who_sends_them(desks: list[Desk]):
    desk = opened(desks, PageAccess(OPERATOR))
    host = f"Host: 127.0.0.1:{desk.server.port}"
    for number in range(10):
        answer = desk.get("/enter", method="POST", body=f"token=wrong{number}")
        assert answer.headers["Location"] == "/?wrong"
        assert "Set-Cookie" not in answer.headers
    assert desk.get("/enter", method="POST", body=f"token={OPERATOR}").code == 429
    codes = [raw(desk, host, cookie(f"guess{n}"), source="127.0.0.2") for n in range(60)]
    assert codes == [401] * 10 + [429] * 50
    assert raw(desk, host, cookie(OPERATOR), source="127.0.0.3") == 200
    assert raw(desk, host, cookie(OPERATOR), source="127.0.0.2") == 429


@pytest.mark.parametrize("name", ["[", "[::1", "a[b", "]:80"])
def test_a_host_or_origin_that_is_none_is_refused(desks: list[Desk], name: str):
    desk = opened(desks)
    host = f"Host: 127.0.0.1:{desk.server.port}"
    for path in ("/", "/bags", "/live", "/page/main.js"):
        assert raw(desk, f"Host: {name}", path=path) in {400, 421}
    for path in ("/", "/bags", "/live"):
        assert raw(desk, host, f"Origin: http://{name}", path=path) == 403
    assert raw(desk, host) == 200


def test_what_cannot_be_read_is_no_bag_and_hides_no_other(desks: list[Desk], tmp_path: Path):
    (tmp_path / "gone.mcap").symlink_to(tmp_path / "nowhere")
    (tmp_path / "fifo").mkdir()
    os.mkfifo(tmp_path / "fifo" / "bag.mcap")
    (tmp_path / "dangling").mkdir()
    (tmp_path / "dangling" / "bag.mcap").symlink_to(tmp_path / "nowhere")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "bag_0.mcap").write_bytes(b"no bag")
    (tmp_path / "bag" / "gone.mcap").symlink_to(tmp_path / "nowhere")
    desk = opened(desks, folder=tmp_path)
    listed = json.loads(desk.get("/bags").body)["bags"]
    assert [bag["name"] for bag in listed] == ["bag"]
    for name in ("gone.mcap", "fifo", "dangling", "loop", "bag"):
        assert desk.get(f"/bags/{name}").code == 404


def test_a_failed_command_is_answered(desks: list[Desk]):
    *_, answer = opened(desks).talk({"command": "fails", "id": 7})
    assert (answer["id"], answer["done"]) == (7, False)
    assert "log" in answer["reason"]


@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_a_command_whose_answer_cannot_be_sent_is_not_executed(desks: list[Desk], number: float):
    desk = opened(desks)
    received = desk.talk({"command": "arm", "id": number})
    assert [each["kind"] for each in received] == ["welcome", "commands", "history"]
    assert desk.requests == []


@pytest.mark.parametrize("path", ["/page/%00", "/page/%2e%2e/server.py", "/page/../server.py"])
def test_no_other_file_is_sent(desks: list[Desk], path: str):
    assert opened(desks).get(path).code in {403, 404}


@pytest.mark.parametrize(
    ("certificate", "key", "complaint"),
    [
        ("nope.pem", "", "certificate_file 'nope.pem' .* No such file"),
        (__file__, "", "cannot be used"),
        ("", "key.pem", "key_file 'key.pem' is given without certificate_file"),
    ],
)
def test_a_certificate_that_cannot_be_used_is_refused(certificate: str, key: str, complaint: str):
    settings = ServerSettings("127.0.0.1", 0, PageAccess(), BagShelf(None), certificate, key)
    with pytest.raises(ServerError, match=complaint):
        Server(settings, lambda _: Future(), dict).start()


def test_frames_reach_the_connected_pages(desks: list[Desk]):
    desk = opened(desks)

    async def look() -> dict[str, Any]:
        socket = await websocket.websocket_connect(f"ws://127.0.0.1:{desk.server.port}/live")
        while json.loads(await socket.read_message() or "{}")["kind"] != "history":
            pass
        read = asyncio.ensure_future(socket.read_message())
        while not read.done():  # a frame is dropped while the history is on its way
            desk.server.send("frame", {"time": 1.5}, may_drop=True)
            await asyncio.sleep(0.01)
        found = json.loads(read.result() or "{}")
        socket.close()
        assert isinstance(found, dict)
        return found

    assert asyncio.run(asyncio.wait_for(look(), 60.0)) == {"kind": "frame", "time": 1.5}


def test_what_is_sent_while_a_page_opens_reaches_it():
    def history() -> Content:
        server.send("journal", {"entries": ["new"]})
        return {"frames": [], "journal": []}

    async def look() -> str | bytes | None:
        socket = await websocket.websocket_connect(f"ws://127.0.0.1:{server.port}/live")
        found = [await socket.read_message() for _ in range(3)]
        socket.close()
        return found[-1]

    server = Server(
        ServerSettings("127.0.0.1", 0, PageAccess(), BagShelf(None)), lambda _: Future(), history
    )
    server.start()
    try:
        found = asyncio.run(asyncio.wait_for(look(), 60.0))
    finally:
        server.stop()
    assert json.loads(found or "{}") == {"kind": "journal", "entries": ["new"]}


def test_a_port_in_use_is_reported(desks: list[Desk]):
    port = opened(desks).server.port
    with pytest.raises(ServerError, match=f"cannot listen on 127.0.0.1 port {port}"):
        Desk(PageAccess(), port=port)
