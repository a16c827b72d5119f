"""Contradictions within one rule, each of whose values is fine by itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from stadimeter.config.findings import Finding, did_you_mean
from stadimeter.config.rules.condition_checks import written_condition
from stadimeter.config.rules.tables import KINDS, FramesTable, RuleTable

_BEEPS = "leave it out: a buzzer on a ramp beeps by itself, the faster the higher the level"
_ONLY_FOR_WHEN = (
    "targets", "on_delay", "off_delay", "delay_tolerance", "level", "pattern", "at_start", "latch", "ack", "realarm",
    "cooldown", "shelve_max", "raises_per_min_max", "group", "suppress_when", "escalation", "notify",
)  # fmt: skip


def written_findings(name: str, table: Mapping[str, Any]) -> Iterator[Finding]:
    """Check which keys stand in a rule's table, whether or not their values can be read."""
    yield from _kind(name, table)
    yield from _keys_of_another_kind(name, table)
    for key in ("when", "suppress_when"):
        if isinstance(table.get(key), Mapping):
            yield from written_condition(("rules", name, key), table[key])


def rule_findings(name: str, rule: RuleTable) -> Iterator[Finding]:
    """Check the values of a rule against each other."""
    for check in _CHECKS:
        yield from check(name, rule)


def _kind(name: str, table: Mapping[str, Any]) -> Iterator[Finding]:
    kinds = [kind for kind in KINDS if kind in table]
    if len(kinds) > 1:
        message = f"the rule '{name}' has {' and '.join(kinds)}; a rule has exactly one of when, ramp and follow"
        yield Finding(("rules", name, kinds[-1]), message, "make a rule of its own for each", "rule-kind")
    misspelt = any(did_you_mean(key, KINDS) for key in table if key not in RuleTable.model_fields)
    if not kinds and not misspelt:
        message = f"the rule '{name}' does nothing; a rule has exactly one of when, ramp and follow"
        yield Finding(("rules", name), message, 'add one, such as when = { below = "50 cm" }', "rule-kind")


def _keys_of_another_kind(name: str, table: Mapping[str, Any]) -> Iterator[Finding]:
    if "when" in table or not any(kind in table for kind in KINDS):
        return
    for key in (key for key in _ONLY_FOR_WHEN if key in table):
        hint = _BEEPS if key == "pattern" else "leave it out"
        yield Finding(("rules", name, key), f"'{key}' has a meaning only beside when", hint, "key-of-another-kind")


def _frames(name: str, rule: RuleTable) -> Iterator[Finding]:
    delay = rule.on_delay
    if isinstance(delay, FramesTable) and delay.frames > delay.of:
        yield Finding(
            ("rules", name, "on_delay"),
            f"{delay.frames} of {delay.of} frames can never be",
            "exchange them",
            "frames-reversed",
        )


def _tolerance(name: str, rule: RuleTable) -> Iterator[Finding]:
    if not isinstance(rule.delay_tolerance, float):
        return
    delays_s = {"on_delay": rule.on_delay, "off_delay": rule.off_delay}
    for key, delay_s in delays_s.items():
        if isinstance(delay_s, float) and 0 < delay_s <= rule.delay_tolerance:
            message = f"delay_tolerance {rule.delay_tolerance:g} s is no shorter than {key} {delay_s:g} s"
            hint = f"make it much shorter, or write a longer {key}: two frames that far apart would fulfil the delay"
            yield Finding(("rules", name, "delay_tolerance"), message, hint, "tolerance-too-long")


def _lost(name: str, rule: RuleTable) -> Iterator[Finding]:
    if rule.lost.fault_after < rule.lost.grace:
        message = f"fault_after {rule.lost.fault_after:g} s is shorter than grace {rule.lost.grace:g} s"
        yield Finding(("rules", name, "lost"), message, "make it at least as long", "lost-reversed")


def _ramp(name: str, rule: RuleTable) -> Iterator[Finding]:
    if rule.ramp is None or rule.ramp.points:  # points are checked as they are read
        return
    start_m, full_m = rule.ramp.ends_m
    if start_m == full_m:
        message = f"the ramp goes from {start_m:g} m to the same distance"
        yield Finding(
            ("rules", name, "ramp"), message, "choose two distances, or write a rule with when", "ramp-reversed"
        )
    if rule.ramp.min > rule.ramp.max:
        message = f"min {rule.ramp.min:g} is above max {rule.ramp.max:g}"
        yield Finding(
            ("rules", name, "ramp", "min"), message, "exchange them; from and to give the direction", "ramp-reversed"
        )


def _follow(name: str, rule: RuleTable) -> Iterator[Finding]:
    if rule.follow is None:
        return
    at = ("rules", name, "follow")
    if rule.follow.deadband >= rule.follow.distance:
        message = f"the deadband {rule.follow.deadband:g} m reaches past the distance {rule.follow.distance:g} m"
        yield Finding((*at, "deadband"), message, "make it smaller than the distance", "band-inverted")
    if rule.follow.turn_deadband < 0:
        yield Finding(
            (*at, "turn_deadband"), "the deadband is below zero", "write it without the minus sign", "band-inverted"
        )
    if rule.follow.max_speed == rule.follow.max_reverse_speed == rule.follow.max_turn_rate == 0:
        yield Finding(
            at, "with all three largest speeds zero the base would never move", "allow one of them", "never-moves"
        )


_CHECKS: tuple[Callable[[str, RuleTable], Iterator[Finding]], ...] = (
    _frames,
    _tolerance,
    _lost,
    _ramp,
    _follow,
)
