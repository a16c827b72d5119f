"""The tables of alarms, ramps, patterns and sequences become what the core knows; what is wrong is said plainly."""

from __future__ import annotations

from pathlib import Path

import pytest

from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.conditions.compounds import AnyOf, Not
from stadimeter.core.conditions.of_rules import RuleCondition
from stadimeter.core.plan import BaseOutput, LevelOutput
from stadimeter.core.rule import AlarmRule, EscalationStep, Pattern, RampRule, Send, Template
from stadimeter.errors import ConfigError, Problem
from support.simulated_run import LENS

PARTS = f"""
[camera]
driver = "simulated"
render = false
{LENS}
[targets.ball]
detector = "ideal"
[targets.cup]
detector = "ideal"
[actuators.buzzer]
driver = "simulated"
[actuators.motor]
driver = "simulated"
combine = "max"
[base]
driver = "simulated"
[messenger]
driver = "simulated"
[notifiers.phone]
driver = "simulated"
[world]
"""


def load(tmp_path: Path, rules: str) -> Configuration:
    path = tmp_path / "run.toml"
    path.write_text(PARTS + rules)
    return load_configuration(path)


def alarm(tmp_path: Path, keys: str, name: str = "near") -> AlarmRule:
    table = f'[rules.near]\ntarget = "ball"\nactuator = "buzzer"\nwhen = {{ below = "1 m" }}\n{keys}\n'
    rules = {rule.name: rule for rule in load(tmp_path, table).plan.rules}
    found = rules[name]
    assert isinstance(found, AlarmRule)
    return found


def problem(tmp_path: Path, keys: str) -> Problem:
    with pytest.raises(ConfigError) as raised:
        alarm(tmp_path, keys)
    (only,) = raised.value.problems
    return only


def ramp(tmp_path: Path, keys: str) -> RampRule:
    (found,) = load(tmp_path, f'[rules.far]\ntarget = "ball"\nactuator = "motor"\nramp = {{ {keys} }}\n').plan.rules
    assert isinstance(found, RampRule)
    return found


def test_every_key_of_an_alarms_life_reaches_the_core(tmp_path: Path) -> None:
    found = alarm(
        tmp_path,
        'latch = true\nack = "required"\nrealarm = "5 min"\ncooldown = "30 s"\nshelve_max = "2 h"\ngroup = "door"\n'
        "observe = true\nsuppress_when = { seen = true }",
    )
    assert (found.latch, found.ack, found.observe, found.group) == (True, "required", True, "door")
    assert (found.realarm_s, found.cooldown_s, found.shelve_max_s) == (300.0, 30.0, 7200.0)
    assert found.suppress_when is not None


def test_without_a_word_about_it_an_alarm_is_as_the_core_has_it(tmp_path: Path) -> None:
    found = alarm(tmp_path, "")
    plain = AlarmRule(name="", target="", condition=found.condition)
    for key in ("latch", "ack", "realarm_s", "cooldown_s", "shelve_max_s", "group", "suppress_when", "escalation"):
        assert getattr(found, key) == getattr(plain, key), key


def test_a_safety_rule_has_no_cooldown_and_cannot_be_shelved(tmp_path: Path) -> None:
    found = alarm(tmp_path, 'severity = "safety"')
    assert (found.cooldown_s, found.shelve_max_s) == (0.0, 0.0)


def test_a_pattern_is_one_level_on_and_off_or_steps_with_levels_of_their_own(tmp_path: Path) -> None:
    found = alarm(tmp_path, 'level = 0.6\npattern = { on = "0.2 s", off = "300 ms", times = 3 }')
    assert found.pattern == Pattern(steps=((0.6, 0.2), (0.0, 0.3)), times=3)
    found = alarm(tmp_path, 'pattern = { steps = [ { level = 1.0, for = "0.2 s" }, { level = 0.3, for = "1 s" } ] }')
    assert found.pattern == Pattern(steps=((1.0, 0.2), (0.3, 1.0)), times=0)


WRONG_ALARMS = [
    ('pattern = { on = "0.2 s" }', "a pattern has on and off"),
    ('pattern = { on = "0.2 s", off = "1 s", steps = [ { level = 1, for = "1 s" } ] }', "has no 'on'"),
    ('pattern = { on = "10 ms", off = "1 s" }', "10 ms is too short for a step of a pattern"),
    ('pattern = { steps = [ { level = 2, for = "1 s" } ] }', "2 is above 1"),
    ('pattern = { steps = [] }', "fewer than 1"),
    ('pattern = { on = "1 s", off = "1 s", times = -1 }', "-1 is below 0"),
    ('ack = "yes"', "'yes' is not one of: required, none"),
    ('targets = []', "fewer than 1"),
]  # fmt: skip


