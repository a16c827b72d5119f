"""One button on every view stops every output; what was stopped is released on purpose."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from support.browser import DESKTOP, PHONE, ROOM, Served, served, tab, until

VIEWS = ("live", "alarms", "recordings", "edit", "setup")
FAR = """
[rules.always]
actuator = "buzzer"
when = { above = "0.1 m" }
on_delay = "0 s"
"""
LEVEL = "document.querySelectorAll('.output')[1]?.querySelector('output').textContent"


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with served(tmp_path_factory.mktemp("stop"), ROOM + FAR) as serving:
        yield serving


def release(page: Any) -> None:
    page.get_by_role("button", name="Release").click()
    page.get_by_label("Why").fill("all clear")
    page.get_by_role("dialog").get_by_role("button", name="Release").click()
    page.get_by_role("button", name="Release").wait_for(state="detached")


@pytest.mark.parametrize("size", [PHONE, DESKTOP], ids=["phone", "desktop"])
@pytest.mark.parametrize("view", VIEWS)
def test_every_view_has_it_in_sight_however_far_one_scrolls(browser, here, view, size):
    with tab(browser, size=size) as page:
        page.goto(f"{here.url}/#{view}")
        page.locator(".view > *").first.wait_for()
        page.evaluate("scrollTo(0, document.body.scrollHeight)")
        stop = page.get_by_role("button", name="Stop every output")
        stop.click()
        page.get_by_text("Every output is at its safe value: stopped until released").wait_for()
        stop.click()  # which is no release
        page.get_by_text("stopped already").wait_for()
        release(page)


def test_outputs_go_to_their_safe_values_and_act_again_when_they_are_released(browser, here):
    with tab(browser) as page:
        page.goto(here.url)
        until(page, f"{LEVEL} === '100 %'")
        page.get_by_role("button", name="Stop every output").press("Enter")
        until(page, f"{LEVEL} === '0 %'")
        page.get_by_text("outputs stopped").first.wait_for()
        assert page.locator(".event").first.inner_text().count("by the page at") == 1  # who it was is said once
        release(page)
        until(page, f"{LEVEL} === '100 %'")
        page.get_by_text("all clear").first.wait_for()


def test_whoever_cannot_be_sure_that_they_are_stopped_is_told_so(browser, here):
    with tab(browser) as page:
        page.goto(here.url)
        page.route("**/outputs/stop", lambda route: route.abort())
        page.get_by_role("button", name="Stop every output").click()
        page.get_by_text("It is not known whether the outputs are stopped").wait_for()
