"""What one rule may not say, though each of its values by itself is fine."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from stadimeter.config.findings import Finding, did_you_mean
from stadimeter.config.rule_models import KINDS, FramesTable, RuleTable, WhenTable

_ONLY_FOR_WHEN = ("on_delay", "off_delay", "level", "at_start")
_ABOUT_DISTANCE = ("of", "deadband", "deadband_sigmas", "probability", "probability_off")
_CONDITIONS = (("above", "below"), ("between",), ("seen",), ("lost",))


def written_findings(name: str, table: Mapping[str, Any]) -> Iterator[Finding]:
    """Check which keys stand in a rule's table, whether or not their values can be read.

    Args:
        name: The rule's name.
        table: Its table as it was written.

    Yields:
        What is wrong.
    """
    yield from _kind(name, table)
    yield from _keys_of_another_kind(name, table)
    when = table.get("when")
    if isinstance(when, Mapping):
        yield from _condition(name, when)


def rule_findings(name: str, rule: RuleTable) -> Iterator[Finding]:
    """Check the values of a rule against each other.

    Args:
        name: The rule's name.
        rule: The rule.

    Yields:
        What is wrong.
    """
    for check in _CHECKS:
        yield from check(name, rule)


def _kind(name: str, table: Mapping[str, Any]) -> Iterator[Finding]:
    kinds = [kind for kind in KINDS if kind in table]
    if len(kinds) > 1:
        message = f"the rule '{name}' has {' and '.join(kinds)}; a rule has exactly one of when, ramp and follow"
        yield Finding(("rules", name, kinds[-1]), message, "make a rule of its own for each")
    misspelt = any(did_you_mean(key, KINDS) for key in table if key not in RuleTable.model_fields)
    if not kinds and not misspelt:
        message = f"the rule '{name}' does nothing; a rule has exactly one of when, ramp and follow"
        yield Finding(("rules", name), message, 'add one, such as when = { below = "50 cm" }')


def _keys_of_another_kind(name: str, table: Mapping[str, Any]) -> Iterator[Finding]:
    if "when" in table or not any(kind in table for kind in KINDS):
        return
    for key in _ONLY_FOR_WHEN:
        if key in table:
            yield Finding(("rules", name, key), f"'{key}' has a meaning only beside when", "leave it out")


def _condition(name: str, when: Mapping[str, Any]) -> Iterator[Finding]:
    at = ("rules", name, "when")
    groups = [" and ".join(used) for group in _CONDITIONS if (used := [key for key in group if key in when])]
    if len(groups) > 1:
        message = f"a condition cannot have {', '.join(groups)} at once"
        yield Finding(at, message, "write one of above, below, between, seen and lost, or above with below")
    known = [key for group in _CONDITIONS for key in group]
    misspelt = any(did_you_mean(key, known) for key in when if key not in WhenTable.model_fields)
    if not groups and not misspelt:
        yield Finding(at, "the condition is empty", "write one of above, below, between, seen and lost")
    if groups in (["seen"], ["lost"]):
        for key in (key for key in _ABOUT_DISTANCE if key in when):
            yield Finding((*at, key), f"'{key}' has no meaning beside '{groups[0]}'", "leave it out")


def _empty_interval(name: str, rule: RuleTable) -> Iterator[Finding]:
    lower_m, upper_m = rule.when.limits_m if rule.when else (None, None)
    if lower_m is None or upper_m is None or lower_m < upper_m:
        return
    what = f"no distance is above {lower_m:g} m and below {upper_m:g} m"
    if rule.when and rule.when.between:
        yield Finding(("rules", name, "when", "between"), what, "write the nearer end first")
    else:
        yield Finding(("rules", name, "when"), what, "exchange the two, or make two rules of them")


def _deadband_without_end(name: str, rule: RuleTable) -> Iterator[Finding]:
    lower_m, upper_m = rule.when.limits_m if rule.when else (None, None)
    if rule.when and lower_m is not None and upper_m is None and rule.when.deadband >= lower_m:
        message = f"with a deadband of {rule.when.deadband:g} m above {lower_m:g} m the alarm could never clear"
        yield Finding(("rules", name, "when", "deadband"), message, "make it smaller than the limit")


def _probabilities(name: str, rule: RuleTable) -> Iterator[Finding]:
    on = rule.when.probability_for(rule.severity) if rule.when else None
    if rule.when and on is not None and rule.when.probability_off > on:
        message = f"probability_off {rule.when.probability_off:g} is above probability {on:g}: the alarm would chatter"
        yield Finding(("rules", name, "when", "probability_off"), message, "exchange the two")


def _frames(name: str, rule: RuleTable) -> Iterator[Finding]:
    delay = rule.on_delay
    if isinstance(delay, FramesTable) and delay.frames > delay.of:
        yield Finding(("rules", name, "on_delay"), f"{delay.frames} of {delay.of} frames can never be", "exchange them")


def _lost(name: str, rule: RuleTable) -> Iterator[Finding]:
    if rule.lost.fault_after < rule.lost.grace:
        message = f"fault_after {rule.lost.fault_after:g} s is shorter than grace {rule.lost.grace:g} s"
        yield Finding(("rules", name, "lost"), message, "make it at least as long")


def _ramp(name: str, rule: RuleTable) -> Iterator[Finding]:
    if rule.ramp is None:
        return
    if rule.ramp.start == rule.ramp.full:
        message = f"the ramp goes from {rule.ramp.start:g} m to the same distance"
        yield Finding(("rules", name, "ramp"), message, "choose two distances, or write a rule with when")
    if rule.ramp.min > rule.ramp.max:
        message = f"min {rule.ramp.min:g} is above max {rule.ramp.max:g}"
        yield Finding(("rules", name, "ramp", "min"), message, "exchange them; from and to give the direction")


def _follow(name: str, rule: RuleTable) -> Iterator[Finding]:
    if rule.follow is None:
        return
    at = ("rules", name, "follow")
    if rule.follow.deadband >= rule.follow.distance:
        message = f"the deadband {rule.follow.deadband:g} m reaches past the distance {rule.follow.distance:g} m"
        yield Finding((*at, "deadband"), message, "make it smaller than the distance")
    if rule.follow.turn_deadband < 0:
        yield Finding((*at, "turn_deadband"), "the deadband is below zero", "write it without the minus sign")
    if rule.follow.max_speed == rule.follow.max_reverse_speed == rule.follow.max_turn_rate == 0:
        yield Finding(at, "with all three largest speeds zero the base would never move", "allow one of them")


_CHECKS: tuple[Callable[[str, RuleTable], Iterator[Finding]], ...] = (
    _empty_interval,
    _deadband_without_end,
    _probabilities,
    _frames,
    _lost,
    _ramp,
    _follow,
)
