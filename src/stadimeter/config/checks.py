"""Findings in a configuration that loads: what does not fit together, and what is hardly meant."""

from __future__ import annotations

import math
import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from datetime import datetime, timedelta
from graphlib import CycleError, TopologicalSorter
from itertools import combinations
from pathlib import Path
from typing import Any

from stadimeter.config.draft import BASE_NAME, Draft, output_path
from stadimeter.config.driver_tables import validate
from stadimeter.config.extras import missing
from stadimeter.config.files import is_file
from stadimeter.config.findings import Finding, did_you_mean, did_you_mean_or_list, format_value
from stadimeter.config.plugins import DriverChoice, RefusesMotion, StatesLatency, StopsByItself, marked_options
from stadimeter.config.rule_test_tables import (
    OF_ACTUATORS,
    OF_BASES,
    OF_OUTPUTS,
    OF_RULES,
    InputTable,
    RuleTest,
    RuleTestTable,
)
from stadimeter.config.rules.compiled import CompiledRule, WrittenCondition
from stadimeter.config.rules.tables import KINDS, ONE_KIND, RuleTable
from stadimeter.config.secrets import secret_warnings
from stadimeter.config.sun import sun_times_s
from stadimeter.config.toml_lines import KeyPath, SourceSpan
from stadimeter.config.units import TAKEN, PinMark, PortMark, validation_context
from stadimeter.core.conditions.compounds import AllOf, Condition, depends_on, leaves, targets_of
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.limits import LimitsCondition
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.conditions.quantities import QUANTITIES
from stadimeter.core.conditions.remembered import RememberedCondition
from stadimeter.core.conditions.schedule import ScheduleCondition
from stadimeter.core.decision import Severity
from stadimeter.core.observation import MonthDay, WallTime
from stadimeter.core.rule import AlarmRule, FollowRule, LostPolicy, gate_of
from stadimeter.core.rules.follow import GAIN_SHARE, MAX_GAIN_SHARE, RESPONSE_S
from stadimeter.operator_actions import OperatorAction

# Contradictions between the parts of a configuration: names that stand for nothing, and parts that do not fit.
#
# What one table says by itself is checked where that table is declared.

# Nothing acts on a frame that is older than this. A robot at 0.5 m/s has gone half a metre by then.
MAX_BLIND_S = 1.0

# The guard looks every 20 ms; a busy small computer has been seen to keep it waiting for 100 ms.
WATCHDOG_AFTER_LEASE_S = 0.2

# The age of a frame of a camera without a stated latency when it is acted on: exposure, transfer and one period.
USUAL_AGE_S = 0.05

# The options of cameras that say which one is meant; the last of a simulated one.
_WHICH = ("device", "device_file", "camera", "path", "paths", "baseline")

# What only an alarm can be told; a ramp, or a rule that follows, is kept quiet like one.
_OF_ALARMS = {OperatorAction.ACKNOWLEDGE, OperatorAction.RESET}


def error_findings(draft: Draft) -> Iterator[Finding]:
    """Find what makes a configuration unusable, in what could be read of it."""
    found = (finding for check in _CHECKS for finding in check(draft))
    yield from dict.fromkeys(found)  # a rule with several targets says the same of each


def written_conditions(draft: Draft) -> Iterator[tuple[CompiledRule, WrittenCondition]]:
    """Go through the conditions of all rules."""
    return ((each, written) for each in draft.compiled for written in each.conditions())


# Names that stand for nothing, and rules that wait for themselves ---------------------------------------------------


def _references(draft: Draft) -> Iterator[Finding]:
    known: dict[str, tuple[str, ...]] = {
        "actuator": draft.output_names,
        "notifier": draft.names("notifiers"),
        "target": draft.target_names,
        "figure": draft.names("figures"),
        "rule": tuple(rule_names(draft)),
    }
    for named in (_named_by_rules, _named_in_conditions, _named_by_others):
        for path, kind, name in named(draft):
            if name is None or name in known[kind]:
                continue
            hint = draft.target_hint(name) if kind == "target" else did_you_mean_or_list(name, known[kind])
            if name == BASE_NAME or not hint:
                hint = f"add a section [{name if name == BASE_NAME else f'{kind}s.{name}'}]"
            yield Finding(path, f"there is no {kind} '{name}'", hint, "unknown-name")


