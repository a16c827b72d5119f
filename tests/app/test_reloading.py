"""A changed configuration is checked first, and taken over whole or not at all."""

from copy import copy

import pytest
from msgspec.structs import force_setattr, replace

from stadimeter.app.bootstrap import build
from stadimeter.app.control.messages import Reply, parse_request
from stadimeter.app.control.reloading import Reloader, needs_restart
from stadimeter.app.control.requests import Control
from stadimeter.app.control.socket_server import Asked
from stadimeter.app.loop import Limits, Loop
from stadimeter.config.loader import load_configuration
from stadimeter.core.plan import Plan, Safety
from stadimeter.testing.rig import eventually
from support.each_case import each_case
from support.recording_doubles import RecordingMessenger
from support.simulated_run import SIMULATED_BALL

NEAR = """
[rules.near]
actuator = "motor"
when = { below = "3 m" }
on_delay = "0 s"
cooldown = "0 s"
"""
TAIL = """
[world]
path = [{ at = "0 s", x = "2 m", y = "0 m" }]
loop = false
"""
FAR = """
[rules.far]
when = { above = "1 m" }
on_delay = "0 s"
"""


class Rig:
    """A simulated run whose configuration is changed after a second."""

    def __init__(self, folder, *rules):
        self.path = folder / "run.toml"
        self.write(*rules)
        self.loop = Loop(build(load_configuration(self.path), speed=None))
        self.loop.parts.messenger = self.messenger = RecordingMessenger()
        self.reloader = Reloader(self.loop.parts.configuration)
        self.waiting, self.answers, self.decisions = [], [], []
        self.loop.services.control = Control([self.take], self.reloader)
        self.loop.listeners.append(self.listen)
        self.change = lambda: None

    def write(self, *rules, head=SIMULATED_BALL, tail=TAIL):
        self.path.write_text("".join((head, *rules, tail)))

    def take(self):
        taken, self.waiting = self.waiting, []
        return taken

    def listen(self, record, _frame):
        self.decisions.append(record.decision)
        if len(self.decisions) == 30:
            self.change()
            self.ask()
        if len(self.decisions) == 31:  # it is checked in a thread: the simulated time waits for it
            assert eventually(lambda: self.answers or self.reloader._ready)

    def ask(self):
        self.waiting.append(Asked(parse_request(b'{"op": "reload"}'), self.answers.append))

    def run(self):
        self.loop.run(Limits(frames=60))
        return self.answers[0]

    def events(self, source):
        return [
            (event.kind.value, event.reason)
            for decision in self.decisions
            for event in decision.events
            if event.source == source
        ]

    @property
    def levels(self):
        return [decision.commands[0].level for decision in self.decisions]


@pytest.fixture
def rig(tmp_path):
    return Rig(tmp_path, NEAR)


def test_a_new_rule_is_taken_over_and_the_others_go_on(rig):
    rig.change = lambda: rig.write(NEAR, FAR)
    answer = rig.run()
    assert answer.error == ""
    assert answer.data["kept"] == ("near",)
    assert answer.data["added"] == ("far",)
    assert [kind for kind, _ in rig.events("near")] == ["raised"]
    assert [kind for kind, _ in rig.events("far")] == ["raised"]
    assert set(rig.levels[10:]) == {1.0}


def test_an_alarm_whose_rule_is_removed_clears_and_its_output_goes_to_its_safe_value(rig):
    rig.change = lambda: rig.write(FAR)
    assert rig.run().data["removed"] == ("near",)
    assert rig.events("near")[1] == ("cleared", "removed from the configuration")
    assert rig.levels[-1] == 0.0
    topics = [(message.topic, message.payload, message.retain) for message in rig.messenger.messages]
    assert ("rule/near/state", "", True) in topics


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('"3 m"', '"3 metres"', "unknown unit 'metres'"),
        ('"motor"', '"moter"', "did you mean 'motor'?"),
        ("[rules.near]", "[rules.near", "this is not valid TOML"),
        ("when", "wenn", "rules.near"),
    ],
)
def test_a_bad_file_is_refused_and_the_running_one_stays(rig, old, new, expected):
    rig.change = lambda: rig.write(NEAR.replace(old, new))
    answer = rig.run()
    assert answer.error.startswith("nothing was changed:\n")
    assert expected in answer.error
    assert [kind for kind, _ in rig.events("near")] == ["raised"]
    assert set(rig.levels[10:]) == {1.0}


def test_what_needs_a_restart_is_named_and_nothing_is_changed(rig):
    rig.change = lambda: rig.write(NEAR, FAR, head=SIMULATED_BALL.replace('rate = "30 Hz"', 'rate = "25 Hz"'))
    assert rig.run().error == "nothing was changed: restart to change [camera]"
    assert rig.events("far") == []
    assert set(rig.levels[10:]) == {1.0}


@each_case(
    ("old", "new", "section"),
    [
        ("fx_px = 600.0", "fx_px = 610.0", "[camera.model]"),
        ("[targets.ball]", "[targets.cube]", "[targets]"),
        ("[actuators.motor]", '[actuators.motor]\nlease = "200 ms"', "[lease of an output]"),
        ("[actuators.motor]", '[actuators.motor]\nafter_fault = "stay_off"', "[after_fault]"),
        ("[actuators.motor]", "[actuators.motor]\nrise_per_s = 2.0", "[actuators or base]"),
        ("[targets.ball]", '[messenger]\ndriver = "simulated"\n[targets.ball]', "[messenger]"),
        ("[targets.ball]", '[base]\ndriver = "simulated"\n[targets.ball]', "[base]"),
        ('x = "2 m"', 'x = "1 m"', "[world]"),
        ("[targets.ball]", "[safety]\nliveness = false\n[targets.ball]", "[safety.liveness]"),
    ],
)
def test_each_part_that_needs_a_restart_is_known(rig, old, new, section):
    rig.path.write_text((SIMULATED_BALL + NEAR + TAIL).replace(old, new))
    assert section in needs_restart(rig.loop.parts.configuration, load_configuration(rig.path))


def test_what_a_start_builds_parts_of_is_never_reloaded_without_a_word(rig):
    """Each field of the plan and of safety is either taken over by every part, which its test shows, or refused."""
    configuration = rig.loop.parts.configuration
    plan = configuration.plan
    taken_over = {"rules", "tracking", "safety", "viewpoint", "figures", "nearest"}
    for name in set(Plan.__struct_fields__) - taken_over:
        changed = replace(configuration, plan=force(plan, name, ("another",)))
        assert needs_restart(configuration, changed), name
    for name in set(Safety.__struct_fields__) - {"max_frame_age_s", "good_frames", "arm", "watchdog_s"}:
        changed = replace(configuration, plan=replace(plan, safety=force(plan.safety, name, "another")))
        assert needs_restart(configuration, changed) == (f"[safety.{name}]",)


def force(struct, name, value):
    changed = copy(struct)
    force_setattr(changed, name, value)
    return changed


def test_two_who_ask_at_once_are_told_so(tmp_path):
    rig = Rig(tmp_path, NEAR)
    rig.reloader._is_busy = True
    rig.reloader.ask(rig.answers.append)
    assert rig.answers == [Reply(error="the configuration is being read already")]


def test_a_defect_in_a_check_leaves_the_run_as_it_is(rig, monkeypatch):
    def defect(_path):
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr("stadimeter.app.control.reloading.load_configuration", defect)
    assert "ZeroDivisionError: a defect" in rig.run().error
    assert set(rig.levels[10:]) == {1.0}
