"""The server as a browser, or somebody else's page, meets it; without ROS."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest
from tornado import httpclient, websocket

from operator_console.bag_shelf import BagShelf
from operator_console.page_access import Access
from operator_console.server import PAGE, Content, Server, ServerError, ServerSettings

OPERATOR, VIEWER = "operator-token-0123456789", "viewer-token-0123456789"


class Desk:
    """A server, and what was asked of it."""

    def __init__(self, access: Access, folder: Path | None = None, port: int = 0) -> None:
        self.asked: list[Content] = []
        settings = ServerSettings("127.0.0.1", port, access, BagShelf(folder))
        self.server = Server(settings, self._on_command, lambda: {"frames": [], "journal": []})
        self.server.keep("commands", {"commands": []})
        self.server.start()

    def _on_command(self, asked: Content) -> Future[Content]:
        self.asked.append(asked)
        answer: Future[Content] = Future()
        if asked["command"] == "never_answered":
            return answer
        answer.set_result({"done": False, "reason": "too deep", "code": "out_of_limits"})
        return answer

    def get(self, path: str, **options: Any) -> httpclient.HTTPResponse:
        """One request, answered with whatever status."""

        async def ask() -> httpclient.HTTPResponse:
            client = httpclient.AsyncHTTPClient()
            url = f"http://127.0.0.1:{self.server.port}{path}"
            options.setdefault("follow_redirects", False)
            return await client.fetch(url, raise_error=False, **options)

        return asyncio.run(ask())

    def talk(
        self, *sent: object, headers: dict[str, str] | None = None, unanswered: int = 0
    ) -> list[dict[str, Any]]:
        """What comes over the live connection until each message has its answer, but so many."""

        async def speak() -> list[dict[str, Any]]:
            url = f"ws://127.0.0.1:{self.server.port}/live"
            request = httpclient.HTTPRequest(url, headers=headers or {})
            socket = await websocket.websocket_connect(request)
            for message in sent:
                await socket.write_message(json.dumps(message))
            heard: list[dict[str, Any]] = []
            wanted = len(sent) - unanswered + 3  # welcome, commands, past
            while len(heard) < wanted:
                text = await socket.read_message()
                if text is None:
                    break
                heard.append(json.loads(text))
            socket.close()
            return heard

        return asyncio.run(asyncio.wait_for(speak(), 60.0))


@pytest.fixture
def desks() -> Iterator[list[Desk]]:
    made: list[Desk] = []
    yield made
    for desk in made:
        desk.server.stop()


def opened(desks: list[Desk], access: Access | None = None, folder: Path | None = None) -> Desk:
    desks.append(Desk(access or Access(), folder))
    return desks[-1]


def test_the_page_comes_with_all_it_needs_and_nothing_from_elsewhere(desks: list[Desk]):
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
def test_no_file_of_the_page_names_another_place(file: Path):
    text = file.read_text(encoding="utf-8")
    assert not re.findall(
        r"""(?:url\(|src=|href=|fetch\(|import\()\s*["'`]?\s*(?:https?:)?//""", text
    )
    assert "@import" not in text


def test_the_licence_of_what_others_made_comes_along():
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
def test_nothing_but_the_page_is_given_away(desks: list[Desk], path: str, tmp_path: Path):
    answer = opened(desks, folder=tmp_path).get(path)
    assert answer.code in {403, 404}
    assert b"root:" not in answer.body
    assert b"def " not in answer.body


def test_other_names_and_other_sites_are_turned_away(desks: list[Desk]):
    desk = opened(desks)
    assert desk.get("/", headers={"Host": "evil.example"}).code == 421
    assert desk.get("/page/main.js", headers={"Host": "evil.example"}).code == 421
    assert desk.get("/bags", headers={"Origin": "http://evil.example"}).code == 403
    own = f"http://127.0.0.1:{desk.server.port}"
    assert desk.get("/bags", headers={"Origin": own}).code == 200
    for origin in ("http://evil.example", "null", "http://127.0.0.1:1"):
        with pytest.raises(httpclient.HTTPClientError, match="403"):
            desk.talk({"command": "arm"}, headers={"Origin": origin})
    assert not desk.asked
    assert desk.talk({"command": "arm"}, headers={"Origin": own})[0]["may_command"]


def test_a_command_goes_out_and_its_refusal_comes_back_with_the_reason(desks: list[Desk]):
    desk = opened(desks)
    *_, outcome = desk.talk({"id": 7, "command": "descend", "arguments": {"depth": 900}})
    assert outcome["kind"] == "outcome"
    assert (outcome["id"], outcome["name"]) == (7, "descend")
    assert (outcome["done"], outcome["reason"]) == (False, "too deep")
    assert desk.asked[0]["arguments"] == {"depth": 900}


@pytest.mark.parametrize("message", [[], "arm", {}, {"command": 3}, 5])
def test_what_is_no_command_ends_the_connection(desks: list[Desk], message: object):
    desk = opened(desks)
    heard = desk.talk(message)
    assert all(content["kind"] != "outcome" for content in heard)
    assert not desk.asked
    assert desk.get("/").code == 200


def test_hold_does_not_wait_for_the_answer_to_another_command(desks: list[Desk]):
    desk = opened(desks)
    told = desk.talk(
        {"command": "never_answered", "id": 1}, {"command": "hold", "id": 2}, unanswered=1
    )
    assert [asked["command"] for asked in desk.asked] == ["never_answered", "hold"]
    assert told[-1]["id"] == 2


def test_view_only_takes_no_command(desks: list[Desk]):
    desk = opened(desks, Access(view_only=True))
    welcome, *_, outcome = desk.talk({"id": 1, "command": "arm"})
    assert welcome["may_command"] is False
    assert outcome["done"] is False
    assert "view only" in outcome["reason"]
    assert not desk.asked


def test_nothing_is_shown_without_the_token(desks: list[Desk], tmp_path: Path):
    desk = opened(desks, Access(OPERATOR, VIEWER), tmp_path)
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
    assert len(desk.asked) == 1


def test_wrong_tokens_are_counted(desks: list[Desk]):
    desk = opened(desks, Access(OPERATOR))
    for _ in range(10):
        answer = desk.get("/enter", method="POST", body="token=wrong")
        assert answer.headers["Location"] == "/?wrong"
        assert "Set-Cookie" not in answer.headers
    assert desk.get("/enter", method="POST", body=f"token={OPERATOR}").code == 429


def test_frames_reach_the_pages_that_look(desks: list[Desk]):
    desk = opened(desks)

    async def look() -> dict[str, Any]:
        socket = await websocket.websocket_connect(f"ws://127.0.0.1:{desk.server.port}/live")
        while json.loads(await socket.read_message() or "{}")["kind"] != "past":
            pass
        while not desk.server.pages:
            await asyncio.sleep(0.01)
        desk.server.tell("frame", {"time": 1.5}, may_drop=True)
        found = json.loads(await socket.read_message() or "{}")
        socket.close()
        assert isinstance(found, dict)
        return found

    assert asyncio.run(asyncio.wait_for(look(), 60.0)) == {"kind": "frame", "time": 1.5}


def test_a_port_that_is_taken_is_told(desks: list[Desk]):
    port = opened(desks).server.port
    with pytest.raises(ServerError, match=f"cannot listen on 127.0.0.1 port {port}"):
        Desk(Access(), port=port)
