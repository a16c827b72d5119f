"""What is published of what operators set: one retained topic for each rule."""

from __future__ import annotations

import json
from typing import Any

from msgspec.structs import replace

from stadimeter.app.messages import Reporter
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.message import Message
from stadimeter.core.persistence import reload
from support.observing import Rehearsal
from support.two_rules import FAR, NEAR, plan_of, rehearse

NOON = "2026-06-01T12:00:00.000+00:00"


def told_settings(reporter: Reporter, run: Rehearsal, rule: str = "near") -> list[Any]:
    messages = reporter.messages(run.now_s, lambda: NOON, run.decisions[-1][1])
    found = [each for each in messages if each.topic == f"rule/{rule}/settings"]
    assert all((each.qos, each.retain) == (1, True) for each in found)
    return [json.loads(each.payload) for each in found]


def test_what_is_set_of_an_alarm_is_published_at_the_start_and_when_it_changes():
    run, reporter = rehearse(NEAR, FAR), Reporter(boot_id="boot")
    run.see(3.0)
    threshold = {"value": 1.0, "configured": 1.0, "unit": "m", "min": 0.001, "max": 1e9, "set_by": None}
    as_configured = {"v": 1, "thresholds": {"below": threshold}, "in_service": True, "observed": False}
    assert told_settings(reporter, run) == [as_configured]
    for _ in range(30):
        run.see(0.5)
        assert told_settings(reporter, run) == []
    run.tell("set-threshold", "near", by="zoe", value=0.6)
    as_set = {**as_configured, "thresholds": {"below": {**threshold, "value": 0.6, "set_by": "zoe"}}}
    assert told_settings(reporter, run) == [as_set]
    run.tell("set-threshold", "near", by="zoe", value=-1.0)
    assert told_settings(reporter, run) == []
    run.tell("observe", "near")
    assert told_settings(reporter, run) == [{**as_set, "observed": True}]
    run.tell("take-out", "near")
    assert told_settings(reporter, run) == [{**as_set, "observed": True, "in_service": False}]
    run.tell("put-back", "near")
    run.tell("act", "near")
    told_settings(reporter, run)
    run.tell("withdraw-threshold", "near")
    assert told_settings(reporter, run) == [as_configured]


def test_what_is_set_is_published_anew_when_a_reload_changes_it_and_cleared_with_its_rule():
    run, reporter = rehearse(NEAR, FAR), Reporter(boot_id="boot")
    reporter.opening(run.state.plan.rules)
    run.see(3.0)
    assert len(told_settings(reporter, run)) == 1
    changed = replace(NEAR, condition=DistanceCondition(below=0.7))
    run.state = reload(run.state, plan_of(changed, FAR)).state
    assert reporter.reload((changed, FAR)) == ()
    run.see(3.0)
    (payload,) = told_settings(reporter, run)
    assert payload["thresholds"]["below"]["value"] == 0.7
    assert Message(topic="rule/near/settings", payload="", qos=1, retain=True) in reporter.reload((FAR,))
    run.state = reload(run.state, plan_of(FAR)).state
    run.see(3.0)
    assert told_settings(reporter, run) == []
    assert "rule/far/settings" in reporter.retained
    reporter.reload((changed, FAR))
    run.state = reload(run.state, plan_of(changed, FAR)).state
    run.see(3.0)
    assert told_settings(reporter, run) == [payload]


def test_published_bounds_are_taken_although_they_are_rounded():
    band = replace(NEAR, condition=DistanceCondition(above=1.00004, below=2.00004))
    run = rehearse(band)
    run.see(3.0)
    (payload,) = told_settings(Reporter(boot_id="boot"), run)
    near, far = payload["thresholds"]["between.near"], payload["thresholds"]["between.far"]
    assert (near["max"], far["min"]) == (2.0, 1.001)
    assert run.tell("set-threshold", "near", key="between.near", value=near["max"]).accepted
    run.tell("withdraw-threshold", "near")
    assert run.tell("set-threshold", "near", key="between.far", value=far["min"]).accepted
