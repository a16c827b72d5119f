"""A key that was renamed goes on to work under its old name, and says what it is called now."""

from __future__ import annotations

from collections.abc import Callable

from stadimeter.config.loader import Configuration
from stadimeter.core.rule import AlarmRule
from stadimeter.errors import Problem

Load = Callable[[str], Configuration]
Problems = Callable[[str], tuple[Problem, ...]]

RULE = """\
[messenger]
driver = "simulated"
[rules.near]
actuator = "motor"
when = { below = "1 m" }
[[rules.near.KEY]]
after = "5 s"
topic = "note"
text = "see http://me:secret@host/x"
"""
OLD, NEW = RULE.replace("KEY", "then"), RULE.replace("KEY", "escalation")


def renamed(configuration: Configuration) -> list[tuple[str, int, str]]:
    warnings = (each for each in configuration.warnings if each.code == "renamed-key")
    return [(each.key, each.line, each.message) for each in warnings]


def test_the_old_name_means_the_same_with_a_warning_at_its_line(load: Load, sound: str) -> None:
    old, new = load(sound + OLD), load(sound + NEW)
    line = sound.count("\n") + 6
    assert old.plan == new.plan
    assert isinstance(old.plan.rules[0], AlarmRule)
    assert len(old.plan.rules[0].escalation) == 1
    assert renamed(old) == [("rules.near.then", line, "'then' is now called 'escalation'")]
    assert renamed(new) == []


def test_an_error_below_an_old_name_still_has_its_line(problems_of: Problems, sound: str) -> None:
    text = sound + OLD.replace("after =", "aftre =")
    (problem,) = problems_of(text)
    assert problem.key == "rules.near.escalation.0.aftre"
    assert problem.line == text[: text.index("aftre")].count("\n") + 1


def test_secrets_below_an_old_name_are_left_out(load: Load, sound: str) -> None:
    text = load(sound + OLD).text
    assert "secret" not in text
    assert "[[rules.near.then]]" in text


def test_a_key_by_both_names_is_an_error(problems_of: Problems, sound: str) -> None:
    (problem,) = problems_of(sound + OLD + '[[rules.near.escalation]]\ntopic = "a"\ntext = "b"\n')
    assert (problem.code, problem.key) == ("unknown-key", "rules.near.then")


def test_the_old_name_of_a_key_outside_rules_works_too(load: Load, sound: str) -> None:
    configuration = load(f"{sound}[tracking]\ncorrelation = 0.4\n")
    assert configuration.plan.tracking.autocorrelation == 0.4
    assert [key for key, _, _ in renamed(configuration)] == ["tracking.correlation"]
