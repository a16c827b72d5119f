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
    text = text.replace("expect.motor = {}", "expect.motor = { level_at = { at = '1 s', level = 0 } }")
    (test,) = load(text).tests
    assert test.name == "hover"
    assert text.splitlines()[test.line - 1] == "[[tests]]"
    assert test.input.hover is not None
    assert (test.input.hover.at, test.input.hover.duration) == (0.5, 60.0)
    assert list(test.expect) == ["near", "motor"]
    assert test.expect["near"].transitions_max == 2


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
        '{ at = "3 s", do = "acknowledge", rule = "near" }, { at = "5 s", do = "take-out", rule = "near" }]'
    )
    (test,) = load(sound + text).tests
    assert test.input.clock == 22.5 * 3600
    assert [(order.do, order.rule) for order in test.input.operator] == [
        (OperatorAction.ACKNOWLEDGE, "near"),
        (OperatorAction.TAKE_OUT, "near"),
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


HOVERS = 'hover = { at = "1 m", for = "5 s" }'
# What is expected of the rules of a test in which the ball hovers.
WRONG_EXPECTATIONS = [
    ("neer = { raised = 1 }", "neer: there is no rule and no output 'neer' (did you mean 'near'?)"),
    ("near = { raisd = 1 }", "near.raisd: unknown key 'raisd' (did you mean 'raised'?)"),
    ("buzzer = { raised = 1 }", "buzzer.raised: 'raised' cannot be expected of 'buzzer'"),
    ('motor = { speed_max = "1 m/s" }', "motor.speed_max: 'speed_max' cannot be expected of 'motor'"),
    ("buzzer = {}", "buzzer: nothing is expected; write such as { raised = 1 }"),
    ('near = { raised_by = "-1 s" }', "near.raised_by: '-1 s' is below zero"),
    ('motor = { level_at = { at = "1 s" } }', "motor.level_at: which level? Add level, or min and max"),
]
# What is wrong in the input of a test.
WRONG_INPUTS = [
    ('hovr = { at = "1 m", for = "1 s" }', ".hovr: unknown key 'hovr' (did you mean 'hover'?)"),
    ("targets = {}", ": no target moves, or one does not; write such as targets.NAME = { … }"),
    (f'targets.ball = {{ {HOVERS} }}, lost = [{{ from = "1 s", for = "1 s" }}]', ": 'lost' does not go with 'targets'"),
    ("seed = 3", ": the test does not say what happens; known are: hover, approach, recede, skip, points, journal"),
    (f'{HOVERS}, skip = {{ from = "3 m", to = "1 m" }}', ": a target cannot hover and skip at once"),
    ('approach = { from = "1 m", to = "4 m", speed = "1 m/s" }', ": from 1 m to 4 m is not nearer"),
    ('approach = { from = "4 m", to = "1 m", speed = "0 m/s" }', ".approach.speed: '0 m/s' is not above 0"),
    ('hover = { at = 1, for = "1 s" }', ".hover.at: 1 has no unit; write it with one, such as '35 cm'"),
    ('points = [{ at = "0 s", distance = "1 m" }, { at = "2 s", distance = "1 m" }, { at = "1 s", distance = "1 m" }]',
     ": points begin at '0 s', are in order,"),
    ('points = [{ at = "1 s", distance = "1 m" }, { at = "2 s", distance = "1 m" }]',
     ": points begin at '0 s', are in order,"),
    ('points = [{ at = "0 s", distance = "1 m" }]', ": points begin at '0 s', are in order, and end later;"),
    (f'{HOVERS}, target = "bal"', ".target: there is no target 'bal' (did you mean 'ball'?)"),
    ('hover = { at = "1 m", for = "1000 h" }', ": 3.6e+06 s are more than 1,000,000 frames"),
    (f'journal = "run.jsonl", {HOVERS}', ": a recording has its own 'hover': take it out, or the journal"),
    (f'{HOVERS}, noise = "a bit"', ".noise: 'a bit' is neither 'model' nor 'none', nor a factor from 0 to 100"),
    (f"{HOVERS}, dropouts = 1.0", ".dropouts: 1.0 is not below 1"),
    (f'{HOVERS}, operator = [{{ at = "1 s", do = "reset", rule = "nar" }}]',
     ".operator.0.rule: there is no rule 'nar'"),
    (f'{HOVERS}, operator = [{{ at = "1 s" }}]', ".operator.0.do: 'do' is missing"),
]  # fmt: skip
WRONG = [
    *((expecting(text), f"tests.0.expect.{words}") for text, words in WRONG_EXPECTATIONS),
    *((given(text), f"tests.0.input{words}") for text, words in WRONG_INPUTS),
    (a_test(f"{HOVER}expect = {{}}\n"), "tests.0.expect: a table is"),
    (a_test(HOVER), "tests.0.expect: 'expect' is missing"),
    (a_test("expect.near = { raised = 0 }\n"), "tests.0.input: 'input' is missing"),
    (f'{RULES}[tests]\nname = "one"\n', "tests: 'tests' is not a list of tables (write it as [[tests]])"),
]


@pytest.mark.long
def test_what_is_wrong_with_a_test_is_said(told: Told, sound: str, subtests: pytest.Subtests) -> None:
    for text, words in WRONG:
        with subtests.test(words=words):
            (line,) = told(sound + text)
            assert line.startswith(words)


def test_what_is_wrong_with_one_test_is_said_at_its_line_and_hides_nothing_of_another(
    problems_of: Problems, sound: str
) -> None:
    text = sound + given('hover = { at = 1, for = "1 s" }') + f"[[tests]]\n{HOVER}expect.neer = {{ raised = 1 }}\n"
    first, second = problems_of(text)
    assert [first.key, second.key] == ["tests.0.input.hover.at", "tests.1.expect.neer"]
    assert text.splitlines()[second.line - 1] == "expect.neer = { raised = 1 }"


def test_with_several_targets_a_test_says_which_one_moves(told: Told, sound: str) -> None:
    tag = '[targets.tag]\ndetector = "tag"\nside = "5 cm"\n'
    text = given('hover = { at = "1 m", for = "1 s" }')
    text = text.replace("[rules.far]", '[rules.far]\ntarget = "ball"').replace(
        "[rules.near]", '[rules.near]\ntarget = "tag"'
    )
    (message,) = told(sound + tag + text)
    assert message.startswith("tests.0.input.target: which of the targets ball, tag moves? (add target")