def test_what_is_wrong_with_an_alarm_is_said_with_its_line(tmp_path: Path, subtests: pytest.Subtests) -> None:
    for keys, words in WRONG_ALARMS:
        with subtests.test(keys=keys, words=words):
            found = problem(tmp_path, keys)
            assert words in found.message
            assert found.line == PARTS.count("\n") + 5
            assert found.key.startswith(f"rules.near.{keys.partition(' ')[0]}")


def test_a_sequence_does_one_thing_after_the_other(tmp_path: Path) -> None:
    found = alarm(
        tmp_path,
        """
[[rules.near.escalation]]
after = "5 s"
only_unacknowledged = true
notify = "phone"
title = "{rule}!"
text = "{target} is {distance_ft:.1f} ft away"
[[rules.near.escalation]]
topic = "door/alert"
json = { distance = "{distance_m}", rule = "{rule}", tags = ["a", 1] }
retain = true
[[rules.near.escalation]]
after = "1 min"
actuator = "motor"
level = 0.5
pattern = { on = "1 s", off = "1 s" }
[[rules.near.escalation]]
on = "cleared"
actuator = "motor"
for = "2 s"
""",
    )
    phone = Send(template=Template(text="{target} is {distance_ft:.1f} ft away"), notifier="phone", title="{rule}!")
    message = Send(
        template=Template(text='{"distance": "{distance_m}", "rule": "{rule}", "tags": ["a", 1]}', is_json=True),
        topic="door/alert",
        retain=True,
    )
    assert found.escalation == (
        EscalationStep(after_s=5.0, only_unacknowledged=True, send=phone),
        EscalationStep(send=message),
        EscalationStep(after_s=60.0, output="motor", level=0.5, pattern=Pattern(steps=((0.5, 1.0), (0.0, 1.0)))),
        EscalationStep(on="cleared", output="motor", for_s=2.0),
    )


def test_a_notification_without_words_says_what_happened_and_why(tmp_path: Path) -> None:
    found = alarm(tmp_path, '[[rules.near.escalation]]\nnotify = "phone"')
    send = found.escalation[0].send
    assert send == Send(template=Template(text="{reason}"), notifier="phone", title="{rule}: {event}")


WRONG_STEPS = [
    ("", "this step does nothing"),
    ('notify = "phone"\ntopic = "a"', "has notify and topic; a step has exactly one of"),
    ('topic = "a"', "exactly one of text and json"),
    ('topic = "a"\ntext = "x"\njson = {}', "exactly one of text and json"),
    ('topic = "a"\ntext = "x"\ntitle = "y"', "'title' has no meaning beside topic"),
    ('actuator = "motor"\ntext = "x"', "'text' has no meaning beside actuator"),
    ('notify = "phone"\nfor = "1 s"', "'for' has no meaning beside notify"),
    ('on = "cleared"\nactuator = "motor"', "needs an end"),
    ('topic = "a/#"\ntext = "x"', "is not a topic"),
    ('topic = "door/{rule}"\ntext = "x"', "is not a topic"),
    ('topic = "rule/near/state"\ntext = "x"', "the program's own"),
    ('topic = "a"\ntext = "{distence_m}"', "did you mean 'distance_m'?"),
    ('topic = "a"\njson = "{distance_m}"', "json is a table or a list"),
    ('topic = "a"\njson = { at = 2026-06-01 }', "put it in quotes"),
    ('topic = "a"\njson = { x = nan }', "JSON has no such value"),
    ('notify = "phone"\ntext = "{rule.__class__}"', "write {rule}"),
    ('notify = "phone"\ntext = "{rule:>1000000000}"', "cannot be written so"),
    ('notify = "phone"\ntitle = "{nope}"', "there is no field 'nope'"),
    ('notify = "phone"\ntext = ""', "shorter than 1"),
    ('on = "raised up"\nnotify = "phone"', "not one of: raised, cleared"),
    ('afer = "1 s"\nnotify = "phone"', "unknown key 'afer'"),
]


@pytest.mark.long
def test_what_is_wrong_with_a_step_is_said_with_its_line(tmp_path: Path, subtests: pytest.Subtests) -> None:
    for step, words in WRONG_STEPS:
        with subtests.test(step=step, words=words):
            found = problem(tmp_path, f"[[rules.near.escalation]]\n{step}")
            assert words in f"{found.message} {found.hint}"
            first = PARTS.count("\n") + 5
            assert first <= found.line <= first + 3
            assert found.key.startswith("rules.near.escalation.0")


