"""Contradictions in a configuration: between keys, between values that are fine each, and between its parts."""

from __future__ import annotations

import math
import os
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from stadimeter.config.analysis import Subject, subject_of
from stadimeter.config.analysis.bands import band_errors, floor_errors, holding_errors, quantity_errors
from stadimeter.config.analysis.references import (
    condition_tables_of,
    promise_errors,
    reference_errors,
    second_camera_errors,
    shadow_errors,
)
from stadimeter.config.analysis.schedules import memory_errors, schedule_errors
from stadimeter.config.draft import BASE_NAME, Draft, output_path
from stadimeter.config.findings import Finding, did_you_mean, did_you_mean_or_list, known_keys
from stadimeter.config.loop_gain import loop_findings
from stadimeter.config.plugins import marked_options
from stadimeter.config.rules import conditions
from stadimeter.config.rules.conditions import KEYS_ABOUT_DISTANCE, KEYS_ABOUT_WHOM, LIMITS, MAX_DEPTH, WhenTable
from stadimeter.config.rules.tables import AT_TIMES, GATED, KINDS, FramesTable, RuleTable
from stadimeter.config.toml_lines import KeyPath
from stadimeter.config.units import PinMark, PortMark
from stadimeter.core.rules.follow import MAX_GAIN_SHARE

# Nothing acts on a frame that is older than this. A robot at 0.5 m/s has gone half a metre by then.
MAX_BLIND_S = 1.0

# The guard looks every 20 ms; a busy small computer has been seen to keep it waiting for 100 ms.
WATCHDOG_AFTER_LEASE_S = 0.2


_BEEPS = "leave it out: a buzzer on a ramp beeps by itself, the faster the higher the level"
_ONLY_FOR_ALARMS = (
    "targets", "on_delay", "off_delay", "delay_tolerance", "level", "pattern", "at_start", "latch", "ack", "realarm",
    "cooldown", "raises_per_min_max", "group", "escalation", "notify",
)  # fmt: skip
_SENDS = ("escalation", "notify")
# What a condition can be; a table with several of these keys is short for all of them.
_NAMED = (*LIMITS, *conditions.KINDS)

# Conditions that are a table of their own, with limits; and those in which deadbands and probabilities stand.
_TABLES = {key: known_keys(WhenTable, (key,)) for key, kind in conditions.KINDS.items() if kind.is_about != "others"}
_BETWEEN_LIMITS = [key for key, known in _TABLES.items() if {"above", "between"} <= {*known}]
_INSIDE = [key for key, known in _TABLES.items() if "deadband" in known]

_GATED = f"{', '.join(GATED[:-1])} and {GATED[-1]}"
_LIMITS_FORM = "write above, below, both of these, or between"
_KNOWN = known_keys(WhenTable)
_ONE_OF = f"write one of {', '.join(_NAMED[:-1])} and {_NAMED[-1]}"


def error_findings(draft: Draft) -> Iterator[Finding]:
    """Find what makes a configuration unusable, in what could be read of it."""
    for check in _CHECKS:
        yield from check(draft)
    subject = subject_of(draft)
    for analysis in _ANALYSES:
        yield from analysis(subject)


def _rules_by_themselves(draft: Draft) -> Iterator[Finding]:
    """Check which keys stand in the table of each rule, whether or not their values can be read; then the values."""
    for name, table in draft.tables("rules").items():
        yield from _kind(name, table)
        yield from _keys_of_another_kind(name, table)
        for at, condition in condition_tables_of(name, table):
            if isinstance(condition, Mapping):
                yield from condition_findings(at, condition)
    for name, rule in draft.rules.items():
        for check in (_times, _follow):
            yield from check(("rules", name), rule)


def _kind(name: str, table: Mapping[str, Any]) -> Iterator[Finding]:
    kinds = [kind for kind in KINDS if kind in table]
    gated = [kind for kind in kinds if kind in GATED]
    if len(gated) > 1:
        message = f"the rule '{name}' has {' and '.join(gated)}; a rule has one of {_GATED}, or when alone"
        yield Finding(("rules", name, gated[-1]), message, "make a rule of its own for each", "rule-kind")
    misspelt = any(did_you_mean(key, KINDS) for key in table if key not in RuleTable.model_fields)
    if not kinds and not misspelt:
        message = f"the rule '{name}' does nothing; a rule has one of {_GATED}, or when alone"
        yield Finding(("rules", name), message, 'add one, such as when = { below = "50 cm" }', "rule-kind")


