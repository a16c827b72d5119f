from __future__ import annotations

import json
import math
from collections.abc import Iterable
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stadimeter.app.messages import Reporter, outgoing
from stadimeter.app.persistence.resumption import read_state, state_text
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.remembered import RememberedFigure, Summary, step_summary
from stadimeter.core.decide import initial_state
from stadimeter.core.decision import Decision, Event, EventKind, Notice, RuleStatus, RuleTrace, SafetyMode, Severity
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.message import Message, is_state
from stadimeter.core.plan import Plan
from stadimeter.core.rule import ALWAYS, AlarmRule, EscalationStep, ReportRule, Rule, Send, Template
from support.each_case import each_case

NOON = "2026-06-01T12:00:00.000+00:00"
LATER = "2026-06-01T12:00:07.000+00:00"
FRAME_S = 1 / 30
FAR = DistanceCondition(above=2.0)

anything = st.none() | st.floats(allow_nan=True, allow_infinity=True)


def decision(
    tracks: Iterable[Track] = (),
    rules: Iterable[RuleTrace] = (),
    events: Iterable[Event] = (),
    reason: str = "2.00 m is not below 0.50 m",
) -> Decision:
    rules = tuple(rules)
    return Decision(
        commands=(),
        events=tuple(events),
        tracks=tuple(tracks),
        safety=SafetyMode.ACTIVE,
        safety_reason="",
        rules=rules,
        outputs=(),
        reasons={trace.rule: reason for trace in rules},
    )


def ball(
    distance_m: float | None = 2.0,
    sigma_m: float | None = 0.01,
    status: TrackStatus = TrackStatus.TRACKING,
    bearing_rad: float | None = 0.0,
) -> Track:
    return Track(
        target="ball",
        status=status,
        distance_m=distance_m,
        sigma_m=sigma_m,
        closing_mps=0.1234,
        bearing_rad=bearing_rad,
        as_of_s=0.0,
    )


def near(status: RuleStatus, *, active: bool | None = None) -> RuleTrace:
    stands = status in {RuleStatus.ACTIVE, RuleStatus.CLEARING, RuleStatus.LATCHED}
    return RuleTrace(rule="near", status=status, active=active or stands)


def happened(kind: EventKind, source: str = "near", sequence: int = 0) -> Event:
    return Event(
        kind=kind,
        source=source,
        at_s=1.0,
        severity=Severity.ALARM,
        reason="0.40 m is below 0.50 m",
        distance_m=0.40004,
        sigma_m=0.0051,
        sequence=sequence,
    )


class Listener:
    """A reporter and everything it said, frame by frame; whether rules are available is kept apart."""

    def __init__(self) -> None:
        self.reporter = Reporter(boot_id="boot")
        self.now_s = 0.0
        self.told: list[tuple[float, Message]] = []
        self.rule_messages: list[tuple[str, str]] = []

    def cycle(self, *tracks: Track, step_s: float = FRAME_S, wall_clock: str = NOON) -> list[Message]:
        return self.decided(decision(tracks), step_s=step_s, wall_clock=wall_clock)

    def decided(self, made: Decision, step_s: float = FRAME_S, wall_clock: str = NOON) -> list[Message]:
        self.now_s += step_s
        messages = self.reporter.messages(self.now_s, lambda: wall_clock, made)
        of_rules = [message for message in messages if message.topic.startswith("rule/")]
        self.rule_messages += [(message.topic.rpartition("/")[2], message.payload) for message in of_rules]
        states = [message for message in messages if not message.topic.endswith("/availability")]
        self.told += [(self.now_s, message) for message in states]
        return states

    @property
    def payloads(self) -> list[dict[str, Any]]:
        return [json.loads(message.payload) for _, message in self.told]


@pytest.mark.parametrize("status", [TrackStatus.SEARCHING, TrackStatus.LOST])
def test_a_target_that_is_not_in_sight_has_no_figures(status):
    listener = Listener()
    listener.cycle(ball(status=status))
    assert listener.payloads[0]["status"] == status.value
    assert [listener.payloads[0][key] for key in ("distance_m", "sigma_m", "closing_mps", "bearing_rad")] == [None] * 4


