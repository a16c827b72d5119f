"""What people ask of a running loop: answered between two cycles, and by what was decided then."""

from types import SimpleNamespace

import pytest
from msgspec.structs import replace

from stadimeter.app.control import requests
from stadimeter.app.control.messages import Reply, parse_request
from stadimeter.app.control.requests import REMEMBERED_S, Control
from stadimeter.app.control.socket_server import Asked
from stadimeter.app.cycle import CycleRecord
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decision import SafetyMode
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import LevelOutput, Plan, Safety, Tracking
from stadimeter.core.rule import AlarmRule
from support.observing import Rehearsal, measured

NEAR = AlarmRule(
    name="near",
    target="ball",
    output="buzzer",
    condition=DistanceCondition(below=1.0),
    off_delay_s=0.4,
    ack="required",
    latch=True,
)
PLAN = Plan(
    targets=("ball",),
    rules=(NEAR, replace(NEAR, name="nearer", output=None, condition=DistanceCondition(below=0.4))),
    outputs=(LevelOutput(name="buzzer"),),
    tracking=Tracking(confirm_frames=1, outliers_max=0, acceleration_mps2=20.0, autocorrelation=0.0),
    safety=Safety(good_frames=1),
)


class NoReload:
    """Counts who asks for it."""

    def __init__(self):
        self.asked = []

    def ask(self, answer):
        self.asked.append(answer)

    def take(self):
        return None


class Desk:
    """A loop that people talk to."""

    def __init__(self):
        self.waiting = []
        self.answers = []
        self.unix_s = 1e9
        self.reloader = NoReload()
        self.is_kept = True
        self.control = Control([self.take], self.reloader, lambda: self.unix_s, is_kept=lambda: self.is_kept)
        self.run = Rehearsal(PLAN)

    def take(self):
        taken, self.waiting = self.waiting, []
        return taken

    def ask(self, line):
        self.waiting.append(Asked(parse_request(line.encode()), self.answers.append))

    def cycle(self, distance_m=3.0, seconds=0.1):
        now_s = self.run.now_s = round(self.run.now_s + seconds, 9)
        self.unix_s += seconds
        frame = FrameStamp(sequence=len(self.run.decisions), captured_at_s=now_s)
        seen = (measured("ball", now_s, distance_m),)
        told = self.control.operator_commands()
        observation = Observation(now_s=now_s, frame=frame, measurements=seen, operator_commands=told)
        decision = self.run.cycle(observation)
        self.control.answer_requests(CycleRecord(observation=observation, applied=(), timings_s={}, decision=decision))

    def reply(self):
        answer = self.answers.pop(0)
        return answer if isinstance(answer, Reply) else answer()

    def said(self, line):
        """Ask, turn once, and return the answer."""
        self.ask(line)
        self.cycle(self.distance_m)
        return self.reply()

    distance_m = 3.0


@pytest.fixture
def desk():
    return Desk()


def test_who_may_not_let_outputs_act_may_quiet_a_rule_that_drives_one_and_order_what_only_sends(desk):
    desk.reloader.running = SimpleNamespace(plan=PLAN)

    def told(line):
        desk.waiting.append(Asked(parse_request(line.encode()), desk.answers.append, may_let_act=False))
        desk.cycle(0.6)
        return desk.reply().error

    assert told('{"op": "shelve", "args": {"rule": "near"}}') == ""
    refusal = 'unshelve could let an output act, by near: over MQTT that needs commands = "all" in [messenger]'
    assert told('{"op": "unshelve", "args": {"rule": "near"}}') == refusal
    assert told('{"op": "unshelve"}') == refusal
    assert "near" in told('{"op": "set-threshold", "args": {"rule": "near", "value": "100 m"}}')
    assert told('{"op": "set-threshold", "args": {"rule": "nearer", "value": "50 cm"}}') == ""
    assert "there is no alarm 'nobody'" in told('{"op": "unshelve", "args": {"rule": "nobody"}}')
    assert told('{"op": "stop-outputs"}') == ""


