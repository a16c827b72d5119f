"""Warnings: what is allowed in a configuration and hardly meant. `check` and a reload ask for them, a run does not."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

from msgspec import Struct

from stadimeter.config.analysis import Subject, delay_s, frame_rate_hz, subject_of
from stadimeter.config.analysis.references import priority_warnings, promise_warnings, rules_asked_for, shadow_warnings
from stadimeter.config.analysis.schedules import memory_warnings, schedule_warnings
from stadimeter.config.draft import BASE_NAME, Draft, output_path
from stadimeter.config.findings import Finding
from stadimeter.config.loop_gain import loop_findings
from stadimeter.config.plugins import RefusesMotion, StatesLatency, StopsByItself, marked_options
from stadimeter.config.rule_test_checks import rule_test_warnings
from stadimeter.config.rules.action_tables import PatternTable
from stadimeter.config.rules.compiled import CompiledRule
from stadimeter.config.rules.tables import RuleTable
from stadimeter.config.secrets import secret_warnings
from stadimeter.config.toml_lines import KeyPath
from stadimeter.config.units import TAKEN, PinMark, parse_speed
from stadimeter.core.conditions.compounds import leaves
from stadimeter.core.conditions.contact import TimeToContactCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.rule import AlarmRule, LostPolicy
from stadimeter.core.rules.follow import MAX_GAIN_SHARE
from stadimeter.operator_actions import OperatorAction

# Three frames at 30 a second: with less, every hiccup of a network stops the outputs.
LEFT_FOR_FRAMES_S = 0.1

# A robot at 0.5 m/s that drives on for longer goes more than a quarter of a metre.
MAX_AUTO_STOP_S = 0.5

# A contact of a hundred thousand switchings that switches more often than this lasts for less than two weeks.
MIN_WEAR_PERIOD_S = 5.0

# Assumed closing speed where none is stated: faster than people walk, slower than they run.
ASSUMED_CLOSING_MPS = 2.0

# A longer delay is no debounce: what is meant is a target that stays.
MAX_DEBOUNCE_S = 2.0


def warning_findings(draft: Draft) -> Iterator[Finding]:
    """Find what to look at again in a configuration without errors."""
    yield from _about_rules(draft)
    for check in (rule_test_warnings, secret_warnings, _clips_written, _lens_centred, *_ABOUT_DRIVERS):
        yield from check(draft)


def rule_warnings(draft: Draft, errors: Iterable[Finding]) -> Iterator[Finding]:
    """Find what to look at again in those rules of a configuration with errors that have none themselves."""
    wrong = {finding.path[:2] for finding in errors}
    if ("rules",) not in wrong:
        yield from (each for each in _about_rules(draft) if each.path[0] == "rules" and each.path[:2] not in wrong)


def _about_rules(draft: Draft) -> Iterator[Finding]:
    for check in _CHECKS:
        yield from check(draft)
    subject = subject_of(draft)
    for analysis in _ANALYSES:
        yield from analysis(subject)


def _leases_long_enough(draft: Draft) -> Iterator[Finding]:
    age_s = draft.safety.max_frame_age
    for name, table in draft.output_tables.items():
        if table.lease < age_s:
            message = (
                f"the lease {table.lease:g} s is shorter than max_frame_age {age_s:g} s: it stops on frames still good"
            )
            hint = "make it longer, or safety.max_frame_age shorter"
            yield Finding((*output_path(name), "lease"), message, hint, "lease-too-short")


def _rules_matter(draft: Draft) -> Iterator[Finding]:
    if not (draft.rules or draft.landmarks):
        yield Finding(
            ("rules",), "there is no rule, so nothing is ever done", "add one, such as [rules.near]", "no-rules"
        )
    for name, rule in draft.rules.items():
        yield from (
            Finding(("rules", name, *path), text, hint, "no-effect") for path, text, hint in _without_effect(rule)
        )


def _without_effect(rule: RuleTable) -> Iterator[tuple[tuple[str, ...], str, str]]:
    if rule.when and rule.actuator == BASE_NAME and "level" in rule.model_fields_set:
        yield ("level",), "a rule with when stops the base, whatever its level", "leave it out"
    elif rule.when and rule.actuator and rule.level == 0:
        yield (
            ("level",),
            f"level 0 holds '{rule.actuator}' still while the alarm is active",
            "leave it out if not meant",
        )
    if not rule.when and "policy" in rule.lost.model_fields_set:
        yield (
            ("lost", "policy"),
            "without its target a ramp or follow rule always goes to the safe value",
            "leave it out",
        )


def _alerts_heard(draft: Draft) -> Iterator[Finding]:
    asked_for = rules_asked_for(draft)
    for name, rule in draft.rules.items():
        does_something = rule.actuator or rule.steps or rule.observe or name in asked_for
        if rule.when and not does_something and "messenger" not in draft.table:
            message = f"nothing reports the alert '{name}': it drives nothing, and there is no messenger"
            yield Finding(("rules", name), message, "add an actuator to it, or a section [messenger]", "unheard")


def _outputs_driven(draft: Draft) -> Iterator[Finding]:
    acting = [rule for rule in draft.rules.values() if not rule.observe]
    driven = {rule.actuator for rule in acting} | {step.actuator for rule in acting for step in rule.escalation}
    for name in draft.output_names if draft.rules else ():
        if name not in driven:
            yield Finding(output_path(name), f"no rule drives '{name}'", "it stays in its safe state", "output-unused")


def _no_motion(draft: Draft) -> Iterator[Finding]:
    if draft.camera is None or not _moves(draft) or not isinstance(draft.camera.options, RefusesMotion):
        return
    for key, why in draft.camera.options.refuse_motion().items():
        yield Finding(("camera", key), why, "alarms and messages work without", "not-for-motion")


def _late_frames(draft: Draft) -> Iterator[Finding]:
    """Find frames that are too old for motion when they arrive, or nearly."""
    if draft.camera is None or not _moves(draft) or not isinstance(draft.camera.options, StatesLatency):
        return
    at = ("camera", "latency")
    latency_s, longest_s = draft.camera.options.frame_latency_s(), draft.safety.max_frame_age
    left_s = longest_s - latency_s
    message = f"pictures are {1e3 * latency_s:.0f} ms old when they arrive, and safety.max_frame_age is"
    hint = (
        "a faster stream or a shorter exposure helps; a longer max_frame_age, and a lease, mean that it drives on for"
        " longer after a stop"
    )
    if latency_s > 0 and left_s <= 0:
        yield Finding(at, f"{message} {1e3 * longest_s:.0f} ms: nothing will ever move", hint, "latency-too-long")
    elif latency_s > 0 and left_s < LEFT_FOR_FRAMES_S:
        left = f"{1e3 * longest_s:.0f} ms: that leaves {1e3 * left_s:.0f} ms until the next picture, or outputs stop"
        yield Finding(at, f"{message} {left}", hint, "latency-too-long")


# Gain times delay from which on a base overshoots by a tenth: 0.5 gives 7 to 10 % in a simulated loop of 100 or 200 ms.
SWINGS_SHARE = 0.5


def _loops_calm(draft: Draft) -> Iterator[Finding]:
    says = f"above {SWINGS_SHARE:g} gain times delay, the base overshoots by a tenth and more"
    yield from loop_findings(draft, SWINGS_SHARE, MAX_GAIN_SHARE, "gain-high", says)


def _moves(draft: Draft) -> bool:
    return bool(draft.rules) and (draft.base is not None or bool(draft.actuators))


def _runs_on(draft: Draft) -> Iterator[Finding]:
    """Find a base that drives on for long, or for ever, when this computer is gone."""
    if draft.base is None or draft.base.is_simulated or not isinstance(draft.base.options, StopsByItself):
        return
    after_s, hint = draft.base.options.stops_by_itself_after_s(), draft.base.options.auto_stop_advice
    at = ("base", "auto_stop" if "auto_stop" in draft.table.get("base", {}) else "driver")
    if math.isinf(after_s):
        message = "this base never stops by itself: if this computer dies or a cable comes off, it drives on"
        yield Finding(at, message, hint, "base-never-stops-by-itself")
    elif after_s > MAX_AUTO_STOP_S:
        message = f"this base drives on for {after_s:g} s if this computer dies or a cable comes off"
        yield Finding(at, message, hint, "base-stops-late")


def _unused_notifiers(draft: Draft) -> Iterator[Finding]:
    used = {step.notify for rule in draft.rules.values() for step in rule.steps}
    for name in draft.names("notifiers"):
        if draft.rules and name not in used:
            hint = f'add notify = "{name}" to a rule, or to a step of its escalation'
            yield Finding(("notifiers", name), f"no rule notifies '{name}'", hint, "output-unused")


def _worn_contacts(draft: Draft) -> Iterator[Finding]:
    worn = {choice.name: choice.driver for choice in draft.actuators if choice.options.is_worn_by_switching}
    for name, rule in draft.rules.items():
        for path, actuator, pattern in _patterns(rule):
            if actuator in worn and pattern.period_s < MIN_WEAR_PERIOD_S and not pattern.times:
                message = (
                    f"'{actuator}' wears out by switching, as a {worn[actuator]} does, and would switch every "
                    f"{pattern.period_s:g} s while the alarm stands"
                )
                hint = "drive a buzzer or a lamp, or add times to the pattern"
                yield Finding(("rules", name, *path, "pattern"), message, hint, "relay-pattern")


def _patterns(rule: RuleTable) -> Iterator[tuple[KeyPath, str | None, PatternTable]]:
    if rule.pattern is not None:
        yield (), rule.actuator, rule.pattern
    for position, step in enumerate(rule.escalation):
        if step.pattern is not None:
            yield ("escalation", position), step.actuator, step.pattern


def _taken_pins(draft: Draft) -> Iterator[Finding]:
    for at, part in draft.drivers.items():
        for key, pin in marked_options(part.options, PinMark):
            if pin in TAKEN:
                message = f"GPIO {pin} is also for {TAKEN[pin]}"
                yield Finding((*at, *key), message, "take one of GPIO 4 to 13 or 16 to 27, such as 18", "pin-taken")


# Delays: whether a rule acts in time, and whether the times of an alarm fit together -------------


class _Approach(Struct, frozen=True, kw_only=True):
    """The largest closing speed of a target, and the time between two frames."""

    speed_mps: float
    is_stated: bool
    frame_s: float

    def waits_s(self, alarm: AlarmRule) -> float:
        """Return the longest time from a target's crossing of a limit until an alarm is raised."""
        # An assumed speed is too rough for a frame to matter.
        return delay_s(alarm, 1 / self.frame_s) + (self.frame_s if self.is_stated else 0.0)


