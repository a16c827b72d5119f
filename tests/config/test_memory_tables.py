"""Counts, sums, remembered figures and messages at times in a configuration: what is taken, refused and warned of."""

import pytest

from stadimeter.config.describe import describe
from stadimeter.config.loader import load_configuration
from stadimeter.core.conditions.of_rules import RuleCondition
from stadimeter.core.conditions.remembered import RememberedCondition, RememberedFigure, Window
from stadimeter.core.conditions.sight import PresenceCondition
from stadimeter.core.rule import ReportRule
from stadimeter.errors import ConfigError
from support.simulated_run import SIMULATED_BALL

AROUND = f"""{SIMULATED_BALL}
[world]
[messenger]
driver = "simulated"
[rules.near]
when = {{ below = "1 m" }}
"""
OFTEN = '[rules.often]\nwhen = { count = { rule = "near", at_least = 3, within = "1 min" } }\n'
NEAREST = '[figures.nearest]\nstatistic = "minimum"\nwithin = "today"\n'
REPORT = '[[rules.report.escalation]]\ntopic = "a"\ntext = "{nearest:.1f} m"\n'


@pytest.fixture
def load(tmp_path):
    def loaded(text):
        path = tmp_path / "rules.toml"
        path.write_text(AROUND + text)
        return load_configuration(path)

    return loaded


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        ('count = { rule = "near", at_least = 3, within = "1 min" }',
         RememberedCondition(rules=("near",), unit="times", above=2.0, window=Window(for_s=60.0), owner="often")),
        ('count = { rule = "near", at_least = 21, within = "today" }',
         RememberedCondition(rules=("near",), unit="times", above=20.0, window=Window(from_second=0.0), owner="often")),
        ('active_for = { rule = "near", at_least = "10 min", since = "06:00" }',
         RememberedCondition(
             rules=("near",), unit="s", above=600.0, window=Window(from_second=21600.0), owner="often"
         )),
        ('figure = { name = "nearest", between = ["50 cm", "3 ft"] }',
         RememberedCondition(name="nearest", unit="m", above=0.5, below=3 * 0.3048)),
    ],
)  # fmt: skip
def test_conditions_are_compiled(load, written, expected):
    assert load(f"{NEAREST}[rules.often]\nwhen = {{ {written} }}\n").plan.rules[1].condition == expected


def test_what_is_counted_has_no_limit_on_chattering_unless_one_is_written(load):
    """With the limit of 10 a minute, 15 visits counted as 10."""
    for limit, expected in (("", 0), ("raises_per_min_max = 4\n", 4)):
        rules = load(
            f'{OFTEN}[rules.far]\nwhen = {{ above = "2 m" }}\n'.replace("near", "far", 1).replace(
                "[rules.far]\n", f"[rules.far]\n{limit}"
            )
        )
        by_name = {rule.name: rule for rule in rules.plan.rules}
        assert by_name["far"].raises_per_min_max == expected
        assert by_name["near"].raises_per_min_max == by_name["often"].raises_per_min_max == 10


def test_a_rule_of_several_targets_counts_as_one(load):
    more = '[rules.any]\ntargets = ["ball"]\nwhen = { below = "50 cm" }\n'
    condition = load(more + OFTEN.replace('"near"', '"any"')).plan.rules[2].condition
    assert condition.rules == ("any:ball",)


def test_figures_and_messages_are_compiled_and_described(load):
    text = f'{NEAREST}[rules.report]\nat = ["00:00", "12:00"]\n{REPORT}{OFTEN}'
    configuration = load(text)
    named, summed = configuration.plan.figures
    assert named == RememberedFigure(name="nearest", target="ball", window=Window(from_second=0.0))
    assert summed.owner == "often"
    rule = next(rule for rule in configuration.plan.rules if isinstance(rule, ReportRule))
    assert rule.at_seconds == (0.0, 43200.0)
    assert rule.severity == "info"
    assert [step.when for step in rule.gate.escalation] == [None]
    assert configuration.plan.needs_wall_time
    sentences = " ".join(describe(configuration))
    assert "Remembers `nearest`: the minimum of the distance of `ball` today." in sentences
    assert "`report` sends `a` at 00:00 and 12:00." in sentences
    assert "when `near` was raised at least 3 times within 1 min" in sentences


