"""The example for Home Assistant, with what a run really publishes, and templates as Jinja renders them."""

import json
import re
from pathlib import Path

import pytest

from stadimeter.app.reporting import Reporter
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decision import Decision, RuleStatus, RuleTrace, SafetyMode
from stadimeter.core.rule import AlarmRule
from stadimeter.core.track import Track, TrackStatus

jinja2 = pytest.importorskip("jinja2")
yaml = pytest.importorskip("yaml")

RULE = AlarmRule(name="too-close", target="ball", condition=DistanceCondition(below_m=0.5))
BASE = "stadimeter/garage"


@pytest.fixture
def example():
    page = (Path(__file__).parents[2] / "docs" / "mqtt.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    return yaml.safe_load(block)["mqtt"]


def published(*traces):
    """Return the newest payload of each topic after these cycles of a run."""
    reporter = Reporter(boot_id="boot")
    newest = {f"{BASE}/availability": "online"}  # the link's own; see tests/messaging/test_mqtt.py
    messages = list(reporter.opening([RULE]))
    for second, trace in enumerate(traces):
        decision = Decision(
            commands=(), events=(), tracks=(Track(target="ball", status=TrackStatus.SEARCHING),), outputs=(),
            safety=SafetyMode.ACTIVE, safety_reason="", rules=(trace,),
        )  # fmt: skip
        messages += reporter.messages(float(second), lambda: "2026-06-01T12:00:00.000+00:00", decision)
    return newest | {f"{BASE}/{each.topic}": each.payload for each in messages}


def shown(entity, newest):
    """Return what Home Assistant shows: its MQTT entities render a template, and take `None` for unknown."""
    if any(newest[each["topic"]] != "online" for each in entity["availability"]):
        return "unavailable"
    value = json.loads(newest[entity["state_topic"]])
    return jinja2.Template(entity["value_template"]).render(value_json=value)


def trace(status, active):
    return RuleTrace(rule="too-close", status=status, active=active)


UNKNOWN, IDLE = trace(RuleStatus.UNKNOWN, None), trace(RuleStatus.IDLE, False)
ACTIVE, BLIND = trace(RuleStatus.ACTIVE, True), trace(RuleStatus.UNKNOWN, True)


@pytest.mark.parametrize(
    ("traces", "expected"),
    [
        ((), "unavailable"),
        ((UNKNOWN,), "unavailable"),
        ((UNKNOWN, IDLE), "OFF"),
        ((IDLE, UNKNOWN), "unavailable"),
        ((IDLE, ACTIVE), "ON"),
        ((ACTIVE, BLIND), "ON"),
    ],
)
def test_a_rule_that_cannot_be_judged_is_neither_on_nor_off(example, traces, expected):
    (entity,) = example["binary_sensor"]
    assert entity["availability_mode"] == "all"
    assert shown(entity, published(*traces)) == expected


def test_whoever_goes_by_the_state_alone_gets_unknown_too(example):
    (entity,) = example["binary_sensor"]
    assert shown({**entity, "availability": []}, published(UNKNOWN)) == "None"


def test_every_topic_of_the_example_is_published(example):
    topics = re.findall(rf"{BASE}/[a-z/-]+", str(example))
    assert set(topics) == published(IDLE).keys()
