"""Recordings in a real browser: made, replayed by the keyboard, downloaded, deleted; and one that is damaged."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from support.browser import Served, served, tab, until

SHOWN_S = "Number(document.querySelector('input[type=range]').value)"
SHOWN_PICTURE = "document.querySelector('.replay img').naturalWidth"


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with served(tmp_path_factory.mktemp("recordings")) as serving:
        yield serving


@pytest.fixture(scope="module")
def recording(browser: Any, room: Served) -> Path:
    """Make a recording of three seconds or more by the page; return its file."""
    with tab(browser) as page:
        page.goto(f"{room.url}/#recordings")
        page.get_by_role("button", name="Record", exact=True).click()
        page.get_by_text(re.compile("Recording: [3-9]")).wait_for()
        page.get_by_role("button", name="Stop recording").click()
        page.get_by_role("button", name="Replay").wait_for()
        page.get_by_role("link", name="Download").wait_for()
    (file,) = room.configuration.parent.glob("*/*.mcap")
    return file


def test_it_is_replayed_by_the_keyboard_alone(browser, room, recording):
    with tab(browser) as page:
        page.goto(f"{room.url}/#recordings")
        replay = page.get_by_role("button", name=f"Replay {recording.name}")
        replay.wait_for()
        replay.focus()
        page.keyboard.press("Enter")
        until(page, SHOWN_PICTURE)
        first = page.locator(".replay img").get_attribute("src")
        for _ in range(5):
            page.keyboard.press("ArrowRight")
        assert until(page, SHOWN_S) == pytest.approx(0.5)
        assert page.get_by_role("slider").get_attribute("aria-valuetext").startswith("0.5 of ")
        until(page, f"document.querySelector('.replay img').src !== '{first}' && {SHOWN_PICTURE} === 640")
        values = page.get_by_role("region", name=f"Replay of {recording.name}")
        assert "ball" in values.get_by_role("list").first.inner_text()


def test_one_that_is_damaged_says_what_is_wrong_and_can_be_replayed_as_far_as_it_goes(browser, room, recording):
    whole = recording.read_bytes()
    cut, ruined = recording.with_name("cut.mcap"), recording.with_name("ruined.mcap")
    cut.write_bytes(whole[: len(whole) * 2 // 3])
    ruined.write_bytes(b"\x89MCAP0\r\n" + bytes(1000))
    with tab(browser) as page:
        page.goto(f"{room.url}/#recordings")
        row = page.get_by_role("listitem").filter(has_text="cut.mcap")
        row.get_by_text("its end is missing").wait_for()
        row.get_by_role("button", name="Replay").click()
        until(page, SHOWN_PICTURE)
        other = page.get_by_role("listitem").filter(has_text="ruined.mcap")
        assert "Damaged: " in other.inner_text()
        assert other.get_by_role("button", name="Replay").count() == 0
        assert other.get_by_role("button", name="Delete").count() == 1
    cut.unlink()
    ruined.unlink()


def test_it_is_deleted_only_after_a_question(browser, room, recording):
    other = recording.with_name("other.mcap")
    other.write_bytes(recording.read_bytes())
    with tab(browser) as page:
        page.goto(f"{room.url}/#recordings")
        delete = page.get_by_role("button", name="Delete other.mcap")
        delete.click()
        page.get_by_role("dialog").get_by_role("button", name="Cancel").click()
        assert other.exists()
        delete.click()
        page.get_by_role("dialog").get_by_role("button", name="Delete").click()
        page.get_by_text("other.mcap is deleted.").first.wait_for()
        until(page, "!document.body.innerText.includes('Download other') && !document.querySelector('dialog')")
        assert not other.exists()
        assert recording.exists()


def test_what_the_documents_install_for_the_page_can_record():
    extras = tomllib.loads((Path(__file__).resolve().parents[2] / "pyproject.toml").read_text())["project"]
    needed = extras["optional-dependencies"]
    assert set(needed["record"]) <= set(needed["web"])
