"""From an empty folder to a rule that acts, by the page alone; and from the demonstration to the page."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from support.browser import Served, served, tab

MOST = 24
"""Clicks and entries, all told."""


class Person:
    """Someone who knows what is on the page, and nothing else. Counts what they do."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.done: list[str] = []

    def click(self, name: str) -> None:
        """Press a button, by its words."""
        self._did(f"press {name}")
        self.page.get_by_role("button", name=name, exact=True).click()

    def choose(self, words: str) -> None:
        """Choose an answer."""
        self._did(f"choose {words}")
        self.page.locator("main label").filter(has_text=words).first.click()

    def enter(self, label: str, text: str) -> None:
        """Write into a field, or set a slider."""
        self._did(f"enter {label}: {text}")
        self.page.get_by_label(label, exact=True).fill(text)

    def point_at_the_ball(self) -> None:
        """Click on the picture where the ball is: in front of the camera, in its middle."""
        self._did("click on the ball")
        box = self.page.get_by_alt_text("What the camera sees").bounding_box()
        self.page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)

    def drag_the_ball_towards_the_camera(self) -> None:
        """Draw the ball through the room, seen from above, from 1.5 m before the camera to about 1 m."""
        self._did("drag the ball")
        self.page.locator("svg.plan .ball").hover()  # waits until it stands still: the page is still being laid out
        self.page.mouse.down()
        ball, camera = (middle(self.page.locator(each)) for each in ("svg.plan .ball", "svg.plan .robot"))
        self.page.mouse.move(ball[0] + 0.35 * (camera[0] - ball[0]), ball[1] + 0.35 * (camera[1] - ball[1]), steps=4)
        self.page.mouse.up()

    def is_asked(self, words: str) -> None:
        """Wait for a question."""
        self.page.get_by_role("heading", name=words).wait_for()

    def sees(self, words: str) -> None:
        """Wait until something stands on the page."""
        self.page.get_by_text(words).first.wait_for()

    def _did(self, what: str) -> None:
        self.done.append(what)


def middle(element: Any) -> tuple[float, float]:
    box = element.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


@pytest.fixture
def empty(tmp_path) -> Iterator[Served]:
    with served(tmp_path, None, runs=False) as serving:
        yield serving


@pytest.mark.timeout(240)
def test_from_an_empty_folder_to_a_rule_that_acts_by_the_page_alone(browser, empty):
    with tab(browser) as page:
        page.goto(empty.url)
        person = Person(page)
        set_up(person)
        person.sees("not raised")
        person.drag_the_ball_towards_the_camera()
        page.get_by_text("active", exact=True).first.wait_for()
        person.sees("raised")
        assert len(person.done) <= MOST, person.done


def set_up(person: Person) -> None:
    """Go through the set-up with the simulated room, and run what was saved."""
    person.page.get_by_role("link", name="Set it up").click()
    person._did("open Set-up")
    person.is_asked("Which camera?")
    person.choose("simulated room")
    person.click("Go on")
    person.is_asked("What shall be measured?")
    person.click("Go on")
    person.is_asked("How large is the ball?")
    person.click("Go on")
    person.is_asked("What colour is the ball?")
    person.point_at_the_ball()
    person.page.get_by_role("button", name="Forget the clicks").wait_for()
    person.click("Go on")
    person.is_asked("How far away is the ball?")
    person.click("Take it")
    person.is_asked("Now put the ball farther away")
    person.enter("Distance of the simulated ball in metres", "3.1")  # its middle: 3 m to its nearest point
    person.click("Take it as proof")
    person.is_asked("What shall happen?")
    person.click("Go on")
    person.is_asked("Nearer than what?")
    person.enter("Nearer than what?", "1.2 m")
    person.click("Go on")
    person.is_asked("drive?")
    person.choose("nothing is wired yet")
    person.click("Go on")
    person.is_asked("Save, and run it")
    person.click("Save, and run it")
    person.page.locator("canvas[data-drawn]").wait_for()


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