def _keys_of_another_kind(name: str, table: Mapping[str, Any]) -> Iterator[Finding]:
    kind = next((kind for kind in GATED if kind in table), "")
    sends = _SENDS if kind in AT_TIMES else ()
    for key in (key for key in _ONLY_FOR_ALARMS if key in table and kind and key not in sends):
        hint = _BEEPS if key == "pattern" else "leave it out"
        yield Finding(("rules", name, key), f"'{key}' has no meaning beside {kind}", hint, "key-of-another-kind")


def _times(at: KeyPath, rule: RuleTable) -> Iterator[Finding]:
    delay, lost = rule.on_delay, rule.lost
    if isinstance(delay, FramesTable) and delay.frames > delay.of:
        message = f"{delay.frames} of {delay.of} frames can never be"
        yield Finding((*at, "on_delay"), message, "exchange them", "frames-reversed")
    if lost.fault_after < lost.grace:
        message = f"fault_after {lost.fault_after:g} s is shorter than grace {lost.grace:g} s"
        yield Finding((*at, "lost"), message, "make it at least as long", "lost-reversed")
    for key, delay_s in (("on_delay", delay), ("off_delay", rule.off_delay)):
        tolerance_s = rule.delay_tolerance
        if isinstance(tolerance_s, float) and isinstance(delay_s, float) and 0 < delay_s <= tolerance_s:
            message = f"delay_tolerance {tolerance_s:g} s is no shorter than {key} {delay_s:g} s"
            hint = f"make it much shorter, or write a longer {key}: two frames that far apart would fulfil the delay"
            yield Finding((*at, "delay_tolerance"), message, hint, "tolerance-too-long")


def _follow(at: KeyPath, rule: RuleTable) -> Iterator[Finding]:
    if rule.follow is None:
        return
    at, follow = (*at, "follow"), rule.follow
    if follow.deadband_m >= follow.distance_m:
        message = f"the deadband {follow.deadband_m:g} m reaches past the distance {follow.distance_m:g} m"
        yield Finding((*at, "deadband"), message, "make it smaller than the distance", "band-inverted")
    if follow.deadband_rad < 0:
        hint = "write it without the minus sign"
        yield Finding((*at, "turn_deadband"), "the deadband is below zero", hint, "band-inverted")
    if follow.linear_max_mps == follow.reverse_max_mps == 0 and (follow.angular_max_radps == 0 or not follow.turn):
        message = "with all three largest speeds zero the base would never move"
        yield Finding(at, message, "allow one of them", "never-moves")


def _loops_stable(draft: Draft) -> Iterator[Finding]:
    says = f"above {MAX_GAIN_SHARE:g} gain times delay, the base swings ever wider"
    yield from loop_findings(draft, MAX_GAIN_SHARE, math.inf, "gain-unstable", says)


def _targets_exist(draft: Draft) -> Iterator[Finding]:
    names, of_camera = draft.target_names, draft.names("targets")
    need_none = {each.section for each in draft.compiled if not each.needs_target}
    for rule_name, rule in draft.rules.items():
        for watched in rule.targets or ():
            if watched not in names:
                yield _no_target(draft, ("rules", rule_name, "targets"), watched)
        if rule.target is None:
            if len(of_camera) > 1 and not rule.targets and rule_name not in need_none:
                message = (
                    f"which of the targets {', '.join(draft.tables('targets'))} does the rule '{rule_name}' watch?"
                )
                yield Finding(("rules", rule_name, "target"), message, draft.any_target_hint, "target-missing")
        elif rule.target not in names:
            yield _no_target(draft, ("rules", rule_name, "target"), rule.target)


def _no_target(draft: Draft, at: KeyPath, name: str) -> Finding:
    return Finding(at, f"there is no target '{name}'", draft.target_hint(name), "unknown-name")


