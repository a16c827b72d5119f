"""The benchmarks of rules run and count right, so that their report can be believed."""

import pytest


def test_rules_that_none_crosses_rest_and_the_others_do_not():
    import rule_scale

    beyond = rule_scale.measure("thresholds", rule_scale.thresholds(50), rule_scale.standing(12.0), frames=30)
    amid = rule_scale.measure("mixed", rule_scale.mixed(50), rule_scale.rolling, frames=60)
    assert (beyond.rules, beyond.active) == (50, 0)
    assert amid.rules == 50
    assert amid.bytes_a_rule > 0


def test_the_memory_grows_with_the_number_of_rules_and_no_faster():
    import rule_scale

    few, many = (
        rule_scale.measure("thresholds", rule_scale.thresholds(count), rule_scale.standing(12.0), frames=5)
        for count in (200, 2000)
    )
    assert many.bytes_a_rule < 2 * few.bytes_a_rule


def test_a_report_says_which_goals_are_met():
    import rules_report
    from part import Part

    facts = {"10,000 thresholds us": 5.0, "100 mixed us": 80.0}
    text = rules_report.report([Part(title="Rules by the thousand", text="…", facts=facts)])
    lines = {line.split(" | ")[0]: line for line in text.splitlines() if line.startswith("| ")}
    assert lines["| 10,000 thresholds on one distance, none crosses, a cycle"].endswith("| 5.0 µs | yes |")
    assert lines["| 100 rules of all kinds, amid their limits, a cycle"].endswith("| 80.0 µs | **no** |")
    assert "not measured" in text


@pytest.mark.long
@pytest.mark.timeout(300)
def test_an_alarm_as_it_comes_is_quiet_at_its_limit_and_quick():
    import rule_policies
    from rules_report import GOALS

    from support.scenes import draw

    facts = rule_policies.run(20, draw.REPORT_SEEDS.start + 5000).facts
    met = {goal.what: goal.line(facts)[3] for goal in GOALS if set(goal.limits) <= set(facts)}
    assert set(met.values()) == {"yes"}, facts
