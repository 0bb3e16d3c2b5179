"""The commands that serve a page as processes of their own, and the editor's page in headless Chromium."""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import pytest

PATIENCE_S: Final = 60.0


class Serving:
    """A running `pzcap` ``part`` that serves a page."""

    def __init__(self, part: str, place: Path, start_s: float = PATIENCE_S) -> None:
        line = [sys.executable, "-m", "pzcap.command", part, str(place), "--no-browser"]
        self.process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        assert self.process.stdout is not None
        said, end = "", time.monotonic() + start_s
        while (address := re.search(r"http://127\.0\.0\.1:\d+/\?token=\S+", said)) is None:
            line_said = self.process.stdout.readline()
            assert line_said or self.process.poll() is None, said
            assert time.monotonic() < end, said
            said += line_said
        self.address = address[0]

    def __enter__(self) -> Serving:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.kill()

    def kill(self) -> None:
        """As when the power fails."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def end(self) -> int:
        """As by Ctrl-C; the exit status."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        return self.process.wait(PATIENCE_S)


@contextmanager
def chromium() -> Iterator[Any]:
    """A headless browser. The test is skipped where there is none."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("needs chromium")
    driver = pytest.importorskip("playwright.sync_api")
    options = ["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]
    with driver.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=options)
        try:
            yield browser
        finally:
            browser.close()


class Hand:
    """A person before the page."""

    def __init__(self, browser: Any, address: str) -> None:
        self.context = browser.new_context(viewport={"width": 1500, "height": 900})
        self.page = self.context.new_page()
        self.faults: list[str] = []
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.page.goto(address)
        self.until("editor.ready()")

    def second_tab(self) -> Hand:
        """Another tab of the same browser."""
        other = object.__new__(Hand)
        other.context, other.faults = self.context, self.faults
        other.page = self.context.new_page()
        other.page.goto(self.page.url)
        other.until("editor.ready()")
        return other

    def until(self, what: str, patience_s: float = PATIENCE_S) -> Any:
        """Wait until something is true on the page, and say it."""
        end = time.monotonic() + patience_s
        while True:
            found = self.page.evaluate(f"() => window.editor && ({what})")
            if found:
                return found
            assert time.monotonic() < end, (
                f"{what}: {self.page.evaluate('() => JSON.stringify(editor.state())')[:2000]}"
            )
            time.sleep(0.02)

    @property
    def shown(self) -> dict[str, Any]:
        return dict(self.page.evaluate("() => editor.state().shown"))

    def on_screen(self, camera: int, x: float, y: float) -> tuple[float, float]:
        u, v = self.page.evaluate("([c, x, y]) => editor.screenOf(c, x, y)", [camera, x, y])
        return u, v

    def place_of(self, handle: int, camera: int) -> tuple[float, float]:
        """Place of a handle on the screen."""
        return self.on_screen(camera, *self.shown["handles"][camera][handle])

    def go(self, frame: int) -> None:
        """By the line of time."""
        box = self.page.query_selector("#time").bounding_box()
        count = self.page.evaluate("() => editor.state().overview.sigma_mm.length")
        self.page.mouse.click(box["x"] + 8 + (box["width"] - 16) * (frame + 0.5) / count, box["y"] + 20)
        self.until(f"editor.state().frame === {frame} && editor.ready()")

    def drag(self, handle: int, camera: int, x: float, y: float) -> None:
        """Drag a handle to a pixel of a view. Where others lie over it, it is chosen by Tab first."""
        mouse, keyboard, before = self.page.mouse, self.page.keyboard, self.shown["version"]
        ends = [[camera, x, y], [camera, *self.shown["handles"][camera][handle]]]
        if not all(self.page.evaluate("([c, x, y]) => editor.inView(c, x, y)", place) for place in ends):
            keyboard.press("0")
        end, start = (self.on_screen(*place) for place in ends)
        mouse.move(*start)
        mouse.down()
        if self.page.evaluate("() => editor.state().dragging") != handle:
            mouse.up()
            while self.page.evaluate("() => editor.state().chosen") != handle:
                keyboard.press("Tab")
            mouse.down()
        if self.page.evaluate("() => editor.state().dragging") != handle:  # right under another one
            mouse.up()
            while self.page.evaluate("() => editor.state().chosen") != handle:
                keyboard.press("Tab")
            keyboard.down("Alt")
            mouse.click(*end)
            keyboard.up("Alt")
        else:
            mouse.move(start[0] + 9.0, start[1])
            mouse.move(*end, steps=3)
            mouse.up()
        self.until(f"editor.state().shown.version > {before}")
