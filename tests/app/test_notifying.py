"""What rules send: filled in, and handed to those who carry it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from stadimeter.app.bootstrap import build
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.messages import outgoing
from stadimeter.config.loader import load_configuration
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decision import Decision, Event, EventKind, Notice, SafetyMode, Severity
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import Track, TrackStatus
from stadimeter.core.message import Message, Notification
from stadimeter.core.rule import AlarmRule, EscalationStep, Send, Template
from stadimeter.errors import DriverError
from stadimeter.messaging.apprise_notifier import AppriseNotifier, AppriseOptions
from stadimeter.testing.rig import eventually
from support.simulated_run import SIMULATED_BALL
from support.webhook_listener import HOST, WebhookListener

TIME = "2026-06-01T22:14:03+02:00"


def alarm(*sends: Send | None) -> AlarmRule:
    return AlarmRule(
        name="near",
        target="ball",
        condition=DistanceCondition(below=0.5),
        escalation=tuple(EscalationStep(send=send) for send in sends),
    )


def decision(*steps: int, reason: str = "0.41 m is below 0.50 m", rule: str = "near") -> Decision:
    event = Event(kind=EventKind.RAISED, source=rule, at_s=1.0, severity=Severity.ALARM, reason=reason)
    return Decision(
        commands=(),
        events=(event,),
        tracks=(
            Track(target="cup", status=TrackStatus.TRACKING, distance_m=9.0),
            Track(target="ball", status=TrackStatus.TRACKING, distance_m=0.41),
        ),
        safety=SafetyMode.ACTIVE,
        safety_reason="",
        outputs=(),
        rules=(),
        notices=tuple(Notice(rule=rule, step=step, event=event) for step in steps),
    )


def to_phone(text: str, title: str = "") -> Send:
    return Send(template=Template(text=text), notifier="phone", title=title)


def sent(rule: AlarmRule, made: Decision) -> tuple[tuple[Message, ...], tuple[tuple[str, Notification], ...]]:
    items = [*outgoing(made, [rule], lambda: TIME)]
    messages = tuple(item for _, item in items if isinstance(item, Message))
    return messages, tuple((name, item) for name, item in items if isinstance(item, Notification))


def test_a_notification_tells_of_the_rules_own_target():
    _, notifications = sent(alarm(to_phone("{target}: {distance_m} m", "{rule} at {time_of_day}")), decision(0))
    note = Notification(title="near at 22:14:03", body="ball: 0.41 m", severity=Severity.ALARM, time=TIME, at_s=1.0)
    assert notifications == (("phone", note),)


def test_a_message_goes_to_its_topic_at_least_once():
    template = Template(text='{"d": "{distance_m}", "why": "{reason}"}', is_json=True)
    messages, _ = sent(alarm(None, Send(template=template, topic="door/alert", retain=True)), decision(1))
    (message,) = messages
    assert (message.topic, message.qos, message.retain) == ("door/alert", 1, True)
    assert json.loads(message.payload) == {"d": 0.41, "why": "0.41 m is below 0.50 m"}


def test_a_title_is_one_short_line_and_a_text_is_never_empty():
    rule = alarm(to_phone("{by}", "{reason}"))
    _, ((_, note),) = sent(rule, decision(0, reason="a\nb\t" + "c" * 500))
    assert note.title.startswith("a b ccc")
    assert len(note.title) == 120
    assert note.body == note.title


RUN = (
    SIMULATED_BALL
    + """
[messenger]
driver = "simulated"
[notifiers.phone]
driver = "{driver}"
{url}
[rules.near]
actuator = "motor"
severity = "alarm"
when = {{ below = "1 m" }}
[[rules.near.escalation]]
notify = "phone"
title = "{{rule}} {{event}}"
text = "{{target}} is {{distance_ft:.1f}} ft away"
[[rules.near.escalation]]
after = "1 s"
topic = "door/alert"
json = {{ distance = "{{distance_m:.1f}}" }}
[[rules.near.escalation]]
after = "1 min"
notify = "phone"
text = "too late to be told"
[[rules.near.escalation]]
on = "cleared"
notify = "phone"
text = "gone"
[world]
path = [
  {{ at = "0 s", x = "2 m", y = "0 m" }}, {{ at = "1 s", x = "0.7 m", y = "0 m" }},
  {{ at = "4 s", x = "0.7 m", y = "0 m" }}, {{ at = "5 s", x = "2 m", y = "0 m" }},
]
loop = false
"""
)


def run(tmp_path: Path, driver: str = "simulated", url: str = "") -> Loop:
    path = tmp_path / "run.toml"
    path.write_text(RUN.format(driver=driver, url=url))
    return Loop(build(load_configuration(path), speed=None))


def test_a_run_tells_people_and_programs_when_it_is_due(tmp_path):
    loop = run(tmp_path)
    loop.run(Limits(seconds=8))
    phone = loop.parts.notifiers["phone"]
    told = [(each.item.title, each.item.body) for each in phone.sent]  # type: ignore[attr-defined]
    assert [title for title, _ in told] == ["near raised", "near: cleared"]
    assert told[0][1].endswith(" ft away")
    assert told[1][1] == "gone"
    messenger = loop.parts.messenger
    alerts = [each for each in messenger.sent if each.item.topic == "door/alert"]  # type: ignore[union-attr]
    assert [each.item.payload for each in alerts] == ['{"distance":0.7}']
    assert alerts[0].at_s - phone.sent[0].at_s == pytest.approx(1.0, abs=0.05)  # type: ignore[attr-defined]
    assert "door/alert" in [message.topic for _, message in loop.deliveries.published]
    assert not loop.troubles


def test_a_notifier_that_cannot_work_is_told_before_anything_moves(tmp_path):
    loop = run(tmp_path, "apprise", 'url_file = "nowhere.txt"')
    with pytest.raises(DriverError, match=r"phone: the file with its address, .*nowhere.txt, cannot be read"):
        loop.run(Limits(seconds=1))
    assert loop.history.frames == 0


@pytest.fixture
def service() -> Iterator[WebhookListener]:
    pytest.importorskip("apprise")
    with WebhookListener() as listener:
        yield listener


def test_a_service_that_refuses_is_said_while_running(tmp_path, service):
    service.status = 403
    loop = run(tmp_path)
    options = AppriseOptions(url=f"json://{HOST}:{service.port}/hook")
    loop.parts.notifiers = {"phone": AppriseNotifier(options, "phone")}
    said: list[str] = []

    def listen(record: CycleRecord, _frame: Frame | None) -> None:
        if record.observation.now_s >= 3.0 and not said:
            said.append(eventually(loop.trouble))

    loop.listeners.append(listen)
    loop.run(Limits(seconds=4))
    assert "the notifier 'phone': " in said[0]
    assert "403" in said[0]


def test_a_message_names_the_clip_of_its_alarm_and_says_where_there_is_none():
    rule, clips = alarm(to_phone("see {clip}")), ({"near": "a.mcap"}, {"far": "b.mcap"})
    found = [item for each in clips for _, item in outgoing(decision(0), [rule], lambda: TIME, (), each)]
    assert [item.body for item in found if isinstance(item, Notification)] == ["see a.mcap", "see unknown"]
