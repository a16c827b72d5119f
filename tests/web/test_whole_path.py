"""From an empty folder to a rule that acts, by the page alone; and from the demonstration to the page."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from typing import Any

import pytest

from support.browser import served, tab


def middle(element: Any) -> tuple[float, float]:
    element.wait_for()  # one that is hidden until its picture comes has no box
    box = element.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def press(page: Any, name: str) -> None:
    page.get_by_role("button", name=name, exact=True).click()


def until_asked(page: Any, words: str) -> None:
    page.get_by_role("heading", name=words).wait_for()


@pytest.mark.timeout(240)
def test_from_an_empty_folder_to_a_rule_that_acts_by_the_page_alone(browser, tmp_path):
    with served(tmp_path, None, runs=False) as here, tab(browser) as page:
        page.goto(here.url)
        set_up(page)
        page.get_by_text("not raised").first.wait_for()
        for _ in range(5):  # from 1.5 m before the camera to 1 m
            page.locator("svg.plan .ball").press("ArrowDown")
        page.get_by_text("active", exact=True).first.wait_for()
        page.get_by_text("raised").first.wait_for()


def set_up(page: Any) -> None:
    """Go through the set-up with the simulated room, and run what was saved."""
    until_asked(page, "Which camera?")
    page.locator("main label").filter(has_text="simulated room").first.click()
    press(page, "Go on")
    until_asked(page, "What shall be measured?")
    press(page, "Go on")
    until_asked(page, "What colour is the ball?")
    page.mouse.click(*middle(page.get_by_alt_text("What the camera sees")))  # the ball is before it
    page.get_by_role("button", name="Forget the clicks").wait_for()
    press(page, "Go on")
    until_asked(page, "How far away is the ball?")
    ball = page.get_by_role("button", name="ball in the room")
    for _ in range(4):  # 10 cm each: its middle is at 1.5 m then, so its nearest point at 1.4 m
        ball.press("ArrowUp")
    page.get_by_text("1.50 m from the camera, ahead").wait_for()
    page.get_by_label("It is this far from the lens now").fill("1.4 m")
    press(page, "Take it")
    until_asked(page, "What shall happen?")
    page.get_by_label("Nearer than what?").fill("1.2 m")
    press(page, "Go on")
    until_asked(page, "drive?")
    page.locator("main label").filter(has_text="nothing is wired yet").first.click()
    press(page, "Go on")
    until_asked(page, "Save, and run it")
    press(page, "Save, and run it")
    page.locator("canvas[data-drawn]").wait_for()


def test_the_demonstration_says_where_its_page_is_and_the_page_shows_it(browser, tmp_path):
    command = [sys.executable, "-m", "stadimeter", "demo", "--plain"]
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(tmp_path), "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as demo:
        try:
            words = (word for line in demo.stdout for word in line.split())
            address = next(word for word in words if word.startswith("http://127.0.0.1"))
            with tab(browser) as page:
                page.goto(address)
                page.locator("canvas[data-drawn]").wait_for()
                page.get_by_label("The room from above").wait_for()
        finally:
            demo.send_signal(signal.SIGINT)
            demo.stdout.read()
            demo.wait()
