"""The frame of the page in a real browser: it opens, and says what is not there."""

from __future__ import annotations

from support.browser import served, tab


def test_the_page_opens_and_says_that_nothing_runs(browser, tmp_path):
    with served(tmp_path, runs=False) as here, tab(browser) as page:
        page.goto(here.url)
        page.get_by_role("link", name="Live").wait_for()
        page.get_by_text("not connected").wait_for()
        assert page.get_by_role("alert").inner_text()
