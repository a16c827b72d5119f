"""Clips in a real browser: kept by a button, and opened from the alarm that they are of."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from support.browser import ROOM, Served, served, tab, until

BOX = '\n[black_box]\nbefore = "3 s"\nafter = "1 s"\n'
SHOWN_S = "Number(document.querySelector('input[type=range]').value)"
SHOWN_PICTURE = "document.querySelector('.replay img').naturalWidth"


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with served(tmp_path_factory.mktemp("clips"), ROOM + BOX) as serving:
        yield serving


@pytest.mark.long
def test_an_alarm_leads_to_the_moment_of_its_clip_with_the_picture_beside_its_sentence(
    browser: Any, room: Served
) -> None:
    with tab(browser) as page:
        page.goto(f"{room.url}/#alarms")
        link = page.locator(".alarms").get_by_role("link", name="Watch the clip")
        link.wait_for()
        link.click()
        page.locator(".replay img").wait_for(state="attached")
        until(page, SHOWN_PICTURE)
        assert until(page, SHOWN_S) > 0.5
        until(page, "document.querySelector('.replay').innerText.includes('near')")
        page.go_back()
        page.locator(".events").get_by_role("link", name="Watch the clip").first.wait_for()
