"""Rules are compiled once, and everything that looks at them shares the result."""

from __future__ import annotations

from pathlib import Path

import pytest

from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.conditions.compounds import AnyOf
from stadimeter.core.conditions.of_rules import RuleCondition
from stadimeter.core.rule import AlarmRule
from support.simulated_run import SIMULATED_BALL

TWO_TARGETS = f"""{SIMULATED_BALL}
[world]
[messenger]
driver = "simulated"
[targets.code]
detector = "ideal"
max_closing_speed = "5 m/s"
"""


def loaded(text: str, folder: Path) -> Configuration:
    file = folder / "two.toml"
    file.write_text(TWO_TARGETS + text, encoding="utf-8")
    return load_configuration(file)


@pytest.mark.parametrize(
    "rule",
    [
        'when = { below = "1 m", target = "code" }\non_delay = "1.2 s"',
        'target = "ball"\nwhen = { below = "1 m", target = "code" }\non_delay = "1.2 s"',
        'target = "code"\nwhen = { below = "1 m" }\non_delay = "1.2 s"',
    ],
    ids=["named by the condition", "named by the condition against the rule", "named by the rule"],
)
def test_a_late_rule_is_found_wherever_its_target_is_named(rule: str, tmp_path: Path) -> None:
    configuration = loaded(f"[rules.near]\n{rule}\n", tmp_path)
    (late,) = (each for each in configuration.warnings if each.code == "late")
    assert late.key == "rules.near.on_delay"
    assert late.message.startswith("at 5 m/s this rule is 6.2 m late")


def test_a_rule_that_asks_for_several_is_looked_at_with_what_it_stands_for(tmp_path: Path) -> None:
    configuration = loaded(
        '[rules.near]\ntargets = ["ball", "code"]\nwhen = { below = "1 m" }\nlatch = true\n'
        '[rules.quiet]\nwhen = { above = "4 m", target = "ball" }\nsuppress_when = { rule = "near" }\n',
        tmp_path,
    )
    quiet = configuration.rules[-1].rule
    assert isinstance(quiet, AlarmRule)
    members = (RuleCondition(rule="near:ball"), RuleCondition(rule="near:code"))
    assert quiet.suppress_when == AnyOf(conditions=members)
    (warning,) = (each for each in configuration.warnings if each.code == "latch-suppresses")
    assert warning.key == "rules.quiet.suppress_when"
    assert "'near'" in warning.message