def rule_names(draft: Draft) -> Iterator[str]:
    """Go through the names of all rules, also of those that could not be read."""
    for section, table in draft.tables("rules").items():
        several = draft.rules[section].targets if section in draft.rules else table.get("targets")
        names = [f"{section}:{each}" for each in several] if isinstance(several, list) else []
        yield from names if section in draft.rules and names else (section, *names)


def _named_by_rules(draft: Draft) -> Iterator[tuple[KeyPath, str, str | None]]:
    for section, rule in draft.rules.items():
        at = ("rules", section)
        yield (*at, "actuator"), "actuator", rule.actuator
        yield (*at, "target"), "target", rule.target
        yield from (((*at, "targets"), "target", each) for each in rule.targets or ())
        if rule.follow is not None and rule.follow.slow is not None:
            yield (*at, "follow", "slow", "target"), "target", rule.follow.slow.target
        yield (*at, "notify"), "notifier", rule.notify
        for number, step in enumerate(rule.escalation):
            yield (*at, "escalation", number, "actuator"), "actuator", step.actuator
            yield (*at, "escalation", number, "notify"), "notifier", step.notify


def _named_in_conditions(draft: Draft) -> Iterator[tuple[KeyPath, str, str | None]]:
    for _, written in written_conditions(draft):
        for leaf in leaves(written.condition):
            names = [*(("rule", each) for each in leaf.rules_named), *(("target", each) for each in leaf.targets_named)]
            if isinstance(leaf, RememberedCondition) and leaf.name:
                names.append(("figure", leaf.name))
            places = [(_place_of(name, written.table, written.path), kind, name) for kind, name in names]
            yield from ((path, kind, name) for path, kind, name in places if path)


def _named_by_others(draft: Draft) -> Iterator[tuple[KeyPath, str, str | None]]:
    for name, figure in draft.figures.items():
        yield ("figures", name, "target"), "target", figure.target
    for name, table in draft.sensor_tables.items():
        yield ("sensors", name, "confirms"), "target", table.confirms or None
        yield ("sensors", name, "stop_below"), "actuator", None if table.stop_below is None else BASE_NAME


def _place_of(name: str, value: object, at: KeyPath) -> KeyPath | None:
    """Return where a name stands in a condition; None if it does not, and so is of the rule or of its table."""
    if value == name:
        return at
    inner: Any = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list) else ()
    return next((found for key, each in inner if (found := _place_of(name, each, (*at, key)))), None)


def _cycles(draft: Draft) -> Iterator[Finding]:
    """Find a ring of rules, each of which asks whether the next is active."""
    section_of = {each.rule.name: each.section for each in draft.compiled}
    asks: dict[str, dict[str, KeyPath]] = defaultdict(dict)
    for each, written in written_conditions(draft):
        asks[each.section] |= {section_of.get(name, name): written.path for name in depends_on(written.condition)}
    try:
        TopologicalSorter(asks).prepare()
    except CycleError as error:
        # Each of them asks for the one before it, and the last is the first again.
        ring: list[str] = error.args[1][::-1]
        names = " → ".join(f"'{name}'" for name in ring)
        message = f"these rules wait for each other: {names}"
        yield Finding(asks[ring[0]][ring[1]], message, "take one of them out of the ring", "reference-cycle")


def _topics(draft: Draft) -> Iterator[Finding]:
    for section, rule in draft.rules.items() if "messenger" not in draft.table else ():
        for number, step in enumerate(rule.escalation):
            if step.topic is not None:
                message = f"nothing sends '{step.topic}': there is no section [messenger]"
                at = ("rules", section, "escalation", number, "topic")
                yield Finding(at, message, "add one, or notify people with notify", "unknown-name")


def _one_target_named(draft: Draft) -> Iterator[Finding]:
    if len(draft.names("targets")) < 2:
        return
    names = ", ".join(draft.tables("targets"))
    needs = {each.section for each in draft.compiled if each.needs_target}
    rules = {name: rule for name, rule in draft.rules.items() if name in needs}
    vague = [("rules", name) for name, rule in rules.items() if rule.target is None and not rule.targets]
    vague += [("figures", name) for name, figure in draft.figures.items() if figure.target is None]
    for at in vague:
        message = f"which of the targets {names} is '{at[1]}' about?"
        yield Finding((*at, "target"), message, draft.any_target_hint, "target-missing")


