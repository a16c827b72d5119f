"""Promises of safety rules, latched alarms that no one is notified of, and rules silenced by a target out of sight."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping

from stadimeter.config.analysis import Subject
from stadimeter.config.draft import BASE_NAME
from stadimeter.config.findings import Finding, did_you_mean
from stadimeter.config.rules.compiled import CompiledRule
from stadimeter.core.conditions.compounds import depends_on, targets_of
from stadimeter.core.conditions.of_rules import UndeliveredCondition
from stadimeter.core.decision import Severity
from stadimeter.core.rule import AlarmRule, FollowRule, LostPolicy, gate_of


def promise_errors(subject: Subject) -> Iterator[Finding]:
    """Find safety rules that could be late, silent or switched off."""
    for declared in subject.rules:
        if declared.rule.severity is Severity.SAFETY:
            yield from _safety(declared, gate_of(declared.rule))


def promise_warnings(subject: Subject) -> Iterator[Finding]:
    """Find alarms that wait for people who do not know, and bases that move though a rule against it is blind."""
    latched = {each.rule.name: each.section for each in subject.every_rule if getattr(each.rule, "latch", False)}
    follows = [each.rule for each in subject.rules if isinstance(each.rule, FollowRule) and not each.rule.observe]
    yield from _groups_of_one(subject)
    yield from _never_undelivered(subject)
    for declared, alarm in subject.alarms:
        yield from _clears_at_once(declared, alarm)
        yield from _waits_unheard(subject, declared, alarm)
        yield from _latch_suppresses(latched, declared, alarm)
        yield from _blind_stop(follows, declared, alarm)


def _safety(declared: CompiledRule, alarm: AlarmRule) -> Iterator[Finding]:
    delay = alarm.on_delay
    if delay.hold_s > 0 or delay.frames > 1:
        waits = f"for {delay.hold_s:g} s" if delay.hold_s else f"for {delay.frames} of {delay.of_frames} frames"
        message = f"a safety rule acts at once, and this one waits {waits}"
        hint = 'leave on_delay out; against false alarms write a higher probability in when, or severity = "alarm"'
        yield Finding(declared.at("on_delay"), message, hint, "safety-delayed")
    wrong = {
        "shelve_max": alarm.shelve_max_s > 0 and "shelve_max" in declared.table and "cannot be shelved",
        "suppress_when": alarm.suppress_when is not None and "cannot be suppressed",
        "observe": alarm.observe and "cannot merely be observed: it would drive nothing",
    }
    codes = {"shelve_max": "safety-shelved", "suppress_when": "safety-suppressed", "observe": "safety-observed"}
    for key, what in wrong.items():
        if what:
            hint = 'leave it out, or write severity = "alarm"'
            yield Finding(declared.at(key), f"a safety rule {what}", hint, codes[key])


def _groups_of_one(subject: Subject) -> Iterator[Finding]:
    sizes = Counter(each.rule.group for each in subject.every_rule if isinstance(each.rule, AlarmRule))
    for declared, alarm in subject.alarms:
        if alarm.group and sizes[alarm.group] == 1:
            message = f"'{declared.section}' is the only alarm of the group '{alarm.group}', and so always its first"
            others = [group for group in sizes if group and group != alarm.group]
            hint = did_you_mean(alarm.group, others) or "name the same group in the others, or leave it out"
            yield Finding(declared.at("group"), message, hint, "group-of-one")


def _clears_at_once(declared: CompiledRule, alarm: AlarmRule) -> Iterator[Finding]:
    if alarm.severity is Severity.SAFETY and alarm.off_delay_s == 0 and not alarm.latch:
        message = "a safety rule clears late, and this one clears at the first frame to the contrary"
        yield Finding(declared.at("off_delay"), message, 'write such as off_delay = "1 s"', "safety-clears-at-once")


def _waits_unheard(subject: Subject, declared: CompiledRule, alarm: AlarmRule) -> Iterator[Finding]:
    waits = (alarm.latch or alarm.ack == "required") and not alarm.observe
    is_heard = not {"messenger", "status_led"}.isdisjoint(subject.draft.table) or any(
        step.send is not None for step in alarm.escalation
    )
    calls_for_operator = alarm.ack_resets and alarm.output  # by what it drives
    if not waits or is_heard or calls_for_operator:
        return
    drives = f" while it drives '{alarm.output}'" if alarm.latch and alarm.output else ""
    is_reset, key = alarm.latch and not alarm.ack_resets, "latch" if alarm.latch else "ack"
    does, command = ("reset", "reset") if is_reset else ("acknowledge", "ack")
    message = f"once raised, '{alarm.name}' waits for an operator to {does} it{drives}, and nothing notifies one"
    hint = (
        f"only `stadimeter alarm {command} {alarm.name}` on this computer does; add a section [messenger] or "
        "[status_led], or notify with a [notifiers.NAME]"
    )
    yield Finding(declared.at(key), message, hint, "latch-unheard")


def _latch_suppresses(latched: Mapping[str, str], declared: CompiledRule, alarm: AlarmRule) -> Iterator[Finding]:
    asked_for = depends_on(alarm.suppress_when) if alarm.suppress_when else frozenset[str]()
    for name in sorted({latched[rule] for rule in asked_for if rule in latched}):
        message = f"'{name}' latches: once raised, it suppresses '{alarm.name}' until an operator resets it"
        hint = f"leave latch out of '{name}', or suppress by another rule"
        yield Finding(declared.at("suppress_when"), message, hint, "latch-suppresses")


def _blind_stop(follows: list[FollowRule], declared: CompiledRule, alarm: AlarmRule) -> Iterator[Finding]:
    """Find rules that stop a base for one target while it follows another, and do not say what to do when blind."""
    if alarm.output != BASE_NAME or alarm.observe or alarm.lost.policy is not LostPolicy.HOLD:
        return
    if "policy" in declared.table.get("lost", {}):
        return
    targets = sorted(targets_of(alarm.condition))
    pairs = [(target, rule.name) for target in targets for rule in follows if rule.target != target]
    for target, other in pairs[:1]:
        message = f"while '{target}' is out of sight, '{alarm.name}' stays as it was, and '{other}' may drive the base"
        hint = (
            'write lost = { policy = "assert" } if not seeing it means danger, and { policy = "hold" } if it does not'
        )
        yield Finding(declared.at("lost"), f"{message} all the same", hint, "motion-blind")


def _never_undelivered(subject: Subject) -> Iterator[Finding]:
    for leaf in subject.leaves if {"messenger", "notifiers"}.isdisjoint(subject.draft.table) else ():
        if isinstance(leaf.condition, UndeliveredCondition):
            message = "no alarm is ever undelivered: there is no section [messenger], and no [notifiers.NAME]"
            yield Finding(leaf.path, message, "add one, or remove the condition", "unheard")