def test_a_change_of_status_is_told_at_once():
    listener = Listener()
    for status in (TrackStatus.SEARCHING, TrackStatus.TRACKING, TrackStatus.COASTING, TrackStatus.LOST):
        listener.cycle(ball(status=status))
    assert [payload["status"] for payload in listener.payloads] == ["searching", "tracking", "coasting", "lost"]
    assert [payload["seq"] for payload in listener.payloads] == [0, 1, 2, 3]


@each_case(
    ("moved", "is_told"),
    [
        (ball(distance_m=2.009), False),
        (ball(distance_m=2.011), True),
        (ball(distance_m=2.19, sigma_m=0.4), False),
        (ball(distance_m=2.21, sigma_m=0.4), True),
        (ball(bearing_rad=0.004), False),
        (ball(bearing_rad=0.006), True),
        (ball(distance_m=None), True),
    ],
)
def test_a_move_is_told_when_it_is_more_than_a_centimetre_and_half_a_sigma(moved, *, is_told):
    listener = Listener()
    listener.cycle(ball())
    assert bool(listener.cycle(moved, step_s=0.6)) is is_told


def test_what_was_held_back_is_told_at_the_end():
    listener = Listener()
    listener.cycle(ball(distance_m=2.0))
    listener.cycle(ball(distance_m=3.0))
    (message,) = listener.reporter.last_messages(LATER)
    assert json.loads(message.payload)["distance_m"] == 3.0
    assert listener.reporter.last_messages(LATER) == ()


@given(
    steps=st.lists(
        st.tuples(
            st.floats(0.001, 2.0),
            st.sampled_from([TrackStatus.TRACKING, TrackStatus.TRACKING, TrackStatus.TRACKING, TrackStatus.LOST]),
            st.floats(0.0, 50.0),
            st.floats(0.0, 1.0),
        ),
        max_size=60,
    )
)
def test_no_second_has_more_than_two_states_that_are_no_change_of_status(steps):
    listener = Listener()
    for step_s, status, distance_m, sigma_m in steps:
        listener.cycle(ball(distance_m, sigma_m, status), step_s=step_s)
    told = list(zip((at_s for at_s, _ in listener.told), listener.payloads, strict=True))
    unchanged_s = [at_s for (_, before), (at_s, after) in pairwise(told) if before["status"] == after["status"]]
    for first, third in zip(unchanged_s, unchanged_s[2:], strict=False):
        assert third - first >= 1.0 - 1e-9


@given(
    distances_m=st.lists(st.floats(0.1, 50.0), min_size=1, max_size=40),
    step_s=st.floats(0.01, 1.0),
    sigma_m=st.floats(0.0, 1.0),
)
def test_the_last_value_is_told_within_five_seconds_of_standing_still(distances_m, step_s, sigma_m):
    listener = Listener()
    for distance_m in distances_m:
        listener.cycle(ball(distance_m, sigma_m), step_s=step_s)
    for _ in range(math.ceil(5.0 / step_s) + 1):
        listener.cycle(ball(distances_m[-1], sigma_m), step_s=step_s)
    assert listener.payloads[-1]["distance_m"] == round(distances_m[-1], 3)


@given(
    distance_m=anything, sigma_m=anything, bearing_rad=anything, status=st.sampled_from(TrackStatus), event_m=anything
)
def test_no_payload_ever_holds_what_json_has_not(distance_m, sigma_m, bearing_rad, status, event_m):
    listener = Listener()
    event = Event(
        kind=EventKind.FAULT, source="camera", at_s=0.0, severity=Severity.WARNING, reason="x", distance_m=event_m
    )
    listener.cycle(ball(), step_s=1.0)
    listener.decided(decision([ball(distance_m, sigma_m, status, bearing_rad)], events=[event]), step_s=6.0)

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    for _, message in listener.told:
        json.loads(message.payload, parse_constant=refuse)


@each_case("kind", list(EventKind))
def test_every_kind_of_event_is_told(kind):
    (message,) = Listener().decided(decision(events=[happened(kind, source="it")]))
    payload = json.loads(message.payload)
    of_outputs = {EventKind.FAULT, EventKind.FAULT_CLEARED, EventKind.STOPPED, EventKind.RELEASED}
    of_outputs |= {EventKind.ARMED, EventKind.DISARMED, EventKind.LIVENESS_UNKNOWN}
    of_rule = kind not in of_outputs | {EventKind.TARGET_SEEN, EventKind.TARGET_LOST}
    assert message.topic == ("event/alarm" if of_rule else "event/system")
    assert payload["event_type"] == kind.value
    assert payload["rule" if of_rule else "source"] == "it"
    assert (message.qos, message.retain) == (1, False)