def test_an_alarm_is_acknowledged_and_reset_and_each_time_the_answer_says_so(desk):
    for _ in range(3):
        desk.cycle(0.6)
    answer = desk.said('{"op": "ack", "args": {"rule": "near", "by": "Zoë", "why": "seen"}}')
    assert answer.error == ""
    assert "near" in answer.data["words"]
    for _ in range(8):
        desk.cycle(3.0)
    assert desk.said('{"op": "reset", "args": {"rule": "near", "by": "Zoë"}}').error == ""
    kinds = desk.run.events("near")
    assert kinds == ["raised", "acknowledged", "reset", "cleared"]
    (event,) = [e for _, d in desk.run.decisions for e in d.events if e.kind == "acknowledged"]
    assert (event.by, event.reason) == ("Zoë", "by Zoë: seen")


def test_what_cannot_be_done_is_refused_in_words(desk):
    desk.cycle()
    assert desk.said('{"op": "ack", "args": {"rule": "near"}}').error != ""
    assert "nera" in desk.said('{"op": "ack", "args": {"rule": "nera"}}').error


def test_the_status_tells_what_every_rule_does_and_why(desk):
    for _ in range(3):
        desk.cycle(0.6)
    desk.distance_m = 0.6
    status = desk.said('{"op": "status"}').data
    near, nearer = status["rules"]
    assert (near["rule"], near["status"], near["acknowledged"]) == ("near", "active", False)
    assert nearer["status"] == "idle"
    assert "0.60" in near["reason"]
    assert status["targets"] == [{"target": "ball", "status": "tracking", "distance_m": pytest.approx(0.6, abs=0.01)}]
    assert status["outputs"][0]["winner"] == "near"


def test_a_rule_is_explained_as_it_was_a_moment_ago(desk):
    for _ in range(10):
        desk.cycle(0.6)
    for _ in range(50):
        desk.cycle(3.0)
    desk.ask(f'{{"op": "explain", "args": {{"rule": "near", "at_unix_s": {desk.unix_s - 5.2}}}}}')
    desk.cycle(3.0)
    explained = desk.reply().data
    assert explained["ago_s"] == pytest.approx(5.3, abs=0.11)
    assert explained["rules"][0]["status"] == "active"


def test_what_is_too_long_ago_or_still_to_come_is_not_explained(desk):
    for _ in range(20):
        desk.cycle(seconds=5.0)
    assert len(desk.control._past) <= REMEMBERED_S / 5 + 1
    error = desk.said(f'{{"op": "explain", "args": {{"at_unix_s": {desk.unix_s - 90}}}}}').error
    assert "only the last 55 s are remembered" in error
    assert "still to come" in desk.said(f'{{"op": "explain", "args": {{"at_unix_s": {desk.unix_s + 90}}}}}').error


def test_a_signal_asks_for_the_configuration_to_be_read_before_the_next_cycle(desk):
    said = []
    desk.control.reload(said.append)
    assert desk.reloader.asked == []
    desk.cycle()
    (answer,) = desk.reloader.asked
    answer(Reply(error="nothing was changed: it is wrong"))
    answer(Reply({"kept": ["a", "b"], "changed": ["c"], "added": [], "removed": [], "warnings": []}))
    assert said == ["nothing was changed: it is wrong", "the configuration was reloaded: 2 rules kept; changed: c"]


def test_a_stop_is_answered_once_it_is_in_the_file_so_that_a_kill_after_the_answer_changes_nothing(desk):
    desk.is_kept = False
    desk.ask('{"op": "stop-outputs", "args": {"by": "Zoë"}}')
    desk.cycle()
    desk.cycle()
    assert desk.run.decisions[-1][1].safety is SafetyMode.STOPPED
    assert desk.answers == []
    desk.is_kept = True
    desk.cycle()
    assert desk.reply().data["words"].startswith("the outputs are stopped until released")


def test_a_stop_that_the_disk_does_not_take_is_answered_after_a_second_and_says_so(desk, monkeypatch):
    monkeypatch.setattr(requests, "KEPT_WITHIN_S", 0.0)
    desk.is_kept = False
    assert desk.said('{"op": "stop-outputs", "args": {}}').data["words"].endswith(requests.NOT_YET_KEPT)
    assert requests.NOT_YET_KEPT not in desk.said('{"op": "release-outputs", "args": {}}').data["words"]
