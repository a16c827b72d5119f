"""What the drivers that a configuration names would lack on this computer, and what is hardly meant for them."""

from __future__ import annotations

from collections.abc import Iterator

from stadimeter.config.draft import Draft
from stadimeter.config.findings import Finding
from stadimeter.config.rules.pattern_tables import PatternTable
from stadimeter.config.rules.tables import RuleTable
from stadimeter.config.toml_lines import KeyPath

_RELAY = "relay"

RELAY_SLOWEST_S = 5.0
"""A relay of a hundred thousand switchings that switches more often than this lasts for less than two weeks."""


def driver_warnings(draft: Draft) -> Iterator[Finding]:
    """Find what keeps drivers from working here, or from working for long, and what nobody uses.

    Elsewhere, where a recording came from, a driver may work.

    Args:
        draft: What could be read of a configuration.

    Yields:
        A warning for each.
    """
    for at, part in draft.parts():
        for lack in part.plugin.lacks(part.options):
            yield Finding(at, f"the driver '{part.driver}' will not work here: {lack}", code="driver-lacks")
    yield from _unused_notifiers(draft)
    yield from _worn_relays(draft)


def _unused_notifiers(draft: Draft) -> Iterator[Finding]:
    used = {step.notify for rule in draft.rules.values() for step in rule.then}
    for name in draft.names("notifiers"):
        if draft.rules and name not in used:
            hint = f'add a step notify = "{name}" to the [[rules.NAME.then]] of a rule'
            yield Finding(("notifiers", name), f"no rule notifies '{name}'", hint, "output-unused")


def _worn_relays(draft: Draft) -> Iterator[Finding]:
    relays = {choice.name for choice in draft.actuators if choice.driver == _RELAY}
    for name, rule in draft.rules.items():
        for path, actuator, pattern in _patterns(rule):
            if actuator in relays and pattern.period_s < RELAY_SLOWEST_S and not pattern.times:
                message = (
                    f"'{actuator}' is a relay, and would click every {pattern.period_s:g} s while the alarm stands"
                )
                hint = "relays wear out: drive a buzzer or a lamp, or add times to the pattern"
                yield Finding(("rules", name, *path, "pattern"), message, hint, "relay-pattern")


def _patterns(rule: RuleTable) -> Iterator[tuple[KeyPath, str | None, PatternTable]]:
    if rule.pattern is not None:
        yield (), rule.actuator, rule.pattern
    for position, step in enumerate(rule.then):
        if step.pattern is not None:
            yield ("then", position), step.actuator, step.pattern
