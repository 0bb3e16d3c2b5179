"""Server of the page on which lengths of the hall are marked."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from functools import partial
from typing import Any, Final

from aiohttp import web

from pzcap.editor.door import Door, listening, page_files, picture
from pzcap.editor.door import serve as serve_page
from pzcap.editor.films import KINDS, Films
from pzcap.editor.lengths import Lengths
from pzcap.types import Capture, PzcapError

_FILES: Final = {"": "lengths.html"} | {name: name for name in ("lengths.js", "pane.js", "editor.css", "lengths.css")}
_COMMANDS: Final = {
    "begin": (), "remove": ("number",), "tell": ("number", "what", "value"), "mark": ("number", "end", "mark"),
    "share": ("number", "end", "other", "its"), "unmark": ("number", "end", "camera"), "undo": (), "redo": (),
}  # fmt: skip
_NUMBERS: Final = ("seen", "number", "other")


class Marking:
    """The server of the lengths of one capture."""

    def __init__(self, lengths: Lengths, films: Films) -> None:
        self.lengths, self._films = lengths, films

    def application(self, door: Door) -> web.Application:
        """The routes, behind the check of every request."""
        application = door.application()
        kinds = "|".join(KINDS)
        place = f"/picture/{{camera:[0-9]{{1,2}}}}/{{kind:{kinds}}}/{{number:[0-9]{{1,7}}}}.jpg"
        application.router.add_get(place, self._picture)
        application.router.add_get("/about", self._about)
        application.router.add_get("/lengths", self._shown)
        application.router.add_post("/lengths", self._change)
        application.router.add_get("/{name:[a-z.]*}", page_files(_FILES))
        return application

    async def _about(self, _: web.Request) -> web.Response:
        capture = self.lengths.capture
        cameras = [{"name": one.name, "films": self._films.of(number)} for number, one in enumerate(capture.cameras)]
        about = {"name": capture.name, "folder": str(capture.folder), "cameras": cameras}
        return _json(about | {"has_object": capture.calibration_object is not None})

    async def _shown(self, _: web.Request) -> web.Response:
        return await self._done(self.lengths.refresh)

    async def _picture(self, request: web.Request) -> web.Response:
        camera, kind, number = (request.match_info[name] for name in ("camera", "kind", "number"))
        return await picture(asyncio.to_thread(self._films.jpeg, int(camera), kind, int(number)))

    async def _change(self, request: web.Request) -> web.Response:
        """Do what a page asks for."""
        try:
            return await self._done(self._asked(json.loads(await request.text())))
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
            return web.Response(status=400, text=f"a message that cannot be read: {error}\n")

    async def _done(self, work: Callable[[], None]) -> web.Response:
        """Do ``work``; the lengths as they are then, and what was wrong with it."""
        try:
            await asyncio.to_thread(work)
        except PzcapError as error:
            return _json({**self.lengths.shown(), "error": str(error)})
        return _json(self.lengths.shown())

    def _asked(self, message: dict[str, Any]) -> partial[None]:
        what = str(message["do"])
        if what not in _COMMANDS:
            raise ValueError(f"nobody here knows how to {what}")
        arguments = {name: message[name] for name in ("seen", *_COMMANDS[what])}
        if not all(type(arguments.get(name, 0)) is int for name in _NUMBERS):
            raise TypeError("a whole number is wanted")
        return partial(getattr(self.lengths, what), **arguments)


def _json(content: Any) -> web.Response:
    return web.json_response(content, headers={"Cache-Control": "no-store"})


def serve(capture: Capture, port: int, *, browse: bool) -> None:
    """Serve the page until the process is interrupted."""
    marking, door, listener = Marking(Lengths(capture), Films(capture)), Door(), listening(port)
    serve_page(marking.application(door), door, listener, f"marking lengths of {capture.name}", browse=browse)
