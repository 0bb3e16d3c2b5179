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
import threading
import time
import traceback
import webbrowser
from collections.abc import Awaitable, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib import resources
from typing import Any, Final, TypeVar
from urllib.parse import urlsplit

from aiohttp import WSCloseCode, WSMsgType, web

from pzcap.editor import showing
from pzcap.editor.inverse_kinematics import HANDLES, Click
from pzcap.editor.showing import Json
from pzcap.editor.workspace import Dragged, Workspace
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
_REPORT_S: Final = 0.2

T = TypeVar("T")


class Editor:
    """The server of one workspace."""

    def __init__(self, workspace: Workspace, token: str | None = None) -> None:
        self.workspace, self.token = workspace, token or secrets.token_urlsafe(24)
        self._pages: set[web.WebSocketResponse] = set()
        self._solving: threading.Event | None = None  # set to stop what is being tracked
        self._tasks: set[asyncio.Task[None]] = set()
        self._hands = ThreadPoolExecutor(1, "hands")  # poses, one after the other
        self._eyes = ThreadPoolExecutor(2, "eyes")  # pictures
        self._legs = ThreadPoolExecutor(1, "legs")  # tracking anew

    def application(self) -> web.Application:
        """The routes, behind the check of every request."""
        application = web.Application(middlewares=[self._guard], client_max_size=_LONGEST_MESSAGE)
        application.router.add_get("/frame/{frame:[0-9]{1,7}}/{camera:[0-9]{1,2}}.jpg", self._picture)
        application.router.add_get("/live", self._live)
        application.router.add_get("/{name:[a-z.]*}", self._file)
        application.on_shutdown.append(self._close)
        return application

    async def _close(self, _: web.Application) -> None:
        if self._solving:
            self._solving.set()
        for page in list(self._pages):
            await page.close(code=WSCloseCode.GOING_AWAY)
        for pool in (self._hands, self._eyes, self._legs):
            pool.shutdown(wait=False, cancel_futures=True)

    # ----------------------------------------------------------------------------------------------------------
    # Who may ask

    @web.middleware
    async def _guard(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        refusal = self.refusal(request.host, request.headers)
        if refusal:
            return web.Response(status=403, text=refusal + "\n", headers=_HEADERS)
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

    def refusal(self, host: str, headers: Mapping[str, str]) -> str | None:
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
            jpeg = await self._in(self._eyes, self.workspace.footage.jpeg, frame, camera)
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
            await self._send(page, {"about": await self._in(self._eyes, showing.about, self.workspace)})
            await self._send(page, {"overview": await self._in(self._hands, showing.overview, self.workspace)})
            talk = _Talk(self, page)
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

    async def _changed(self, frame: int) -> None:
        """Tell every page what has changed."""
        shown, overview = await self._in(self._hands, self._state, frame)
        await self._tell_all({"shown": shown, "overview": overview})

    def _state(self, frame: int) -> tuple[Json, Json]:
        return showing.frame(self.workspace, frame), showing.overview(self.workspace)

    @staticmethod
    async def _in(pool: ThreadPoolExecutor, work: Callable[..., T], *arguments: Any) -> T:
        return await asyncio.get_running_loop().run_in_executor(pool, work, *arguments)

    # ----------------------------------------------------------------------------------------------------------
    # Tracking anew, beside everything else

    async def solve(self, frame: int) -> None:
        if self._solving is not None:
            raise PzcapError("an interval is being solved already")
        self._solving = stop = threading.Event()
        loop, said = asyncio.get_running_loop(), [0.0]

        def report(done: int, total: int) -> None:
            now = time.monotonic()
            if now - said[0] > _REPORT_S:
                said[0] = now
                asyncio.run_coroutine_threadsafe(self._tell_all({"solving": [done, total]}), loop)

        async def work() -> None:
            try:
                await self._tell_all({"solving": [0, 1]})
                await self._in(self._legs, self.workspace.solve_again, frame, report, stop.is_set)
                await self._tell_all({"solving": None, "done": "solved again"})
                await self._changed(frame)
            except PzcapError as error:
                await self._tell_all({"solving": None, "error": str(error)})
            except Exception as error:
                await self._tell_all({"solving": None, "error": f"solving failed: {type(error).__name__}: {error}"})
                raise
            finally:
                self._solving = None

        task = asyncio.create_task(work())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def stop_solving(self) -> None:
        """Stop what is being tracked after its present frame."""
        if self._solving is not None:
            self._solving.set()


class _Talk:
    """What one page says, and what it is told."""

    def __init__(self, editor: Editor, page: web.WebSocketResponse) -> None:
        self._editor, self._page = editor, page
        self._dragged: Dragged | None = None

    async def hear(self, text: str) -> None:
        """Do what a message asks for; what is wrong with it goes back as a line."""
        try:
            message = json.loads(text)
            await self._do(str(message["do"]), message)
        except PzcapError as error:
            await self._tell({"error": str(error)})
        except (ValueError, KeyError, TypeError, IndexError, OverflowError) as error:
            await self._tell({"error": f"a message that cannot be read: {error}"})
        except Exception as error:  # said on the page, and where the server was started
            traceback.print_exc()
            await self._tell({"error": f"that went wrong: {type(error).__name__}: {error}"})

    async def _do(self, what: str, message: Json) -> None:
        editor, space = self._editor, self._editor.workspace
        hands = editor._hands
        if what in ("undo", "redo"):
            step = space.undo if what == "undo" else space.redo
            frame = await editor._in(hands, step, int(message["seen"]))
            await self._tell({"go": frame})
            await editor._changed(frame)
            return
        if what == "stop":
            editor.stop_solving()
            return
        frame = int(message["frame"])
        if not 0 <= frame < len(space.sets):
            raise PzcapError(f"there is no frame {frame}")
        match what:
            case "show":
                await self._tell({"shown": await editor._in(hands, showing.frame, space, frame)})
                return
            case "silhouettes":
                lines = await editor._in(editor._eyes, showing.silhouettes, space, frame)
                await self._tell({"silhouettes": lines, "frame": frame})
                return
            case "drag":
                started = time.perf_counter()
                self._dragged = await editor._in(hands, space.drag, frame, self._click(message), self._dragged)
                drawn = await editor._in(hands, showing.drag, space, self._dragged)
                drawn["ms"] = round(1000.0 * (time.perf_counter() - started), 1)
                await self._tell({"dragged": drawn, "frame": frame, "number": message.get("number")})
                return
            case "solve":
                await editor.solve(frame)
                return
            case "drop":
                dragged, self._dragged = self._dragged, None
                await editor._in(hands, space.drop, frame, self._click(message), dragged)
            case "cancel":
                self._dragged = None
            case "unclick":
                camera = message.get("camera")
                camera = None if camera is None else self._camera(camera)
                await editor._in(hands, space.unclick, frame, self._handle(message["handle"]), camera)
            case "hide":
                handle, camera = self._handle(message["handle"]), self._camera(message["camera"])
                await editor._in(hands, space.hide, frame, handle, camera)
            case "exchange":
                await editor._in(hands, space.exchange, frame, str(message["limbs"]), int(message["seen"]))
            case "fit":
                await editor._in(editor._eyes, space.fit_to_images, frame, int(message["seen"]))
            case "key":
                await editor._in(hands, space.set_key, frame, bool(message["key"]))
            case "begin":
                await editor._in(hands, space.begin_from, frame, str(message["origin"]), int(message["seen"]))
            case _:
                raise PzcapError(f"nobody here knows how to {what}")
        await editor._changed(frame)

    async def _tell(self, message: Json) -> None:
        await self._editor._send(self._page, message)

    def _click(self, message: Json) -> Click:
        x, y, sigma = (float(message[name]) for name in ("x", "y", "sigma"))
        if not (abs(x) < 1e5 and abs(y) < 1e5 and 0.1 <= sigma <= 200.0):
            raise PzcapError("a click far outside the picture")
        return Click(self._handle(message["handle"]), self._camera(message["camera"]), x, y, sigma)

    @staticmethod
    def _handle(value: Any) -> int:
        handle = int(value)
        if not 0 <= handle < len(HANDLES):
            raise PzcapError(f"there is no handle {handle}")
        return handle

    def _camera(self, value: Any) -> int:
        camera = int(value)
        if not 0 <= camera < len(self._editor.workspace.capture.cameras):
            raise PzcapError(f"there is no camera {camera}")
        return camera


def listening(port: int) -> socket.socket:
    """A socket at 127.0.0.1; port 0 is any that is free. PzcapError where it is taken."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((HOST, port))
    except OSError as error:
        listener.close()
        raise PzcapError(f"port {port} cannot be listened at ({error.strerror}); give another --port") from error
    return listener


def serve(workspace: Workspace, port: int, *, browse: bool) -> None:
    """Serve the page until the process is interrupted."""
    editor, listener = Editor(workspace), listening(port)
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
