"""What the drivers that a configuration names would lack on this computer, and what is hardly meant for them."""

from __future__ import annotations

from collections.abc import Iterator

from stadimeter.config.draft import Draft
from stadimeter.config.findings import Finding
from stadimeter.config.rules.pattern_tables import PatternTable
from stadimeter.config.rules.tables import RuleTable
from stadimeter.config.toml_lines import KeyPath

LEFT_FOR_FRAMES_S = 0.1
"""Three frames at 30 a second: with less, every hiccup of a network stops the outputs."""

SHORTEST_PERIOD_OF_WEAR_S = 5.0
"""A contact of a hundred thousand switchings that switches more often than this lasts for less than two weeks."""


def driver_warnings(draft: Draft) -> Iterator[Finding]:
    """Find what keeps drivers from working here, or from working for long, and what nobody uses.

    Elsewhere, where a recording came from, a driver may work.
    """
    for at, part in draft.parts():
        for lack in part.plugin.lacks(part.options):
            yield Finding(at, f"the driver '{part.driver}' will not work here: {lack}", code="driver-lacks")
    yield from _no_motion(draft)
    yield from _late_frames(draft)
    yield from _unused_notifiers(draft)
    yield from _worn_contacts(draft)


def _no_motion(draft: Draft) -> Iterator[Finding]:
    if draft.camera is None or not _moves(draft):
        return
    for key, why in draft.camera.plugin.not_for_motion(draft.camera.options).items():
        yield Finding(("camera", key), why, "alarms and messages work without", "not-for-motion")


def _late_frames(draft: Draft) -> Iterator[Finding]:
    """Find frames that are too old for motion when they arrive, or nearly."""
    if draft.camera is None or not _moves(draft):
        return
    at = ("camera", "latency")
    latency_s, longest_s = draft.camera.plugin.latency(draft.camera.options), draft.safety.max_frame_age
    left_s = longest_s - latency_s
    message = f"pictures are {1e3 * latency_s:.0f} ms old when they arrive, and safety.max_frame_age is"
    hint = "a faster stream helps; a longer max_frame_age, and a lease, mean that it drives on for longer after a stop"
    if latency_s > 0 and left_s <= 0:
        yield Finding(at, f"{message} {1e3 * longest_s:.0f} ms: nothing will ever move", hint, "latency-too-long")
    elif latency_s > 0 and left_s < LEFT_FOR_FRAMES_S:
        left = f"{1e3 * longest_s:.0f} ms: that leaves {1e3 * left_s:.0f} ms until the next picture, or outputs stop"
        yield Finding(at, f"{message} {left}", hint, "latency-too-long")


def _moves(draft: Draft) -> bool:
    return bool(draft.rules) and (draft.base is not None or bool(draft.actuators))


def _unused_notifiers(draft: Draft) -> Iterator[Finding]:
    used = {step.notify for rule in draft.rules.values() for step in rule.then}
    for name in draft.names("notifiers"):
        if draft.rules and name not in used:
            hint = f'add a step notify = "{name}" to the [[rules.NAME.then]] of a rule'
            yield Finding(("notifiers", name), f"no rule notifies '{name}'", hint, "output-unused")


def _worn_contacts(draft: Draft) -> Iterator[Finding]:
    worn = {choice.name: choice.driver for choice in draft.actuators if choice.plugin.is_worn_by_switching}
    for name, rule in draft.rules.items():
        for path, actuator, pattern in _patterns(rule):
            if actuator in worn and pattern.period_s < SHORTEST_PERIOD_OF_WEAR_S and not pattern.times:
                message = (
                    f"'{actuator}' wears out by switching, as a {worn[actuator]} does, and would switch every "
                    f"{pattern.period_s:g} s while the alarm stands"
                )
                hint = "drive a buzzer or a lamp, or add times to the pattern"
                yield Finding(("rules", name, *path, "pattern"), message, hint, "relay-pattern")


def _patterns(rule: RuleTable) -> Iterator[tuple[KeyPath, str | None, PatternTable]]:
    if rule.pattern is not None:
        yield (), rule.actuator, rule.pattern
    for position, step in enumerate(rule.then):
        if step.pattern is not None:
            yield ("then", position), step.actuator, step.pattern
