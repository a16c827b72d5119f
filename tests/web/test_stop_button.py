"""One button on every view stops every output; what was stopped is released on purpose."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from stadimeter.testing.rig import eventually
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
    page.get_by_role("dialog").wait_for(state="detached")
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
        page.locator("summary", has_text="Events").click()
        until(page, f"{LEVEL} === '100 %'")
        page.get_by_role("button", name="Stop every output").press("Enter")
        until(page, f"{LEVEL} === '0 %'")
        stopped = page.locator(".event", has_text="outputs stopped").first
        assert stopped.inner_text().count("by the page at") == 1  # who it was is said once
        release(page)
        until(page, f"{LEVEL} === '100 %'")
        page.get_by_text("all clear").first.wait_for()


BY_HAND = "Not confirmed: the outputs may still act. Cut their supply by hand."


@contextmanager
def stepped_tab(browser: Any, here: Served, view: str = "live") -> Iterator[Any]:
    """Open the page on a clock that a test can step."""
    with tab(browser) as page:
        page.clock.install(time=0)
        page.goto(f"{here.url}/#{view}")
        page.locator(".view > *").first.wait_for()
        page.clock.pause_at(3_600_000)
        yield page


HELD, REFUSED = (lambda _route: None), (lambda route: route.abort())


@pytest.mark.parametrize(("view", "held"), [*((view, HELD) for view in VIEWS), ("live", REFUSED)])
def test_where_no_answer_comes_it_is_sent_again_and_then_says_in_red_what_to_do_by_hand(browser, here, view, held):
    with stepped_tab(browser, here, view) as page:
        sent: list[Any] = []
        page.route("**/outputs/stop", lambda route: (sent.append(route), held(route)))
        said = page.evaluate("""() => {
            document.querySelector("#stop button").click();
            return document.querySelector("#stop .said").textContent;
        }""")
        assert said == "Sending …", "at once: in the task of the click itself"
        for count in range(1, 5):
            eventually(lambda count=count: page.evaluate("1") and len(sent) == count)
            page.clock.run_for(1000)
            page.get_by_text("Not confirmed yet, sending again …").wait_for()
        page.clock.run_for(1000)
        page.get_by_text(BY_HAND).wait_for()
        assert page.locator("#stop .said").get_attribute("class") == "said is-error"
        eventually(lambda: page.evaluate("1") and len(sent) == 5)
        page.clock.run_for(60_000)
        page.get_by_text(BY_HAND).wait_for()


def test_an_answer_that_comes_late_is_told_and_what_was_sent_again_is_called_off(browser, here):
    with stepped_tab(browser, here) as page:
        sent: list[Any] = []
        page.route("**/outputs/stop", lambda route: sent.append(route))  # noqa: PLW0108 - playwright marks what it is given
        page.get_by_role("button", name="Stop every output").click()
        eventually(lambda: page.evaluate("1") and len(sent) == 1)
        page.clock.run_for(6000)
        page.get_by_text(BY_HAND).wait_for()
        with page.expect_event("requestfailed", lambda request: request.url.endswith("/outputs/stop")):
            sent[0].continue_()
            page.locator("#stop .is-good").wait_for()
    with tab(browser) as page:
        page.goto(here.url)
        release(page)


DIALOGS = {
    "colour": lambda page: (
        page.locator("summary", has_text="About the picture").click(),
        page.get_by_role("button", name="Colour …").first.click(),
    ),
    "acknowledge": lambda page: page.get_by_role("button", name="Acknowledge").first.click(),
    "shelve": lambda page: (
        page.locator(".more summary").first.click(),
        page.get_by_role("button", name="Shelve").first.click(),
    ),
    "release": lambda page: (
        page.get_by_role("button", name="Stop every output").click(),
        page.get_by_role("button", name="Release").click(),
    ),
}


@pytest.mark.parametrize("size", [PHONE, DESKTOP], ids=["phone", "desktop"])
@pytest.mark.parametrize("dialog", DIALOGS)
def test_it_is_above_every_dialog_and_says_there_what_became_of_it(browser, here, dialog, size):
    with tab(browser, size=size) as page:
        page.goto(here.url)
        DIALOGS[dialog](page)
        page.get_by_role("dialog").wait_for()
        with page.expect_response("**/outputs/stop"):
            page.get_by_role("button", name="Stop every output").click()
        page.locator("dialog #stop .said").wait_for()
        page.keyboard.press("Escape")
        page.get_by_role("dialog").wait_for(state="detached")
        page.get_by_role("button", name="Stop every output").click()
        release(page)
        page.locator("header #stop button").wait_for()