def test_a_rule_is_told_when_it_changes_and_not_when_only_its_figures_do():
    listener = Listener()
    for number in range(100):
        figures = f"{2 + number / 100:.2f} m is not below 0.50 m"
        listener.decided(decision(rules=[near(RuleStatus.IDLE)], reason=figures))
    raised = decision(rules=[near(RuleStatus.ACTIVE)], events=[happened(EventKind.RAISED)])
    event, state = listener.decided(raised, wall_clock=LATER)
    assert len(listener.told) == 3
    assert event.topic == "event/alarm"
    assert (state.topic, state.qos, state.retain, state.expires_s) == ("rule/near/state", 1, True, None)
    told = listener.payloads[-1]
    assert (told["active"], told["status"], told["ts"], told["since"]) == (True, "active", LATER, LATER)


def test_an_alarm_that_lost_its_target_stands_and_says_that_it_is_blind():
    listener = Listener()
    listener.decided(decision(rules=[near(RuleStatus.ACTIVE)], events=[happened(EventKind.RAISED)]))
    listener.decided(
        decision(rules=[near(RuleStatus.UNKNOWN, active=True)], events=[happened(EventKind.MEASUREMENT_LOST)])
    )
    assert (listener.payloads[-1]["active"], listener.payloads[-1]["data_lost"]) == (True, True)
    listener.decided(decision(rules=[near(RuleStatus.ACTIVE)], events=[happened(EventKind.MEASUREMENT_BACK)]))
    assert (listener.payloads[-1]["active"], listener.payloads[-1]["data_lost"]) == (True, False)
    listener.decided(decision(rules=[near(RuleStatus.IDLE)], events=[happened(EventKind.CLEARED)]))
    assert listener.payloads[-1]["active"] is False


@pytest.mark.parametrize(
    "change",
    [
        {"acknowledged": False},
        {"inhibits": ("shelved",)},
        {"first_out": True},
        {"chattering": True},
        {"status": RuleStatus.LATCHED},
    ],
)
def test_what_somebody_may_have_to_act_on_is_told_at_once(change):
    listener = Listener()
    trace = near(RuleStatus.ACTIVE)
    listener.decided(decision(rules=[trace], events=[happened(EventKind.RAISED)]))
    assert len(listener.decided(decision(rules=[replace(trace, **change)]))) == 1
    (key,) = change
    expected = {"status": "latched"}.get(key, list(change[key]) if key == "inhibits" else change[key])
    told = listener.payloads[-1]
    assert (told[key], told["active"], told["latched"]) == (expected, True, key == "status")


def test_a_rule_that_cannot_be_judged_is_neither_active_nor_not():
    listener = Listener()
    for active in (None, False):  # False where it treats a target that is lost as one that is far away
        listener.decided(decision(rules=[replace(near(RuleStatus.UNKNOWN), active=active)]), step_s=1.0)
        assert (listener.payloads[-1]["active"], listener.payloads[-1]["status"]) == (None, "unknown")


def test_a_rule_is_unavailable_before_its_state_is_unknown_and_available_after_it_is_known():
    listener = Listener()
    unknown, idle = replace(near(RuleStatus.UNKNOWN), active=None), near(RuleStatus.IDLE)
    for trace in (unknown, idle, near(RuleStatus.PENDING), unknown, near(RuleStatus.ACTIVE)):
        listener.decided(decision(rules=[trace]), step_s=1.0)
    seen = [
        payload if what == "availability" else json.loads(payload)["active"] for what, payload in listener.rule_messages
    ]
    assert seen == ["offline", None, False, "online", False, "offline", None, True, "online"]


def test_a_target_on_the_edge_of_sight_makes_its_rule_flicker_twice_a_second_at_most():
    listener = Listener()
    for other in (replace(near(RuleStatus.UNKNOWN), active=None), near(RuleStatus.PENDING)):
        before = len(listener.told)
        for frame in range(300):
            listener.decided(decision(rules=[other if frame % 2 else near(RuleStatus.IDLE)]))
        assert len(listener.told) - before <= 21