def _sensors(draft: Draft) -> Iterator[Finding]:
    targets = draft.names("targets")
    for name in draft.names("sensors"):
        if name in targets:
            message = f"'{name}' is a target and a sensor; a rule could not tell them apart"
            yield Finding(("sensors", name), message, "give one another name", "name-twice")
    for name, table in draft.sensor_tables.items():
        if table.confirms and table.confirms not in targets:
            yield _no_target(draft, ("sensors", name, "confirms"), table.confirms)
        if table.stop_below is not None and BASE_NAME not in draft.table:
            message = f"'{name}' shall stop the base, but there is no section [base]"
            yield Finding(("sensors", name, "stop_below"), message, "add one, or leave it out", "unknown-name")


def _slow_targets_exist(draft: Draft) -> Iterator[Finding]:
    names = draft.target_names
    for name, rule in draft.rules.items():
        slow = rule.follow.slow if rule.follow is not None else None
        if slow is not None and slow.target not in names:
            yield _no_target(draft, ("rules", name, "follow", "slow", "target"), slow.target)


def _outputs_exist(draft: Draft) -> Iterator[Finding]:
    known = draft.output_names
    for rule_name, rule in draft.rules.items():
        at = ("rules", rule_name, "actuator")
        if rule.actuator is None or rule.actuator in known:
            continue
        if rule.actuator == BASE_NAME:
            yield Finding(at, "the rule drives the base, but there is no section [base]", "add one", "unknown-name")
        else:
            hint = did_you_mean_or_list(rule.actuator, known)
            yield Finding(at, f"there is no actuator '{rule.actuator}'", hint, "unknown-name")


def _outputs_fit(draft: Draft) -> Iterator[Finding]:
    for name, rule in draft.rules.items():
        at = ("rules", name, "actuator")
        if rule.follow and rule.actuator != BASE_NAME:
            driven = f"not '{rule.actuator}'" if rule.actuator else "and this rule names nothing"
            yield Finding(at, f"only the base can follow, {driven}", f'write actuator = "{BASE_NAME}"', "output-unfit")
        drives = rule.follow is not None and (rule.follow.linear_max_mps or rule.follow.reverse_max_mps)
        if drives and draft.base is not None and draft.base.options.only_turns:
            message = f"the base '{draft.base.driver}' turns and drives nowhere, and this rule shall drive it"
            yield Finding(("rules", name, "follow"), message, 'write max_speed = "0 m/s"', "output-unfit")
        if rule.ramp and rule.actuator == BASE_NAME:
            hint = "drive an actuator, or write follow in place of ramp"
            yield Finding(at, "a ramp cannot drive the base", hint, "output-unfit")
        if rule.ramp and "actuator" not in draft.tables("rules")[name]:
            hint = 'add one, such as actuator = "motor"'
            yield Finding(at, "a ramp needs an actuator to drive", hint, "output-missing")


def _pins_once(draft: Draft) -> Iterator[Finding]:
    yield from _used_once(draft, PinMark, "pin", lambda pin: pin)


def _ports_once(draft: Draft) -> Iterator[Finding]:
    # One device has several names below /dev/serial.
    yield from _used_once(draft, PortMark, "serial port", os.path.realpath)


def _used_once(draft: Draft, mark: type, kind: str, identity: Callable[[Any], object]) -> Iterator[Finding]:
    users: dict[object, list[tuple[KeyPath, object]]] = defaultdict(list)
    for table, part in draft.drivers.items():
        for key, value in marked_options(part.options, mark):
            users[identity(value)].append(((*table, *key), value))
    for (first, _), *others in users.values():
        for path, value in others:
            message = f"{kind} {value} is used twice: by {_dotted(first)} and by {_dotted(path)}"
            yield Finding(path, message, "each needs its own", "used-twice")


def _world_around(draft: Draft) -> Iterator[Finding]:
    for table, part in draft.drivers.items():
        if "world" not in draft.table and part.options.needs_world:
            key = "detector" if table[0] == "targets" else "driver"
            message = f"'{part.driver}' needs a simulated world to be in, and there is no section [world]"
            yield Finding((*table, key), message, "add one; it may be empty", "world-missing")


def _lens_known(draft: Draft) -> Iterator[Finding]:
    camera = draft.table.get("camera")
    if draft.names("rules") and isinstance(camera, dict) and "model" not in camera and draft.second_camera is None:
        hint = 'run `stadimeter calibrate distance PICTURE@DISTANCE -o camera.toml` and add model = "camera.toml"'
        yield Finding(
            ("camera", "model"), "rules need distances, and distances need a camera model", hint, "camera-model-missing"
        )


