"""What was not delivered: kept for the next run, sent by it, or counted; never lost without a word."""

import json
from functools import partial

import pytest
from msgspec.structs import replace

from stadimeter.app.bootstrap import build
from stadimeter.app.deliveries import MESSENGER, Deliveries, in_words
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.persistence.alarm_store import AlarmStore
from stadimeter.app.persistence.resumption import moment
from stadimeter.app.persistence.state_writer import StateWriter
from stadimeter.config.loader import load_configuration
from stadimeter.core.decision import Severity
from stadimeter.core.message import Message, Notification
from support.simulated_run import SIMULATED_BALL

RAISED = Message(topic="event/alarm", payload='{"id":"a-1"}', qos=1)
NOTE = Notification(title="near", body="0.41 m", time="2026-06-01T22:14:03+02:00")

BACK_AND_FORTH = """
[messenger]
driver = "simulated"

[notifiers.phone]
driver = "simulated"

[rules.near]
when = { below = "2 m" }
on_delay = "0 s"
escalation = [{ notify = "phone", text = "{distance_m}" }, { topic = "door", text = "{event}" }]

[world]
path = [
    { at = "0 s", x = "3 m", y = "0 m" },
    { at = "2 s", x = "1 m", y = "0 m" },
    { at = "4 s", x = "3 m", y = "0 m" },
]
"""


def says(message):
    """Return topic and payload of a message, without the word that it is history."""
    return message.topic, message.payload.replace(',"replayed":true', "")


class Run:
    """A simulated run whose broker and notification service may be away."""

    def __init__(self, folder, *, is_gone, keeps=True, messenger=True):
        text = SIMULATED_BALL + BACK_AND_FORTH
        path = folder / "run.toml"
        for part in (
            () if messenger else ('[messenger]\ndriver = "simulated"\n', ', { topic = "door", text = "{event}" }')
        ):
            text = text.replace(part, "")
        path.write_text(text)
        self.loop = Loop(build(load_configuration(path), speed=None))
        self.messenger, self.phone = self.loop.parts.messenger, self.loop.parts.notifiers["phone"]
        self.set_gone(is_gone)
        if keeps:
            store = AlarmStore(folder / "run.sqlite3")
            self.loop.services.memory = StateWriter(store, partial(moment, "stepped"), self.loop.deliveries)

    def set_gone(self, is_gone):
        if self.messenger is not None:
            self.messenger._world.faults.broker_gone = is_gone
        self.phone.is_gone = is_gone

    def for_s(self, seconds):
        self.loop.run(Limits(seconds=seconds))
        return self

    def sent(self):
        """Return the messages that must not be lost, and the notifications, as they arrived."""
        messages = [each.item for each in self.messenger.sent if each.item.topic in {"event/alarm", "door"}]
        return messages, [each.item for each in self.phone.sent]


def test_what_a_run_could_not_deliver_is_sent_by_the_next_with_its_own_time_and_before_all_else(tmp_path):
    first = Run(tmp_path, is_gone=True).for_s(6)
    (words,) = first.loop.troubles
    assert words.startswith("not delivered yet, the next run sends them: ")
    assert "messages, 1 notification for phone (the simulated broker is gone; " in words
    left = [item for name, item in first.loop.deliveries.undelivered() if name == MESSENGER]
    notes = [item for name, item in first.loop.deliveries.undelivered() if name]
    assert any(each.topic == "rule/near/state" for each in first.messenger.undelivered())
    assert not any(each.topic.startswith("rule/") for each in left), "each run says states of rules anew"

    second = Run(tmp_path, is_gone=False).for_s(0.5)
    assert second.loop.troubles == []
    every = [
        each.item
        for each in second.messenger.sent
        if not each.item.topic.endswith(("/availability", "camera/state", "info"))
    ]
    assert [says(each) for each in every[: len(left)]] == [says(each) for each in left]  # the same ids and times
    events = [each for each in every if each.topic.startswith("event/")]
    told = [json.loads(each.payload).get("replayed") for each in events]
    assert told == [True] * told.count(True) + [None] * (len(events) - told.count(True)), "history first, then news"
    assert 0 < told.count(True) < len(events)
    assert [note.body for note in second.sent()[1][: len(notes)]] == [f"{note.body}\n({note.time})" for note in notes]

    third = Run(tmp_path, is_gone=False).for_s(0.5)
    assert not {str(says(each)) for each in left} & {str(says(each.item)) for each in third.messenger.sent}


def test_a_run_without_a_state_file_counts_what_it_loses(tmp_path):
    run = Run(tmp_path, is_gone=True, keeps=False).for_s(6)
    messages = len([each for each in run.loop.deliveries.undelivered() if each[0] == MESSENGER])
    (words,) = run.loop.troubles
    assert words.startswith(f"given up: {messages} messages, 1 notification for phone (")


def test_what_nobody_carries_any_more_is_given_up_and_counted(tmp_path):
    Run(tmp_path, is_gone=True).for_s(6)
    run = Run(tmp_path, is_gone=False, messenger=False).for_s(0.5)
    (words,) = run.loop.troubles
    assert words.startswith("given up: ")
    assert words.endswith(" messages")
    assert run.loop.deliveries.figures()[-1]["to"] == "messenger"


