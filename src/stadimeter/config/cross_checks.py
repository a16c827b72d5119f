"""Contradictions between the parts of a configuration, each of which can be read by itself."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any

from stadimeter.config.analysis.bands import band_errors, holding_errors
from stadimeter.config.analysis.promises import promise_errors
from stadimeter.config.analysis.references import reference_errors
from stadimeter.config.analysis.subject import Subject, subject_of
from stadimeter.config.analysis.writers import shadow_errors
from stadimeter.config.draft import BASE_NAME, Draft
from stadimeter.config.findings import Finding, did_you_mean_or_list
from stadimeter.config.plugins import marked_options
from stadimeter.config.rules.checks import rule_findings, written_findings
from stadimeter.config.toml_lines import KeyPath
from stadimeter.config.units import PinMark, PortMark

# Nothing acts on a frame that is older than this. A robot at 0.5 m/s has gone half a metre by then.
MAX_BLIND_S = 1.0


def error_findings(draft: Draft) -> Iterator[Finding]:
    """Find what makes a configuration unusable, in what could be read of it."""
    for check in _CHECKS:
        yield from check(draft)
    subject = subject_of(draft)
    for analysis in _ANALYSES:
        yield from analysis(subject)


def _rules_by_themselves(draft: Draft) -> Iterator[Finding]:
    for name, table in draft.tables("rules").items():
        yield from written_findings(name, table)
    for name, rule in draft.rules.items():
        yield from rule_findings(name, rule)


def _targets_exist(draft: Draft) -> Iterator[Finding]:
    names = draft.names("targets")
    need_none = {each.section for each in draft.compiled if not each.needs_target}
    for rule_name, rule in draft.rules.items():
        for watched in rule.targets or ():
            if watched not in names:
                hint = did_you_mean_or_list(watched, names)
                yield Finding(("rules", rule_name, "targets"), f"there is no target '{watched}'", hint, "unknown-name")
        if rule.target is None:
            if len(names) > 1 and not rule.targets and rule_name not in need_none:
                message = f"which of the targets {', '.join(names)} does the rule '{rule_name}' watch?"
                yield Finding(("rules", rule_name, "target"), message, f'add target = "{names[0]}"', "target-missing")
        elif rule.target not in names:
            hint = did_you_mean_or_list(rule.target, names)
            yield Finding(("rules", rule_name, "target"), f"there is no target '{rule.target}'", hint, "unknown-name")


def _outputs_exist(draft: Draft) -> Iterator[Finding]:
    names = draft.names("actuators")
    for rule_name, rule in draft.rules.items():
        at = ("rules", rule_name, "actuator")
        if rule.actuator == BASE_NAME:
            if BASE_NAME not in draft.table:
                yield Finding(at, "the rule drives the base, but there is no section [base]", "add one", "unknown-name")
        elif rule.actuator is not None and rule.actuator not in names:
            known = [*names, *([BASE_NAME] if BASE_NAME in draft.table else [])]
            hint = did_you_mean_or_list(rule.actuator, known)
            yield Finding(at, f"there is no actuator '{rule.actuator}'", hint, "unknown-name")


def _outputs_fit(draft: Draft) -> Iterator[Finding]:
    for name, rule in draft.rules.items():
        at = ("rules", name, "actuator")
        if rule.follow and rule.actuator != BASE_NAME:
            driven = f"not '{rule.actuator}'" if rule.actuator else "and this rule names nothing"
            yield Finding(at, f"only the base can follow, {driven}", f'write actuator = "{BASE_NAME}"', "output-unfit")
        if rule.ramp and rule.actuator == BASE_NAME:
            yield Finding(
                at,
                "a ramp cannot drive the base",
                "drive an actuator, or write follow in place of ramp",
                "output-unfit",
            )
        if rule.ramp and "actuator" not in draft.tables("rules")[name]:
            yield Finding(
                at, "a ramp needs an actuator to drive", 'add one, such as actuator = "motor"', "output-missing"
            )


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
    if draft.names("rules") and isinstance(camera, dict) and "model" not in camera:
        hint = 'run `stadimeter calibrate distance PICTURE@DISTANCE -o camera.toml` and add model = "camera.toml"'
        yield Finding(
            ("camera", "model"), "rules need distances, and distances need a camera model", hint, "camera-model-missing"
        )


def _never_blind_for_long(draft: Draft) -> Iterator[Finding]:
    """Whatever a configuration says, nothing acts for long on what is out of sight."""
    limits: list[tuple[KeyPath, float]] = [
        (("actuators", name, "lease"), table.lease) for name, table in draft.actuator_tables.items()
    ]
    if draft.base_table is not None:
        limits += [
            (("base", "lease"), draft.base_table.lease),
            (("tracking", "coast"), draft.tracking.coast),
            (("safety", "max_frame_age"), draft.safety.max_frame_age),
        ]
    for path, seconds in limits:
        if seconds > MAX_BLIND_S:
            message = f"{seconds:g} s is longer than outputs may act without seeing, {MAX_BLIND_S:g} s"
            yield Finding(path, message, 'a lease of "300 ms" suits most cameras', "blind-too-long")


def _dotted(path: KeyPath) -> str:
    return ".".join(str(part) for part in path)


_CHECKS: tuple[Callable[[Draft], Iterator[Finding]], ...] = (
    _rules_by_themselves,
    _targets_exist,
    _outputs_exist,
    _outputs_fit,
    _pins_once,
    _ports_once,
    _world_around,
    _lens_known,
    _never_blind_for_long,
    reference_errors,
)
_ANALYSES: tuple[Callable[[Subject], Iterator[Finding]], ...] = (
    band_errors,
    holding_errors,
    shadow_errors,
    promise_errors,
)
