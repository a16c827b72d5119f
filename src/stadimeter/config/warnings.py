"""Warnings: what is allowed in a configuration and hardly meant. `check` and a reload ask for them, a run does not."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from stadimeter.config.analysis.bands import holding_warnings
from stadimeter.config.analysis.promises import promise_warnings, unknown_warnings
from stadimeter.config.analysis.references import rules_asked_for
from stadimeter.config.analysis.subject import Subject, subject_of
from stadimeter.config.analysis.timing import timing_warnings
from stadimeter.config.analysis.writers import overlap_warnings, priority_warnings, shadow_warnings
from stadimeter.config.draft import BASE_NAME, Draft
from stadimeter.config.findings import Finding
from stadimeter.config.gpio_header import TAKEN
from stadimeter.config.plugins import RefusesMotion, StatesLatency, marked_options
from stadimeter.config.rule_test_checks import rule_test_warnings
from stadimeter.config.rules.sequence_tables import PatternTable
from stadimeter.config.rules.tables import RuleTable
from stadimeter.config.secrets import secret_warnings
from stadimeter.config.toml_lines import KeyPath
from stadimeter.config.units import PinMark

# Three frames at 30 a second: with less, every hiccup of a network stops the outputs.
LEFT_FOR_FRAMES_S = 0.1

# A contact of a hundred thousand switchings that switches more often than this lasts for less than two weeks.
MIN_WEAR_PERIOD_S = 5.0


def warning_findings(draft: Draft) -> Iterator[Finding]:
    """Find what to look at again in a configuration without errors."""
    yield from draft.renamed
    yield from _about_rules(draft)
    for check in (rule_test_warnings, secret_warnings, *_ABOUT_DRIVERS):
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
    leases: list[tuple[KeyPath, float]] = [
        (("actuators", name), table.lease) for name, table in draft.actuator_tables.items()
    ]
    leases += [((BASE_NAME,), draft.base_table.lease)] if draft.base_table else []
    for at, lease_s in leases:
        if lease_s < age_s:
            message = (
                f"the lease {lease_s:g} s is shorter than max_frame_age {age_s:g} s: it stops on frames still good"
            )
            yield Finding((*at, "lease"), message, "make it longer, or safety.max_frame_age shorter", "lease-too-short")


def _rules_matter(draft: Draft) -> Iterator[Finding]:
    if not draft.rules:
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
    driven = {rule.actuator for rule in draft.rules.values() if not rule.observe}
    driven |= {step.actuator for rule in draft.rules.values() for step in rule.escalation if not rule.observe}
    paths: list[KeyPath] = [("actuators", name) for name in draft.names("actuators")]
    paths += [(BASE_NAME,)] if BASE_NAME in draft.table else []
    for path in paths:
        if draft.rules and path[-1] not in driven:
            yield Finding(path, f"no rule drives '{path[-1]}'", "it stays in its safe state", "output-unused")


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


def _moves(draft: Draft) -> bool:
    return bool(draft.rules) and (draft.base is not None or bool(draft.actuators))


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


_CHECKS: tuple[Callable[[Draft], Iterator[Finding]], ...] = (
    _leases_long_enough,
    _rules_matter,
    _alerts_heard,
    _outputs_driven,
)
_ANALYSES: tuple[Callable[[Subject], Iterator[Finding]], ...] = (
    holding_warnings,
    shadow_warnings,
    overlap_warnings,
    priority_warnings,
    timing_warnings,
    promise_warnings,
    unknown_warnings,
)
_ABOUT_DRIVERS: tuple[Callable[[Draft], Iterator[Finding]], ...] = (
    _no_motion,
    _late_frames,
    _unused_notifiers,
    _worn_contacts,
    _taken_pins,
)
