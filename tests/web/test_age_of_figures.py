"""What a run told is grey and says how old it is, as soon as it is not of now: killed, hung, or cut off."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from typing import Any

import pytest

from support.browser import DESKTOP, PHONE, SILENT_AFTER_ONE, STILL, Served, served, tab, until
from support.page import faults_of


@pytest.fixture
def here(tmp_path) -> Iterator[Served]:
    with served(tmp_path, STILL) as serving:
        yield serving
        assert serving.run is not None
        serving.run.send_signal(signal.SIGCONT)


def opened(page: Any, here: Served, view: str = "live") -> None:
    page.goto(f"{here.url}/#{view}")
    page.get_by_text("live", exact=True).wait_for()
    page.locator(".panel").first.wait_for()


AGE = "parseInt(getComputedStyle(document.documentElement).getPropertyValue('--age').slice(1))"

COLOURED = """() => [...document.querySelectorAll('.of-run .panel')].filter((panel) => {
    const style = getComputedStyle(panel);
    const age = getComputedStyle(panel, '::before').content;
    const says = panel.matches('.picture') || /^"\\d+ s old"$/.test(age);
    return panel.checkVisibility() && !(style.filter === 'grayscale(1)' && says);
}).map((panel) => panel.className)"""
"""The parts of the page that have a colour, or do not say how old they are; the picture says so by itself."""

GREY = f"({COLOURED})().length === 0"
"""On a slow machine a late message can make the page fresh once more after the run has died: this is waited for."""


@pytest.mark.parametrize("how", ["killed", "hung"])
@pytest.mark.parametrize(("size", "scheme"), [(PHONE, "dark"), (DESKTOP, "light")], ids=["phone", "desktop"])
def test_every_part_of_every_view_of_a_dead_run_is_grey_and_says_how_old_it_is(browser, here, how, size, scheme):
    with tab(browser, size=size, scheme=scheme) as page:
        opened(page, here)
        page.locator("canvas[data-drawn]").wait_for()
        page.locator("html:not(.stale)").wait_for()
        here.run.send_signal(signal.SIGKILL if how == "killed" else signal.SIGSTOP)
        page.locator("html.stale").wait_for()
        until(page, GREY)
        page.locator(".picture .old").wait_for()
        assert page.get_by_text("live", exact=True).count() == 0
        page.get_by_role("link", name="Alarms", exact=True).click()
        page.get_by_text("History").wait_for()
        until(page, GREY)
        until(page, f"{AGE} >= 3")
        page.get_by_role("link", name="Live", exact=True).click()
        page.locator(".target .value").wait_for()
        until(page, GREY)
        assert not faults_of(page)


def test_a_run_that_goes_on_has_its_colours_again(browser, here):
    with tab(browser) as page:
        opened(page, here)
        here.run.send_signal(signal.SIGSTOP)
        page.locator("html.stale").wait_for()
        here.run.send_signal(signal.SIGCONT)
        page.locator("html:not(.stale)").wait_for()
        page.get_by_text("live", exact=True).wait_for()


def test_whoever_opens_the_page_while_the_run_hangs_sees_how_old_the_last_figures_are(browser, here):
    with tab(browser) as first, tab(browser) as second:
        opened(first, here)
        here.run.send_signal(signal.SIGSTOP)
        until(first, f"document.documentElement.classList.contains('stale') && {AGE} >= 3")
        second.goto(here.url)
        second.locator("html.stale").wait_for()
        assert second.evaluate(AGE) >= 3


def test_figures_are_grey_one_second_after_the_last_message(browser, here):
    with tab(browser) as page:
        page.clock.install()
        page.add_init_script(f"({SILENT_AFTER_ONE})()")
        page.goto(here.url)
        until(page, "window.isSilent === true")
        page.locator(".target .value").wait_for()
        page.clock.run_for(1000)
        assert page.locator("html.stale").count() == 1
        assert page.evaluate(AGE) >= 1  # more on a slow machine: the clock of the page goes on by itself
