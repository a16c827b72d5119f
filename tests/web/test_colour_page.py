"""The colour of a ball by sliders in a real browser: in the set-up, and of a running configuration."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

import pytest

from stadimeter.config.files import sha256_of
from stadimeter.web.passwords import PasswordFile
from stadimeter.workbench.saving import versions
from support.browser import DESKTOP, PHONE, STILL, Served, served, tab, until
from support.page import faults_of

GREEN = "29,86,6:64,255,255"


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with served(tmp_path_factory.mktemp("still"), STILL) as serving:
        yield serving


def opened(page: Any, here: Served) -> Any:
    page.goto(f"{here.url}/#live")
    page.locator("summary", has_text="About the picture").click()
    page.get_by_role("button", name="Colour …").click()
    dialog = page.get_by_role("dialog", name="Colour of ball")
    dialog.get_by_text(re.compile("On the ball: [89]")).wait_for()
    return dialog


def move(page: Any, name: str, value: int) -> None:
    """Drag a slider as a finger does: it says where it is, and the page hears of it."""
    page.get_by_label(name, exact=True).fill(str(value))


def values(page: Any) -> list[int]:
    return [int(each.input_value()) for each in page.locator(".colour-sliders input").all()]


@pytest.mark.parametrize("size", [DESKTOP, PHONE])
def test_sliders_show_the_mask_of_the_live_picture_and_what_the_ball_and_the_rest_give(browser, still, size):
    still.configuration.write_text(STILL)
    with tab(browser, size=size) as page:
        dialog = opened(page, still)
        assert values(page) == [29, 64, 86, 255, 6, 255]
        until(page, "document.querySelector('dialog img').naturalWidth === 640")
        assert faults_of(page) == []
        move(page, "Hue from", 100)
        move(page, "Hue to", 10)
        dialog.get_by_text("Hues from 100 on, through red (0), to 10.").wait_for()
        dialog.get_by_text("It would not be found.").wait_for()
        dialog.get_by_text("Where the ball is, is not known.").wait_for()
        dialog.get_by_role("button", name="Undo").click()
        dialog.get_by_role("button", name="Undo").click()
        dialog.get_by_text(re.compile("It would be found, its size ± 0")).wait_for()
        assert values(page) == [29, 64, 86, 255, 6, 255]
        dialog.get_by_role("button", name="Redo").click()
        page.keyboard.press("Escape")
        dialog.locator(".fault").wait_for()
        assert values(page)[0] == 100, "Escape loses nothing"
        dialog.get_by_role("button", name="Close").click()
        dialog.wait_for(state="detached")
        assert still.configuration.read_text() == STILL


def test_a_range_is_saved_with_a_version_and_the_run_takes_it(browser, tmp_path):
    with served(tmp_path, STILL) as here, tab(browser) as page:
        dialog = opened(page, here)
        move(page, "Saturation from", 70)
        dialog.get_by_text(re.compile("It would be found")).wait_for()
        dialog.get_by_role("button", name="Save").click()
        dialog.get_by_text("Saved.").wait_for()
        assert here.configuration.read_text() == STILL.replace(GREEN, "29,70,6:64,255,255")
        assert len(versions(here.configuration)) == 1
        dialog.get_by_role("button", name="Restart the run").click()
        digest = "fetch('/api/v1/session').then((a) => a.json()).then(({ run }) => run.digest)"
        until(page, f"{digest}.then((now) => now === {json.dumps(sha256_of(here.configuration.read_text()))})")
        here.configuration.write_text(STILL + "# by another\n")
        move(page, "Saturation from", 60)
        dialog.get_by_role("button", name="Save", exact=True).click()
        dialog.get_by_text(re.compile("was changed by another")).first.wait_for()
        assert here.configuration.read_text() == STILL + "# by another\n"


def test_whoever_may_only_watch_has_no_button_for_it(browser, tmp_path):
    passwords = tmp_path / "passwords"
    PasswordFile(passwords).set("operate", "operate-it")
    PasswordFile(passwords).set("read", "only-look")
    options = ("--password-file", str(passwords), "--address", "127.0.0.1")
    with served(tmp_path, STILL, *options) as here, tab(browser) as page:
        page.goto(f"{here.url}/login")
        page.get_by_label("Password").fill("only-look")
        page.keyboard.press("Enter")
        page.locator(".target .value").wait_for()
        assert page.get_by_role("button", name="Colour …").count() == 0
        asked = page.request.get(f"{here.url}/api/v1/targets/ball/colour.jpg")
        assert asked.status == 403
