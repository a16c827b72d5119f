"""Names of other rules, targets, actuators and notifiers that must exist, and no rule that waits for itself.

Read from the tables as they were written, so that a rule with a mistake elsewhere is checked too.
"""

from __future__ import annotations

import math
import os
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from typing import Any

from msgspec import Struct

from stadimeter.config.analysis import ASSUMED_RATE_HZ, Subject, delay_s
from stadimeter.config.analysis.bands import is_always_open, range_of
from stadimeter.config.draft import BASE_NAME, Draft
from stadimeter.config.findings import Finding, did_you_mean, did_you_mean_or_list
from stadimeter.config.models import ButtonTable
from stadimeter.config.plugins import DriverChoice
from stadimeter.config.rules.compiled import CompiledRule
from stadimeter.config.rules.conditions import KEYS_ABOUT_WHOM, KEYS_OF_GROUPS
from stadimeter.config.toml_lines import KeyPath
from stadimeter.core.camera_model import CameraModel, is_one_aspect
from stadimeter.core.conditions.compounds import depends_on, targets_of
from stadimeter.core.conditions.measured import COMPARISONS
from stadimeter.core.conditions.of_rules import UndeliveredCondition
from stadimeter.core.decision import Severity
from stadimeter.core.rule import AlarmRule, AnyRule, FollowRule, LostPolicy, gate_of
from stadimeter.core.words import duration
from stadimeter.operator_actions import OperatorAction

# Promises of safety rules, latched alarms that no one is notified of, and rules silenced by a target out of sight -----


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


# A longer ring is written with a gap.
_MAX_NAMES = 8

# More rings are found once these are mended: each takes a walk through all rules.
_MAX_RINGS = 50

_CONDITIONS = ("when", "suppress_when")

# What only an alarm can be told; a ramp, or a rule that follows, is kept quiet like one.
_OF_ALARMS = frozenset({OperatorAction.ACKNOWLEDGE, OperatorAction.RESET})


class _Name(Struct, frozen=True):
    """A name that stands in a condition."""

    kind: str
    name: str
    path: KeyPath


def reference_errors(draft: Draft) -> Iterator[Finding]:
    """Find names that stand for nothing, and rules that wait for themselves."""
    rules, targets = set(_rule_names(draft)), draft.target_names
    known = {"rule": rules, "target": set(targets), "figure": set(draft.names("figures"))}
    known["counted"] = {*targets, *draft.groups}
    for section, table in draft.tables("rules").items():
        for name in _names(section, table):
            if name.name not in known[name.kind]:
                is_target = name.kind in {"target", "counted"}
                message = f"there is no {'target' if is_target else name.kind} '{name.name}'"
                hint = draft.target_hint(name.name) if is_target else did_you_mean_or_list(name.name, known[name.kind])
                yield Finding(name.path, message, hint, "unknown-name")
        yield from _steps(draft, section, table)
    yield from _groups(draft)
    yield from _buttons(draft)
    yield from _cycles(draft)


def rules_asked_for(draft: Draft) -> frozenset[str]:
    """Return the rules that conditions of others ask for."""
    sections = draft.tables("rules")
    return frozenset(
        _section_of(name, sections)
        for section, table in sections.items()
        for name in _rules_in(section, table)
        if name.name != section
    )


def _rule_names(draft: Draft) -> Iterator[str]:
    for section, table in draft.tables("rules").items():
        yield section
        targets = table.get("targets")
        if isinstance(targets, list):
            names = draft.expanded(target for target in targets if isinstance(target, str))
            yield from (f"{section}:{target}" for target in names)


def condition_tables_of(section: str, table: Mapping[str, Any]) -> Iterator[tuple[KeyPath, Any]]:
    """Go through the conditions of a rule as they were written, and where each stands."""
    yield from ((("rules", section, key), table.get(key)) for key in _CONDITIONS)
    steps = table.get("escalation")
    for number, step in enumerate(steps if isinstance(steps, list) else ()):
        if isinstance(step, Mapping):
            yield ("rules", section, "escalation", number, "when"), step.get("when")


def _names(section: str, table: Mapping[str, Any]) -> Iterator[_Name]:
    """Go through the names in the conditions of a rule, however deep these are nested."""
    left: list[tuple[KeyPath, Any]] = [*reversed(list(condition_tables_of(section, table)))]
    while left:
        path, value = left.pop()
        if isinstance(value, list):
            left += [((*path, number), entry) for number, entry in reversed(list(enumerate(value)))]
        if isinstance(value, Mapping):
            yield from _named_in(path, value)
            left += [((*path, key), value[key]) for key in reversed(list(value))]