def timing_warnings(subject: Subject) -> Iterator[Finding]:
    """Find rules that act too late, and times of one alarm that do not fit together."""
    limits_m = _limits_m(subject)
    tables = subject.draft.tables("targets")
    groups = {member: name for name, members in subject.draft.groups.items() for member in members}
    groups |= {each.name: groups[each.members[0]] for each in subject.draft.nearest}
    targets = tables | {member: tables[name] for member, name in groups.items()}
    frame_s = 1 / frame_rate_hz(subject.draft)
    for declared, alarm in subject.alarms:
        approach = _approach(targets.get(_watched(alarm), {}), frame_s)
        if approach.is_stated or ("on_delay" in declared.table and alarm.on_delay.hold_s <= MAX_DEBOUNCE_S):
            yield from _late(declared, alarm, approach, limits_m)
            yield from _missed(declared, alarm, approach)
        yield from _too_long_for_contact(declared, alarm, delay_s(alarm, 1 / frame_s))
        yield from _cut_off_delay(declared, alarm)


def _watched(alarm: AlarmRule) -> str:
    """Return the target whose distance an alarm is about, which may be another than the rule's."""
    return alarm.condition.target if isinstance(alarm.condition, DistanceCondition) else alarm.target


def _approach(target: Mapping[str, Any], frame_s: float) -> _Approach:
    try:
        return _Approach(speed_mps=parse_speed(target.get("max_closing_speed")), is_stated=True, frame_s=frame_s)
    except ValueError:  # not written, or not a speed: reported where tables are read
        return _Approach(speed_mps=ASSUMED_CLOSING_MPS, is_stated=False, frame_s=frame_s)


