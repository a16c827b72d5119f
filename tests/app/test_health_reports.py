"""What a run publishes of its own health."""

from __future__ import annotations

import json
from typing import Any

import pytest

import stadimeter
from stadimeter.app.bootstrap import build
from stadimeter.app.loop import Limits, Loop
from stadimeter.config.loader import load_configuration
from stadimeter.core.home_assistant import Announcement, DiscoveryPlace
from stadimeter.core.message import Message
from support.recording_doubles import RecordingMessenger
from support.simulated_run import SIMULATED_BALL

CONFIGURATION = (
    SIMULATED_BALL.replace('rate = "30 Hz"', 'rate = "10 Hz"')
    + """
[rules.near]
when = { below = "2.5 m" }
[world]
path = [{ at = "0 s", x = "2 m", y = "0 m" }]
"""
)


class Discovered(RecordingMessenger):
    """A messenger over which a run is discovered."""

    discovery_place = DiscoveryPlace(node="it", base="stadimeter/it", prefix="homeassistant")
    orders = frozenset({"request/stop-outputs"})

    def __init__(self) -> None:
        super().__init__()
        self.announcements: list[Announcement] = []
        self.is_due = self.is_forgotten = False

    def retain_only(self, topics: frozenset[str]) -> None:
        """Keep nothing."""

    def announce(self, announcement: Announcement) -> None:
        """Keep it."""
        self.announcements.append(announcement)

    def take_states_due(self) -> bool:
        """Return what `is_due` says, once."""
        is_due, self.is_due = self.is_due, False
        return is_due

    def take_forgotten(self) -> bool:
        """Return what `is_forgotten` says, once."""
        is_forgotten, self.is_forgotten = self.is_forgotten, False
        return is_forgotten


class Run:
    """A run of a simulated camera that delivers or not."""

    def __init__(self, folder: Any, configuration: str = CONFIGURATION) -> None:
        path = folder / "run.toml"
        path.write_text(configuration)
        self.loop = Loop(build(load_configuration(path), speed=None))
        self.messenger = self.loop.parts.messenger = Discovered()

    def for_s(self, seconds: float) -> list[Message]:
        self.loop.run(Limits(seconds=seconds))
        return self.messenger.messages

    def on(self, topic: str) -> list[str]:
        return [each.payload for each in self.messenger.messages if each.topic == topic]


@pytest.fixture
def run(tmp_path: Any) -> Run:
    return Run(tmp_path)


@pytest.mark.long
def test_health_is_published_every_half_minute_with_what_is_known(run):
    messages = run.for_s(70.0)
    told = [json.loads(payload) for payload in run.on("health")]
    assert len(told) == 3
    assert told[-1].keys() >= {"v", "ts", "frame_rate_hz", "latency_s", "temperature_c", "undelivered", "trouble"}
    assert told[-1]["version"] == stadimeter.__version__
    assert told[-1]["frame_rate_hz"] == pytest.approx(10.0, abs=0.5)
    assert told[-1]["undelivered"] == told[-1]["given_up"] == 0
    (first,) = {(each.qos, each.retain) for each in messages if each.topic == "health"}
    assert first == (0, False)


def test_the_camera_is_offline_until_its_first_picture_and_while_it_is_silent(run):
    faults = run.loop.parts.world.faults  # type: ignore[union-attr]

    def fail(record: Any, _frame: Any) -> None:
        faults.camera_blocked = 5.0 < record.observation.now_s < 12.0

    run.loop.listeners.append(fail)
    run.for_s(20.0)
    assert run.on("camera/state") == ["offline", "online", "offline", "online", "offline"], "at last, the run has ended"
    assert all(each.qos == 1 and each.retain for each in run.messenger.messages if each.topic == "camera/state")


def test_a_run_is_announced_with_what_its_messenger_takes(run):
    run.for_s(1.0)
    (announced,) = run.messenger.announcements
    assert {"distance_ball", "rule_near", "stop_outputs"} <= set(announced.components)
    assert not any(key.startswith("shelve") for key in announced.components)


OWN = """
[messenger]
driver = "simulated"
[[rules.near.escalation]]
topic = "door/alert"
text = "{rule}"
retain = true
"""


@pytest.mark.parametrize("is_forgotten", [False, True], ids=["Home Assistant began anew", "the broker forgot all"])
def test_all_states_are_published_again_when_they_are_due_and_messages_of_one_s_own_when_they_are_forgotten(
    tmp_path, is_forgotten
):
    run = Run(tmp_path, CONFIGURATION + OWN)

    def ask(record: Any, _frame: Any) -> None:
        if not asked and record.observation.now_s > 6.2:
            asked.append(len(run.messenger.messages))
            run.messenger.is_due, run.messenger.is_forgotten = not is_forgotten, is_forgotten

    asked: list[int] = []
    run.loop.listeners.append(ask)
    run.for_s(6.4)
    before, after = run.messenger.messages[: asked[0]], run.messenger.messages[asked[0] :]
    states = {"info", "camera/state", "rule/near/availability", "rule/near/state", "rule/near/settings"}
    own = {"door/alert"} if is_forgotten else set()
    assert {each.topic for each in after} == {*states, *own, "target/ball/state", "health"}
    for topic in states:
        newest = [each for each in before if each.topic == topic][-1]
        assert next(each for each in after if each.topic == topic) == newest, "the same state, of the same time"


def test_at_the_end_of_a_run_no_state_that_a_broker_keeps_says_that_it_goes_on(run):
    run.for_s(6.5)
    assert run.on("camera/state")[-1] == "offline"
    assert run.on("rule/near/availability")[-1] == "offline"
    assert json.loads(run.on("rule/near/state")[-2])["active"] is True
    last = json.loads(run.on("rule/near/state")[-1])
    assert (last["active"], last["status"], last["reason"]) == (None, "unknown", "the run has ended")
