"""Messages of a page, and the answers to them."""

from __future__ import annotations

import json
import time
import traceback
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

from pzcap.editor import showing
from pzcap.editor.desk import Desk
from pzcap.editor.inverse_kinematics import HANDLES, Click
from pzcap.editor.showing import Json
from pzcap.editor.workspace import Dragged
from pzcap.types import PzcapError

T = TypeVar("T")


class Talk:
    """Messages of one page, and what it is told."""

    def __init__(self, desk: Desk, tell: Callable[[Json], Awaitable[None]]) -> None:
        self._desk, self._tell = desk, tell
        self._dragged: Dragged | None = None
        self._seen = 0  # version up to which the page knows what was changed, or has changed it itself

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
        desk, space, change = self._desk, self._desk.workspace, self._change
        if (seen := int(message.get("seen", 0))) <= space.version:
            self._seen = max(self._seen, seen)
        if what in ("undo", "redo"):
            step = space.undo if what == "undo" else space.redo
            frame = await change(step, self._seen)
            await self._tell({"go": frame})
            await desk.changed(frame)
            return
        if what == "stop":
            desk.stop_solving()
            return
        frame = int(message["frame"])
        if not 0 <= frame < len(space.sets):
            raise PzcapError(f"there is no frame {frame}")
        match what:
            case "show":
                await self._tell({"shown": await desk.pose(showing.frame, space, frame)})
                return
            case "silhouettes":
                lines = await desk.look(showing.silhouettes, space, frame)
                await self._tell({"silhouettes": lines, "frame": frame})
                return
            case "drag":
                started = time.perf_counter()
                self._dragged = await desk.pose(space.drag, frame, self._click(message), self._dragged)
                drawn = await desk.pose(showing.drag, space, self._dragged)
                drawn["ms"] = round(1000.0 * (time.perf_counter() - started), 1)
                await self._tell({"dragged": drawn, "frame": frame, "number": message.get("number")})
                return
            case "solve":
                await desk.solve(frame)
                return
            case "drop":
                dragged, self._dragged = self._dragged, None
                await change(space.drop, frame, self._click(message), dragged)
            case "cancel":
                self._dragged = None
            case "unclick":
                camera = message.get("camera")
                camera = None if camera is None else self._camera(camera)
                await change(space.unclick, frame, self._handle(message["handle"]), camera)
            case "hide":
                handle, camera = self._handle(message["handle"]), self._camera(message["camera"])
                await change(space.hide, frame, handle, camera)
            case "exchange":
                await change(space.exchange, frame, str(message["limbs"]), self._seen)
            case "fit":
                await desk.look(space.fit_to_images, frame, self._seen)
            case "key":
                await change(space.set_key, frame, bool(message["key"]))
            case "begin":
                await change(space.begin_from, frame, str(message["origin"]), self._seen)
            case _:
                raise PzcapError(f"nobody here knows how to {what}")
        await desk.changed(frame)

    async def _change(self, command: Callable[..., T], *arguments: Any) -> T:
        """Do what changes something. A page that knew all before knows all after it, told or not yet."""
        space = self._desk.workspace

        def counted() -> tuple[int, T, int]:
            with space.lock:
                return space.version, command(*arguments), space.version

        before, done, after = await self._desk.pose(counted)
        if self._seen == before:
            self._seen = after
        return done

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
        if not 0 <= camera < len(self._desk.workspace.capture.cameras):
            raise PzcapError(f"there is no camera {camera}")
        return camera