def _limits_m(subject: Subject) -> Mapping[tuple[str, str], list[float]]:
    """Return, for each target and quantity, the distances below which alarms act, the nearest first."""
    limits_m: dict[tuple[str, str], list[float]] = {}
    for _, alarm in subject.alarms:
        condition = alarm.condition
        if isinstance(condition, DistanceCondition) and condition.above is None and condition.below is not None:
            limits_m.setdefault((condition.target, condition.quantity), []).append(condition.below)
    return {which: sorted(each) for which, each in limits_m.items()}


def _late(
    declared: CompiledRule,
    alarm: AlarmRule,
    approach: _Approach,
    limits_m: Mapping[tuple[str, str], list[float]],
) -> Iterator[Finding]:
    condition = alarm.condition
    if not isinstance(condition, DistanceCondition) or condition.below is None or condition.above is not None:
        return
    others_m = limits_m[condition.target, condition.quantity]
    nearer = bisect_left(others_m, condition.below)
    next_m = others_m[nearer - 1] if nearer else 0.0
    margin_m = condition.below - next_m
    waits_s = approach.waits_s(alarm)
    late_m = waits_s * approach.speed_mps
    if late_m <= margin_m:
        return
    until = f"the next limit, {next_m:g} m" if nearer else "contact"
    message = (
        f"at {approach.speed_mps:g} m/s this rule is {late_m:.2g} m late: it waits {_waits(approach, waits_s)}, and "
        f"from {condition.below:g} m it is {margin_m:.2g} m to {until}"
    )
    yield Finding(declared.at("on_delay"), message, _sooner(approach, margin_m, alarm), "late")