def _names_once(draft: Draft) -> Iterator[Finding]:
    taken = {member: group for group, members in draft.groups.items() for member in members}
    taken |= {each.name: each.name.rpartition("-")[0] for each in draft.nearest}
    for at in [(section, name) for section in ("targets", "sensors") for name in draft.tables(section)]:
        other = f"[targets.{taken[at[1]]}] stands for" if at[1] in taken else ""
        if other or (at[0] == "sensors" and at[1] in draft.names("targets")):
            message = f"'{at[1]}' is also the name of a target{f' that {other}' if other else ''}"
            yield Finding(at, message, "give one of them another name", "name-twice")


def _rules_do_something(draft: Draft) -> Iterator[Finding]:
    for name, table in draft.tables("rules").items():
        is_misspelt = any(did_you_mean(key, KINDS) for key in table if key not in RuleTable.model_fields)
        if not is_misspelt and table.keys().isdisjoint(KINDS):
            hint = f'write {ONE_KIND}, such as when = {{ below = "50 cm" }}'
            yield Finding(("rules", name), "the rule does nothing", hint, "missing-key")


def _buttons(draft: Draft) -> Iterator[Finding]:
    """Check that what buttons are for is there, and may be shelved for as long as they ask."""
    for button, table in draft.button_tables.items():
        asked, at = {table.press, table.hold}, ("buttons", button)
        only_alarms = not asked.isdisjoint(_OF_ALARMS)
        rules = {each.rule.name: each.rule for each in draft.compiled}
        meant = {name: gate_of(rule) for name, rule in rules.items() if isinstance(rule, AlarmRule) or not only_alarms}
        unread = draft.tables("rules").keys() - draft.rules.keys()
        if table.rule and table.rule not in {*meant, *unread}:
            hint = did_you_mean_or_list(table.rule, meant)
            yield Finding((*at, "rule"), f"there is no alarm '{table.rule}'", hint, "unknown-name")
        longest_s = meant[table.rule].shelve_max_s if table.rule in meant else math.inf
        if "shelve" in asked and longest_s < (table.shelve_for or 1.0):
            message = f"'{table.rule}' may be shelved for {longest_s:g} s at most (shelve_max)"
            key = "rule" if table.shelve_for is None else "shelve_for"
            yield Finding((*at, key), message, "shorten shelve_for, or raise shelve_max", "shelve-too-long")


# Conditions that need what is not there, or never hold ----------------------------------------------------------------


def _conditions(draft: Draft) -> Iterator[Finding]:
    for _, written in written_conditions(draft):
        parts = written.condition.conditions if isinstance(written.condition, AllOf) else ()
        if any(are_apart(*pair) for pair in combinations(parts, 2)):  # below `any` or `not` that does no harm
            message = "two limits of this on one figure exclude each other, so it never holds"
            yield Finding(written.path, message, "write any in place of all, or change a limit", "never-true")
        for leaf in leaves(written.condition):
            if isinstance(leaf, ScheduleCondition) and leaf.is_by_sun:
                yield from _needs_place(draft, written.path)
            if isinstance(leaf, RememberedCondition) and (figure := draft.figures.get(leaf.name)) is not None:
                unit = QUANTITIES[figure.of].unit
                if leaf.unit != unit:
                    message = f"the figure '{leaf.name}' is in {unit}, and not in {leaf.unit}"
                    yield Finding(written.path, message, f"write its limits in {unit}", "bad-value")