def _named_in(path: KeyPath, table: Mapping[str, Any]) -> Iterator[_Name]:
    for key in COMPARISONS:
        if isinstance(table.get(key), str):
            yield _Name("target", table[key], (*path, key))
    figure = table.get("figure")
    if isinstance(figure, Mapping) and isinstance(figure.get("name"), str):
        yield _Name("figure", figure["name"], (*path, "figure", "name"))
    for key in ("rule", *KEYS_ABOUT_WHOM):
        if isinstance(table.get(key), str):
            yield _Name("counted" if key in KEYS_OF_GROUPS else key, table[key], (*path, key))
    for key, kind in (("of", "counted" if path[-1] == "count" else "target"), ("rules", "rule")):
        names = table.get(key) if isinstance(table.get(key), list) else ()
        each = ((number, name) for number, name in enumerate(names or ()) if isinstance(name, str))
        yield from (_Name(kind, name, (*path, key, number)) for number, name in each)


def _steps(draft: Draft, section: str, table: Mapping[str, Any]) -> Iterator[Finding]:
    steps = table.get("escalation")
    yield from _exists(table, "notify", draft.names("notifiers"), ("rules", section))
    for number, step in enumerate(steps if isinstance(steps, list) else ()):
        if not isinstance(step, Mapping):
            continue
        at: KeyPath = ("rules", section, "escalation", number)
        yield from _exists(step, "actuator", draft.output_names, at)
        yield from _exists(step, "notify", draft.names("notifiers"), at)
        if "topic" in step and "messenger" not in draft.table:
            message = f"nothing sends '{step['topic']}': there is no section [messenger]"
            yield Finding((*at, "topic"), message, "add one, or notify people with notify", "unknown-name")


def _groups(draft: Draft) -> Iterator[Finding]:
    """Check that no target has a name that several of one kind take."""
    taken = {member: group for group, members in draft.groups.items() for member in members}
    taken |= {each.name: each.name.rpartition("-")[0] for each in draft.nearest}
    for section in ("targets", "sensors"):
        for name in draft.tables(section):
            if name in taken:
                message = f"'{name}' is one of the targets that [targets.{taken[name]}] stands for"
                yield Finding((section, name), message, "give one another name", "name-twice")


def _buttons(draft: Draft) -> Iterator[Finding]:
    """Check what buttons ask of alarms."""
    for button, table in draft.button_tables.items():
        is_for_alarms = not {table.press, table.hold}.isdisjoint(_OF_ALARMS)
        rules = (each.rule for each in draft.compiled)
        alarms = [gate_of(rule) for rule in rules if isinstance(rule, AlarmRule) or not is_for_alarms]
        at: KeyPath = ("buttons", button)
        meant = [rule for rule in alarms if table.rule in {"", rule.name}]
        if not meant and table.rule and (table.rule in draft.rules or table.rule not in draft.names("rules")):
            hint = did_you_mean_or_list(table.rule, [rule.name for rule in alarms])
            yield Finding((*at, "rule"), f"there is no alarm '{table.rule}'", hint, "unknown-name")
        if "shelve" in {table.press, table.hold}:
            yield from _shelved_for(meant, table, at)


def _shelved_for(meant: list[AlarmRule], table: ButtonTable, at: KeyPath) -> Iterator[Finding]:
    """Check that alarms may be shelved for as long as a button asks. Of every alarm, those that never may are left."""
    may_be = [rule for rule in meant if rule.shelve_max_s > 0 or table.rule]
    for rule in sorted(may_be, key=lambda rule: rule.shelve_max_s)[:1]:
        if rule.shelve_max_s <= 0:
            yield Finding((*at, "rule"), f"'{rule.name}' can never be shelved", "name another alarm", "shelve-too-long")
        elif table.shelve_for is not None and table.shelve_for > rule.shelve_max_s:
            message = f"'{rule.name}' may be shelved for {duration(rule.shelve_max_s)} at most (shelve_max)"
            hint = "shorten shelve_for, or raise shelve_max of the rule"
            yield Finding((*at, "shelve_for"), message, hint, "shelve-too-long")


def _exists(step: Mapping[str, Any], key: str, known: Iterable[str], at: KeyPath) -> Iterator[Finding]:
    name = step.get(key)
    if not isinstance(name, str) or name in (names := list(known)):
        return
    kind = "notifier" if key == "notify" else key
    hint = did_you_mean_or_list(name, names) or f"add a section [{kind}s.{name}]"
    yield Finding((*at, key), f"there is no {kind} '{name}'", hint, "unknown-name")


