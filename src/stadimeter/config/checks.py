"""Contradictions between the parts of a configuration: names that stand for nothing, and parts that do not fit.

What one table says by itself is checked where that table is declared.
"""

from __future__ import annotations

import math
import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from itertools import combinations
from typing import Any

from stadimeter.config.draft import BASE_NAME, Draft, output_path
from stadimeter.config.extras import missing
from stadimeter.config.findings import Finding, did_you_mean, did_you_mean_or_list
from stadimeter.config.plugins import DriverChoice, StatesLatency, marked_options
from stadimeter.config.rules.compiled import CompiledRule, WrittenCondition
from stadimeter.config.rules.tables import KINDS, ONE_KIND, RuleTable
from stadimeter.config.toml_lines import KeyPath
from stadimeter.config.units import PinMark, PortMark
from stadimeter.core.conditions.compounds import AllOf, Condition, depends_on, leaves
from stadimeter.core.conditions.limits import LimitsCondition
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.conditions.quantities import QUANTITIES
from stadimeter.core.conditions.remembered import RememberedCondition
from stadimeter.core.conditions.schedule import ScheduleCondition
from stadimeter.core.conditions.sight import CountCondition
from stadimeter.core.decision import Severity
from stadimeter.core.rule import AlarmRule
from stadimeter.core.rules.follow import GAIN_SHARE, MAX_GAIN_SHARE, RESPONSE_S

# Nothing acts on a frame that is older than this. A robot at 0.5 m/s has gone half a metre by then.
MAX_BLIND_S = 1.0

# The guard looks every 20 ms; a busy small computer has been seen to keep it waiting for 100 ms.
WATCHDOG_AFTER_LEASE_S = 0.2

# The age of a frame of a camera without a stated latency when it is acted on: exposure, transfer and one period.
USUAL_AGE_S = 0.05


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
    for name, button in draft.button_tables.items():
        yield ("buttons", name, "rule"), "rule", button.rule or None
    for name, table in draft.sensor_tables.items():
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
    if len(draft.tables("targets")) < 2:
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


# Conditions that need what is not there, or never hold ----------------------------------------------------------------


def _conditions(draft: Draft) -> Iterator[Finding]:
    for _, written in written_conditions(draft):
        parts = written.condition.conditions if isinstance(written.condition, AllOf) else (written.condition,)
        if "suppress_when" not in written.path:  # what never suppresses does no harm
            yield from _counts(draft, written.path, parts)
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


def _counts(draft: Draft, at: KeyPath, parts: Iterable[Condition]) -> Iterator[Finding]:
    for part in parts:
        if isinstance(part, CountCondition) and (part.at_least or 0) > len(part.targets or draft.measured_names):
            message = f"at least {part.at_least} are asked for, and there are fewer, so it never holds"
            yield Finding(at, message, "ask for fewer, or have more targets", "never-true")


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
        if first.driver == second.driver and first.options == second.options:
            hint = "name another device; where it is simulated, write baseline"
            yield Finding(("second_camera", "driver"), "this is the first camera once more", hint, "used-twice")
        if draft.camera_table.model is not None:
            message = "the stereo file of [second_camera] has the lenses of both cameras"
            yield Finding(("camera", "model"), message, "leave it out", "used-twice")
        return
    for target in draft.targets:
        table = draft.target_tables.get(target.name)
        if table is not None and not table.on_floor and is_size_unknown(target):
            hint = "add a section [second_camera], write on_floor for what stands on the floor, or measure its size"
            message = "one camera measures no distance of a thing whose size is not known"
            yield Finding(("targets", target.name), message, hint, "size-unknown")


def is_size_unknown(target: DriverChoice) -> bool:
    """Check whether the size of a target is stated as unknown."""
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
    _rules_do_something, _references, _cycles, _topics, _one_target_named, _names_once, _conditions, _heights,
    _outputs_fit, _safety_first, _used_once, _cameras, _world_around, _never_blind_for_long, _watchdog_after_leases,
    _loops_stable,
)  # fmt: skip