def _missed(declared: CompiledRule, alarm: AlarmRule, approach: _Approach) -> Iterator[Finding]:
    condition = alarm.condition
    if not isinstance(condition, DistanceCondition) or condition.below is None or condition.above is None:
        return
    waits_s = approach.waits_s(alarm)
    width_m = condition.below - condition.above
    if not 0 < width_m < waits_s * approach.speed_mps:
        return
    message = (
        f"at {approach.speed_mps:g} m/s a target crosses these {width_m:.2g} m in {width_m / approach.speed_mps:.2g} s,"
        f" and this rule waits {_waits(approach, waits_s)}: it misses it"
    )
    yield Finding(declared.at("on_delay"), message, _sooner(approach, width_m, alarm), "band-skipped")


def _sooner(approach: _Approach, room_m: float, alarm: AlarmRule) -> str:
    left_s = room_m / approach.speed_mps - (approach.frame_s if approach.is_stated else 0.0)
    if left_s < 0:
        return "no delay is short enough: write a further limit, or take more frames a second"
    longest_s = math.floor(left_s * 100) / 100  # rounded down: what is offered must do
    shorter = f'write on_delay = "{longest_s:g} s" or less'
    if approach.is_stated:
        return shorter
    return f"{shorter}, or say how fast it comes at most: max_closing_speed in [targets.{_watched(alarm)}]"


def _waits(approach: _Approach, waits_s: float) -> str:
    return f"{waits_s:.2g} s, a frame included" if approach.is_stated else f"{waits_s:.2g} s"


def _too_long_for_contact(declared: CompiledRule, alarm: AlarmRule, waits_s: float) -> Iterator[Finding]:
    condition = alarm.condition
    if isinstance(condition, TimeToContactCondition) and waits_s >= condition.below_s:
        message = f"this rule waits {waits_s:.2g} s for a contact that is less than {condition.below_s:g} s away"
        yield Finding(declared.at("on_delay"), message, "make it much shorter", "late")


def _cut_off_delay(declared: CompiledRule, alarm: AlarmRule) -> Iterator[Finding]:
    """Find an off-delay that a target cuts short when it leaves the picture: `hold` lets the output go earlier."""
    lost = alarm.lost
    if lost.policy is not LostPolicy.HOLD or alarm.latch or alarm.output is None:
        return
    if not any(isinstance(leaf, DistanceCondition) for leaf in leaves(alarm.condition)):
        return
    if "off_delay" in declared.table and alarm.off_delay_s > lost.fault_after_s:
        message = (
            f"when its target leaves the picture, '{alarm.output}' is let go after {lost.fault_after_s:g} s "
            f"(lost.fault_after), not after the off_delay of {alarm.off_delay_s:g} s, and the alarm never clears"
        )
        hint = 'write lost = { policy = "clear" }: then a target that left counts as over, for the off_delay'
        yield Finding(declared.at("off_delay"), message, hint, "lost-cuts-off-delay")


def _clips_written(draft: Draft) -> Iterator[Finding]:
    for name, table in draft.button_tables.items():
        for key in ("press", "hold"):
            if draft.black_box is None and getattr(table, key) == OperatorAction.CLIP:
                message = f"the button '{name}' orders a clip, and there is no black box"
                yield Finding(("buttons", name, key), message, "add the section [black_box]", "no-black-box")


def _lens_centred(draft: Draft) -> Iterator[Finding]:
    if draft.camera_model is not None and (words := draft.camera_model.off_centre_words):
        yield Finding(("camera", "model"), words, "calibrate with a board", "off-centre")


_CHECKS: tuple[Callable[[Draft], Iterator[Finding]], ...] = (
    _leases_long_enough,
    _rules_matter,
    _alerts_heard,
    _outputs_driven,
)
_ANALYSES: tuple[Callable[[Subject], Iterator[Finding]], ...] = (
    shadow_warnings,
    priority_warnings,
    timing_warnings,
    promise_warnings,
    schedule_warnings,
    memory_warnings,
)
_ABOUT_DRIVERS: tuple[Callable[[Draft], Iterator[Finding]], ...] = (
    _no_motion,
    _late_frames,
    _runs_on,
    _loops_calm,
    _unused_notifiers,
    _worn_contacts,
    _taken_pins,
)
