"""Rules are compiled once, and everything that looks at them shares the result."""

from __future__ import annotations

from pathlib import Path

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
"""


def loaded(text: str, folder: Path) -> Configuration:
    file = folder / "two.toml"
    file.write_text(TWO_TARGETS + text, encoding="utf-8")
    return load_configuration(file)


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