def test_a_wrong_step_does_not_hide_what_is_wrong_elsewhere_in_the_rule(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as raised:
        alarm(
            tmp_path,
            'group = 5\n[[rules.near.escalation]]\ntopic = "a"\ntext = "{nope}"\n[rules.far]\ntarget = "nobody"',
        )
    keys = [found.key for found in raised.value.problems]
    assert {"rules.near.group", "rules.near.escalation.0.text", "rules.far.target"} <= set(keys)


def test_a_condition_on_a_family_of_alarms_is_one_on_any_of_them(tmp_path: Path) -> None:
    rules = load(
        tmp_path,
        '[rules.near]\ntargets = ["ball", "cup"]\nwhen = { below = "1 m" }\n'
        '[rules.alone]\ntarget = "ball"\nwhen = { lost = true }\nsuppress_when = { not = { rule = "near" } }\n'
        '[rules.one]\ntarget = "ball"\nactuator = "buzzer"\nwhen = { rule = "near:cup" }\n',
    ).plan.rules
    alone, one = rules[2], rules[3]
    assert isinstance(alone, AlarmRule)
    assert isinstance(one, AlarmRule)
    members = AnyOf(conditions=(RuleCondition(rule="near:ball"), RuleCondition(rule="near:cup")))
    assert alone.suppress_when == Not(condition=members)
    assert one.condition == RuleCondition(rule="near:cup")


def test_outputs_may_combine_what_equals_want(tmp_path: Path) -> None:
    outputs = {output.name: output for output in load(tmp_path, "").plan.outputs}
    motor, base, buzzer = outputs["motor"], outputs["base"], outputs["buzzer"]
    assert isinstance(motor, LevelOutput)
    assert isinstance(base, BaseOutput)
    assert (motor.combine, base.combine, buzzer.combine) == ("max", "most_restrictive", "max")


def test_a_table_of_points_reaches_the_core_with_the_nearest_first(tmp_path: Path) -> None:
    keys = 'points = [ { at = "3 m", level = 0.2 }, { at = "1 m", level = 1 } ], dead_zone = 0.1, of = "depth"'
    found = ramp(tmp_path, keys)
    assert found.points == ((1.0, 1.0), (3.0, 0.2))
    assert (found.start, found.full, found.dead_zone, found.quantity) == (3.0, 1.0, 0.1, "depth")


WRONG_RAMPS = [
    ('from = "1 m"', "'to' is missing; a ramp has from and to, or points"),
    ('points = [ { at = "1 m", level = 1 }, { at = "2 m", level = 0 } ], from = "1 m"', "has no 'from'"),
    ('points = [ { at = "1 m", level = 1 }, { at = "2 m", level = 0 } ], gamma = 2', "has no 'gamma'"),
    ('points = [ { at = "1 m", level = 1 } ]', "fewer than 2"),
    ('points = [ { at = "1 m", level = 1 }, { at = "1 m", level = 0 } ]', "not in order"),
    ('points = [ { at = "1 m", level = 1 }, { at = "3 m", level = 0 }, { at = "2 m", level = 0 } ]', "not in order"),
    ('points = [ { at = "1 m", level = 1 }, { at = "2 m", level = 7 } ]', "7 is above 1"),
    ('from = "1 m", to = "2 m", dead_zone = 2', "2 is above 1"),
]


def test_what_is_wrong_with_a_ramp_is_said(tmp_path: Path, subtests: pytest.Subtests) -> None:
    for keys, words in WRONG_RAMPS:
        with subtests.test(keys=keys, words=words):
            with pytest.raises(ConfigError) as raised:
                ramp(tmp_path, keys)
            (found,) = raised.value.problems
            assert words in found.message
            assert found.line == PARTS.count("\n") + 4


def test_a_rule_whose_condition_says_what_it_is_about_need_not_name_a_target(tmp_path: Path) -> None:
    (rule,) = load(tmp_path, '[rules.cold]\nwhen = { below = "1 m", target = "cup" }\n').plan.rules
    assert rule.target == "cup"
    (rule,) = load(tmp_path, "[rules.two]\nwhen = { count = { at_least = 2 } }\n").plan.rules
    assert rule.target == "ball"


def test_a_rule_with_a_part_that_names_no_target_must_name_one(tmp_path: Path) -> None:
    rules = '[rules.near]\nwhen = { any = [{ below = "1 m", target = "cup" }, { lost = true }] }\n'
    with pytest.raises(ConfigError, match="which of the targets ball, cup is 'near' about"):
        load(tmp_path, rules)
