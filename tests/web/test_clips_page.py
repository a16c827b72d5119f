"""Clips in a real browser: kept by a button, and opened from the alarm that they are of."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
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


@pytest.mark.long
def test_the_last_seconds_are_kept_by_a_button_and_the_clip_says_what_it_is_of(browser: Any, room: Served) -> None:
    folder: Path = room.configuration.parent / "recordings" / "clips"
    with tab(browser) as page:
        page.goto(f"{room.url}/#recordings")
        page.get_by_role("button", name="Save clip").click()
        page.get_by_text("will hold the last 3 s and the next 1 s").wait_for()
        name = page.get_by_text("will hold the last").inner_text().split()[0]

        row = page.get_by_role("listitem").filter(has_text=name).filter(has_text=re.compile(" (order|raised): "))
        row.wait_for()  # the list is shown anew when the clip is whole
        assert (folder / name).exists()
