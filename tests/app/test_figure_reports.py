"""Remembered figures reach other programs: by MQTT, in messages, in the status."""

import json

from msgspec.structs import replace

from stadimeter.app.messages import Reporter, outgoing
from stadimeter.app.persistence.resumption import read_state, state_text
from stadimeter.core.conditions.remembered import RememberedFigure, Summary, step_summary
from stadimeter.core.decide import initial_state
from stadimeter.core.decision import Decision, Event, EventKind, Notice, SafetyMode, Severity
from stadimeter.core.plan import Plan
from stadimeter.core.rule import ALWAYS, AlarmRule, EscalationStep, ReportRule, Send, Template

NEAREST = RememberedFigure(name="nearest", target="ball")
SIDE = RememberedFigure(name="side", target="ball", quantity="bearing", statistic="mean")


def decided(**fields):
    return Decision(
        commands=(), events=(), tracks=(), safety=SafetyMode.ACTIVE, safety_reason="", outputs=(), rules=(), **fields
    )


def payloads(made, rule):
    return [item.payload for _, item in outgoing(made, [rule], lambda: "2026-06-01T22:14:03", (NEAREST, SIDE))]


def test_a_figure_is_told_when_it_changes_and_every_two_seconds_at_most():
    reporter, told = Reporter("boot"), []
    for number in range(100):
        value = None if number < 10 else 2.0 - number // 10 / 10
        told += [
            (number / 10, each)
            for each in reporter.messages(number / 10, lambda: "noon", decided(figures={"nearest": value}))
        ]
    assert [(at_s, json.loads(each.payload)["value"]) for at_s, each in told] == [
        (0.0, None), (2.0, 1.8), (4.0, 1.6), (6.0, 1.4), (8.0, 1.2),
    ]  # fmt: skip
    assert {(each.topic, each.retain, each.qos) for _, each in told} == {("figure/nearest/state", True, 1)}


def test_a_figure_that_is_no_more_is_forgotten_by_the_broker():
    reporter = Reporter(boot_id="boot")
    reporter.opening([], [NEAREST])
    assert [(each.topic, each.payload) for each in reporter.reload([], [SIDE])] == [("figure/nearest/state", "")]


def test_messages_tell_figures_in_their_gaps_an_angle_in_degrees():
    texts = ("{nearest} m, {side:.1f}°", '{"nearest": "{nearest}", "side": "{side}"}')
    templates = [Template(text=texts[0]), Template(text=texts[1], is_json=True)]
    steps = tuple(EscalationStep(send=Send(template=template, topic="a")) for template in templates)
    gate = AlarmRule(name="", target="", condition=ALWAYS, escalation=steps)
    rule = ReportRule(name="report", target="ball", every_s=60.0, gate=gate)
    event = Event(kind=EventKind.REPORT, source="report", at_s=1.0, severity=Severity.INFO, reason="every 1 min")
    notices = tuple(Notice(rule="report", step=step, event=event) for step in range(2))
    made = decided(notices=notices, figures={"nearest": 1.23456, "side": 0.1})
    first, second = payloads(made, rule)
    assert first == "1.23 m, 5.7°"
    assert json.loads(second) == {"nearest": 1.235, "side": 5.73}
    unknown = decided(notices=notices, figures={"nearest": None, "side": None})
    first, second = payloads(unknown, rule)
    assert first == "unknown m, unknown°"
    assert json.loads(second) == {"nearest": None, "side": None}


def test_a_recording_that_begins_with_a_state_holds_what_is_remembered_to_the_last_bit():
    plan = Plan(targets=("ball",), figures=(NEAREST, SIDE))
    state = initial_state(plan)
    kept = tuple(step_summary(figure, Summary(), 1 / 3, 100.1, None) for figure in plan.figures)
    assert read_state(state_text(replace(state, figures=kept)), state).figures == kept