def limits_on_one_figure(one: Condition, other: Condition) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Return the limits of two simple conditions on one figure; None for others."""
    if not (isinstance(one, LimitsCondition) and isinstance(other, LimitsCondition)):
        return None
    is_one_figure = (one.noun, one.targets_named) == (other.noun, other.targets_named)
    return (one.limits, other.limits) if is_one_figure else None


def are_apart(one: Condition, other: Condition) -> bool:
    """Check whether two conditions have limits on one figure that exclude each other."""
    found = limits_on_one_figure(one, other)
    return found is not None and max(low for low, _ in found) >= min(high for _, high in found)


def _needs_place(draft: Draft, at: KeyPath) -> Iterator[Finding]:
    if draft.place is None or draft.place.latitude is None or draft.place.longitude is None:
        hint = "add a section [place] with latitude and longitude, in degrees"
        yield Finding(at, "where the sun rises and sets is not said", hint, "place-missing")
    if trouble := missing("sun"):
        yield Finding(at, f"when the sun rises and sets cannot be computed: {trouble}", "", "library-missing")


def _heights(draft: Draft) -> Iterator[Finding]:
    """Find heights above a floor, and targets on it, where it is not known how far below the camera it is."""
    standing = [name for name, table in draft.target_tables.items() if table.on_floor is not False]
    on_floor = [("targets", name, "on_floor") for name in standing]
    if on_floor and draft.base is not None and getattr(draft.base.options, "tilt", None) is not None:
        message = "the base tilts the camera, so its tilt above the floor is not known"
        yield Finding((BASE_NAME, "tilt"), message, "leave on_floor out, or the tilt of the base", "floor-unseen")
    if draft.camera_table.height is not None:
        return
    asks: list[KeyPath] = [*on_floor]
    asks += [("figures", name, "of") for name, figure in draft.figures.items() if figure.of == "height"]
    asks += [("rules", name, "ramp") for name, rule in draft.rules.items() if rule.ramp and rule.ramp.of == "height"]
    for _, written in written_conditions(draft):
        quantities = [leaf.quantity for leaf in leaves(written.condition) if isinstance(leaf, FigureCondition)]
        asks += [written.path] if "height" in quantities else []
    for path in asks:
        hint = 'measure it and add such as height = "30 cm" to [camera]'
        yield Finding(path, "how high the camera is above the floor is not known", hint, "height-unknown")


# Parts that do not fit each other -------------------------------------------------------------------------------------


def _outputs_fit(draft: Draft) -> Iterator[Finding]:
    for name, rule in draft.rules.items():
        at = ("rules", name, "actuator")
        if rule.follow and rule.actuator != BASE_NAME:
            yield Finding(at, "only the base can follow", f'write actuator = "{BASE_NAME}"', "output-unfit")
        drives = rule.follow is not None and (rule.follow.linear_max_mps or rule.follow.reverse_max_mps)
        if drives and draft.base is not None and draft.base.options.only_turns:
            message = f"the base '{draft.base.driver}' turns and drives nowhere, and this rule shall drive it"
            yield Finding(("rules", name, "follow"), message, 'write max_speed = "0 m/s"', "output-unfit")
        if rule.ramp and rule.actuator in {None, BASE_NAME}:
            hint = 'write such as actuator = "motor", or follow in place of ramp'
            yield Finding(at, "a ramp needs an actuator to drive, and cannot drive the base", hint, "output-unfit")


def _safety_first(draft: Draft) -> Iterator[Finding]:
    """Find safety rules that another rule goes before: on a base, one that drives it, since every alarm stops it."""
    for safety in (each.rule for each in draft.compiled if each.rule.severity is Severity.SAFETY):
        rivals = [each for each in draft.compiled if each.rule.output == safety.output is not None]
        for each in rivals:
            stops_too = safety.output == BASE_NAME and isinstance(each.rule, AlarmRule)
            if each.rule.priority > safety.priority and not stops_too and each.rule.severity is not Severity.SAFETY:
                message = f"'{each.rule.name}' goes before the safety rule '{safety.name}' and drives '{safety.output}'"
                hint = f"give '{safety.name}' the higher priority, such as priority = {each.rule.priority + 100}"
                yield Finding(each.at("priority"), message, hint, "shadowed")


def _used_once(draft: Draft) -> Iterator[Finding]:
    """Find pins and serial ports that two drivers use; a port has several names below ``/dev/serial``."""
    users: dict[object, KeyPath] = {}
    for table, part in draft.drivers.items():
        pins = [((*table, *key), f"pin {pin}", pin) for key, pin in marked_options(part.options, PinMark)]
        ports = [
            ((*table, *key), f"serial port {port}", os.path.realpath(str(port)))
            for key, port in marked_options(part.options, PortMark)
        ]
        for path, what, identity in (*pins, *ports):
            if (first := users.setdefault(identity, path)) != path:
                by = " and by ".join(".".join(map(str, each)) for each in (first, path))
                yield Finding(path, f"{what} is used twice: by {by}", "each needs its own", "used-twice")


def _cameras(draft: Draft) -> Iterator[Finding]:
    """Find rules without a lens, one camera used as two, and targets of unknown size before a single one."""
    camera = draft.table.get("camera")
    first, second = draft.camera, draft.second_camera
    if second is None and draft.names("rules") and isinstance(camera, dict) and "model" not in camera:
        message = "rules need distances, and distances need a camera model"
        hint = 'run `stadimeter calibrate distance PICTURE@DISTANCE -o camera.toml` and add model = "camera.toml"'
        yield Finding(("camera", "model"), message, hint, "camera-model-missing")
    if first is not None and second is not None:
        if first.driver == second.driver and _which(first) == _which(second):
            hint = "name another device; where it is simulated, write baseline"
            yield Finding(("second_camera", "driver"), "this is the first camera once more", hint, "used-twice")
        if draft.camera_table.model is not None:
            message = "the stereo file of [second_camera] has the lenses of both cameras"
            yield Finding(("camera", "model"), message, "leave it out", "used-twice")
        return
    for target in draft.targets:
        table = draft.target_tables.get(target.name)
        if table is not None and not table.on_floor and _is_size_unknown(target):
            hint = "add a section [second_camera], write on_floor for what stands on the floor, or measure its size"
            message = "one camera measures no distance of a thing whose size is not known"
            yield Finding(("targets", target.name), message, hint, "size-unknown")


def _which(camera: DriverChoice) -> list[object]:
    """Return the device of a camera, which has several names; a number is one of them."""
    options = [getattr(camera.options, key, None) for key in _WHICH]
    paths = [f"/dev/video{each}" if isinstance(each, int) else each for each in options]
    return [os.path.realpath(each) if isinstance(each, str) and each.startswith("/dev/") else each for each in paths]


def _is_size_unknown(target: DriverChoice) -> bool:
    sigmas = (getattr(target.options, key, None) for key in ("tolerance", "height", "width", "eye_distance"))
    return any(getattr(each, "sigma_m", each) == math.inf for each in sigmas)


def _world_around(draft: Draft) -> Iterator[Finding]:
    for table, part in draft.drivers.items():
        if "world" not in draft.table and part.options.needs_world:
            key = "detector" if table[0] == "targets" else "driver"
            message = f"'{part.driver}' needs a simulated world to be in, and there is no section [world]"
            yield Finding((*table, key), message, "add one; it may be empty", "world-missing")


# Times that let outputs act blindly, and loops that swing -------------------------------------------------------------


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
    least_s = max((table.lease for table in draft.output_tables.values()), default=0.0) + WATCHDOG_AFTER_LEASE_S
    limit_s = draft.safety.watchdog
    if limit_s is not None and limit_s < least_s:
        message = f"{limit_s:g} s would end a program that still drives its outputs as it should"
        hint = f"write {least_s:g} s or more, {WATCHDOG_AFTER_LEASE_S:g} s after the longest lease, or leave it out"
        yield Finding(("safety", "watchdog"), message, hint, "watchdog-too-short")


def _loops_stable(draft: Draft) -> Iterator[Finding]:
    """Find gains of rules that follow which are too much for the delay from the picture to the wheels."""
    options = draft.camera.options if draft.camera is not None else None
    latency_s = options.frame_latency_s() if isinstance(options, StatesLatency) else 0.0
    for name, rule in draft.rules.items():
        if rule.follow is None:
            continue
        delay_s = rule.follow.delay_s or max(latency_s, USUAL_AGE_S) + RESPONSE_S
        for key, gain_per_s in (("gain", rule.follow.gain_per_s), ("turn_gain", rule.follow.turn_gain_per_s)):
            if gain_per_s is not None and gain_per_s * delay_s > MAX_GAIN_SHARE:
                message = (
                    f"{key} {gain_per_s:g} with {1e3 * delay_s:.0f} ms from the picture to the wheels: above "
                    f"{MAX_GAIN_SHARE:g} gain times delay, the base swings ever wider"
                )
                hint = f"leave it out, or write {GAIN_SHARE / delay_s:.2g}"
                yield Finding(("rules", name, "follow", key), message, hint, "gain-unstable")


_CHECKS: tuple[Callable[[Draft], Iterator[Finding]], ...] = (
    _rules_do_something, _references, _cycles, _topics, _one_target_named, _names_once, _buttons, _conditions, _heights,
    _outputs_fit, _safety_first, _used_once, _cameras, _world_around, _never_blind_for_long, _watchdog_after_leases,
    _loops_stable,
)  # fmt: skip


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
    names: dict[str, int] = {}
    for position, test in draft.tests.items():
        at: KeyPath = ("tests", position)
        if names.setdefault(test.name, position) != position:
            message = f"two tests are called '{test.name}'"
            yield Finding((*at, "name"), message, "give each a name of its own")
        yield from _input(draft, (*at, "input"), test.input)
        for subject in test.expect:
            yield from _expected(draft, (*at, "expect", subject), test, subject)


def _input(draft: Draft, at: KeyPath, given: InputTable) -> Iterator[Finding]:
    measured, rules = draft.measured_names, tuple(rule_names(draft))
    named = [((*at, "targets", name), "target", name, measured) for name in given.targets or ()]
    named += [((*at, "target"), "target", given.target, measured)] if given.target is not None else []
    for index, table in enumerate(given.operator):
        named += [((*at, "operator", index, "rule"), "rule", table.rule, rules)] if table.rule else []
        if table.at > given.moving_s > 0:
            yield _too_late((*at, "operator", index, "at"), table.at, given.moving_s)
    for path, kind, name, known in named:
        if name not in known:
            yield Finding(path, f"there is no {kind} '{name}'", did_you_mean_or_list(name, known))
    of_camera = draft.names("targets")
    if len(of_camera) > 1 and given.journal is None and given.target is None and given.targets is None:
        message = f"which of the targets {', '.join(of_camera)} moves?"
        yield Finding((*at, "target"), message, f'add target = "{measured[0]}", or targets.NAME for each')


def _expected(draft: Draft, at: KeyPath, test: RuleTest, subject: str) -> Iterator[Finding]:
    rules, outputs, expected = tuple(rule_names(draft)), draft.output_names, test.expect[subject]
    if subject not in (known := [*rules, *outputs]):
        yield Finding(at, f"there is no rule and no output '{subject}'", did_you_mean_or_list(subject, known))
        return
    fitting: list[str] = [*OF_RULES] if subject in rules else []
    if subject in outputs:
        fitting += [*(OF_BASES if subject == BASE_NAME else OF_ACTUATORS), *OF_OUTPUTS]
    for key in sorted(expected.model_fields_set - set(fitting)):
        hint = f"of '{subject}' these can be expected: {', '.join(fitting)}"
        yield Finding((*at, key), f"'{key}' cannot be expected of '{subject}'", hint)
    for key in sorted(expected.model_fields_set & {"raised_within", "cleared_within"}):
        instead = f"write {key.partition('_')[0]}_by with a time from the start of the test"
        if test.input.journal is not None:
            yield Finding((*at, key), "where the target truly was, a recording does not know", instead)
        elif not _is_on_distance(draft, subject):
            message = f"'{subject}' has no limit on the distance alone, so there is no moment at which it is crossed"
            yield Finding((*at, key), message, instead)
    for key, times in expected.moments().items() if test.input.moving_s else ():
        yield from (_too_late((*at, key), at_s, test.input.moving_s) for at_s in times if at_s > test.input.moving_s)


def _is_on_distance(draft: Draft, rule_name: str) -> bool:
    compiled = next((each for each in draft.compiled if rule_name in (each.rule.name, each.section)), None)
    if compiled is None:
        return True  # what could not be read has findings of its own
    condition = compiled.rule.condition if isinstance(compiled.rule, AlarmRule) else None
    return isinstance(condition, DistanceCondition) and condition.quantity == "distance"


def _too_late(at: KeyPath, at_s: float, end_s: float) -> Finding:
    return Finding(at, f"{at_s:g} s is after the end of the test at {end_s:g} s", "let the test last longer")


# Warnings: what is allowed in a configuration and hardly meant. `check` and a reload ask for them, a run does not.

# Three frames at 30 a second: with less, every hiccup of a network stops the outputs.
LEFT_FOR_FRAMES_S = 0.1

# A robot at 0.5 m/s that drives on for longer goes more than a quarter of a metre.
MAX_AUTO_STOP_S = 0.5


def warning_findings(draft: Draft) -> Iterator[Finding]:
    """Find what to look at again in a configuration without errors."""
    yield from dict.fromkeys(finding for check in (*_ABOUT_RULES, *_ABOUT_PARTS) for finding in check(draft))


def rule_warnings(draft: Draft, errors: Iterable[Finding]) -> Iterator[Finding]:
    """Find what to look at again in those rules of a configuration with errors that have none themselves."""
    wrong = {finding.path[:2] for finding in errors}
    found = () if ("rules",) in wrong else dict.fromkeys(each for check in _ABOUT_RULES for each in check(draft))
    yield from (each for each in found if each.path[0] == "rules" and each.path[:2] not in wrong)


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


_ABOUT_RULES: tuple[Callable[[Draft], Iterator[Finding]], ...] = (_contests, _rules_matter, _motion_blind, _empty_days)
_ABOUT_PARTS: tuple[Callable[[Draft], Iterator[Finding]], ...] = (
    _outputs_used, _leases_long_enough, _camera_for_motion, _runs_on, _taken_pins, _clips_written, _lens_centred,
    rule_test_warnings, secret_warnings,
)  # fmt: skip