def test_messages_have_a_gate_and_steps_with_conditions(load):
    text = f'{NEAREST}[rules.report]\nevery = "1 min"\nwhen = {{ seen = true }}\n{REPORT}when = {{ rule = "near" }}\n'
    configuration = load(text)
    rule = next(rule for rule in configuration.plan.rules if isinstance(rule, ReportRule))
    assert rule.gate.condition == PresenceCondition(seen=True, target="ball")
    assert rule.gate.escalation[0].when == RuleCondition(rule="near")
    sentences = " ".join(describe(configuration))
    assert "`report` sends `a` if `near` is active every 1 min. Sends only while `ball` is in sight." in sentences


BROKEN = {
    OFTEN.replace("1 min", "0 s"): "rules.often.when.count.within: '0 s' is not within 0.1 s and 8784 h, a year",
    OFTEN.replace("1 min", "9000 h"): "'9000 h' is not within 0.1 s and 8784 h, a year",
    OFTEN.replace(', within = "1 min"', ""): 'write one of within = "1 min", within = "today" and since = "06:00"',
    OFTEN.replace("1 min", 'today", since = "06:00'): "write one of within",
    OFTEN.replace("at_least = 3", "at_least = 1001"): "beside rule stands at_least, 1 to 1000",
    OFTEN.replace("at_least = 3", "at_most = 3"): "beside rule stands at_least, 1 to 1000",
    '[rules.often]\nwhen = { count = { at_least = 1, within = "1 min" } }': "name a rule to count how often",
    OFTEN.replace('"near"', '"naer"'): "rules.often.when.count.rule: there is no rule 'naer' (did you mean 'near'?)",
    NEAREST + '[rules.low]\nwhen = { figure = { name = "nearst", below = "50 cm" } }':
        "rules.low.when.figure.name: there is no figure 'nearst' (did you mean 'nearest'?)",
    NEAREST + '[rules.louder]\nactuator = "buzzer"\nramp = { from = "2 m", to = "1 m" }\n'
    'when = { figure = { name = "nearest", below = "3 s" } }':
        "rules.louder.when: the figure 'nearest' is in m, and not in s",
    NEAREST.replace("minimum", "percentile"): 'goes with percentile, such as percentile = 90',
    NEAREST.replace('"minimum"', '"percentile"\npercentile = 101'): "figures.nearest.percentile: 101",
    NEAREST.replace("nearest", "count"): "figures.count: 'count' cannot be a name here",
    NEAREST + 'target = "bal"': "figures.nearest.target: there is no target 'bal' (did you mean 'ball'?)",
    '[rules.report]\nevery = "1 min"\n' + REPORT: "there is no field 'nearest' that a template can tell",
    '[rules.report]\nevery = "0.1 s"\nnotify = "phone"\n': "rules.report.every: '0.1 s' is not within 1 s and 8784 h",
    '[rules.report]\nevery = "1 min"\n': "rules.report: the rule sends nothing",
    NEAREST + '[rules.report]\nat = ["12:00", "12:01"]\n' + REPORT: "two of the times are less than 2 min apart",
    NEAREST + '[rules.report]\nat = "00:00"\n' + REPORT + 'after = "5 s"': "it drives and awaits nothing",
    NEAREST + '[rules.report]\nat = "00:00"\nlatch = true\n' + REPORT: "'latch' has no meaning beside at",
}  # fmt: skip


@pytest.mark.parametrize("written", BROKEN)
def test_what_cannot_be_is_refused_with_key_line_and_remedy(load, written):
    with pytest.raises(ConfigError) as refused:
        load(written)
    (problem, *_) = refused.value.problems
    assert BROKEN[written] in "\n".join(map(str, refused.value.problems))
    assert problem.line > AROUND.count("\n")
