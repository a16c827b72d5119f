"""Delays: whether a rule acts in time, and whether the times of an alarm fit together."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from stadimeter.config.analysis.subject import Subject, delay_s, frame_rate_hz
from stadimeter.config.findings import Finding
from stadimeter.config.rules.compiled import CompiledRule
from stadimeter.config.units import parse_speed
from stadimeter.core.condition import DistanceCondition, TimeToContactCondition, leaves
from stadimeter.core.rule import AlarmRule, LostPolicy

# Assumed closing speed where none is stated: faster than people walk, slower than they run.
ASSUMED_CLOSING_MPS = 2.0

# A longer delay is no debounce: what is meant is a target that stays.
MAX_DEBOUNCE_S = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Approach:
    """The largest closing speed of a target, and the time between two frames."""

    speed_mps: float
    is_stated: bool
    frame_s: float

    def waits_s(self, alarm: AlarmRule) -> float:
        """Return how long after the target has crossed a limit an alarm is raised at the latest."""
        # An assumed speed is too rough for a frame to matter.
        return delay_s(alarm, 1 / self.frame_s) + (self.frame_s if self.is_stated else 0.0)


def timing_warnings(subject: Subject) -> Iterator[Finding]:
    """Find rules that act too late, and times of one alarm that do not fit together."""
    limits_m = _limits_m(subject)
    targets = subject.draft.tables("targets")
    frame_s = 1 / frame_rate_hz(subject.draft)
    for declared, alarm in subject.alarms:
        approach = _approach(targets.get(_watched(alarm), {}), frame_s)
        if approach.is_stated or ("on_delay" in declared.table and alarm.on_delay.hold_s <= MAX_DEBOUNCE_S):
            yield from _late(declared, alarm, approach, limits_m)
            yield from _missed(declared, alarm, approach)
        yield from _too_long_for_contact(declared, alarm, delay_s(alarm, 1 / frame_s))
        yield from _hidden_realarm(declared, alarm)
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
        if isinstance(condition, DistanceCondition) and condition.above_m is None and condition.below_m is not None:
            limits_m.setdefault((condition.target, condition.quantity), []).append(condition.below_m)
    return {which: sorted(each) for which, each in limits_m.items()}


def _late(
    declared: CompiledRule,
    alarm: AlarmRule,
    approach: _Approach,
    limits_m: Mapping[tuple[str, str], list[float]],
) -> Iterator[Finding]:
    condition = alarm.condition
    if not isinstance(condition, DistanceCondition) or condition.below_m is None or condition.above_m is not None:
        return
    others_m = limits_m[condition.target, condition.quantity]
    nearer = bisect_left(others_m, condition.below_m)
    next_m = others_m[nearer - 1] if nearer else 0.0
    margin_m = condition.below_m - next_m
    waits_s = approach.waits_s(alarm)
    late_m = waits_s * approach.speed_mps
    if late_m <= margin_m:
        return
    until = f"the next limit, {next_m:g} m" if nearer else "contact"
    message = (
        f"at {approach.speed_mps:g} m/s this rule is {late_m:.2g} m late: it waits {_waits(approach, waits_s)}, and "
        f"from {condition.below_m:g} m it is {margin_m:.2g} m to {until}"
    )
    yield Finding(declared.at("on_delay"), message, _sooner(approach, margin_m, alarm), "late")


def _missed(declared: CompiledRule, alarm: AlarmRule, approach: _Approach) -> Iterator[Finding]:
    condition = alarm.condition
    if not isinstance(condition, DistanceCondition) or condition.below_m is None or condition.above_m is None:
        return
    waits_s = approach.waits_s(alarm)
    width_m = condition.below_m - condition.above_m
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


def _hidden_realarm(declared: CompiledRule, alarm: AlarmRule) -> Iterator[Finding]:
    if alarm.realarm_s is not None and alarm.cooldown_s > alarm.realarm_s:
        message = (
            f"cooldown {alarm.cooldown_s:g} s is longer than realarm {alarm.realarm_s:g} s: people are notified of it "
            f"only every {alarm.cooldown_s:g} s"
        )
        key = "cooldown" if "cooldown" in declared.table else "realarm"
        yield Finding(declared.at(key), message, "make the cooldown shorter", "cooldown-hides-realarm")
