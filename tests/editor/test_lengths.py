"""Lengths that are marked on a page are never lost, and lengths.json holds those that are whole, as it is specified."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import aiohttp
import pytest
from aiohttp import web

from pzcap.editor import paper
from pzcap.editor.door import Door, listening
from pzcap.editor.films import Films
from pzcap.editor.lengths import Lengths
from pzcap.editor.marking import Marking
from pzcap.io.capture import read_capture
from pzcap.types import PzcapError
from tests.scenes import edited
from tests.scenes.browsing import Serving, chromium

TOKEN = "a-secret"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return edited.capture(tmp_path / "take")


def mark(camera: int = 0, frame: int = 3, px: tuple[float, float] = (10.0, 20.5)) -> dict[str, Any]:
    return {"camera": edited.found().camera_names[camera], "video": "motion", "frame": frame, "px": [*px]}


def whole(lengths: Lengths, length_m: float = 12.0) -> None:
    """One length more, marked by two cameras at one end and by one at the other."""
    lengths.begin(lengths.version)
    number = len(lengths.entries) - 1
    lengths.tell(lengths.version, number, "length_m", length_m)
    for end, camera in (("from", 0), ("from", 1), ("to", 2)):
        lengths.mark(lengths.version, number, end, mark(camera, px=(10.0 + number, 20.0)))


def stands(folder: Path) -> list[tuple[str, float, list[int]]]:
    """The lengths of a capture as everybody reads them: name, metres, marks of either end."""
    return [(one.name, one.length_m, [len(end) for end in one.ends]) for one in read_capture(folder).lengths]


def test_a_length_stands_in_the_file_once_it_is_whole(folder: Path) -> None:
    lengths = Lengths(read_capture(folder))
    lengths.begin(0)
    lacks = ["how long it is, a mark of one end and a mark of the other end"]
    assert [one["lacks"] for one in lengths.shown()["lengths"]] == [f"lacks {words}" for words in lacks]
    lengths.tell(1, 0, "length_m", 12.0)
    lengths.mark(2, 0, "from", mark(0))
    assert stands(folder) == []
    lengths.mark(3, 0, "to", mark(2))
    assert stands(folder) == [("length 1", 12.0, [1, 1])]
    lengths.mark(4, 0, "from", mark(0, frame=5))  # in place of that of the same camera
    lengths.mark(5, 0, "from", mark(1))
    lengths.tell(6, 0, "name", " east side ")
    assert stands(folder) == [("east side", 12.0, [2, 1])]
    assert [one.frame for one in read_capture(folder).lengths[0].ends[0]] == [5, 3]
    lengths.unmark(7, 0, "to", edited.found().camera_names[2])
    assert stands(folder) == []
    assert "lengths" in json.loads((folder / "capture.json").read_text())
    lengths.remove(8, 0)
    assert lengths.entries == []


def test_undone_to_the_beginning_and_done_again(folder: Path) -> None:
    lengths = Lengths(read_capture(folder))
    whole(lengths)
    whole(lengths, 3.0)
    after, steps = stands(folder), lengths.version
    for _ in range(steps):
        lengths.undo(lengths.version)
    assert stands(folder) == []
    assert lengths.entries == []
    with pytest.raises(PzcapError, match="nothing to undo"):
        lengths.undo(lengths.version)
    for _ in range(steps):
        lengths.redo(lengths.version)
    assert stands(folder) == after == [("length 1", 12.0, [2, 1]), ("length 2", 3.0, [2, 1])]


def test_a_corner_of_two_sides_is_marked_once(folder: Path) -> None:
    lengths = Lengths(read_capture(folder))
    whole(lengths)
    lengths.begin(lengths.version)
    lengths.tell(lengths.version, 1, "length_m", 4.0)
    lengths.share(lengths.version, 1, "to", 0, "from")
    lengths.mark(lengths.version, 1, "from", mark(3))
    assert stands(folder) == [("length 1", 12.0, [2, 1]), ("length 2", 4.0, [1, 2])]
    lengths.unmark(lengths.version, 1, "to", edited.found().camera_names[0])  # and is its own from then on
    assert stands(folder) == [("length 1", 12.0, [2, 1]), ("length 2", 4.0, [1, 1])]


def test_begun_again_it_is_as_it_was_left(folder: Path) -> None:
    lengths = Lengths(read_capture(folder))
    whole(lengths)
    lengths.begin(lengths.version)
    whole(lengths, 3.0)
    with pytest.raises(PzcapError, match="another editor is at work on it"):
        Lengths(read_capture(folder))
    lengths.close()
    assert Lengths(read_capture(folder)).entries == lengths.entries


@pytest.mark.parametrize("name", ["write_bytes", "write_json"])  # lengths.json, and the line that names it
def test_killed_between_two_files_nothing_is_lost(folder: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    lengths = Lengths(read_capture(folder))
    lengths.begin(0)
    lengths.tell(1, 0, "length_m", 12.0)
    lengths.mark(2, 0, "from", mark(0))

    def killed(*_: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(paper, name, killed)
        with pytest.raises(KeyboardInterrupt):
            lengths.mark(3, 0, "to", mark(2))
    lengths.close()
    again = Lengths(read_capture(folder))
    assert [[len(one[end]) for end in ("from", "to")] for one in again.entries] == [[1, 1]]
    again.tell(0, 0, "sigma_m", 0.004)
    assert stands(folder) == [("length 1", 12.0, [1, 1])]


def test_what_somebody_else_writes_is_taken_in(folder: Path) -> None:
    lengths = Lengths(read_capture(folder))
    whole(lengths)
    lengths.begin(lengths.version)
    path = folder / "lengths.json"
    content = json.loads(path.read_text())
    path.write_text(json.dumps([content[0] | {"name": "by hand"}]))
    seen = lengths.version
    with pytest.raises(PzcapError, match="somebody else has changed"):
        lengths.tell(seen, 0, "length_m", 5.0)
    assert [one["name"] for one in lengths.shown()["lengths"]] == ["by hand", "length 2"]
    lengths.tell(lengths.version, 0, "length_m", 5.0)
    assert stands(folder) == [("by hand", 5.0, [2, 1])]
    before, whole_file = lengths.version, path.read_bytes()
    lengths.tell(before, 0, "length_m", 6.0)
    path.write_bytes(whole_file)  # as it was a change before
    lengths.refresh()
    assert [one["length_m"] for one in lengths.shown()["lengths"]] == [5.0, None]
    path.write_text("[{}]")
    with pytest.raises(PzcapError, match='"length_m" is missing'):
        lengths.refresh()
    assert [one["name"] for one in lengths.shown()["lengths"]] == ["by hand", "length 2"]
    lengths.close()
    path.write_text("[]")
    assert [one["name"] for one in Lengths(read_capture(folder)).entries] == ["length 2"]


def test_the_file_that_was_found_is_kept(folder: Path) -> None:
    lengths = Lengths(read_capture(folder))
    whole(lengths)
    lengths.close()
    found = (folder / "lengths.json").read_bytes()
    again = Lengths(read_capture(folder))
    again.tell(0, 0, "length_m", 11.0)
    again.tell(1, 0, "length_m", 10.0)
    (kept,) = (folder / "editing" / "backups").iterdir()
    assert kept.read_bytes() == found


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda one: one.mark(one.version, 0, "from", mark(0, frame=99)), "has no picture 99"),
        (lambda one: one.mark(one.version, 0, "from", mark(0, px=(1e4, 0.0))), "lies outside the pictures"),
        (lambda one: one.mark(one.version, 0, "from", mark() | {"camera": "9"}), 'there is no camera "9"'),
        (lambda one: one.mark(one.version, 0, "from", mark() | {"px": [0.0, float("nan")]}), "2 finite numbers"),
        (lambda one: one.mark(one.version, 0, "middle", mark()), "has no end middle"),
        (lambda one: one.mark(one.version, 7, "from", mark()), "there is no length 7"),
        (lambda one: one.tell(one.version, 0, "name", " "), "give the length a name"),
        (lambda one: one.tell(one.version, 0, "length_m", -2.0), "^how long it is: .* above 0 and at most"),
        (lambda one: one.tell(one.version, 0, "sigma_m", 0.0), "^how well that is known: .* above 0 and at most"),
        (lambda one: one.tell(one.version, 0, "name", "length 2"), "a name of its own"),
        (lambda one: one.tell(one.version, 0, "length_m", "long"), "finite numbers"),
        (lambda one: one.tell(one.version, 0, "weight", 3.0), "has no weight"),
        (lambda one: one.undo(0), "somebody else has changed"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_and_changes_nothing(
    folder: Path, change: Callable[[Lengths], None], why: str
) -> None:
    lengths = Lengths(read_capture(folder))
    whole(lengths)
    whole(lengths, 3.0)
    before = lengths.shown()
    with pytest.raises(PzcapError, match=why):
        change(lengths)
    assert lengths.shown() == before


def test_what_the_format_refuses_waits_beside_the_file(folder: Path) -> None:
    lengths = Lengths(read_capture(folder))
    whole(lengths)
    lengths.tell(lengths.version, 0, "sigma_m", 2.0)
    lacks = lengths.shown()["lengths"][0]["lacks"]
    assert lacks == "how well that is known: must be above 0 and at most a tenth of the length, in metres"
    assert stands(folder) == []


def test_who_is_answered(folder: Path) -> None:
    capture = read_capture(folder)

    async def run() -> None:
        listener, lengths = listening(0), Lengths(capture)
        runner = web.AppRunner(Marking(lengths, Films(capture)).application(Door(TOKEN)))
        await runner.setup()
        await web.SockSite(runner, listener).start()
        port = listener.getsockname()[1]
        url, cookie = f"http://127.0.0.1:{port}", {"Cookie": f"pzcap-editor-{port}={TOKEN}"}
        begin = json.dumps({"do": "begin", "seen": 0})
        try:
            async with aiohttp.ClientSession(cookie_jar=aiohttp.DummyCookieJar()) as session:

                async def status(way: str, path: str, data: str | None = None, **headers: str) -> int:
                    async with session.request(way, url + path, headers=headers, data=data) as answer:
                        return answer.status

                for headers in (
                    {}, cookie | {"Host": "evil.example"}, cookie | {"Origin": "http://evil.example"},
                    cookie | {"Origin": "null"}, cookie | {"Sec-Fetch-Site": "cross-site"},
                ):  # fmt: skip
                    for path in ("/", "/about", "/lengths", "/picture/0/motion/0.jpg"):
                        assert await status("GET", path, **headers) == 403
                    assert await status("POST", "/lengths", begin, **headers) == 403
                assert lengths.entries == []
                for path in ("/", "/lengths.js", "/lengths.css", "/pane.js", "/about", "/picture/1/motion/7.jpg"):
                    assert await status("GET", path, **cookie) == 200
                for path in ("/picture/1/motion/99.jpg", "/picture/9/motion/0.jpg", "/picture/0/sweep/0.jpg", "/x.js"):
                    assert await status("GET", path, **cookie) == 404
                for message in ("", "[]", "{}", '{"do": "mark"}', '{"do": "undo", "seen": "x"}', '{"do": 3}'):
                    assert await status("POST", "/lengths", message, **cookie) in (200, 400)
                assert lengths.entries == []
                async with session.post(url + "/lengths", data='{"do": "dance", "seen": 0}', headers=cookie) as answer:
                    assert "nobody here knows" in await answer.text()
                assert await status("POST", "/lengths", begin, **cookie, Origin=url) == 200
                assert len(lengths.entries) == 1
        finally:
            await runner.cleanup()

    asyncio.run(run())


def test_marked_by_clicks_seen_in_two_tabs_killed_and_nothing_lost(folder: Path) -> None:
    with chromium() as browser:
        serving = Serving("lengths", folder)
        context = browser.new_context(viewport={"width": 1300, "height": 800})
        page, faults = context.new_page(), []
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.goto(serving.address)
        page.wait_for_function("() => window.lengths.ready()")
        page.keyboard.press("n")
        page.wait_for_function("() => lengths.state().shown.lengths.length === 1")
        page.fill("input[aria-label=name]", "a stick")
        page.keyboard.press("Enter")
        page.fill("input[aria-label=length_m]", "1,5")
        page.keyboard.press("Enter")
        page.wait_for_function("() => lengths.state().shown.lengths[0].length_m === 1.5")
        for end, camera, x, y in (("from", 1, 30.0, 40.0), ("from", 2, 50.0, 41.5), ("to", 4, 12.0, 33.0)):
            if end == "to":
                page.keyboard.press("Tab")
            page.keyboard.press(f"{camera}")
            page.keyboard.press("ArrowRight")
            page.wait_for_function(f"() => lengths.state().camera === {camera - 1} && lengths.ready()")
            seen = page.evaluate("() => lengths.state().shown.version")
            page.mouse.click(*page.evaluate("([x, y]) => lengths.screenOf(x, y)", [x, y]))
            page.wait_for_function(f"() => lengths.state().shown.version > {seen}")
        (length,) = read_capture(folder).lengths
        assert (length.name, length.length_m) == ("a stick", 1.5)
        marks = [(mark.camera, mark.frame, *mark.px.tolist()) for end in length.ends for mark in end]
        clicked = ((0, 30.0, 40.0), (1, 50.0, 41.5), (3, 12.0, 33.0))
        for found, (camera, x, y) in zip(marks, clicked, strict=True):
            assert found[:2] == (edited.found().camera_names[camera], 1)
            assert found[2:] == pytest.approx((x, y), abs=0.6)  # the mouse has whole pixels of the screen
        other = context.new_page()
        other.goto(page.url.partition("#")[0])
        other.wait_for_function("() => window.lengths.ready()")
        other.keyboard.press("u")
        other.wait_for_function("() => lengths.state().shown.lengths[0].to.length === 0")
        page.keyboard.press("u")  # of what it has not seen yet
        page.wait_for_function("() => lengths.state().message.includes('somebody else')")
        page.keyboard.press("Control+y")
        page.wait_for_function("() => lengths.state().shown.lengths[0].to.length === 1")
        saved = (folder / "lengths.json").read_bytes()
        serving.kill()
        page.keyboard.press("n")
        page.wait_for_function("() => lengths.state().message.includes('Nothing is lost')")
        serving = Serving("lengths", folder)
        page.goto(serving.address)
        page.wait_for_function("() => window.lengths.ready() && lengths.state().shown.lengths[0].to.length === 1")
        assert (folder / "lengths.json").read_bytes() == saved
        assert not faults
        assert serving.end() == 0


def test_a_name_is_typed_at_once_and_its_letters_are_no_keys(folder: Path) -> None:
    with chromium() as browser, Serving("lengths", folder) as serving:
        page = browser.new_context(viewport={"width": 1000, "height": 700}).new_page()
        page.goto(serving.address)
        page.wait_for_function("() => window.lengths.ready()")
        for number, name in enumerate(("south, mouth side", "north")):  # s, u, h and m are keys
            page.keyboard.press("n")
            page.wait_for_function(f"() => lengths.state().shown.lengths.length === {number + 1}")
            page.keyboard.type(name)
            page.keyboard.press("Enter")
            page.keyboard.type("12,5")
            page.keyboard.press("Enter")
            page.wait_for_function(f"() => lengths.state().shown.lengths[{number}].length_m === 12.5")
        assert [one["name"] for one in page.evaluate("() => lengths.state().shown.lengths")] == [
            "south, mouth side", "north",
        ]  # fmt: skip
        assert page.evaluate("() => document.activeElement === document.body")  # keys are keys again


def test_a_window_that_is_made_small_and_large_again_shows_what_it_showed(folder: Path) -> None:
    with chromium() as browser, Serving("lengths", folder) as serving:
        page = browser.new_context(viewport={"width": 1300, "height": 800}).new_page()
        page.goto(serving.address)
        page.wait_for_function("() => window.lengths.ready()")
        corner = "() => [...lengths.screenOf(0, 0), ...lengths.screenOf(50, 40)].map(Math.round)"

        def sized(width: int, height: int) -> list[int]:
            page.set_viewport_size({"width": width, "height": height})
            page.wait_for_function(f"() => innerWidth === {width} && innerHeight === {height}")
            page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
            return list(page.evaluate(corner))

        for zoomed in (False, True):
            if zoomed:
                page.mouse.move(400, 300)
                page.mouse.wheel(0, -400)
            whole = sized(1300, 800)
            assert sized(700, 900) != whole
            assert sized(1300, 500) != whole
            assert sized(1300, 800) == whole


def test_nothing_is_marked_in_a_picture_that_is_not_shown_yet(folder: Path) -> None:
    with chromium() as browser, Serving("lengths", folder) as serving:
        page = browser.new_context(viewport={"width": 1000, "height": 700}).new_page()
        held: list[Any] = []

        def hold(route: Any) -> None:
            held.append(route)

        page.goto(serving.address)
        page.wait_for_function("() => window.lengths.ready()")
        page.keyboard.press("n")
        page.wait_for_function("() => lengths.state().shown.lengths.length === 1")
        page.keyboard.press("Escape")
        page.route("**/picture/**/5.jpg", hold)
        page.evaluate("() => { const time = document.getElementById('time'); time.value = 5; time.oninput(); }")
        page.mouse.click(*page.evaluate("() => lengths.screenOf(20, 20)"))
        page.wait_for_function("() => lengths.state().message.includes('not shown yet')")
        while not held:
            page.wait_for_timeout(10)
        held[0].continue_()
        page.wait_for_function("() => lengths.ready()")
        assert page.evaluate("() => lengths.state().shown.lengths[0].from") == []
        page.mouse.click(*page.evaluate("() => lengths.screenOf(20, 20)"))
        page.wait_for_function("() => lengths.state().shown.lengths[0].from.length === 1")
