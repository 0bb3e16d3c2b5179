"""The server answers to its own pages on this machine and to nobody else; what two pages do, both see."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import aiohttp
import pytest
from aiohttp import web

from pzcap.editor.door import Door, listening
from pzcap.editor.inverse_kinematics import HANDLES
from pzcap.editor.server import Editor
from pzcap.types import PzcapError
from tests.scenes import edited

TOKEN = "a-secret"


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return edited.capture(tmp_path_factory.mktemp("served") / "capture")


def served(folder: Path, talk: Callable[[int, aiohttp.ClientSession], Awaitable[None]]) -> None:
    """Serve a capture, tracked everywhere, and ``talk`` to it at its port; without a cookie."""

    async def run() -> None:
        listener = listening(0)
        runner = web.AppRunner(Editor(edited.workspace(folder, tracked=True), Door(TOKEN)).application())
        await runner.setup()
        await web.SockSite(runner, listener).start()
        jar = aiohttp.DummyCookieJar()
        try:
            async with aiohttp.ClientSession(cookie_jar=jar, timeout=aiohttp.ClientTimeout(30)) as session:
                await talk(listener.getsockname()[1], session)
        finally:
            await runner.cleanup()

    asyncio.run(run())


def test_who_is_answered(shared: Path) -> None:
    async def talk(port: int, session: aiohttp.ClientSession) -> None:
        url, own = f"http://127.0.0.1:{port}", f"http://127.0.0.1:{port}"
        cookie = {"Cookie": f"pzcap-editor-{port}={TOKEN}"}

        async def status(path: str, **headers: str) -> int:
            async with session.get(url + path, headers=headers, allow_redirects=False) as answer:
                assert "Access-Control-Allow-Origin" not in answer.headers
                return answer.status

        for path in ("/", "/editor.js", "/frame/0/0.jpg", "/live"):
            assert await status(path) == 403  # no cookie
            assert await status(path, Cookie=f"pzcap-editor-{port}=guess") == 403
            for host in (
                "evil.example",
                f"evil.example:{port}",
                f"127.0.0.1.evil.example:{port}",
                "[::1]x",
                "10.0.0.1",
            ):
                assert await status(path, **cookie, Host=host) == 403
            for origin in ("http://evil.example", "null", "http://127.0.0.1:1", f"https://127.0.0.1:{port}"):
                assert await status(path, **cookie, Origin=origin) == 403
            assert await status(path, **cookie, **{"Sec-Fetch-Site": "cross-site"}) == 403
        for path in ("/", "/editor.js", "/editor.css", "/frame/0/0.jpg"):
            assert await status(path, **cookie) == 200
            assert await status(path, **cookie, Origin=own) == 200
        for path in ("/frame/99/0.jpg", "/frame/0/9.jpg", "/nothing", "/../pyproject.toml", "/history.jsonl"):
            assert await status(path, **cookie) == 404
        assert await status("/?token=guess") == 403
        assert await status(f"/?token={TOKEN}", Host="evil.example") == 403
        async with session.get(f"{url}/?token={TOKEN}", allow_redirects=False) as answer:
            assert (answer.status, answer.headers["Location"]) == (303, "/")
            given = answer.headers["Set-Cookie"]
            assert "HttpOnly" in given
            assert "SameSite=Strict" in given
        async with session.get(f"{url}/", headers=cookie) as answer:
            assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
        for method in ("POST", "PUT", "DELETE"):
            async with session.request(method, url + "/", headers=cookie) as answer:
                assert answer.status in (403, 405)

    served(shared, talk)


def test_a_socket_is_opened_by_the_page_alone(shared: Path) -> None:
    async def talk(port: int, session: aiohttp.ClientSession) -> None:
        url, cookie = f"http://127.0.0.1:{port}/live", f"pzcap-editor-{port}={TOKEN}"
        for headers in (
            {"Cookie": cookie}, {"Cookie": cookie, "Origin": "http://evil.example"},
            {"Cookie": cookie, "Origin": "http://127.0.0.1:1"}, {"Origin": f"http://127.0.0.1:{port}"},
            {"Cookie": cookie, "Origin": f"http://evil.example:{port}", "Host": f"evil.example:{port}"},
        ):  # fmt: skip
            with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
                await session.ws_connect(url, headers=headers)

    served(shared, talk)


def test_it_listens_at_127_0_0_1_alone() -> None:
    with listening(0) as listener:
        listener.listen()
        host, port = listener.getsockname()
        assert host == "127.0.0.1"
        socket.create_connection(("127.0.0.1", port), 2).close()
        others = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)}
        for other in {"127.0.0.2", *map(str, others)} - {"127.0.0.1"}:
            with pytest.raises(OSError, match=r"refused|unreachable|timed out"):
                socket.create_connection((other, port), 2)
        with pytest.raises(PzcapError, match=f"port {port} cannot be listened at"):
            listening(port)
    for impossible in (-1, 65536):
        with pytest.raises(PzcapError, match="ports go from 0 to 65535"):
            listening(impossible)


class Page:
    """What a page says and hears."""

    def __init__(self, live: aiohttp.ClientWebSocketResponse) -> None:
        self.live = live

    async def say(self, what: str, **more: Any) -> None:
        await self.live.send_str(json.dumps({"do": what, **more}))

    async def hear(self, *names: str) -> dict[str, Any]:
        while True:
            message: dict[str, Any] = json.loads((await self.live.receive(20)).data)
            if any(name in message for name in names):
                return message


async def opened(port: int, session: aiohttp.ClientSession) -> Page:
    headers = {"Cookie": f"pzcap-editor-{port}={TOKEN}", "Origin": f"http://127.0.0.1:{port}"}
    page = Page(await session.ws_connect(f"http://127.0.0.1:{port}/live", headers=headers))
    assert (await page.hear("about"))["about"]["frames"] == edited.FRAMES
    await page.hear("overview")
    return page


def test_two_pages_see_the_same(tmp_path: Path) -> None:
    folder = edited.capture(tmp_path / "capture")
    wrist = edited.clicks(4, (2,))[HANDLES.index("right_wrist")]
    place = {"frame": 4, "handle": wrist.handle, "camera": 2, "x": wrist.x, "y": wrist.y, "sigma": 2.0}

    async def talk(port: int, session: aiohttp.ClientSession) -> None:
        one, two = await opened(port, session), await opened(port, session)
        await one.say("drag", **place, number=7)
        drawn = await one.hear("dragged")
        assert drawn["dragged"]["handles"][2][wrist.handle] == pytest.approx([wrist.x, wrist.y], abs=1.5)
        await one.say("drop", **place)
        for page in (one, two):
            told = await page.hear("shown")
            assert [click[:2] for click in told["shown"]["clicks"]] == [[wrist.handle, 2]]
            assert told["overview"]["keys"] == [4]
        await two.say("undo", seen=0)
        assert "another page" in (await two.hear("error"))["error"]
        await two.say("undo", seen=told["overview"]["version"])
        for page in (one, two):
            told = await page.hear("shown")
            assert told["overview"]["keys"] == []
        seen = told["overview"]["version"]
        for what in ("drop", "drop", "undo", "undo"):  # in haste, before it is told what became of them
            await two.say(what, **place, seen=seen)
        for _ in range(4):
            told = await two.hear("error", "shown")
            await one.hear("shown")
        assert told["overview"]["keys"] == []
        drop = {"do": "drop", **place}
        wrongs: list[Any] = [
            {"do": "drop", "frame": 4}, {"do": "dance", "frame": 0}, {"do": "show", "frame": 99}, {}, [], 3,
            drop | {"x": 1e9}, drop | {"camera": 7}, drop | {"y": "NaN"},
            {"do": "begin", "frame": 1, "origin": "?", "seen": 0},
        ]  # fmt: skip
        for wrong in wrongs:
            await one.live.send_str(json.dumps(wrong))
            assert (await one.hear("error", "shown")).get("error"), wrong
        await one.say("show", frame=5)
        assert (await one.hear("shown"))["shown"]["frame"] == 5

    served(folder, talk)
    assert not (folder / "keyframes.json").exists()
