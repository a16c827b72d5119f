"""Which keys of a rule and of its conditions go together, and contradictions between values that are fine each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from stadimeter.config.findings import Finding, did_you_mean, known_keys
from stadimeter.config.rules.condition_tables import (
    KEYS_ABOUT_DISTANCE,
    KEYS_OF_A_TARGET,
    KEYS_OF_NO_TARGET,
    KEYS_OF_OTHERS,
    MAX_DEPTH,
    WhenTable,
)
from stadimeter.config.rules.tables import KINDS, FramesTable, RuleTable
from stadimeter.config.toml_lines import KeyPath

# What a condition can be; a table with keys of several of these groups is short for all of them.
_BEEPS = "leave it out: a buzzer on a ramp beeps by itself, the faster the higher the level"
_ONLY_FOR_WHEN = (
    "targets", "on_delay", "off_delay", "delay_tolerance", "level", "pattern", "at_start", "latch", "ack", "realarm",
    "cooldown", "shelve_max", "raises_per_min_max", "group", "suppress_when", "escalation", "notify",
)  # fmt: skip
_LIMITS = (("above", "below"), ("between",))
_CONDITION_KINDS = (*_LIMITS, *((key,) for key in (*KEYS_OF_A_TARGET, *KEYS_OF_NO_TARGET, *KEYS_OF_OTHERS)))

# Conditions that are a table of their own, in which their deadbands and probabilities stand.
_BETWEEN_LIMITS = ("bearing", "elevation", "closing_speed", "separation")
_INSIDE = ("bearing", "elevation", "closing_speed", "time_to_contact", "separation")

_LIMITS_FORM = "write above, below, both of these, or between"
_NAMED = [key for group in _CONDITION_KINDS for key in group]
_KNOWN = known_keys(WhenTable)
_ONE_OF = f"write one of {', '.join(_NAMED[:-1])} and {_NAMED[-1]}"


def written_findings(name: str, table: Mapping[str, Any]) -> Iterator[Finding]:
    """Check which keys stand in a rule's table, whether or not their values can be read."""
    yield from _kind(name, table)
    yield from _keys_of_another_kind(name, table)
    for key in ("when", "suppress_when"):
        if isinstance(table.get(key), Mapping):
            yield from condition_findings(("rules", name, key), table[key])


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


# The table of a condition -------------------------------------------------------------------------


def condition_findings(at: KeyPath, table: Mapping[str, Any], depth: int = 1) -> Iterator[Finding]:
    """Check which keys stand in the table of a condition, and in those of the conditions that it is made of.

    Args:
        depth: How many conditions it stands inside of, itself included.
    """
    if depth > MAX_DEPTH:
        message = f"conditions stand inside each other more than {MAX_DEPTH} deep"
        yield Finding(at, message, "make rules of some of them, and ask for those with rule", "too-deep")
        return
    written = [key for group in _CONDITION_KINDS for key in group if key in table]
    yield from _not_empty(at, table, written)
    yield from _limits_of_one_form(at, table)
    if written:
        yield from _meaningless(at, table, written)
    yield from _inner_tables(at, table)
    for path, part in _parts(at, table):
        yield from condition_findings(path, part, depth + 1)


def _not_empty(at: KeyPath, table: Mapping[str, Any], written: list[str]) -> Iterator[Finding]:
    misspelt = any(did_you_mean(key, _NAMED) for key in table if key not in _KNOWN)
    if not written and not misspelt:
        yield Finding(at, "the condition is empty", _ONE_OF, "condition-keys")


def _meaningless(at: KeyPath, table: Mapping[str, Any], written: list[str]) -> Iterator[Finding]:
    if any(key in group for group in _LIMITS for key in written):
        return
    kinds = " and ".join(f"'{kind}'" for kind in written)
    inside = next((kind for kind in written if kind in _INSIDE), "")
    for key in (key for key in KEYS_ABOUT_DISTANCE if key in table):
        hint = f"write it inside {inside}" if inside and key != "of" else "leave it out"
        yield Finding((*at, key), f"'{key}' has no meaning beside {kinds}", hint, "condition-keys")
    if "target" in table and not any(kind in KEYS_OF_A_TARGET for kind in written):
        of_others = any(kind in KEYS_OF_OTHERS for kind in written)
        hint = "write it inside each condition that is about another target" if of_others else "leave it out"
        yield Finding((*at, "target"), f"'target' has no meaning beside {kinds}", hint, "condition-keys")


def _inner_tables(at: KeyPath, table: Mapping[str, Any]) -> Iterator[Finding]:
    inner = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    for key in (key for key in _BETWEEN_LIMITS if key in inner):
        yield from _limits_of_one_form((*at, key), inner[key])
        yield from _any_limit((*at, key), inner[key])
    if "count" in inner and not inner["count"].keys() & {"at_least", "at_most"}:
        hint = "add at_least, at_most, or both"
        yield Finding((*at, "count"), "how many targets is not said", hint, "condition-keys")
    separation = inner.get("separation", {}).get("of")
    if isinstance(separation, list) and len(separation) == 2 and separation[0] == separation[1]:
        message = f"'{separation[0]}' is always where it is itself"
        yield Finding((*at, "separation", "of"), message, "name two targets", "condition-keys")
    between = inner.get("time", {}).get("between")
    if isinstance(between, list) and len(between) == 2 and between[0] == between[1]:
        hint = 'write ["00:00", "24:00"] for the whole day'
        message = f"the time begins and ends at {between[0]}"
        yield Finding((*at, "time", "between"), message, hint, "empty-interval")


def _limits_of_one_form(at: KeyPath, table: Mapping[str, Any]) -> Iterator[Finding]:
    written = [" and ".join(used) for group in _LIMITS if (used := [key for key in group if key in table])]
    if len(written) > 1:
        message = f"a condition cannot have {', '.join(written)} at once"
        yield Finding(at, message, _LIMITS_FORM, "condition-keys")


def _any_limit(at: KeyPath, table: Mapping[str, Any]) -> Iterator[Finding]:
    names = [key for group in _LIMITS for key in group]
    if not any(key in table for key in names) and not any(did_you_mean(key, names) for key in table):
        yield Finding(at, f"'{at[-1]}' has no limit", _LIMITS_FORM, "condition-keys")


def _parts(at: KeyPath, table: Mapping[str, Any]) -> Iterator[tuple[KeyPath, Mapping[str, Any]]]:
    for key in ("all", "any"):
        entries = table.get(key)
        for number, entry in enumerate(entries if isinstance(entries, list) else ()):
            if isinstance(entry, Mapping):
                yield (*at, key, number), entry
    if isinstance(table.get("not"), Mapping):
        yield (*at, "not"), table["not"]
