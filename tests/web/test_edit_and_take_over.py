"""Editing a configuration that runs, by the page alone: three processes, as a user has them."""

from __future__ import annotations

import json
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from stadimeter.testing.rig import eventually
from support.browser import Served, served
from support.simulated_run import SIMULATED_BALL

pytestmark = pytest.mark.long

TEXT = (
    SIMULATED_BALL
    + """
[rules.near]
actuator = "motor"
when = { below = "1 m" }

[world]
path = [{ at = "0 s", x = "1.5 m", y = "0 m" }]
"""
)


class Page:
    """The API of a page, as the page itself asks it."""

    def __init__(self, here: Served) -> None:
        self.here = here

    def __call__(self, method: str, path: str, body: object = None) -> Any:
        status, answer = self.answered(method, path, body)
        assert status == 200, answer
        return answer

    def answered(self, method: str, path: str, body: object = None) -> tuple[int, Any]:
        """Return the status and the answer."""
        headers = {"Origin": self.here.url, "Content-Type": "application/json"} if method != "GET" else {}
        data = None if method == "GET" else json.dumps(body or {}).encode()
        request = urllib.request.Request(f"{self.here.url}/api/v1/{path}", data, headers, method=method)  # noqa: S310
        try:
            with urllib.request.urlopen(request, timeout=120) as response:  # noqa: S310 - the page of this test
                return response.status, json.loads(response.read())
        except urllib.error.HTTPError as error:
            with error:
                return error.code, json.loads(error.read())

    def state(self) -> dict[str, Any]:
        """Return the state of the rule; nothing while the run cannot be asked."""
        status, answer = self.answered("GET", "status")
        rules = answer.get("rules", []) if status == 200 else []
        return next((rule for rule in rules if rule["rule"] == "near"), {})

    def save(self, text: str, base: str, **more: object) -> Any:
        return self("PUT", "configuration", {"text": text, "base_version": base, **more})


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    with served(tmp_path, TEXT) as here:
        yield Page(here)


def test_a_threshold_is_edited_saved_and_taken_over_and_the_rule_acts_on_it(page: Page) -> None:
    eventually(lambda: page.state().get("active") is False)
    saved = page("GET", "configuration")
    assert saved["text"] == TEXT
    farther = TEXT.replace('below = "1 m"', 'below = "2 m"')
    assert page("POST", "configuration/check", {"text": farther})["problems"] == []
    kept = page.save(farther, saved["version"])
    assert kept["needs"] == "reload"
    assert page.state()["active"] is False, "a save alone changes nothing"
    page("POST", "run/reload")
    eventually(lambda: page.state().get("active") is True)

    status, refused = page.answered("PUT", "configuration", {"text": TEXT, "base_version": saved["version"]})
    assert (status, refused["error"]["code"]) == (409, "conflict")
    assert refused["error"]["their_text"] == farther
    assert any("below" in line for line in refused["error"]["diff"])

    (former,) = page("GET", "configuration")["versions"]
    back = page("POST", f"configuration/versions/{former['id']}/restore", {"base_version": kept["version"]})
    assert back["needs"] == "reload"
    page("POST", "run/reload")
    eventually(lambda: page.state().get("active") is False)
