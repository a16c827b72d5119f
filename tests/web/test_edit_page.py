"""The editor in a real browser: what is wrong while one types, saving, two who save at once, and former versions."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from support.browser import ROOM, Served, served, tab

NEAR = 'when = { below = "1 m" }'


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with served(tmp_path_factory.mktemp("edit")) as serving:
        yield serving


@pytest.fixture
def here(room: Served) -> Served:
    """Return a page whose configuration is the first one again."""
    room.configuration.write_text(ROOM)
    return room


@pytest.fixture
def alone(tmp_path) -> Iterator[Served]:
    with served(tmp_path, runs=False) as serving:
        yield serving


def opened(page: Any, here: Served) -> Any:
    """Open the editor; return its field, when its text has been checked."""
    page.goto(f"{here.url}/#edit")
    page.get_by_text("1 warning").wait_for()
    return page.get_by_role("textbox", name="Configuration")


def edit(field: Any, old: str, new: str) -> None:
    text = field.input_value()
    assert old in text
    field.fill(text.replace(old, new))


def save(page: Any) -> None:
    page.get_by_role("button", name="Save", exact=True).click()


def saved(page: Any) -> None:
    """Save, and wait until the page says so: its list of versions is the new one then."""
    save(page)
    page.get_by_role("region", name="Saved").wait_for()


def until_saved(page: Any, here: Served, words: str) -> None:
    while words not in here.configuration.read_text():
        page.wait_for_timeout(50)


def test_an_error_stands_at_its_line_while_one_types_and_goes_when_it_is_mended(browser, here):
    with tab(browser) as page:
        field = opened(page, here)
        edit(field, NEAR, 'when = { below = "1 parsec" }')
        page.get_by_text("1 error").wait_for()
        assert page.locator(".meaning .words li").all_text_contents() == [NO_WORDS]
        page.get_by_role("button", name="unknown unit 'parsec'").click()
        line = ROOM.split("\n").index(NEAR) + 1
        assert page.evaluate(LINE_OF_CURSOR) == line
        assert f"✕ {line}\n" in page.locator(".numbers").inner_text()
        edit(field, "1 parsec", "1 m")
        page.get_by_text("1 warning").wait_for()
        assert page.locator(".strip.error").count() == 0
        assert page.locator(".meaning .words li").count() > 1


NO_WORDS = "What the rules do is said here when there is no error."


LINE_OF_CURSOR = """() => {
    const field = document.querySelector("textarea");
    return field.value.slice(0, field.selectionStart).split("\\n").length;
}"""


def test_the_newest_answer_wins_though_it_comes_first(browser, here):
    with tab(browser) as page:
        field = opened(page, here)
        held: list[Any] = []
        page.route("**/check", lambda route: held.append(route) if not held else route.continue_())
        edit(field, NEAR, 'when = { below = "1 parsec" }')
        while not held:
            page.wait_for_timeout(20)
        edit(field, "1 parsec", "2 m")
        page.get_by_text("nearer than 2.00 m").wait_for()
        held[0].continue_()
        assert page.get_by_text("parsec").count() == 0


def test_a_text_that_is_not_saved_outlives_a_reload_of_the_tab(browser, here):
    with tab(browser) as page:
        edit(opened(page, here), NEAR, 'when = { below = "1.25 m" }')
        page.get_by_text("nearer than 1.25 m").wait_for()
        page.on("dialog", lambda dialog: dialog.accept())
        page.reload()
        page.get_by_text("Your text from before is here.").wait_for()
        assert "1.25 m" in page.get_by_role("textbox", name="Configuration").input_value()
    assert here.configuration.read_text() == ROOM


def test_the_second_of_two_who_save_is_shown_what_the_first_changed_and_loses_nothing(browser, here):
    with tab(browser) as first, tab(browser) as second:
        one, other = opened(first, here), opened(second, here)
        edit(one, NEAR, 'when = { below = "80 cm" }')
        saved(first)
        edit(other, 'to = "3.5 m"', 'to = "4.5 m"')
        save(second)
        second.get_by_text("Someone else saved this configuration").wait_for()
        assert second.locator("ins").all_inner_texts() == ['+ when = { below = "80 cm" }']
        assert "4.5 m" in other.input_value()
        assert "80 cm" in here.configuration.read_text()
        second.get_by_role("button", name="Use theirs").click()
        assert "80 cm" in other.input_value()
        other.press("Control+z")
        assert "4.5 m" in other.input_value()


def test_a_text_with_errors_is_saved_only_by_one_who_says_so(browser, here):
    with tab(browser) as page:
        edit(opened(page, here), NEAR, 'when = { below = "1 parsec" }')
        save(page)
        page.get_by_text("Save it with its errors?").wait_for()
        assert here.configuration.read_text() == ROOM
        page.get_by_role("button", name="Save all the same").click()
        until_saved(page, here, "parsec")


def test_what_is_saved_is_applied_by_a_reload_where_that_is_enough(browser, here):
    with tab(browser) as page:
        edit(opened(page, here), NEAR, 'when = { below = "1.1 m" }')
        save(page)
        page.get_by_role("button", name="Reload the run").click()
        page.get_by_text("changed: near").wait_for()


def test_a_changed_camera_restarts_the_run_and_the_page_stays(browser, here):
    with tab(browser) as page:
        edit(opened(page, here), 'rate = "30 Hz"', 'rate = "20 Hz"')
        before = page.evaluate(DIGEST)
        save(page)
        page.get_by_role("button", name="Restart the run").click()
        while page.evaluate(DIGEST) in {None, before}:
            page.wait_for_timeout(50)
        page.get_by_text("live", exact=True).wait_for()


DIGEST = """async () => {
    const { run } = await (await fetch("/api/v1/session")).json();
    return run.is_running ? run.digest : null;
}"""


def test_a_former_version_is_brought_back(browser, here):
    with tab(browser) as page:
        field = opened(page, here)
        edit(field, NEAR, 'when = { below = "90 cm" }')
        saved(page)
        page.get_by_role("button", name="Bring back").first.click()
        page.get_by_role("dialog").get_by_role("button", name="Bring back").click()
        until_saved(page, here, NEAR)
        while field.input_value() != ROOM:
            page.wait_for_timeout(50)


def test_saving_works_while_there_is_no_run_and_the_page_offers_to_start_one(browser, alone):
    with tab(browser) as page:
        page.goto(f"{alone.url}/#edit")
        page.get_by_text("1 warning").wait_for()
        edit(page.get_by_role("textbox", name="Configuration"), NEAR, 'when = { below = "1.3 m" }')
        save(page)
        page.get_by_role("region", name="Saved").get_by_role("button", name="Start the run").click()
        page.get_by_text("live", exact=True).wait_for()
    assert "1.3 m" in alone.configuration.read_text()
