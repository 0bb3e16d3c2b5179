"""Server of the page: HTTP for its files and pictures, a WebSocket for everything else, for this machine alone.

It listens on 127.0.0.1. A page of another site, open in the same browser, could still send requests there: so a
request is answered only if it names this machine as its host (which one that reached it by a name made to point here
does not), if it comes from a page of this server or from none, and if it brings the secret that the address told at
the start has put into a cookie.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import secrets
import socket
import sys
import webbrowser
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from importlib import resources
from typing import Final
from urllib.parse import urlsplit

from aiohttp import WSCloseCode, WSMsgType, web

from pzcap.editor import showing
from pzcap.editor.desk import Desk
from pzcap.editor.showing import Json
from pzcap.editor.talk import Talk
from pzcap.editor.workspace import Workspace
from pzcap.types import PzcapError

HOST: Final = "127.0.0.1"
_HOSTS: Final = (HOST, "localhost")
_FILES: Final = {"": ("index.html", "text/html"), "editor.js": ("editor.js", "text/javascript"),
                 "editor.css": ("editor.css", "text/css")}  # fmt: skip
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff", "X-Frame-Options": "DENY", "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin", "Cross-Origin-Opener-Policy": "same-origin",
}  # fmt: skip
_LONGEST_MESSAGE: Final = 1 << 16


class Editor:
    """The server of one workspace."""

    def __init__(self, workspace: Workspace, token: str | None = None) -> None:
        self.workspace, self.token = workspace, token or secrets.token_urlsafe(24)
        self._pages: set[web.WebSocketResponse] = set()
        self._desk = Desk(workspace, self._tell_all)

    def application(self) -> web.Application:
        """The routes, behind the check of every request."""
        application = web.Application(middlewares=[self._guard], client_max_size=_LONGEST_MESSAGE)
        application.router.add_get("/frame/{frame:[0-9]{1,7}}/{camera:[0-9]{1,2}}.jpg", self._picture)
        application.router.add_get("/live", self._live)
        application.router.add_get("/{name:[a-z.]*}", self._file)
        application.on_shutdown.append(self._close)
        return application

    async def _close(self, _: web.Application) -> None:
        self._desk.stop_solving()
        for page in list(self._pages):
            await page.close(code=WSCloseCode.GOING_AWAY)
        self._desk.close()

    # ----------------------------------------------------------------------------------------------------------
    # Who may ask

    @web.middleware
    async def _guard(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        if reason := refusal(request.host, request.headers):
            return web.Response(status=403, text=reason + "\n", headers=_HEADERS)
        port = urlsplit(f"//{request.host}").port or 80
        cookie = f"pzcap-editor-{port}"  # cookies are of a host, whatever the port
        if "token" in request.query:
            if not hmac.compare_digest(request.query["token"].encode(), self.token.encode()):
                return web.Response(status=403, text="this address is of another editor\n", headers=_HEADERS)
            answer = web.Response(status=303, headers={**_HEADERS, "Location": "/", "Cache-Control": "no-store"})
            answer.set_cookie(cookie, self.token, httponly=True, samesite="Strict", path="/")
            return answer
        if not hmac.compare_digest(request.cookies.get(cookie, "").encode(), self.token.encode()):
            text = "open the address that pzcap edit has printed\n"
            return web.Response(status=403, text=text, headers=_HEADERS)
        try:
            answer_to = await handler(request)
        except web.HTTPException as error:
            return web.Response(status=error.status, text=f"{error.reason}\n", headers=_HEADERS)
        if not answer_to.prepared:
            answer_to.headers.update(_HEADERS)
        return answer_to

    # ----------------------------------------------------------------------------------------------------------
    # Answers

    async def _file(self, request: web.Request) -> web.Response:
        known = _FILES.get(request.match_info["name"])
        if known is None:
            raise web.HTTPNotFound
        data = resources.files("pzcap.editor").joinpath("page", known[0]).read_bytes()
        return web.Response(body=data, content_type=known[1], charset="utf-8", headers={"Cache-Control": "no-store"})

    async def _picture(self, request: web.Request) -> web.Response:
        frame, camera = int(request.match_info["frame"]), int(request.match_info["camera"])
        if frame >= len(self.workspace.sets) or camera >= len(self.workspace.capture.cameras):
            raise web.HTTPNotFound
        try:
            jpeg = await self._desk.look(self.workspace.footage.jpeg, frame, camera)
        except PzcapError as error:
            return web.Response(status=500, text=f"{error}\n")
        if jpeg is None:
            raise web.HTTPNotFound
        return web.Response(body=jpeg, content_type="image/jpeg", headers={"Cache-Control": "private, max-age=3600"})

    async def _live(self, request: web.Request) -> web.StreamResponse:
        if request.headers.get("Origin") is None:
            return web.Response(status=403, text="only a page of this server may ask here\n")
        page = web.WebSocketResponse(max_msg_size=_LONGEST_MESSAGE, heartbeat=30.0, compress=False)
        await page.prepare(request)
        self._pages.add(page)
        try:
            await self._send(page, {"about": await self._desk.look(showing.about, self.workspace)})
            await self._send(page, {"overview": await self._desk.pose(showing.overview, self.workspace)})
            talk = Talk(self._desk, partial(self._send, page))
            async for message in page:
                if message.type == WSMsgType.TEXT:
                    await talk.hear(message.data)
        finally:
            self._pages.discard(page)
        return page

    @staticmethod
    async def _send(page: web.WebSocketResponse, message: Json) -> None:
        if not page.closed:
            with contextlib.suppress(ConnectionError):
                await page.send_str(json.dumps(message, separators=(",", ":")))

    async def _tell_all(self, message: Json) -> None:
        for page in list(self._pages):
            await self._send(page, message)


def refusal(host: str, headers: Mapping[str, str]) -> str | None:
    """Why a request is refused, before its secret is looked at; None where it is not."""
    try:
        name = urlsplit(f"//{host}").hostname
    except ValueError:
        name = None
    if name not in _HOSTS:
        return "this server answers to 127.0.0.1 alone"
    origin = headers.get("Origin")
    if origin is not None and origin != f"http://{host}":
        return "a page of another origin may not ask here"
    if headers.get("Sec-Fetch-Site", "none") not in ("same-origin", "none"):
        return "a page of another site may not ask here"
    return None


def listening(port: int) -> socket.socket:
    """A socket at 127.0.0.1; port 0 is any that is free. PzcapError where it is taken."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((HOST, port))
    except (OSError, OverflowError) as error:
        listener.close()
        why = error.strerror if isinstance(error, OSError) else "ports go from 0 to 65535"
        raise PzcapError(f"port {port} cannot be listened at ({why}); give another --port") from error
    return listener


def serve(workspace: Workspace, port: int, *, browse: bool) -> None:
    """Serve the page until the process is interrupted."""
    editor, listener = Editor(workspace), listening(port)
    print(f"{workspace.capture.name}: getting ready; the first time on a machine that takes up to a minute", flush=True)
    showing.warm_up(workspace)
    address = f"http://{HOST}:{listener.getsockname()[1]}/?token={editor.token}"

    async def until_interrupted() -> None:
        runner = web.AppRunner(editor.application(), access_log=None)
        await runner.setup()
        try:
            await web.SockSite(runner, listener).start()
            print(f"editing {workspace.capture.name}: {address}")
            print("end with Ctrl-C; every change is saved at once", flush=True)
            if browse and not await asyncio.to_thread(webbrowser.open, address):
                print("no browser was found; open the address yourself", file=sys.stderr)
            await asyncio.Event().wait()
        finally:
            await runner.cleanup()

    with listener, contextlib.suppress(KeyboardInterrupt):
        asyncio.run(until_interrupted())
