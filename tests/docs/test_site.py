"""The site of the documentation is whole, and its own search leads from the words of readers to the right page."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("mkdocs", reason="make docs installs what builds the site")
py_mini_racer = pytest.importorskip("py_mini_racer", reason="make docs installs what runs its search")

ROOT = Path(__file__).resolve().parents[2]

BROWSER = """
var answers = [], listeners = [], self = this, location = {href: "http://site/"};
function addEventListener(kind, listener) { listeners.push(listener); }
function postMessage(message) { answers.push(message); }
function importScripts() {}
function send(type, data) { answers = []; listeners.forEach(listener => listener({data: {type: type, data: data}})); }
"""
"""What the worker of the site's search finds around it in a browser."""

SETUP, QUERY = 0, 2

PAGE_OF = {
    "accuracy": "accuracy.html",
    "arduino": "robots/ros-arduino-bridge.html",
    "buzzer not sounding": "troubleshooting.html",
    "calibrate": "calibration.html",
    "camera busy": "troubleshooting.html",
    "emergency stop": "safety.html",
    "false alarm": "teaching.html",
    "follow a ball": "robots.html",
    "home assistant": "mqtt.html",
    "how far can it see": "what-it-does-not-do.html",
    "hysteresis": "rules.html",
    "password": "web-security.html",
    "person": "objects.html",
    "print a tag": "printing.html",
    "robot does not move": "troubleshooting.html",
    "start on boot": "appliance.html",
    "two cameras": "two-cameras.html",
    "unknown size": "unknown-size.html",
    "webcam": "cameras.html",
    "wrong distance": "troubleshooting.html",
}
"""The page that a reader who searches for a word wants to see first."""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    build = [sys.executable, "-m", "mkdocs", "build", "--site-dir", folder]
    done = subprocess.run(build, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def search(site):
    """Return the search of the site, as a browser runs it: a word to the addresses that it leads to, best first."""
    (worker,) = (site / "assets" / "javascripts" / "workers").glob("search.*.js")
    index = json.loads((site / "search" / "search_index.json").read_text())
    with py_mini_racer.MiniRacer() as browser:
        browser.eval(BROWSER + worker.read_text())
        browser.eval(f"send({SETUP}, {json.dumps({**index, 'options': {'suggest': False}})})")

        def ask(word):
            browser.eval(f"send({QUERY}, {json.dumps(word)})")
            (answer,) = json.loads(browser.eval("JSON.stringify(answers)"))
            return [group[0]["location"] for group in answer["data"]["items"]]

        yield ask


@pytest.mark.parametrize(("word", "page"), PAGE_OF.items())
def test_a_word_that_readers_search_for_leads_to_its_page(search, word, page):
    first, *_ = search(word) or [""]
    assert first.partition("#")[0] == page


def test_a_page_from_elsewhere_is_a_page_of_the_site_and_so_are_links_to_it(site):
    assert 'href="deploy.html"' in (site / "appliance.html").read_text()
    assert 'href="appliance.html"' in (site / "deploy.html").read_text()


def test_the_site_loads_nothing_from_elsewhere(site):
    loaded = re.findall(r"(?:src=|rel=\"stylesheet\" href=)\"(https?://[^\"]+)", (site / "index.html").read_text())
    assert loaded == []
