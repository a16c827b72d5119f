"""The timeline in a real browser: a day at once, scrolled and zoomed by every means, and a moment explained."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest

from support.browser import STILL, Served, served, tab, until
from support.timeline_day import keep_day

CHART = "document.querySelector('.timeline-chart').dataset"
SPAN_S = f"({CHART}.to - {CHART}.from)"
HOUR_S = 3600


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """Serve a run that keeps a timeline, and has kept a day of it."""
    folder = tmp_path_factory.mktemp("timeline")
    keep_day(folder / "timeline" / "stadimeter", time.time() - 60)
    with served(folder, f'[timeline]\nkeep = "7 d"\n{STILL}') as serving:
        yield serving


def opened(page: Any, here: Served) -> Any:
    page.goto(f"{here.url}/#timeline")
    chart = page.locator(".timeline-chart[data-step]")
    chart.wait_for()
    return chart


def test_a_day_is_there_at_once_and_zooming_in_shows_each_second(browser: Any, here: Served) -> None:
    with tab(browser) as page:
        chart = opened(page, here)
        assert until(page, SPAN_S) == pytest.approx(24 * HOUR_S, abs=5)
        assert chart.get_attribute("data-step") == "120"
        box = page.locator(".u-over").bounding_box()
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        for _ in range(40):
            page.mouse.wheel(0, -300)
        until(page, f"{SPAN_S} < 60 && {CHART}.step === '1'")


def test_the_keyboard_reads_scrolls_zooms_and_explains(browser: Any, here: Served) -> None:
    with tab(browser) as page:
        chart = opened(page, here)
        chart.focus()
        for _ in range(30):
            page.keyboard.press("ArrowLeft")
        words = until(page, "document.querySelector('.timeline .read').textContent")
        assert "ball" in words
        assert chart.get_attribute("aria-valuetext") == words
        page.keyboard.press("+")
        until(page, f"{SPAN_S} < 80000")
        before = page.evaluate(f"Number({CHART}.to)")
        page.keyboard.press("PageUp")
        until(page, f"Number({CHART}.to) < {before - HOUR_S}")
        page.keyboard.press("Enter")
        page.get_by_role("region", name="The moment").get_by_role("heading", name="Rules").wait_for()


def test_a_click_on_the_past_tells_what_is_known_of_it(browser: Any, here: Served) -> None:
    with tab(browser) as page:
        opened(page, here)
        box = page.locator(".u-over").bounding_box()
        page.mouse.click(box["x"] + box["width"] / 3, box["y"] + 60)
        told = page.get_by_role("region", name="The moment")
        told.get_by_text("No recording holds this moment").wait_for()
        assert "near" in told.inner_text()
        assert " m ±" in told.inner_text() or "not measured" in told.inner_text()
        told.get_by_role("button", name="Close").click()
        assert told.count() == 0


def test_live_values_go_on_at_the_right_edge_and_the_run_explains_them(browser: Any, here: Served) -> None:
    with tab(browser) as page:
        chart = opened(page, here)
        page.get_by_role("button", name="Show 10 min").click()
        until(page, f"{CHART}.step === '1'")
        before = page.evaluate(f"Number({CHART}.to)")
        until(page, f"Number({CHART}.to) > {before + 7}")
        chart.focus()
        page.keyboard.press("ArrowLeft")  # 5 s
        words = until(page, "document.querySelector('.timeline .read').textContent")
        assert "ball 3." in words
        assert "far active" in words
        page.keyboard.press("Enter")
        page.get_by_role("region", name="The moment").get_by_text("By the run itself").wait_for()
