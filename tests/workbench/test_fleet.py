"""The state of a fleet from what devices send, of which nothing is trusted."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.app.messages import Reporter
from stadimeter.cli import fleet as devices
from stadimeter.cli.fleet import STALE_S, Fleet, fleet_record, troubles
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decision import Decision, RuleStatus, RuleTrace, SafetyMode, Severity
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.message import EXPIRES_S
from stadimeter.core.rule import AlarmRule
from stadimeter.messaging.protocol import Received

NOON = "2026-06-01T12:00:00.000+00:00"


class Heard:
    """A fleet, and what it is sent."""

    def __init__(self, root: str = "stadimeter") -> None:
        self.fleet = Fleet(root)
        self.now_s = 1000.0

    def say(self, topic: str, payload: object, *, is_retained: bool = False, expires_s: int | None = None) -> None:
        data = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
        self.fleet.take(
            Received(topic=f"stadimeter/{topic}", payload=data, is_retained=is_retained, expires_s=expires_s),
            self.now_s,
        )

    def online(self, device: str = "garage") -> None:
        self.say(f"{device}/availability", b"online")

    def state(self, device: str = "garage", **changed: Any) -> None:
        self.say(f"{device}/target/ball/state", {"seq": 0, "status": "tracking", "distance_m": 1.5, **changed})

    def rule(self, device: str = "garage", rule: str = "near", **changed: Any) -> None:
        state = {
            "active": True,
            "severity": "alarm",
            "acknowledged": False,
            "since": NOON,
            "reason": "0.48 m",
            **changed,
        }
        self.say(f"{device}/rule/{rule}/state", state)

    def status(self, device: str = "garage") -> str:
        return self.fleet.devices[device].status(self.now_s)


@pytest.fixture
def heard() -> Heard:
    return Heard()


def test_what_a_run_publishes_is_understood_word_for_word(heard: Heard) -> None:
    rule = AlarmRule(name="near", target="ball", condition=DistanceCondition(below=2.0), severity=Severity.SAFETY)
    reporter = Reporter(boot_id="boot")
    decision = Decision(
        commands=(),
        events=(),
        tracks=(Track(target="ball", status=TrackStatus.TRACKING, distance_m=1.5, sigma_m=0.02, as_of_s=0.0),),
        safety=SafetyMode.ACTIVE,
        safety_reason="",
        rules=(RuleTrace(rule="near", status=RuleStatus.ACTIVE, active=True, acknowledged=False),),
        outputs=(),
        reasons={"near": "1.50 m is below 2.00 m"},
    )
    heard.online()
    for message in (reporter.info("9f86"), *reporter.opening([rule]), *reporter.messages(0.0, lambda: NOON, decision)):
        heard.say(f"garage/{message.topic}", message.payload.encode())
    record = fleet_record(heard.fleet, heard.now_s)
    (device,), (alarm,) = record["devices"], record["alarms"]
    assert (device["device"], device["status"], device["configuration_sha256"]) == ("garage", "online", "9f86")
    assert device["targets"] == [
        {"target": "ball", "status": "tracking", "distance_m": 1.5, "sigma_m": 0.02, "age_s": 0.0}
    ]
    assert (alarm["rule"], alarm["severity"], alarm["is_acknowledged"]) == ("near", "safety", False)
    assert alarm["reason"] == "1.50 m is below 2.00 m"
    assert (heard.fleet.passed_over, device["unreadable"]) == (0, 0)


def test_a_device_that_says_online_and_nothing_else_is_silent(heard: Heard) -> None:
    heard.online()
    heard.rule()  # a broker may have kept this for a year
    assert heard.status() == "silent"
    heard.state()
    assert heard.status() == "online"
    heard.now_s += STALE_S
    assert heard.status() == "online"
    heard.now_s += 0.1
    assert heard.status() == "silent"
    assert troubles(heard.fleet, heard.now_s)[0] == "garage: silent"


@pytest.mark.parametrize(
    ("expires_s", "age_s"), [(10, 0.0), (3, 7.0), (0, 10.0), (None, None), (11, None), (2**31, None)]
)
def test_a_kept_state_is_as_old_as_what_is_left_of_its_life_says(
    heard: Heard, expires_s: int | None, age_s: float | None
) -> None:
    assert EXPIRES_S == 10
    heard.online()
    state = {"seq": 7, "status": "tracking", "distance_m": 1.5}
    heard.say("garage/target/ball/state", state, is_retained=True, expires_s=expires_s)
    (device,) = fleet_record(heard.fleet, heard.now_s)["devices"]
    assert (device["age_s"], device["targets"][0]["age_s"]) == (age_s, age_s)
    assert heard.status() == ("silent" if age_s is None else "online")


def test_alarms_are_sorted_as_a_person_needs_them(heard: Heard) -> None:
    heard.rule(rule="kept-quiet", severity="safety", inhibits=["shelved"])
    heard.rule(rule="known", severity="safety", acknowledged=True)
    heard.rule(rule="mild", severity="warning")
    heard.rule(rule="later", severity="alarm", since="2026-06-01T12:00:01.000+00:00")
    heard.rule(rule="sooner", severity="alarm")
    heard.rule(rule="worst", severity="safety")
    heard.rule(rule="of-unknown-severity", severity="catastrophe")
    heard.rule(rule="returned", severity="info", active=False)
    heard.rule(rule="over", active=False, acknowledged=True)
    heard.rule(rule="follow", severity=None)
    heard.rule(rule="unseen", active=None, acknowledged=True)
    assert [alarm.rule for alarm in heard.fleet.standing] == [
        "of-unknown-severity", "worst", "sooner", "later", "mild", "returned", "known", "kept-quiet",
    ]  # fmt: skip
    assert heard.fleet.devices["garage"].unjudged == {"unseen"}
    serious = [line.partition(":")[0] for line in troubles(heard.fleet, heard.now_s)[1:]]
    assert serious == [f"garage/{rule}" for rule in ("of-unknown-severity", "worst", "sooner", "later", "known")]


def test_an_alarm_that_clears_or_whose_rule_is_gone_stands_no_more(heard: Heard) -> None:
    heard.online()
    for end in ({"active": False, "severity": "alarm"}, b""):
        heard.rule()
        assert len(heard.fleet.standing) == 1
        heard.say("garage/rule/near/state", end)
        assert heard.fleet.standing == []
    assert heard.fleet.devices["garage"].unreadable == 0


def test_a_device_is_forgotten_with_its_availability(heard: Heard) -> None:
    heard.online()
    heard.state()
    heard.rule()
    heard.rule(rule="unseen", active=None, acknowledged=True)
    heard.say("garage/availability", b"")
    assert heard.fleet.devices == {}
    heard.say("attic/availability", b"")
    assert heard.fleet.devices == {}


@pytest.mark.parametrize(
    "payload",
    [
        b"", b"{", b"null", b"[]", b"\xff\xfe", b'{"seq":1}', b'{"status":1}',
        b'{"seq":1,"status":"tracking","distance_m":NaN}', b'{"seq":1,"status":"tracking","distance_m":1e999}',
        b'{"seq":1,"status":"tracking","distance_m":1e300}', b'{"status":"tracking","sigma_m":"1"}',
        b'{"seq":1,"status":"tracking","x":"' + b"a" * 20_000 + b'"}',
    ],
)  # fmt: skip
def test_what_is_no_state_is_counted_and_changes_nothing(heard: Heard, payload: bytes) -> None:
    heard.online()
    heard.online("attic")
    heard.state("attic")
    before = fleet_record(heard.fleet, heard.now_s)["devices"][0]
    heard.say("garage/target/ball/state", payload)
    after = fleet_record(heard.fleet, heard.now_s)["devices"]
    assert heard.fleet.devices["garage"].unreadable == 1
    assert (heard.fleet.devices["garage"].targets, after[0]) == ({}, before)
    assert heard.status("attic") == "online"


def test_no_text_can_command_a_terminal(heard: Heard) -> None:
    evil = "\x1b[2J\u202e\x07\n" + "x" * 500
    heard.say("gar\x1bage/info", {"version": evil, "configuration_sha256": evil, "boot_id": evil})
    heard.say("gar\x1bage/target/b\x1ball/state", {"seq": 1, "status": evil})
    heard.rule("gar\x1bage", "ne\x07ar", reason=evil, since=evil, severity=evil, inhibits=[evil] * 10)
    record = fleet_record(heard.fleet, heard.now_s)
    assert len(record["devices"]) == len(record["alarms"]) == 1

    def texts(value: object) -> list[str]:
        if isinstance(value, dict):
            return [text for each in (*value, *value.values()) for text in texts(each)]
        return [text for each in value for text in texts(each)] if isinstance(value, list | tuple) else [str(value)]

    assert all(text.isprintable() and len(text) <= 300 for text in texts(record))
    assert all(line.isprintable() for line in troubles(heard.fleet, heard.now_s))


def test_there_is_room_for_so_many_and_a_device_can_fill_its_own_only(
    heard: Heard, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(devices, "MAX_DEVICES", 50)
    heard.online("garage")
    for number in range(100):
        heard.online(f"bad/{number}")
        heard.say(f"bad/0/target/ball-{number}/state", {"seq": 0, "status": "tracking"})
        heard.rule("bad/0", f"rule-{number}")
        heard.rule("bad/0", f"rule-{number + 100}", active=None, acknowledged=True)
    assert heard.fleet.devices["bad/0"].entries == devices.MAX_ENTRIES
    heard.rule("garage")
    assert [alarm for alarm in heard.fleet.standing if alarm.device == "garage"]
    assert any("messages were passed over" in line for line in troubles(heard.fleet, heard.now_s))
    assert len(heard.fleet.devices) == 50


texts = st.text(max_size=30) | st.sampled_from(["online", "offline", "garage", "near", "ball", "\x1b[2J", "\u202e"])
numbers = st.integers() | st.floats() | st.sampled_from([1e308, -0.0, 2**63])
values = st.recursive(
    st.none() | st.booleans() | numbers | texts,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=4),
    max_leaves=12,
)
keys = st.sampled_from([
    "seq", "status", "distance_m", "sigma_m", "active", "severity", "acknowledged", "inhibits", "since", "reason", "id",
    "version", "configuration_sha256", "boot_id",
])  # fmt: skip
payloads = st.binary(max_size=60) | st.dictionaries(keys, values, max_size=8).map(
    lambda each: json.dumps(each).encode()
)
endings = st.sampled_from([
    "availability", "info", "target/ball/state", "rule/near/state", "rule/near/availability", "state",
])  # fmt: skip
levels = st.lists(
    st.sampled_from(["garage", "hall", "rule", "target", "event", "state", "\x1b", "a" * 400]), max_size=4
)
topics = st.builds(lambda above, ending: "/".join([*above, ending]), levels, endings) | texts
messages = st.tuples(topics, payloads, st.booleans(), st.none() | st.integers(0, 2**32 - 1))


@pytest.mark.long
@given(st.lists(messages, max_size=60))
def test_whatever_devices_send_the_others_are_shown(sent) -> None:
    heard = Heard()
    heard.online("well")
    heard.state("well", seq=4)
    for topic, payload, is_retained, expires_s in sent:
        if not topic.startswith("well"):
            heard.say(topic, payload, is_retained=is_retained, expires_s=expires_s)
    heard.state("well", seq=5)
    record = fleet_record(heard.fleet, heard.now_s)
    json.dumps(record, allow_nan=False)
    (well,) = [each for each in record["devices"] if each["device"] == "well"]
    assert (well["status"], well["targets"][0]["distance_m"]) == ("online", 1.5)
    assert all(line.isprintable() for line in troubles(heard.fleet, heard.now_s))