def _cycles(draft: Draft) -> Iterator[Finding]:
    """Find rings of rules, each of which asks whether the next is active. Each rule is reported in one at most."""
    sections = draft.tables("rules")
    asks = {section: {_section_of(name, sections): name for name in _rules_in(section, table)}
            for section, table in sections.items()}  # fmt: skip
    order = list(asks)
    for _ in range(_MAX_RINGS):
        try:
            TopologicalSorter(asks).prepare()
            break
        except CycleError as error:
            # Each of them asks for the one before it, and the last is the first again.
            ring: list[str] = error.args[1][:0:-1]
            start = ring.index(min(ring, key=order.index))
            ring = [*ring[start:], *ring[:start]]
            yield _in_a_ring(ring, asks[ring[0]][ring[1 % len(ring)]].path)
            asks = {section: names for section, names in asks.items() if section not in ring}


def _rules_in(section: str, table: Mapping[str, Any]) -> Iterator[_Name]:
    return (name for name in _names(section, table) if name.kind == "rule")


def _section_of(name: _Name, sections: Mapping[str, Any]) -> str:
    """Return the table that a rule comes from: ``near:ball`` comes from ``near``."""
    return name.name if name.name in sections else name.name.partition(":")[0]


def _in_a_ring(ring: list[str], path: KeyPath) -> Finding:
    if len(ring) == 1:
        does = "suppresses itself" if "suppress_when" in path else "asks whether it is active itself"
        return Finding(path, f"the rule '{ring[0]}' {does}", "name another rule", "reference-cycle")
    names = [f"'{name}'" for name in (*ring, ring[0])]
    if len(names) > _MAX_NAMES:
        names[_MAX_NAMES - 2 : -1] = ["…"]
    message = f"these rules wait for each other: {' → '.join(names)}"
    return Finding(path, message, "take one of them out of the ring", "reference-cycle")


# Rules that drive one output: who wins, and who never does ------------------------------------------------------------

# A rule that wins an output for no longer than this, because the winner waits longer, has hardly any effect.
MOMENT_S = 1.0

# Outputs that more rules drive are not looked at: every rule is held against every other one.
MAX_RIVALS = 200


def priority_warnings(subject: Subject) -> Iterator[Finding]:
    """Find alarms that drive one actuator with one priority, and are hardly meant to be combined."""
    for rivals in _rivals(subject):
        alarms = [each for each in rivals if isinstance(each.rule, AlarmRule)]
        for position, later in enumerate(alarms):
            for earlier in alarms[:position]:
                if earlier.rule.priority == later.rule.priority and earlier.section != later.section:
                    yield from _badly_combined(subject, earlier, later)


def _badly_combined(subject: Subject, earlier: CompiledRule, later: CompiledRule) -> Iterator[Finding]:
    output, priority = later.rule.output or "", later.rule.priority
    table = subject.draft.output_tables.get(output)
    if output == BASE_NAME or (table and "combine" in table.model_fields_set):
        return
    levels = [getattr(each.rule, "level", 1.0) for each in (earlier, later)]
    patterns = [getattr(each.rule, "pattern", None) for each in (earlier, later)]
    both = f"'{earlier.section}' and '{later.section}' drive '{output}' with priority {priority}"
    if 0.0 in levels and any(levels):
        silent = (earlier, later)[levels.index(0.0)]
        message = f"{both}, and the highest level counts: level 0 of '{silent.section}' never does"
    elif all(patterns) and _may_meet(earlier.rule, later.rule):
        silent, message = later, f"{both}, and may act at once: their patterns mix"
    else:
        return
    hint = f"give the one that shall win a higher priority, such as priority = {priority + 100}"
    yield Finding(silent.at("priority"), message, hint, "equal-priority")


def shadow_errors(subject: Subject) -> Iterator[Finding]:
    """Find safety rules that never win their output."""
    return (finding for loser, finding in _shadowed(subject) if loser.rule.severity is Severity.SAFETY)


def shadow_warnings(subject: Subject) -> Iterator[Finding]:
    """Find other rules that never win their output."""
    return (finding for loser, finding in _shadowed(subject) if loser.rule.severity is not Severity.SAFETY)


def _rivals(subject: Subject) -> Iterator[list[CompiledRule]]:
    """Yield the rules that drive each output, except for outputs with more than `MAX_RIVALS`."""
    by_output: dict[str, list[CompiledRule]] = defaultdict(list)
    for declared in subject.every_rule:
        if declared.rule.output is not None and not declared.rule.observe:
            by_output[declared.rule.output].append(declared)
    return (rivals for rivals in by_output.values() if len(rivals) <= MAX_RIVALS)


def _may_meet(first: AnyRule, second: AnyRule) -> bool:
    one, other = range_of(first), range_of(second)
    return one is None or other is None or one.meets(other)


def _shadowed(subject: Subject) -> Iterator[tuple[CompiledRule, Finding]]:
    reported: set[str] = set()
    for rivals in _rivals(subject):
        for loser in rivals:
            winner = next((each for each in rivals if _goes_before(each.rule, loser.rule)), None)
            if winner is not None and loser.section not in reported:
                reported.add(loser.section)
                yield loser, _loses(loser, winner)


