"""A table that stands for several targets: their names, what rules may say of them, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from stadimeter.config.describe import describe
from stadimeter.config.loader import load_configuration
from stadimeter.core.conditions.compounds import AllOf, AnyOf, leaves, targets_of
from stadimeter.core.rule import gate_of
from stadimeter.errors import ConfigError
from support.simulated_run import SIMULATED_BALL

BASIS = f"""{SIMULATED_BALL.partition("[targets.ball]")[0]}
[world]
[actuators.buzzer]
driver = "simulated"
[targets.cup]
detector = "disc"
diameter = "8 cm"
[targets.balls]
detector = "ball"
diameter = "6.7 cm"
hsv = "29,86,6:64,255,255"
count = 3
"""
MEMBERS = ("balls-1", "balls-2", "balls-3")


def load(tmp_path: Path, more: str, basis: str = BASIS):
    path = tmp_path / "several.toml"
    path.write_text(basis + more, encoding="utf-8")
    return load_configuration(path)


def problems(tmp_path: Path, more: str, basis: str = BASIS) -> list[tuple[int | None, str, str]]:
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, more, basis)
    return [(each.line, each.message, each.hint) for each in caught.value.problems]


def test_each_member_is_a_target_and_so_are_the_nearest_and_the_farthest(tmp_path: Path) -> None:
    plan = load(tmp_path, "").plan
    assert plan.targets == ("cup", *MEMBERS, "balls-nearest", "balls-farthest")
    assert plan.measured_targets == ("cup", *MEMBERS)


def test_a_count_of_the_group_counts_its_members(tmp_path: Path) -> None:
    rule = '[rules.many]\nactuator = "buzzer"\nwhen = { count = { of = ["balls"], at_least = 3 } }\n'
    (many,) = load(tmp_path, rule).plan.rules
    assert targets_of(gate_of(many).condition) == {*MEMBERS}


def test_a_count_of_all_does_not_count_the_nearest_twice(tmp_path: Path) -> None:
    rule = '[rules.many]\nactuator = "buzzer"\nwhen = { count = { at_least = 3 } }\n'
    (many,) = load(tmp_path, rule).plan.rules
    assert next(leaves(gate_of(many).condition)).targets_named == ("cup", *MEMBERS)


RULE = '[rules.near]\nactuator = "buzzer"\ntarget = "{}"\nwhen = {{ below = "1 m" }}\n'
STANDS = "'balls' stands for balls-1 to balls-3: name one, or balls-nearest or balls-farthest"


def test_a_member_beyond_the_count_is_refused_with_those_that_there_are(tmp_path: Path) -> None:
    ((line, message, hint),) = problems(tmp_path, RULE.format("balls-9"))
    assert (line, message, hint) == (BASIS.count("\n") + 3, "there is no target 'balls-9'", STANDS)


def test_a_rule_on_the_group_is_one_on_any_of_it_so_the_nearest_counts(tmp_path: Path) -> None:
    nested = '[rules.near]\nactuator = "buzzer"\ntarget = "cup"\nwhen = { any = [{ target = "balls", seen = true }] }\n'
    figure = '[figures.most]\ntarget = "balls"\nstatistic = "maximum"\nwithin = "1 h"\n'
    loaded = load(tmp_path, RULE.format("balls") + figure)
    assert loaded.plan.rules[0].target == "balls-nearest"
    assert loaded.plan.figures[0].target == "balls-nearest"
    assert targets_of(gate_of(load(tmp_path, nested).plan.rules[0]).condition) == {"balls-nearest"}


def test_where_a_group_is_all_there_is_a_rule_need_not_name_it(tmp_path: Path) -> None:
    alone = BASIS.partition("[targets.cup]")[0] + "[targets.balls]" + BASIS.partition("[targets.balls]")[2]
    rule = '[rules.near]\nactuator = "buzzer"\nwhen = { below = "1 m" }\n'
    (near,) = load(tmp_path, rule, alone).plan.rules
    assert near.target == "balls-nearest"
    assert problems(tmp_path, rule)[0][1] == "which of the targets cup, balls is 'near' about?"


@pytest.mark.parametrize(("count", "says"), [("0", "0 is below 1"), ("65", "65 is above 64")])
def test_a_count_out_of_range_is_one_error_with_its_line(tmp_path: Path, count: str, says: str) -> None:
    found = problems(tmp_path, RULE.format("balls-2"), BASIS.replace("count = 3", f"count = {count}"))
    assert found == [(BASIS.count("\n"), says, "")]


def test_a_detector_that_finds_one_has_no_count(tmp_path: Path) -> None:
    found = problems(tmp_path, "", BASIS.replace('diameter = "8 cm"', 'diameter = "8 cm"\ncount = 2'))
    ((line, message, hint),) = found
    assert (message, hint) == (
        "unknown key 'count'",
        "this detector finds one target; ball, tag and object find several",
    )
    assert line == 1 + BASIS[: BASIS.index('diameter = "8 cm"')].count("\n") + 1


def test_numbers_given_twice_are_refused_with_their_line(tmp_path: Path) -> None:
    tags = '[targets.tags]\ndetector = "tag"\nside = "8 cm"\nids = [3, 3]\n'
    ((line, message, _),) = problems(tmp_path, tags + RULE.format("tags-3"))
    assert line == BASIS.count("\n") + 4
    assert message == "3 is given twice; each number is one target, so write it once"


@pytest.mark.parametrize("name", ["balls-2", "balls-nearest"])
def test_a_target_with_the_name_of_a_member_is_refused(tmp_path: Path, name: str) -> None:
    ((_, message, hint),) = problems(tmp_path, f'[targets.{name}]\ndetector = "disc"\ndiameter = "8 cm"\n')
    assert message == f"'{name}' is also the name of a target that [targets.balls] stands for"
    assert hint == "give one of them another name"


def test_any_of_a_group_is_one_condition_on_each_and_all_of_likewise(tmp_path: Path) -> None:
    when = '{{ {} = "balls", below = "1 m", not = {{ closing_speed = {{ below = "0 m/s" }} }} }}'
    for key, whole in (("any_of", AnyOf), ("all_of", AllOf)):
        rule = f'[rules.near]\nactuator = "buzzer"\nwhen = {when.format(key)}\n'
        loaded = load(tmp_path, rule)
        assert loaded.warnings == ()
        condition = gate_of(loaded.plan.rules[0]).condition
        assert isinstance(condition, whole)
        assert [targets_of(each) for each in condition.conditions] == [{member} for member in MEMBERS]
        assert all(isinstance(each, AllOf) for each in condition.conditions), "both keys are about one at a time"
        words = describe(loaded)
        assert all(any(member in line for line in words) for member in MEMBERS)


def test_a_group_inside_of_others_is_still_about_each(tmp_path: Path) -> None:
    inner = '{ not = { any_of = "balls", below = "1 m" } }, { target = "cup", seen = true }'
    rule = f'[rules.near]\nactuator = "buzzer"\nwhen = {{ all = [{inner}] }}\n'
    rule += 'suppress_when = { all_of = "balls", lost = true }\n'
    alarm = gate_of(load(tmp_path, rule).plan.rules[0])
    assert targets_of(alarm.condition) == {*MEMBERS, "cup"}
    assert targets_of(alarm.suppress_when) == {*MEMBERS}


def test_a_group_that_there_is_none_of_and_two_keys_for_whom_are_refused_with_their_place(tmp_path: Path) -> None:
    rule = '[rules.near]\nactuator = "buzzer"\nwhen = {{ {}, below = "1 m" }}\n'
    ((line, message, _),) = problems(tmp_path, rule.format('any_of = "bals"'))
    assert (line, message) == (BASIS.count("\n") + 3, "there is no target 'bals'")
    found = problems(tmp_path, rule.format('any_of = "balls", target = "cup"'))
    assert [message for _, message, _ in found] == ["'target' says already whom this is about; leave out 'any_of'"]
    found = problems(tmp_path, rule.format('any_of = "balls", all_of = "balls"'))
    assert [message for _, message, _ in found] == ["'any_of' says already whom this is about; leave out 'all_of'"]


def test_a_configuration_that_only_tells_where_the_camera_is_needs_no_rule(tmp_path: Path) -> None:
    tags = '[landmarks]\ntag_size = "16 cm"\ntags = [{ id = 3, at = ["0 m", "2 m", "50 cm"], facing = "0 deg" }]\n'
    assert [each.code for each in load(tmp_path, "").warnings if each.code == "no-rules"] == ["no-rules"]
    assert [each.code for each in load(tmp_path, tags).warnings if each.code == "no-rules"] == []