def _never_blind_for_long(draft: Draft) -> Iterator[Finding]:
    """Whatever a configuration says, nothing acts for long on what is out of sight."""
    limits = [((*output_path(name), "lease"), table.lease) for name, table in draft.output_tables.items()]
    if BASE_NAME in draft.output_tables:
        limits += [
            (("tracking", "coast"), draft.tracking.coast_s),
            (("safety", "max_frame_age"), draft.safety.max_frame_age),
        ]
    for path, seconds in limits:
        if seconds > MAX_BLIND_S:
            message = f"{seconds:g} s is longer than outputs may act without seeing, {MAX_BLIND_S:g} s"
            yield Finding(path, message, 'a lease of "300 ms" suits most cameras', "blind-too-long")


def _watchdog_after_leases(draft: Draft) -> Iterator[Finding]:
    """The watchdog process must leave the guard, which ends leases, the time to do so."""
    longest_s = max((table.lease for table in draft.output_tables.values()), default=0.0)
    limit_s = draft.safety.watchdog
    if limit_s is not None and limit_s < longest_s + WATCHDOG_AFTER_LEASE_S:
        least_s = longest_s + WATCHDOG_AFTER_LEASE_S
        message = f"{limit_s:g} s would end a program that still drives its outputs as it should"
        hint = f"write {least_s:g} s or more, {WATCHDOG_AFTER_LEASE_S:g} s after the longest lease, or leave it out"
        yield Finding(("safety", "watchdog"), message, hint, "watchdog-too-short")


def _dotted(path: KeyPath) -> str:
    return ".".join(str(part) for part in path)


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
    written = [key for key in _NAMED if key in table]
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
    about = [key for key in KEYS_ABOUT_WHOM if key in table]
    for key in about[1:]:
        yield Finding((*at, key), f"'{about[0]}' says already whom this is about", "keep one of them", "condition-keys")
    if any(key in LIMITS for key in written):
        return
    kinds = " and ".join(f"'{kind}'" for kind in written)
    inside = next((kind for kind in written if kind in _INSIDE), "")
    for key in (key for key in KEYS_ABOUT_DISTANCE if key in table):
        hint = f"write it inside {inside}" if inside and key != "of" else "leave it out"
        yield Finding((*at, key), f"'{key}' has no meaning beside {kinds}", hint, "condition-keys")
    about_what = [conditions.KINDS[key].is_about for key in written]
    if "target" in table and "target" not in about_what:
        of_others = "others" in about_what
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
    sides = [key for key in ("above", "below") if key in table]
    written = [form for form in (" and ".join(sides), "between" if "between" in table else "") if form]
    if len(written) > 1:
        message = f"a condition cannot have {', '.join(written)} at once"
        yield Finding(at, message, _LIMITS_FORM, "condition-keys")


def _any_limit(at: KeyPath, table: Mapping[str, Any]) -> Iterator[Finding]:
    if not any(key in table for key in LIMITS) and not any(did_you_mean(key, LIMITS) for key in table):
        yield Finding(at, f"'{at[-1]}' has no limit", _LIMITS_FORM, "condition-keys")


def _parts(at: KeyPath, table: Mapping[str, Any]) -> Iterator[tuple[KeyPath, Mapping[str, Any]]]:
    for key in ("all", "any"):
        entries = table.get(key)
        for number, entry in enumerate(entries if isinstance(entries, list) else ()):
            if isinstance(entry, Mapping):
                yield (*at, key, number), entry
    if isinstance(table.get("not"), Mapping):
        yield (*at, "not"), table["not"]


_CHECKS: tuple[Callable[[Draft], Iterator[Finding]], ...] = (
    _rules_by_themselves,
    _loops_stable,
    _slow_targets_exist,
    _targets_exist,
    _sensors,
    _outputs_exist,
    _outputs_fit,
    _pins_once,
    _ports_once,
    _world_around,
    _lens_known,
    _never_blind_for_long,
    _watchdog_after_leases,
    reference_errors,
)
_ANALYSES: tuple[Callable[[Subject], Iterator[Finding]], ...] = (
    band_errors, quantity_errors, floor_errors, second_camera_errors, holding_errors, shadow_errors,
    promise_errors, schedule_errors, memory_errors,
)  # fmt: skip