def test_no_rule_is_available_before_the_first_cycle_of_a_run():
    rules = [AlarmRule(name="near", target="ball", condition=FAR), Rule(name="follow", target="ball")]
    messages = Reporter(boot_id="boot").opening(rules)
    assert [(each.topic, each.payload, each.qos, each.retain) for each in messages] == [
        ("rule/near/availability", "offline", 1, True),
        ("rule/follow/availability", "offline", 1, True),
    ]


def test_an_event_names_the_newest_clip_of_its_rule_or_source():
    listener = Listener()
    listener.reporter.clips = {"near": "a.mcap", "camera": "b.mcap"}
    events = [
        happened(EventKind.RAISED),
        happened(EventKind.FAULT, source="camera"),
        happened(EventKind.RAISED, source="far"),
    ]
    clips = [json.loads(each.payload)["clip"] for each in listener.decided(decision(events=events))]
    assert clips == ["a.mcap", "b.mcap", None]


def test_a_rule_says_its_severity_and_says_it_again_when_a_reload_changes_only_that():
    def rules(severity: Severity) -> tuple[AlarmRule | Rule, ...]:
        return AlarmRule(name="near", target="ball", condition=FAR, severity=severity), Rule(name="go", target="ball")

    listener = Listener()
    quiet = decision(rules=[near(RuleStatus.IDLE), RuleTrace(rule="go", status=RuleStatus.IDLE, active=False)])
    listener.reporter.opening(rules(Severity.WARNING))
    assert [payload["severity"] for payload in map(read, listener.decided(quiet))] == ["warning", None]
    assert listener.decided(quiet, step_s=1.0) == []
    listener.reporter.reload(rules(Severity.SAFETY))
    (state,) = listener.decided(quiet, step_s=1.0)
    assert (state.topic, read(state)["severity"]) == ("rule/near/state", "safety")
    assert listener.decided(quiet, step_s=1.0) == []


@each_case("topic", ["information/door", "camera-alarm", "my/info"])
def test_a_message_of_one_s_own_is_no_state_whatever_its_topic_begins_with(topic):
    assert not is_state(Message(topic=topic, payload="x", qos=1))


def read(message: Message) -> dict[str, Any]:
    payload: dict[str, Any] = json.loads(message.payload)
    return payload


def sending(name: str, topic: str, *, retain: bool) -> AlarmRule:
    step = EscalationStep(send=Send(template=Template(text="x"), topic=topic, retain=retain))
    return AlarmRule(name=name, target="ball", condition=FAR, escalation=(step,))


def test_what_a_changed_configuration_publishes_no_more_is_forgotten_by_the_broker_and_told_anew_when_it_is_back():
    reporter = Reporter(boot_id="boot")
    reporter.opening([sending("near", "door/alert", retain=True), sending("far", "door/gone", retain=False)])
    told, _ = reporter.messages(0.0, lambda: NOON, decision(rules=[near(RuleStatus.IDLE)]))
    forgotten = reporter.reload([sending("far", "door/gone", retain=False)])
    assert [(each.topic, each.payload, each.retain) for each in forgotten] == [
        ("door/alert", "", True),
        ("rule/near/availability", "offline", False),
        ("rule/near/availability", "", True),
        ("rule/near/settings", "", True),
        (told.topic, "", True),
    ]
    assert reporter.messages(1.0, lambda: NOON, decision(rules=[])) == ()
    back, available = reporter.messages(2.0, lambda: NOON, decision(rules=[near(RuleStatus.IDLE)]))
    assert (back.topic, available.payload) == (told.topic, "online")


def test_distances_of_an_unconfirmed_mounting_are_marked_at_once_and_the_mark_goes_at_once():
    reporter = Reporter(boot_id="1")
    marks = [
        [
            json.loads(each.payload).get("mounting")
            for each in reporter.messages(at_s, lambda: NOON, decision([ball()]), mark)
        ]
        for at_s, mark in ((0.0, ""), (0.1, "unconfirmed"), (0.2, "unconfirmed"), (0.3, ""))
    ]
    assert marks == [[None], ["unconfirmed"], [], [None]]


# Remembered figures reach other programs: by MQTT, in messages, in the status.


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
