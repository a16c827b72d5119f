"""The tests of a configuration are read with it, and what is wrong with them is said beside its line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from stadimeter.config.loader import Configuration
from stadimeter.config.rule_test_tables import SpanTable
from stadimeter.errors import Problem
from stadimeter.operator_actions import OperatorAction

Load = Callable[[str], Configuration]
Problems = Callable[[str], tuple[Problem, ...]]
Told = Callable[[str], list[str]]

RULES = """
[rules.far]
actuator = "motor"
ramp = { from = "1 m", to = "2 m" }
[rules.near]
actuator = "buzzer"
when = { below = "50 cm" }
"""
HOVER = 'input = { hover = { at = "50 cm", for = "60 s" } }\n'


def a_test(text: str) -> str:
    return f"{RULES}\n[[tests]]\n{text}"


def expecting(text: str) -> str:
    return a_test(f"{HOVER}expect.{text}\n")


def given(text: str) -> str:
    return a_test(f"input = {{ {text} }}\nexpect.near = {{ raised = 0 }}\n")


def test_a_test_has_a_name_an_input_and_expectations(load: Load, sound: str) -> None:
    text = sound + a_test(f'name = "hover"\n{HOVER}expect.near = {{ transitions_max = 2 }}\nexpect.motor = {{}}\n')
    text = text.replace("expect.motor = {}", "expect.motor = { level_max = 0 }")
    (test,) = load(text).tests
    assert test.name == "hover"
    assert text.splitlines()[test.line - 1] == "[[tests]]"
    assert test.input.hover is not None
    assert (test.input.hover.at, test.input.hover.duration) == (0.5, 60.0)
    assert list(test.expect) == ["near", "motor"]
    assert test.expect["near"].transitions_max == 2


def test_a_test_without_a_name_is_called_by_its_number(load: Load, sound: str) -> None:
    text = sound + expecting("near = { raised = 0 }") + f"[[tests]]\n{HOVER}expect.near = {{ raised = 0 }}\n"
    assert [test.name for test in load(text).tests] == ["test 1", "test 2"]


def test_moments_are_one_or_several_and_may_be_stretches(load: Load, sound: str) -> None:
    (test,) = load(
        sound
        + expecting('near = { active_at = "3 s", inactive_at = ["4 s", { from = "5 s", for = "1 min" }] }').replace(
            '"60 s"', '"120 s"'
        )
    ).tests
    assert test.expect["near"].active_at == [3.0]
    moment, span = test.expect["near"].inactive_at or ()
    assert moment == 4.0
    assert isinstance(span, SpanTable)
    assert (span.start, span.end_s) == (5.0, 65.0)


def test_noise_is_that_of_the_camera_none_or_a_factor(load: Load, sound: str) -> None:
    def noise(value: str) -> float:
        text = given(f'hover = {{ at = "1 m", for = "1 s" }}, noise = {value}')
        return load(sound + text).tests[0].input.noise

    assert [noise('"model"'), noise('"none"'), noise("2.5")] == [1.0, 0.0, 2.5]


def test_what_people_do_and_the_time_of_day_are_read(load: Load, sound: str) -> None:
    text = given(
        'hover = { at = "1 m", for = "20 s" }, clock = "22:30", day = "sun", operator = ['
        '{ at = "3 s", acknowledge = "near", by = "anna" }, { at = "5 s", take_out = "near" }]'
    )
    (test,) = load(sound + text).tests
    assert test.input.clock == 22.5 * 3600
    assert [order.orders() for order in test.input.operator] == [
        ((OperatorAction.ACKNOWLEDGE, "near"),),
        ((OperatorAction.TAKE_OUT, "near"),),
    ]


def test_several_targets_move_each_for_itself(load: Load, sound: str) -> None:
    tag = '[targets.tag]\ndetector = "tag"\nside = "5 cm"\n'
    text = (
        a_test(
            'input.targets.ball = { hover = { at = "1 m", for = "2 s" } }\n'
            'input.targets.tag = { hover = { at = "2 m", for = "5 s" } }\n'
            "expect.near = { raised = 0 }\n"
        )
        .replace("[rules.far]", '[rules.far]\ntarget = "ball"')
        .replace("[rules.near]", '[rules.near]\ntarget = "tag"')
    )
    (test,) = load(sound + tag + text).tests
    assert list(test.input.motions(("ball", "tag"))) == ["ball", "tag"]
    assert test.input.moving_s == 5.0


def test_a_recording_is_looked_for_beside_the_configuration(load: Load, sound: str, tmp_path: Path) -> None:
    (tmp_path / "run.jsonl").touch()
    loaded = load(sound + a_test('input = { journal = "run.jsonl" }\nexpect.near = { raised = 1 }\n'))
    assert loaded.tests[0].input.journal == tmp_path / "run.jsonl"
    assert not [warning for warning in loaded.warnings if "recording" in warning.message]


def test_a_missing_recording_is_a_warning_so_that_the_configuration_can_still_be_run(load: Load, sound: str) -> None:
    text = sound + a_test('input = { journal = "run.jsonl" }\nexpect.near = { raised = 1 }\n')
    (warning,) = (each for each in load(text).warnings if each.key.startswith("tests"))
    assert "there is no recording" in warning.message
    assert text.splitlines()[warning.line - 1].startswith("input")


WRONG = {
    "an unknown rule": (
        expecting("neer = { raised = 1 }"),
        "tests.0.expect.neer: there is no rule and no output 'neer' (did you mean 'near'?)",
    ),
    "an unknown key": (
        expecting("near = { raisd = 1 }"),
        "tests.0.expect.near.raisd: unknown key 'raisd' (did you mean 'raised'?)",
    ),
    "a rule's key of an output": (
        expecting("buzzer = { raised = 1 }"),
        (
            "tests.0.expect.buzzer.raised: 'raised' cannot be expected of 'buzzer' (of 'buzzer' these can be expected: "
            "level_at, level_max, level_reaches, stopped_at, acts_at)"
        ),
    ),
    "a base's key of an actuator": (
        expecting('motor = { speed_max = "1 m/s" }'),
        (
            "tests.0.expect.motor.speed_max: 'speed_max' cannot be expected of 'motor' (of 'motor' these "
            "can be expected: level_at, level_max, level_reaches, stopped_at, acts_at)"
        ),
    ),
    "an empty expectation": (
        expecting("buzzer = {}"),
        (
            "tests.0.expect.buzzer: nothing is expected of 'buzzer' (known are: level_at, level_max, level_reaches, "
            "stopped_at, acts_at)"
        ),
    ),
    "a time after the end": (
        expecting('near = { active_at = "61 s" }'),
        "tests.0.expect.near.active_at: 61 s is after the end of the test at 60 s (let the test last longer)",
    ),
    "a negative time": (
        expecting('near = { raised_by = "-1 s" }'),
        "tests.0.expect.near.raised_by: '-1 s' is below zero",
    ),
    "never and when": (
        expecting('near = { raised = 0, raised_by = "1 s" }'),
        "tests.0.expect.near.raised_by: 'raised = 0' expects that it never happens, and this says when",
    ),
    "by before after": (
        expecting('near = { raised_by = "1 s", raised_after = "2 s" }'),
        "tests.0.expect.near.raised_by: nothing is raised by 1 s and not before 2 s",
    ),
    "a crossing of a ramp": (
        expecting('far = { raised_within = "1 s" }'),
        (
            "tests.0.expect.far.raised_within: 'far' has no limit on the distance alone, so there is no moment at "
            "which it is crossed (write raised_by with a time from the start of the test)"
        ),
    ),
    "a level without a level": (
        expecting('motor = { level_at = { at = "1 s" } }'),
        "tests.0.expect.motor.level_at: which level? Add level, or min and max",
    ),
    "expecting nothing": (
        a_test(f"{HOVER}expect = {{}}\n"),
        "tests.0.expect: the test expects nothing (add expect.RULE = { raised = 1 })",
    ),
    "a misspelt motion": (
        given('hovr = { at = "1 m", for = "1 s" }'),
        "tests.0.input.hovr: unknown key 'hovr' (did you mean 'hover'?)",
    ),
    "no target at all": (
        given("targets = {}"),
        "tests.0.input.targets: no target moves (add one, such as targets.NAME = { … })",
    ),
    "a loss beside the targets": (
        given('targets.ball = { hover = { at = "1 m", for = "5 s" } }, lost = [{ from = "1 s", for = "1 s" }]'),
        "tests.0.input.lost: 'lost' does not go with 'targets' (put it inside one of them, or out)",
    ),
    "no expectation": (a_test(HOVER), "tests.0.expect: 'expect' is missing"),
    "no input": (a_test("expect.near = { raised = 0 }\n"), "tests.0.input: 'input' is missing"),
    "an input that says nothing": (
        given("seed = 3"),
        (
            "tests.0.input: the test does not say what happens; known are: hover, approach, recede, skip, points, "
            'journal (add one, such as hover = { at = "50 cm", for = "60 s" })'
        ),
    ),
    "two motions": (
        given('hover = { at = "1 m", for = "1 s" }, skip = { from = "3 m", to = "1 m" }'),
        "tests.0.input.skip: a target cannot hover and skip at once (use points for both)",
    ),
    "an approach that goes away": (
        given('approach = { from = "1 m", to = "4 m", speed = "1 m/s" }'),
        "tests.0.input.approach: from 1 m to 4 m is not nearer (swap the two, or write recede)",
    ),
    "a speed of zero": (
        given('approach = { from = "4 m", to = "1 m", speed = "0 m/s" }'),
        "tests.0.input.approach.speed: '0 m/s' is not above 0",
    ),
    "a distance without a unit": (
        given('hover = { at = 1, for = "1 s" }'),
        "tests.0.input.hover.at: 1 has no unit; write it with one, such as '35 cm'",
    ),
    "points out of order": (
        given(
            'points = [{ at = "0 s", distance = "1 m" }, { at = "2 s", distance = "1 m" }, '
            '{ at = "1 s", distance = "1 m" }]'
        ),
        "tests.0.input.points.2.at: the point at 1 s follows one at 2 s; order them by time",
    ),
    "points that begin late": (
        given('points = [{ at = "1 s", distance = "1 m" }, { at = "2 s", distance = "1 m" }]'),
        "tests.0.input.points.0.at: the points begin at 1 s; the first must be at '0 s'",
    ),
    "a single point": (
        given('points = [{ at = "0 s", distance = "1 m" }]'),
        "tests.0.input.points: a single point takes no time (add where the target is later, or use hover)",
    ),
    "an unknown target": (
        given('hover = { at = "1 m", for = "1 s" }, target = "bal"'),
        "tests.0.input.target: there is no target 'bal' (did you mean 'ball'?)",
    ),
    "a test without end": (
        given('hover = { at = "1 m", for = "1000 h" }'),
        "tests.0.input: 3.6e+06 s are more than 1,000,000 frames, the most that a test may have (make it shorter)",
    ),
    "a recording and a motion": (
        given('journal = "run.jsonl", hover = { at = "1 m", for = "1 s" }'),
        "tests.0.input.hover: a recording has its own 'hover' (take it out, or the journal)",
    ),
    "noise in words": (
        given('hover = { at = "1 m", for = "1 s" }, noise = "a bit"'),
        "tests.0.input.noise: 'a bit' is neither 'model' nor 'none', nor a factor from 0 to 100",
    ),
    "all frames missing": (
        given('hover = { at = "1 m", for = "1 s" }, dropouts = 1.0'),
        "tests.0.input.dropouts: 1.0 is not below 1",
    ),
    "an order to nobody": (
        given('hover = { at = "1 m", for = "5 s" }, operator = [{ at = "1 s", reset = "nar" }]'),
        "tests.0.input.operator.0.reset: there is no rule 'nar' (did you mean 'near'?)",
    ),
    "no order": (
        given('hover = { at = "1 m", for = "5 s" }, operator = [{ at = "1 s" }]'),
        (
            "tests.0.input.operator.0: the entry does not say what is done "
            '(write it such as { at = "3 s", acknowledge = "near" })'
        ),
    ),
    "a crossing in a recording": (
        a_test('input = { journal = "run.jsonl" }\nexpect.near = { raised_within = "1 s" }\n'),
        (
            "tests.0.expect.near.raised_within: where the target truly was, a recording does not know "
            "(write raised_by with a time from the start of the test)"
        ),
    ),
    "a table in place of a list": (
        RULES + '[tests]\nname = "one"\n',
        "tests: 'tests' is not a list of tables (write it as [[tests]])",
    ),
}


@pytest.mark.long
def test_what_is_wrong_with_a_test_is_said(told: Told, sound: str, subtests: pytest.Subtests) -> None:
    for what, (text, message) in WRONG.items():
        with subtests.test(what=what):
            assert told(sound + text) == [message]


def test_it_is_said_beside_its_line(problems_of: Problems, sound: str) -> None:
    text = sound + expecting("near = { raised = 1 }") + f"[[tests]]\n{HOVER}expect.neer = {{ raised = 1 }}\n"
    (problem,) = problems_of(text)
    assert text.splitlines()[problem.line - 1] == "expect.neer = { raised = 1 }"


def test_what_is_wrong_with_one_test_hides_nothing_of_another(problems_of: Problems, sound: str) -> None:
    text = sound + given('hover = { at = 1, for = "1 s" }') + f"[[tests]]\n{HOVER}expect.neer = {{ raised = 1 }}\n"
    assert [problem.key for problem in problems_of(text)] == ["tests.0.input.hover.at", "tests.1.expect.neer"]


def test_two_tests_cannot_have_one_name(told: Told, sound: str) -> None:
    one = f'name = "hover"\n{HOVER}expect.near = {{ raised = 0 }}\n'
    (message,) = told(sound + a_test(one) + "[[tests]]\n" + one)
    assert message == "tests.1.name: two tests are called 'hover' (give each a name of its own)"


def test_with_several_targets_a_test_says_which_one_moves(told: Told, sound: str) -> None:
    tag = '[targets.tag]\ndetector = "tag"\nside = "5 cm"\n'
    text = given('hover = { at = "1 m", for = "1 s" }')
    text = text.replace("[rules.far]", '[rules.far]\ntarget = "ball"').replace(
        "[rules.near]", '[rules.near]\ntarget = "tag"'
    )
    (message,) = told(sound + tag + text)
    assert message.startswith("tests.0.input.target: which of the targets ball, tag moves? (add target")
