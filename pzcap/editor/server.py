"""Server of the page: HTTP for its files and pictures, a WebSocket for everything else."""

from __future__ import annotations

import contextlib
import json
from functools import partial
from typing import Final

from aiohttp import WSCloseCode, WSMsgType, web

from pzcap.editor import showing
from pzcap.editor.desk import Desk
from pzcap.editor.door import LONGEST_MESSAGE, Door, listening, page_files, picture
from pzcap.editor.door import serve as serve_page
from pzcap.editor.showing import Json
from pzcap.editor.talk import Talk
from pzcap.editor.workspace import Workspace

_FILES: Final = {"": "index.html"} | {name: name for name in ("editor.js", "pane.js", "editor.css")}


class Editor:
    """The server of one workspace, behind a ``door``."""

    def __init__(self, workspace: Workspace, door: Door) -> None:
        self.workspace, self._door = workspace, door
        self._pages: set[web.WebSocketResponse] = set()
        self._desk = Desk(workspace, self._tell_all)

    def application(self) -> web.Application:
        """The routes, behind the check of every request."""
        application = self._door.application()
        application.router.add_get("/frame/{frame:[0-9]{1,7}}/{camera:[0-9]{1,2}}.jpg", self._picture)
        application.router.add_get("/live", self._live)
        application.router.add_get("/{name:[a-z.]*}", page_files(_FILES))
        application.on_shutdown.append(self._close)
        return application

    async def _close(self, _: web.Application) -> None:
        self._desk.stop_solving()
        for page in list(self._pages):
            await page.close(code=WSCloseCode.GOING_AWAY)
        self._desk.close()

    async def _picture(self, request: web.Request) -> web.Response:
        frame, camera = int(request.match_info["frame"]), int(request.match_info["camera"])
        if frame >= len(self.workspace.sets) or camera >= len(self.workspace.capture.cameras):
            raise web.HTTPNotFound
        return await picture(self._desk.look(self.workspace.footage.jpeg, frame, camera))

    async def _live(self, request: web.Request) -> web.StreamResponse:
        if request.headers.get("Origin") is None:
            return web.Response(status=403, text="only a page of this server may ask here\n")
        page = web.WebSocketResponse(max_msg_size=LONGEST_MESSAGE, heartbeat=30.0, compress=False)
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


def serve(workspace: Workspace, port: int, *, browse: bool) -> None:
    """Serve the page until the process is interrupted."""
    door, listener = Door(), listening(port)
    print(f"{workspace.capture.name}: getting ready; the first time on a machine that takes up to a minute", flush=True)
    showing.warm_up(workspace)
    serve_page(
        Editor(workspace, door).application(), door, listener, f"editing {workspace.capture.name}", browse=browse
    )
