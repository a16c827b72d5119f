"""Editing a configuration that runs, by the page's API alone: three processes, as a user has them."""

import pytest

from stadimeter.testing.rig import eventually
from support.browser import served
from support.page import ServedPage
from support.simulated_run import SIMULATED_BALL

pytestmark = pytest.mark.long

NEAR = """
[rules.near]
actuator = "motor"
when = { below = "1 m" }

[world]
path = [{ at = "0 s", x = "1.5 m", y = "0 m" }]
"""
TEXT = SIMULATED_BALL + NEAR


@pytest.fixture
def site(tmp_path):
    with served(tmp_path, TEXT) as here:
        yield ServedPage(None, int(here.url.rpartition(":")[2]))


def is_active(site):
    """Return whether the rule is active; None while the run cannot be asked."""
    answer = site.get("/api/v1/status")
    return answer.data["rules"][0]["active"] if answer.status == 200 and answer.data["rules"] else None


def test_a_threshold_is_edited_saved_and_taken_over_and_the_rule_acts_on_it(site):
    def asked(method, path, body):
        return site.ask(method, f"/api/v1/{path}", body).data

    eventually(lambda: is_active(site) is False)
    saved = site.get("/api/v1/configuration").data
    assert saved["text"] == TEXT
    farther = TEXT.replace('below = "1 m"', 'below = "2 m"')
    assert asked("POST", "configuration/check", {"text": farther})["problems"] == []
    kept = asked("PUT", "configuration", {"text": farther, "base_version": saved["version"]})
    assert kept["needs"] == "reload"
    assert is_active(site) is False, "a save alone changes nothing"
    asked("POST", "run/reload", {})
    eventually(lambda: is_active(site) is True)

    refused = site.ask("PUT", "/api/v1/configuration", {"text": TEXT, "base_version": saved["version"]})
    assert (refused.status, refused.error) == (409, "conflict")
    assert refused.data["error"]["their_text"] == farther
    assert any("below" in line for line in refused.data["error"]["diff"])

    (former,) = site.get("/api/v1/configuration").data["versions"]
    back = asked("POST", f"configuration/versions/{former['id']}/restore", {"base_version": kept["version"]})
    assert back["needs"] == "reload"
    asked("POST", "run/reload", {})
    eventually(lambda: is_active(site) is False)
