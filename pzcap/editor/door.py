"""Who may come in: servers of pages listen on 127.0.0.1 and answer to their own pages alone.

A page of another site, open in the same browser, could still send requests there: so a request is answered only if it
names this machine as its host (which one that reached it by a name made to point here does not), if it comes from a
page of this server or from none, and if it brings the secret that the address told at the start has put into a cookie.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import secrets
import socket
import sys
import webbrowser
from collections.abc import Awaitable, Callable, Mapping
from importlib import resources
from typing import Final
from urllib.parse import urlsplit

from aiohttp import web

from pzcap.types import PzcapError

HOST: Final = "127.0.0.1"
LONGEST_MESSAGE: Final = 1 << 16
_HOSTS: Final = (HOST, "localhost")
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff", "X-Frame-Options": "DENY", "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin", "Cross-Origin-Opener-Policy": "same-origin",
}  # fmt: skip
_TYPES: Final = {"html": "text/html", "js": "text/javascript", "css": "text/css"}


class Door:
    """The door of one server. ``token`` is its secret."""

    def __init__(self, token: str | None = None) -> None:
        self.token = token or secrets.token_urlsafe(24)

    def application(self) -> web.Application:
        """An application without routes, behind the check of every request."""
        return web.Application(middlewares=[self._guard], client_max_size=LONGEST_MESSAGE)

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
                return web.Response(status=403, text="this address is of another run\n", headers=_HEADERS)
            answer = web.Response(status=303, headers={**_HEADERS, "Location": "/", "Cache-Control": "no-store"})
            answer.set_cookie(cookie, self.token, httponly=True, samesite="Strict", path="/")
            return answer
        if not hmac.compare_digest(request.cookies.get(cookie, "").encode(), self.token.encode()):
            text = "open the address that the command has printed\n"
            return web.Response(status=403, text=text, headers=_HEADERS)
        try:
            answer_to = await handler(request)
        except web.HTTPException as error:
            return web.Response(status=error.status, text=f"{error.reason}\n", headers=_HEADERS)
        if not answer_to.prepared:
            answer_to.headers.update(_HEADERS)
        return answer_to


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


def page_files(names: Mapping[str, str]) -> Callable[[web.Request], Awaitable[web.Response]]:
    """A handler that answers with the files of a page; ``names`` are by what the address ends in."""

    async def file(request: web.Request) -> web.Response:
        name = names.get(request.match_info["name"])
        if name is None:
            raise web.HTTPNotFound
        data = resources.files("pzcap.editor").joinpath("page", name).read_bytes()
        kind = _TYPES[name.rpartition(".")[2]]
        return web.Response(body=data, content_type=kind, charset="utf-8", headers={"Cache-Control": "no-store"})

    return file


async def picture(jpeg: Awaitable[bytes | None]) -> web.Response:
    """The answer with a picture, which its address names for good; 404 where there is none."""
    try:
        data = await jpeg
    except PzcapError as error:
        return web.Response(status=500, text=f"{error}\n")
    if data is None:
        raise web.HTTPNotFound
    return web.Response(body=data, content_type="image/jpeg", headers={"Cache-Control": "private, max-age=3600"})


def serve(application: web.Application, door: Door, listener: socket.socket, what: str, *, browse: bool) -> None:
    """Serve a page that does ``what`` until the process is interrupted."""
    address = f"http://{HOST}:{listener.getsockname()[1]}/?token={door.token}"

    async def until_interrupted() -> None:
        runner = web.AppRunner(application, access_log=None)
        await runner.setup()
        try:
            await web.SockSite(runner, listener).start()
            print(f"{what}: {address}")
            print("end with Ctrl-C; every change is saved at once", flush=True)
            if browse and not await asyncio.to_thread(webbrowser.open, address):
                print("no browser was found; open the address yourself", file=sys.stderr)
            await asyncio.Event().wait()
        finally:
            await runner.cleanup()

    with listener, contextlib.suppress(KeyboardInterrupt):
        asyncio.run(until_interrupted())
