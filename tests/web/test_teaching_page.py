"""From "it fired wrongly last night" to a mended, tested rule, on the page alone."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from stadimeter.config.loader import load_configuration
from stadimeter.workbench.rule_tests import run_rule_test
from support.browser import Served, served, tab, until
from support.false_alarm import BY_S, CONFIGURATION, STAYED_S, record

pytestmark = pytest.mark.timeout(900)

CHART = "document.querySelector('.timeline-chart').dataset"
CLICKS_MAX = 12


class Newcomer:
    """Someone who has nothing but the page, and whose clicks are counted."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.clicks = 0

    def click(self, role: str, name: str) -> None:
        self.page.get_by_role(role, name=name, exact=True).click()
        self.clicks += 1

    def click_moment(self, unix_s: float) -> None:
        box = self.page.locator(".u-over").bounding_box()
        from_s, to_s = (self.page.evaluate(f"Number({CHART}.{each})") for each in ("from", "to"))
        self.page.mouse.click(box["x"] + (unix_s - from_s) / (to_s - from_s) * box["width"], box["y"] + 8)
        self.clicks += 1


@pytest.fixture
def began_s() -> float:
    return time.time() - 400


@pytest.fixture
def here(tmp_path: Path, began_s: float) -> Iterator[Served]:
    """Serve a run, and what it recorded some minutes ago."""
    record(tmp_path, began_s)
    with served(tmp_path, CONFIGURATION) as serving:
        yield serving


def shown(page: Any, words: str) -> None:
    until(page, f"document.querySelector('[aria-label=\"What if\"] [role=status]')?.textContent.includes({words!r})")


def test_a_newcomer_mends_a_rule_that_fired_wrongly(browser: Any, here: Served, began_s: float) -> None:
    with tab(browser) as page:
        page.goto(here.url)
        newcomer = Newcomer(page)
        newcomer.click("link", "Timeline")
        page.locator(".timeline-chart[data-step]").wait_for()
        newcomer.click("button", "Show 10 min")
        until(page, f"{CHART}.step === '1'")
        newcomer.click_moment(began_s + BY_S)
        newcomer.click("button", "Should not have fired")
        shown(page, "2 of yours gone")
        newcomer.click_moment(began_s + STAYED_S)
        newcomer.click("button", "Should have fired")
        newcomer.click("button", "Save with its test")
        shown(page, "Saved, with 1 test that passes.")
        newcomer.click("button", "Reload the run")
        page.get_by_text("Done").wait_for()
    assert newcomer.clicks <= CLICKS_MAX
    mended = load_configuration(here.configuration)
    (test,) = mended.tests
    assert run_rule_test(mended, test).passed
    unmended = CONFIGURATION + mended.text[mended.text.index("\n[[tests]]") :]
    before = load_configuration(here.configuration, texts={here.configuration: unmended})
    assert not run_rule_test(before, before.tests[0]).passed, "the test holds what was wrong"
