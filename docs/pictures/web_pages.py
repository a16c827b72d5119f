"""Screenshots of the page, in a real browser, with a run in a simulated room: for docs/web.md."""

from __future__ import annotations

import io
import re
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from PIL import Image

from support import false_alarm
from support.browser import ROOM, chromium, served, tab
from support.timeline_day import keep_day

WIDE, TALL, PHONE = (1120, 760), (1120, 1280), (390, 780)
COLOURS = 256
"""As many colours as a screenshot keeps: a third of the bytes. With fewer, the ball turns grey now and then."""

STILL = ROOM.partition("path = [")[0] + 'path = [{ at = "0 s", x = "1.6 m", y = "0.2 m" }]\n'
"""The ball does not move, so that a picture made again is nearly the same one."""


def make_pages(folder: Path) -> None:
    """Write the screenshots.

    Args:
        folder: Where to.
    """
    with tempfile.TemporaryDirectory() as room, chromium() as browser:
        with _at(browser, Path(room), STILL, WIDE) as page:
            _live(page, folder / "web-live.png")
            _coloured(page, folder / "web-sliders.png")
            _edited(page, folder / "web-edit.png")
            _recorded(page, folder / "web-recordings.png")
        keep_day(Path(room) / "timeline" / "stadimeter", time.time())
        with _at(browser, Path(room), STILL, WIDE) as page:
            _timeline(page, folder / "web-timeline.png")
        with _at(browser, Path(room), STILL, PHONE, "dark") as page:
            _live(page, folder / "web-phone.png")
    with tempfile.TemporaryDirectory() as room, chromium() as browser:
        began_s = time.time() - 400
        false_alarm.record(Path(room), began_s)
        with _at(browser, Path(room), false_alarm.CONFIGURATION, TALL) as page:
            _taught(page, began_s, folder / "web-teaching.png")
    with tempfile.TemporaryDirectory() as room, chromium() as browser:
        _two_cameras(browser, Path(room), folder / "web-others.png")
    with tempfile.TemporaryDirectory() as empty, chromium() as browser, _at(browser, Path(empty), None, WIDE) as page:
        _set_up(page, folder)


@contextmanager
def _at(browser: Any, folder: Path, text: str | None, size: tuple[int, int], scheme: str = "light") -> Iterator[Any]:
    with served(folder, text, runs=text is not None) as here, tab(browser, size=size, scheme=scheme) as page:
        page.goto(here.url)
        page.home = here.url
        yield page


def _live(page: Any, path: Path) -> None:
    page.locator("canvas[data-drawn]").wait_for()
    page.wait_for_timeout(20_000)  # until the chart has a line
    save(page, path)


def _coloured(page: Any, path: Path) -> None:
    page.goto(f"{page.home}/#live")
    page.locator("summary", has_text="About the picture").click()
    page.get_by_role("button", name="Colour …").click()
    page.get_by_text("On the ball").wait_for()
    page.get_by_label("Hue to", exact=True).fill("38")
    page.wait_for_timeout(5000)
    save(page, path)
    for _ in range(2):  # it asks first: a slider was moved
        page.get_by_role("button", name="Close", exact=True).click()


def _two_cameras(browser: Any, folder: Path, path: Path) -> None:
    """Show the alarms of this camera and of another one, and a third one that is off."""
    (folder / "there").mkdir()
    gate = STILL.replace('when = { below = "1 m" }', 'when = { below = "5 m" }').replace("rules.near", "rules.gate")
    with served(folder / "there", gate) as there:
        others = f'[web]\nothers = ["{there.url}", "http://127.0.0.1:9"]\n'
        text = STILL.replace('when = { below = "1 m" }', 'when = { below = "2 m" }') + others
        with _at(browser, folder, text, WIDE) as page:
            page.goto(f"{page.home}/#alarms")
            page.get_by_role("link", name=re.compile("silent")).wait_for()
            page.get_by_role("region", name="On all cameras").get_by_text("gate").wait_for()
            page.wait_for_timeout(1000)
            save(page, path)