def _goes_before(winner: AnyRule, loser: AnyRule) -> bool:
    """Check whether a rule surely drives the output in place of another one, wherever that one holds."""
    if winner.priority <= loser.priority or not is_always_open(winner):
        return False
    if isinstance(loser, AlarmRule) and (loser.latch or loser.lost.policy is LostPolicy.ASSERT):
        return False  # it can be active where its condition does not hold
    wide, narrow = range_of(winner), range_of(loser)
    if wide is None or narrow is None or narrow.is_empty or not wide.covers(narrow):
        return False
    if not isinstance(winner, AlarmRule):
        return True
    if winner.at_start == "announce":
        return False
    waits_s = delay_s(loser, ASSUMED_RATE_HZ) if isinstance(loser, AlarmRule) else 0.0
    stays_s = loser.off_delay_s if isinstance(loser, AlarmRule) else 0.0
    return delay_s(winner, ASSUMED_RATE_HZ) <= waits_s + MOMENT_S and stays_s <= winner.off_delay_s + MOMENT_S


def _loses(loser: CompiledRule, winner: CompiledRule) -> Finding:
    output, name = loser.rule.output, winner.rule.name
    message = (
        f"wherever '{loser.section}' holds, '{name}' holds too and wins '{output}': '{loser.section}' never drives it, "
        "or for a moment only"
    )
    hint = f"give '{loser.section}' the higher priority, or make '{name}' hold in fewer situations"
    return Finding(loser.path, message, hint, "shadowed")


# A second camera that cannot measure beside the first: it is the same one, or the stereo file is of other pictures ----

# The options of cameras that say which one is meant; the last of a simulated one.
_WHICH = ("device", "device_file", "camera", "path", "paths", "baseline")


def second_camera_errors(subject: Subject) -> Iterator[Finding]:
    """Find what keeps both cameras from measuring together, or one from measuring a thing of unknown size."""
    first, second, rig = subject.draft.camera, subject.draft.second_camera, subject.draft.rig
    if first is None or second is None:
        yield from _without_size(subject.draft)
        return
    if first.driver == second.driver and _device(first) == _device(second):
        hint = "name another device; where it is simulated, write baseline"
        yield Finding(("second_camera", "driver"), "this is the first camera once more", hint, "used-twice")
    if subject.draft.camera_table.model is not None:
        message = "the stereo file of [second_camera] has the lenses of both cameras"
        yield Finding(("camera", "model"), message, "leave it out", "lens-twice")
    if rig is not None:
        yield from _unfit("camera", first, rig.left)
        yield from _unfit("second_camera", second, rig.right)
    for target in subject.draft.targets:
        if not target.options.needs_pixels:
            message = f"'{target.driver}' looks at no picture, so a second camera shows it nothing"
            yield Finding(("targets", target.name, "detector"), message, "leave [second_camera] out", "stereo-unfit")


def _without_size(draft: Draft) -> Iterator[Finding]:
    """Find targets of unknown size that nothing measures."""
    for target in draft.targets:
        table = draft.target_tables.get(target.name)
        if table is not None and not table.on_floor and _is_size_unknown(target):
            hint = "add a section [second_camera], write on_floor for what stands on the floor, or measure its size"
            message = "one camera measures no distance of a thing whose size is not known"
            yield Finding(("targets", target.name), message, hint, "size-unknown")


def _unfit(section: str, choice: DriverChoice, lens: CameraModel) -> Iterator[Finding]:
    width_px, height_px = (getattr(choice.options, key, None) for key in ("width_px", "height_px"))
    if width_px and height_px and not is_one_aspect((width_px, height_px), (lens.width_px, lens.height_px)):
        message = (
            f"pictures of {width_px}x{height_px} have another aspect than those of the stereo file, "
            f"{lens.width_px}x{lens.height_px}, so they show another part of the view"
        )
        hint = "set width_px and height_px so, or calibrate at this resolution"
        yield Finding((section, "width_px"), message, hint, "stereo-unfit")


def _is_size_unknown(target: DriverChoice) -> bool:
    sigmas = (getattr(target.options, key, None) for key in ("tolerance", "height", "width", "eye_distance"))
    return any(getattr(each, "sigma_m", each) == math.inf for each in sigmas)


def _device(choice: DriverChoice) -> list[object]:
    return [_real(getattr(choice.options, key, None)) for key in _WHICH]


def _real(device: object) -> object:
    """Return a device by its own path: it has several names, and a number is one of them."""
    path = f"/dev/video{device}" if isinstance(device, int) else device
    return os.path.realpath(path) if isinstance(path, str) and path.startswith("/dev/") else device
