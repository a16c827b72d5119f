"""Screenshots of the page, in a real browser, with a run in a simulated room: for docs/web.md and docs/teaching.md."""

from __future__ import annotations

import io
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

WIDE, TALL = (1120, 760), (1120, 1280)
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
        keep_day(Path(room) / "timeline" / "stadimeter", time.time())
        with _at(browser, Path(room), STILL, WIDE) as page:
            _timeline(page, folder / "web-timeline.png")
    with tempfile.TemporaryDirectory() as room, chromium() as browser:
        began_s = time.time() - 400
        false_alarm.record(Path(room), began_s)
        with _at(browser, Path(room), false_alarm.CONFIGURATION, TALL) as page:
            _taught(page, began_s, folder / "web-teaching.png")


@contextmanager
def _at(browser: Any, folder: Path, text: str | None, size: tuple[int, int]) -> Iterator[Any]:
    with served(folder, text, runs=text is not None) as here, tab(browser, size=size) as page:
        page.goto(here.url)
        page.home = here.url
        yield page


def _live(page: Any, path: Path) -> None:
    page.locator("canvas[data-drawn]").wait_for()
    page.wait_for_timeout(20_000)  # until the chart has a line
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


def save(page: Any, path: Path) -> None:
    """Write what is in sight, with few colours."""
    shown = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    shown.quantize(COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(path, optimize=True)


if __name__ == "__main__":
    make_pages(Path(__file__).parent)
