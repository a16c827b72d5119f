"""What Home Assistant discovers of a run: complete, in a form that it takes, and nothing that would not work."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jinja2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.app.discovery import announcement
from stadimeter.app.messages import Reporter
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decision import ALARM_EVENTS, Decision, EventKind, RuleStatus, RuleTrace, SafetyMode, Severity
from stadimeter.core.home_assistant import DiscoveryPlace
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.plan import LevelOutput, Plan
from stadimeter.core.rule import AlarmRule
from stadimeter.messaging.mqtt import MqttOptions
from support.each_case import each_case
from support.every_rule import ORDERS, announced, every_rule

PLACE = DiscoveryPlace(node="it", base="stadimeter/it", prefix="homeassistant")


def payload(folder: Path, orders: frozenset[str] = ORDERS) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(announced(every_rule(folder), orders=orders).message().payload)
    return found


@pytest.fixture
def message(tmp_path: Path) -> dict[str, Any]:
    return payload(tmp_path)


NAMES = st.text("abA-_0", min_size=1, max_size=6)


@pytest.mark.long
@given(targets=st.sets(NAMES, max_size=6), rules=st.sets(NAMES, max_size=6))
def test_no_two_entities_are_the_same_however_targets_and_rules_are_called(targets, rules):
    kinds = ["rule", "sigma", "in_service", "threshold", "closing_speed", "take"]
    names = {f"{kind}_{name}" for kind in kinds for name in rules} | rules
    plan = Plan(
        targets=tuple(targets),
        rules=tuple(
            AlarmRule(name=name, target="a", condition=DistanceCondition(below=1.0), ack="required", latch=True)
            for name in names
        ),
    )
    found = announcement(plan, PLACE, ORDERS)
    per_rule = 8  # state, acknowledge, reset, shelve, unshelve, in service, observed, threshold
    assert len(found.components) == 5 * len(targets) + per_rule * len(names) + 9


def test_nothing_is_offered_that_the_run_would_not_take(tmp_path):
    platforms = {each["platform"] for each in payload(tmp_path, orders=frozenset())["components"].values()}
    assert platforms == {"sensor", "binary_sensor", "event", "update"}
    some = payload(tmp_path, orders=frozenset({"request/acknowledge"}))["components"]
    assert [key for key, each in some.items() if each["platform"] == "button"] == ["acknowledge_near"]
    assert "snapshot" not in some


def test_of_a_rule_that_drives_an_output_only_what_quiets_it_is_offered_unless_outputs_may_be_let_act():
    condition = DistanceCondition(below=1.0)
    near = AlarmRule(name="near", target="a", output="motor", condition=condition, ack="required", latch=True)
    plan = Plan(targets=("a",), rules=(near,), outputs=(LevelOutput(name="motor"),))
    components = announcement(plan, PLACE, ORDERS - {"request/release-outputs"}).components
    assert {key for key in components if key.endswith("_near")} == {"rule_near", "acknowledge_near", "shelve_near"}


def test_orders_are_json_for_the_actions_that_operators_have(message):
    components = message["components"]
    assert json.loads(components["acknowledge_near"]["payload_press"]) == {"rule": "near"}
    assert json.loads(components["shelve_near"]["payload_press"]) == {"rule": "near", "for_s": 1800.0}
    assert json.loads(components["stop_outputs"]["payload_press"]) == {}
    assert components["stop_outputs"]["command_topic"] == "stadimeter/Dock-3/request/stop-outputs"
    number = components["threshold_time_to_contact.below_near"]
    sent = jinja2.Template(number["command_template"]).render(value=1.25)
    assert json.loads(sent) == {"rule": "near", "key": "time_to_contact.below", "value": 1.25}
    settings = {"thresholds": {"time_to_contact.below": {"value": 2.0}}, "in_service": True, "observed": False}
    assert jinja2.Template(number["value_template"]).render(value_json=settings) == "2.0"
    switch = components["in_service_near"]
    assert jinja2.Template(switch["value_template"]).render(value_json=settings) == "ON"
    assert json.loads(switch["payload_off"]) == {"rule": "near", "value": False}


def test_a_safety_rule_has_no_button_that_makes_it_quiet(message):
    of_it = {key for key in message["components"] if key.endswith("_too-close")}
    assert of_it == {"rule_too-close", "reset_too-close"}
    assert message["components"]["rule_too-close"]["device_class"] == "safety"


def test_every_kind_of_event_of_a_rule_is_known_beforehand(message):
    """Home Assistant logs an error for one that is not, and passes it over."""
    reporter = Reporter("boot")
    for kind in EventKind:
        found = reporter.messages(0.0, str, _decision(kind))
        if found[0].topic == "event/alarm":
            assert json.loads(found[0].payload)["event_type"] in message["components"]["alarm"]["event_types"]
        else:
            assert kind not in ALARM_EVENTS


def _decision(kind: EventKind) -> Decision:
    from stadimeter.core.decision import Event

    event = Event(kind=kind, source="near", at_s=0.0, severity=Severity.ALARM, reason="x")
    return Decision(
        commands=(), events=(event,), tracks=(), outputs=(), safety=SafetyMode.ACTIVE, safety_reason="", rules=()
    )


def shown(message: dict[str, Any], key: str, track: Track, active: bool | None = None) -> str:
    """Return what Home Assistant shows of what a run publishes."""
    component = message["components"][key]
    trace = RuleTrace(rule="near", status=RuleStatus.UNKNOWN if active is None else RuleStatus.ACTIVE, active=active)
    decision = Decision(
        commands=(), events=(), tracks=(track,), outputs=(), safety=SafetyMode.ACTIVE, safety_reason="", rules=(trace,),
        reasons={"near": "0.40 m is below 0.50 m"},
    )  # fmt: skip
    published = {f"stadimeter/Dock-3/{each.topic}": each for each in Reporter("boot").messages(0.0, str, decision)}
    value = json.loads(published[component["state_topic"]].payload)
    return jinja2.Template(component["value_template"]).render(value_json=value)


SEEN = Track(target="ball", status=TrackStatus.TRACKING, distance_m=1.5, sigma_m=0.02, closing_mps=-0.1)
GONE = Track(target="ball", status=TrackStatus.LOST, distance_m=1.5, sigma_m=0.02)


@each_case(
    ("key", "track", "active", "expected"),
    [
        ("distance_ball", SEEN, None, "1.5"),
        ("distance_ball", GONE, None, "None"),
        ("sigma_ball", SEEN, None, "0.02"),
        ("closing_speed_ball", SEEN, None, "-0.1"),
        ("closing_speed_ball", GONE, None, "None"),
        ("status_ball", GONE, None, "lost"),
        ("presence_ball", SEEN, None, "ON"),
        ("presence_ball", GONE, None, "OFF"),
        ("rule_near", SEEN, True, "ON"),
        ("rule_near", SEEN, False, "OFF"),
        ("rule_near", GONE, None, "None"),
    ],
)
def test_what_is_unknown_is_neither_a_figure_nor_off(key, track, active, expected, tmp_path):
    assert shown(payload(tmp_path), key, track, active) == expected


def test_a_rule_is_available_only_while_it_is_known_and_a_target_while_the_camera_delivers(message):
    def needs(key: str) -> list[str]:
        each = message["components"][key]
        assert each["availability_mode"] == "all"
        return [topic["topic"].removeprefix("stadimeter/Dock-3/") for topic in each["availability"]]

    assert needs("rule_near") == ["availability", "rule/near/availability"]
    assert needs("presence_ball") == ["availability", "camera/state"]


@each_case("value", ["home assistant", "/ha", "ha/#", "", "ha/"])
def test_a_prefix_that_can_be_no_topic_is_refused(value):
    with pytest.raises(ValueError, match="not a topic"):
        MqttOptions.model_validate({"discovery_prefix": value})
