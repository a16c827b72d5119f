"""Warnings: what is allowed in a configuration and hardly meant. `check` and a reload ask for them, a run does not."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from datetime import datetime, timedelta
from itertools import combinations
from pathlib import Path

from stadimeter.config.checks import are_apart, is_size_unknown, limits_on_one_figure, rule_names, written_conditions
from stadimeter.config.draft import BASE_NAME, Draft, output_path
from stadimeter.config.driver_tables import validate
from stadimeter.config.files import is_file
from stadimeter.config.findings import Finding, did_you_mean_or_list, format_value
from stadimeter.config.plugins import RefusesMotion, StatesLatency, StopsByItself, marked_options
from stadimeter.config.rule_test_tables import (
    OF_ACTUATORS,
    OF_BASES,
    OF_OUTPUTS,
    OF_RULES,
    ExpectTable,
    InputTable,
    RuleTest,
    RuleTestTable,
)
from stadimeter.config.rules.compiled import CompiledRule
from stadimeter.config.secrets import secret_warnings
from stadimeter.config.sun import sun_times_s
from stadimeter.config.toml_lines import KeyPath, SourceSpan
from stadimeter.config.units import TAKEN, PinMark, validation_context
from stadimeter.core.conditions.compounds import depends_on, leaves, targets_of
from stadimeter.core.conditions.schedule import ScheduleCondition
from stadimeter.core.observation import MonthDay, WallTime
from stadimeter.core.rule import AlarmRule, FollowRule, LostPolicy
from stadimeter.operator_actions import OperatorAction

# Mistakes in the tests of a configuration: what one table does not say by itself.


def read_tests(draft: Draft, file: Path, spans: Mapping[KeyPath, SourceSpan]) -> None:
    """Add the tests of a configuration to its draft, and what makes them unusable."""
    tables = draft.table["tests"]
    if not isinstance(tables, list):
        message = "'tests' is not a list of tables"
        draft.findings.append(Finding(("tests",), message, "write it as [[tests]]", "bad-value"))
        return
    for position, table in enumerate(tables):
        at: KeyPath = ("tests", position)
        if not isinstance(table, Mapping):
            message = f"{format_value(table)} is not a table"
            draft.findings.append(Finding(at, message, "write it below [[tests]]", "bad-value"))
        elif read := validate(RuleTestTable, table, at, validation_context(file), draft.findings):
            name = read.name or f"test {position + 1}"
            draft.tests[position] = RuleTest(name=name, line=spans[at].line, input=read.input, expect=read.expect)
    draft.findings += _mistakes(draft)


def rule_test_warnings(draft: Draft) -> Iterator[Finding]:
    """Find tests that cannot be run here, though the configuration can."""
    for position, test in draft.tests.items():
        journal = test.input.journal
        if journal is not None and not is_file(journal):
            hint = "record one with `stadimeter run CONFIG --journal FILE`; until then the test fails"
            yield Finding(("tests", position, "input", "journal"), f"there is no recording {journal}", hint)


def _mistakes(draft: Draft) -> Iterator[Finding]:
    for position, test in draft.tests.items():
        at: KeyPath = ("tests", position)
        yield from _input(draft, (*at, "input"), test.input)
        for subject in test.expect:
            yield from _expected(draft, (*at, "expect", subject), test.expect[subject], subject)


def _input(draft: Draft, at: KeyPath, given: InputTable) -> Iterator[Finding]:
    measured, rules = draft.measured_names, tuple(rule_names(draft))
    named = [((*at, "targets", name), "target", name, measured) for name in given.targets or ()]
    named += [((*at, "target"), "target", given.target, measured)] if given.target is not None else []
    for index, table in enumerate(given.operator):
        named += [((*at, "operator", index, "rule"), "rule", table.rule, rules)] if table.rule else []
    for path, kind, name, known in named:
        if name not in known:
            yield Finding(path, f"there is no {kind} '{name}'", did_you_mean_or_list(name, known))
    of_camera = draft.names("targets")
    if len(of_camera) > 1 and given.journal is None and given.target is None and given.targets is None:
        message = f"which of the targets {', '.join(of_camera)} moves?"
        yield Finding((*at, "target"), message, f'add target = "{measured[0]}", or targets.NAME for each')


def _expected(draft: Draft, at: KeyPath, expected: ExpectTable, subject: str) -> Iterator[Finding]:
    rules, outputs = tuple(rule_names(draft)), draft.output_names
    if subject not in (known := [*rules, *outputs]):
        yield Finding(at, f"there is no rule and no output '{subject}'", did_you_mean_or_list(subject, known))
        return
    fitting: list[str] = [*OF_RULES] if subject in rules else []
    if subject in outputs:
        fitting += [*(OF_BASES if subject == BASE_NAME else OF_ACTUATORS), *OF_OUTPUTS]
    for key in sorted(expected.model_fields_set - set(fitting)):
        hint = f"of '{subject}' these can be expected: {', '.join(fitting)}"
        yield Finding((*at, key), f"'{key}' cannot be expected of '{subject}'", hint)


# Three frames at 30 a second: with less, every hiccup of a network stops the outputs.
LEFT_FOR_FRAMES_S = 0.1

# A robot at 0.5 m/s that drives on for longer goes more than a quarter of a metre.
MAX_AUTO_STOP_S = 0.5


def warning_findings(draft: Draft) -> Iterator[Finding]:
    """Find what to look at again in a configuration without errors."""
    yield from dict.fromkeys(finding for check in _CHECKS for finding in check(draft))


# Two rules that ask one output for different things, rules that do nothing, and schedules that never come -------------


def _contests(draft: Draft) -> Iterator[Finding]:
    """Compare alarms that drive one output, two at a time, by the limits on one figure of each."""
    by_output: dict[str, list[tuple[CompiledRule, AlarmRule]]] = defaultdict(list)
    for each in draft.compiled:
        if isinstance(each.rule, AlarmRule) and each.rule.output is not None and not each.rule.observe:
            by_output[each.rule.output].append((each, each.rule))
    for output, rivals in by_output.items():
        for pair in combinations(rivals, 2):
            (loser, weak), (winner, strong) = sorted(pair, key=lambda rival: rival[1].priority)
            if loser.section == winner.section:
                continue
            if weak.priority == strong.priority:
                yield from _badly_combined(draft, *pair)
            elif _covers(strong, weak):
                message = f"wherever '{loser.section}' holds, '{winner.section}' holds too and wins '{output}'"
                hint = f"give '{loser.section}' the higher priority, or let '{winner.section}' hold less often"
                yield Finding(loser.path, message, hint, "shadowed")


def _badly_combined(
    draft: Draft, one: tuple[CompiledRule, AlarmRule], other: tuple[CompiledRule, AlarmRule]
) -> Iterator[Finding]:
    (first, _), (at, rule) = one, other
    rules, table = (one[1], rule), draft.output_tables.get(rule.output or "")
    if table is None or rule.output == BASE_NAME or "combine" in table.model_fields_set:
        return
    is_mixed = all(each.pattern for each in rules) and not are_apart(one[1].condition, rule.condition)
    if is_mixed or {0.0} < {each.level for each in rules}:
        why = "both have a pattern, and these mix" if is_mixed else "the highest level counts, so level 0 never does"
        message = f"'{first.section}' and '{at.section}' drive '{rule.output}' with one priority: {why}"
        yield Finding(at.at("priority"), message, "give the one that shall win a higher priority", "equal-priority")


def _covers(winner: AlarmRule, loser: AlarmRule) -> bool:
    """Check whether an alarm is active wherever another one is: as soon, and with nothing that keeps it from acting."""
    limits = limits_on_one_figure(winner.condition, loser.condition)
    if limits is None or winner.on_delay != loser.on_delay or winner.off_delay_s < loser.off_delay_s:
        return False
    if winner.suppress_when is not None or winner.at_start == "announce":
        return False
    if loser.latch or loser.lost.policy is LostPolicy.ASSERT:
        return False  # it can be active where its condition does not hold
    (low, high), (least, most) = limits
    return low <= least and high >= most


def _rules_matter(draft: Draft) -> Iterator[Finding]:
    if not (draft.names("rules") or draft.landmarks):
        hint = "add one, such as [rules.near]"
        yield Finding(("rules",), "there is no rule, so nothing is ever done", hint, "no-rules")
    asked_for = {name for _, written in written_conditions(draft) for name in depends_on(written.condition)}
    for each in draft.compiled:
        rule = draft.rules[each.section]
        does_something = rule.actuator or rule.steps or rule.observe or each.rule.name in asked_for
        if not does_something and "messenger" not in draft.table:
            message = f"nothing reports the alert '{each.section}': it drives nothing, and there is no messenger"
            yield Finding(each.path, message, "add an actuator to it, or a section [messenger]", "unheard")


def _outputs_used(draft: Draft) -> Iterator[Finding]:
    acting = [rule for rule in draft.rules.values() if not rule.observe]
    used = {rule.actuator for rule in acting} | {step.actuator for rule in acting for step in rule.escalation}
    told = {step.notify for rule in draft.rules.values() for step in rule.steps}
    unused = [(output_path(name), name) for name in draft.output_names if name not in used]
    unused += [(("notifiers", name), name) for name in draft.names("notifiers") if name not in told]
    for path, name in unused if draft.rules else ():
        yield Finding(path, f"no rule uses '{name}'", "name it in a rule, or leave it out", "output-unused")


def _motion_blind(draft: Draft) -> Iterator[Finding]:
    """Find rules that stop a base for one target while it follows another, and do not say what to do when blind."""
    follows = [each.rule for each in draft.compiled if isinstance(each.rule, FollowRule) and not each.rule.observe]
    for each in draft.compiled:
        rule = each.rule
        if not isinstance(rule, AlarmRule) or rule.output != BASE_NAME or rule.observe:
            continue
        if rule.lost.policy is not LostPolicy.HOLD or "policy" in each.table.get("lost", {}):
            continue
        others = [follow.name for follow in follows if targets_of(rule.condition) - {follow.target}]
        for other in others[:1]:
            message = f"without its target '{rule.name}' stays as it was, and '{other}' may drive the base all the same"
            hint = 'write lost = { policy = "assert" } if not seeing it means danger, else { policy = "hold" }'
            yield Finding(each.at("lost"), message, hint, "motion-blind")


def _empty_days(draft: Draft) -> Iterator[Finding]:
    """Count the days of the year ahead on which a schedule by the sun never comes."""
    place = draft.place
    if place is None or place.latitude is None or place.longitude is None:
        return
    today = datetime.combine(datetime.now(place.zone), datetime.min.time())
    days = [today + timedelta(days=number) for number in range(366)]
    for _, written in written_conditions(draft):
        for leaf in leaves(written.condition):
            if not isinstance(leaf, ScheduleCondition) or not leaf.is_by_sun:
                continue
            may, empty = [day for day in days if leaf.begins_on(MonthDay(day.month, day.day))], []
            for day in may:
                rises_s, sets_s = sun_times_s(place.latitude, place.longitude, place.zone, day.date())
                wall = WallTime(second_of_day=0.0, weekday=0, sunrise_s=rises_s, sunset_s=sets_s)
                low_s, high_s = leaf.interval_s(wall) or (0.0, 0.0)
                empty += [f"{day:%m-%d}"] if low_s >= high_s else []
            if empty:
                which = f"from {empty[0]} to {empty[-1]}" if len(empty) > 1 else empty[0]
                message = f"this never comes on {len(empty)} of the next {len(may)} days on which it may hold, {which}"
                hint = "its end comes first then; write another time if it shall hold on these days too"
                yield Finding(written.path, message, hint, "empty-days")


# Drivers that cannot serve what is asked, and parts without effect ----------------------------------------------------


def _leases_long_enough(draft: Draft) -> Iterator[Finding]:
    age_s = draft.safety.max_frame_age
    for name, table in draft.output_tables.items():
        if table.lease < age_s:
            message = f"the lease {table.lease:g} s is shorter than max_frame_age: it stops on frames still good"
            hint = f"make it {age_s:g} s or longer, or safety.max_frame_age shorter"
            yield Finding((*output_path(name), "lease"), message, hint, "lease-too-short")


def _camera_for_motion(draft: Draft) -> Iterator[Finding]:
    """Find a camera whose frames nothing moves on, or that are too old for motion when they arrive, or nearly."""
    moves = bool(draft.rules) and (draft.base is not None or bool(draft.actuators))
    if draft.camera is None or not moves:
        return
    options = draft.camera.options
    if isinstance(options, RefusesMotion):
        for key, why in options.refuse_motion().items():
            yield Finding(("camera", key), why, "alarms and messages work without", "not-for-motion")
    latency_s = options.frame_latency_s() if isinstance(options, StatesLatency) else 0.0
    longest_s = draft.safety.max_frame_age
    if latency_s > 0 and longest_s - latency_s < LEFT_FOR_FRAMES_S:
        message = (
            f"pictures are {1e3 * latency_s:.0f} ms old when they arrive, and safety.max_frame_age is "
            f"{1e3 * longest_s:.0f} ms: outputs stop before the next picture"
        )
        hint = "a faster stream or a shorter exposure helps; with a longer max_frame_age it drives on for longer"
        yield Finding(("camera", "latency"), message, hint, "latency-too-long")


def _runs_on(draft: Draft) -> Iterator[Finding]:
    """Find a base that drives on for long, or for ever, when this computer is gone."""
    if draft.base is None or draft.base.is_simulated or not isinstance(draft.base.options, StopsByItself):
        return
    after_s, hint = draft.base.options.stops_by_itself_after_s(), draft.base.options.auto_stop_advice
    at = ("base", "auto_stop" if "auto_stop" in draft.table.get("base", {}) else "driver")
    if after_s > MAX_AUTO_STOP_S:
        for_how_long = "for ever: it never stops by itself" if math.isinf(after_s) else f"for {after_s:g} s"
        message = f"if this computer dies or a cable comes off, this base drives on {for_how_long}"
        code = "base-never-stops-by-itself" if math.isinf(after_s) else "base-stops-late"
        yield Finding(at, message, hint, code)


def _taken_pins(draft: Draft) -> Iterator[Finding]:
    for at, part in draft.drivers.items():
        for key, pin in marked_options(part.options, PinMark):
            if pin in TAKEN:
                message = f"GPIO {pin} is also for {TAKEN[pin]}"
                yield Finding((*at, *key), message, "take one of GPIO 4 to 13 or 16 to 27, such as 18", "pin-taken")


def _clips_written(draft: Draft) -> Iterator[Finding]:
    for name, table in draft.button_tables.items():
        for key in ("press", "hold"):
            if draft.black_box is None and getattr(table, key) == OperatorAction.CLIP:
                message = f"the button '{name}' orders a clip, and there is no black box"
                yield Finding(("buttons", name, key), message, "add the section [black_box]", "no-black-box")


def _lens_centred(draft: Draft) -> Iterator[Finding]:
    if draft.camera_model is not None and (words := draft.camera_model.off_centre_words):
        yield Finding(("camera", "model"), words, "calibrate with a board", "off-centre")


def _networks_named(draft: Draft) -> Iterator[Finding]:
    """Find targets that leave the network to the sensor of a camera that has none."""
    if draft.camera is None or getattr(draft.camera.options, "network", None) is not None:
        return
    for target in draft.targets:
        if getattr(target.options, "model", "") is None:
            message = "no network is named, and the camera has none on its sensor"
            yield Finding(("targets", target.name), message, 'add such as model = "yolox_nano.onnx"', "model-missing")


def _feet_cut(draft: Draft) -> Iterator[Finding]:
    for target in draft.targets:
        table = draft.target_tables.get(target.name)
        by_network = hasattr(target.options, "box_sigma") and not is_size_unknown(target)
        if by_network and table is not None and table.on_floor is not False:
            message = "boxes by a network cut the feet, so the floor makes distances too long"
            hint = "leave on_floor out: its size is known"
            yield Finding(("targets", target.name, "on_floor"), message, hint, "feet-cut")


_CHECKS: tuple[Callable[[Draft], Iterator[Finding]], ...] = (
    _contests, _networks_named, _feet_cut, _rules_matter, _motion_blind, _empty_days,
    _outputs_used, _leases_long_enough, _camera_for_motion, _runs_on, _taken_pins, _clips_written, _lens_centred,
    rule_test_warnings, secret_warnings,
)  # fmt: skip