def test_what_was_given_up_is_told_over_mqtt_when_the_broker_is_back(tmp_path):
    run = Run(tmp_path, is_gone=True)

    def comes_back(record, _frame):
        if record.observation.now_s >= 1.0:
            run.set_gone(is_gone=False)

    run.messenger.given_up = 7
    run.loop.listeners.append(comes_back)
    run.for_s(2)
    events = [json.loads(each.item.payload) for each in run.messenger.sent if each.item.topic == "event/system"]
    (told,) = [event for event in events if event["event_type"] == "given_up"]
    assert (told["source"], told["reason"]) == ("messenger", "messages given up since the start: 7")
    assert run.loop.deliveries.figures() == [
        {"to": "messenger", "waiting": 0, "given_up": 7},
        {"to": "phone", "waiting": 0, "given_up": 0},
    ]
    assert run.loop.troubles == ["given up: 7 messages"]


def test_a_notification_that_says_its_time_is_sent_again_as_it_was(tmp_path):
    run = Run(tmp_path, is_gone=False)
    run.phone.open()
    says_so = Notification(title="near", body=f"at {NOTE.time}", time=NOTE.time)
    run.loop.deliveries.send_again([("phone", NOTE), ("phone", says_so)], now_s=0.0, shift_s=0.0)
    assert [note.body for note in run.sent()[1]] == [f"0.41 m\n({NOTE.time})", says_so.body]


class Fallback:
    """A run whose buzzer sounds, by a rule, while an alarm is undelivered; its broker comes and goes."""

    def __init__(self, folder, *, gone_s, back_s, severity="warning"):
        rules = BACK_AND_FORTH.replace('on_delay = "0 s"', f'on_delay = "0 s"\nseverity = "{severity}"')
        path = folder / "run.toml"
        path.write_text(SIMULATED_BALL + FALLBACK + rules)
        self.loop = Loop(build(load_configuration(path), speed=None))
        self.buzzing, self.raised_s = [], []
        self._away = gone_s, back_s
        self.loop.listeners.append(self)

    def __call__(self, record, _frame):
        now_s = record.observation.now_s
        gone_s, back_s = self._away
        self.loop.parts.messenger._world.faults.broker_gone = gone_s <= now_s < back_s
        (level,) = [command.level for command in record.decision.commands if command.output == "buzzer"]
        if level:
            self.buzzing.append(now_s)
        self.raised_s += [now_s for event in record.decision.events if (event.source, event.kind) == ("near", "raised")]

    def for_s(self, seconds):
        self.loop.run(Limits(seconds=seconds))
        return self


FALLBACK = """
[actuators.buzzer]
driver = "simulated"

[rules.unheard]
when = { undelivered_for = "5 s" }
actuator = "buzzer"
off_delay = "0 s"
"""


def test_a_buzzer_sounds_within_6_s_of_an_alarm_without_a_broker_until_all_is_delivered(tmp_path):
    run = Fallback(tmp_path, gone_s=1.0, back_s=12.0).for_s(15)
    raised_s = run.raised_s[0]
    assert raised_s + 5.0 <= run.buzzing[0] <= raised_s + 6.0
    assert 12.0 <= run.buzzing[-1] <= 13.0
    assert len(run.buzzing) >= 0.9 * 30 * (run.buzzing[-1] - run.buzzing[0]), "without a break"
    events = [json.loads(each.item.payload) for each in run.loop.parts.messenger.sent if "event/" in each.item.topic]
    told = {event["reason"]: event for event in events if event.get("rule") == "unheard"}
    assert [event["event_type"] for event in told.values()] == ["raised", "cleared"]


@pytest.mark.parametrize(("back_s", "severity"), [(5.0, "alarm"), (12.0, "info")])
def test_no_buzzer_sounds_while_alarms_arrive_in_time_or_for_what_is_no_alarm(tmp_path, back_s, severity):
    assert not Fallback(tmp_path, gone_s=0.0, back_s=back_s, severity=severity).for_s(11.9).buzzing


DAY_S = 86_400.0


@pytest.mark.parametrize(("severity", "days", "is_sent"), [("alarm", 6.9, 1), ("alarm", 7.1, 0), ("safety", 7.1, 1)])
def test_after_a_week_only_what_is_about_safety_is_still_sent(tmp_path, severity, days, is_sent):
    run = Run(tmp_path, is_gone=False)
    run.messenger.open()
    old = replace(RAISED, severity=Severity(severity), at_s=1000.0)
    run.loop.deliveries.send_again([(MESSENGER, old)], now_s=5.0, shift_s=5.0 - days * DAY_S - 1000.0)
    assert [json.loads(each.payload) for each in run.sent()[0]] == [{"id": "a-1", "replayed": True}] * is_sent
    assert run.loop.deliveries.given_up() == ({} if is_sent else {MESSENGER: 1})


@pytest.mark.parametrize("message", [RAISED, Message(topic="#", payload="", qos=1)])
def test_what_cannot_be_sent_again_is_given_up_and_counted(tmp_path, message):
    deliveries = Deliveries(Run(tmp_path, is_gone=False).loop.parts)
    deliveries.send_again(
        [(MESSENGER, message), ("telephone", NOTE)], now_s=0.0, shift_s=0.0
    )  # the messenger is not open
    assert deliveries.given_up() == {MESSENGER: 1, "telephone": 1}
    assert in_words(deliveries.given_up()) == "1 message, 1 notification for telephone"