def _edited(page: Any, path: Path) -> None:
    page.goto(f"{page.home}/#edit")
    page.get_by_text(re.compile(r"\d warning")).first.wait_for()
    field = page.get_by_role("textbox", name="Configuration")
    field.fill(field.input_value().replace('when = { below = "1 m" }', 'when = { below = "1 parsec" }'))
    page.get_by_text("1 error").wait_for()
    page.get_by_role("button", name="unknown unit").click()
    save(page, path)
    field.fill(field.input_value().replace("1 parsec", "1 m"))


def _recorded(page: Any, path: Path) -> None:
    page.goto(f"{page.home}/#recordings")
    page.get_by_role("button", name="Record", exact=True).click()
    page.get_by_text(re.compile("Recording: [6-9]")).wait_for()
    page.get_by_role("button", name="Stop recording").click()
    page.get_by_role("button", name="Replay").first.click()
    page.get_by_label("Moment of the recording").fill("1")
    page.get_by_text("1.0 s of").wait_for()
    page.get_by_text("Measured").wait_for()
    page.wait_for_timeout(1000)
    save(page, path)


def _timeline(page: Any, path: Path) -> None:
    page.goto(f"{page.home}/#timeline")
    page.locator(".timeline-chart[data-step]").wait_for()
    page.wait_for_timeout(8000)  # until the thresholds are there
    box = page.locator(".u-over").bounding_box()
    page.mouse.click(box["x"] + box["width"] * 0.6, box["y"] + 60)
    page.get_by_role("region", name="The moment").get_by_role("heading", name="Rules").wait_for()
    save(page, path)


def _taught(page: Any, began_s: float, path: Path) -> None:
    page.goto(f"{page.home}/#timeline")
    page.locator(".timeline-chart[data-step]").wait_for()
    page.get_by_role("button", name="Show 10 min").click()
    page.locator(".timeline-chart[data-step='1']").wait_for()
    box = page.locator(".u-over").bounding_box()
    view = [page.evaluate(f"Number(document.querySelector('.timeline-chart').dataset.{end})") for end in ("from", "to")]
    part = (began_s + false_alarm.BY_S - view[0]) / (view[1] - view[0])
    page.mouse.click(box["x"] + box["width"] * part, box["y"] + 8)
    page.get_by_role("button", name="Should not have fired").click()
    page.get_by_text("1 of yours gone").wait_for()
    page.get_by_role("region", name="The moment").get_by_role("button", name="Close").click()
    save(page, path)


def _set_up(page: Any, folder: Path) -> None:
    def asked(words: str) -> None:
        page.get_by_role("heading", name=words).wait_for()
        page.wait_for_timeout(1500)

    def go(words: str = "Go on") -> None:
        page.get_by_role("button", name=words, exact=True).click()

    page.goto(f"{page.home}/#setup")
    asked("Which camera?")
    page.get_by_text("simulated room").first.click()
    go()
    asked("What shall be measured?")
    go()
    asked("What colour is the ball?")
    box = page.get_by_alt_text("What the camera sees").bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.get_by_role("button", name="Forget the clicks").wait_for()
    page.wait_for_timeout(1500)
    save(page, folder / "web-colour.png")
    go()
    asked("How far away is the ball?")
    go("Take it")
    asked("What shall happen?")
    page.set_viewport_size({"width": TALL[0], "height": TALL[1]})
    page.wait_for_timeout(2000)
    save(page, folder / "web-wish.png")
    go()
    asked("drive?")
    page.get_by_role("radio", name="buzzer 23").check()
    page.get_by_alt_text("How the buzzer is wired to GPIO 23").wait_for()
    page.wait_for_timeout(2000)
    save(page, folder / "web-wiring.png")


def save(page: Any, path: Path) -> None:
    """Write what is in sight, with few colours."""
    shown = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    shown.quantize(COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(path, optimize=True)


if __name__ == "__main__":
    make_pages(Path(__file__).parent)
