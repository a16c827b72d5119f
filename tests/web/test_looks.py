"""Every page at three sizes, light and dark: nothing is cut off, all can be read, and the keyboard comes everywhere."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from support.browser import DESKTOP, PHONE, TABLET, Served, served, tab
from support.page import faults_of, out_of_reach

VIEWS = ("live", "timeline", "alarms", "recordings", "edit", "setup", "certificate")


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with served(tmp_path_factory.mktemp("looks")) as serving:
        yield serving


def unfold(page: Any) -> None:
    page.evaluate("document.querySelectorAll('details:not([open]) > summary').forEach((each) => each.click())")


def opened(page: Any, here: Served, view: str) -> None:
    page.goto(f"{here.url}/#{view}")
    page.get_by_text("live", exact=True).wait_for()
    page.locator(".view > *").first.wait_for()
    page.wait_for_load_state("load")
    if view == "edit":
        page.locator(".to-line").first.wait_for()  # what its check found
    if view == "setup":
        page.locator(".setup-way .primary").wait_for()  # the question is there, and has the focus
    if view == "timeline":
        page.locator(".timeline-chart[data-step]").wait_for()
        page.get_by_role("region", name="What if").wait_for()  # it comes with the thresholds, a moment later
    if view == "live":
        page.locator("canvas[data-drawn]").wait_for()
        unfold(page)
        page.get_by_text("Show what was refused").click()
        unfold(page)


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [PHONE, TABLET, DESKTOP], ids=["phone", "tablet", "desktop"])
def test_nothing_is_cut_off_or_hard_to_read(browser, here, size, scheme):
    with tab(browser, size=size, scheme=scheme) as page:
        for view in VIEWS:
            opened(page, here, view)
            assert not faults_of(page), view


@pytest.mark.parametrize("view", VIEWS)
def test_the_keyboard_comes_to_everything(browser, here, view):
    with tab(browser) as page:
        opened(page, here, view)
        assert not out_of_reach(page)
