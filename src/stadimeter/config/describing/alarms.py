"""Says in plain words what an alarm does beside driving its output, and what becomes of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from stadimeter.config.describing.conditions import begins
from stadimeter.core.rule import AlarmRule, Pattern, SequenceStep

_RAISES_MAX = AlarmRule.__dataclass_fields__["raises_per_minute_max"].default

Verb = Callable[[str], str]
"""What an output does when it acts, such as ``lights``, by its name."""


def rhythm(pattern: Pattern | None) -> str:
    """Say how a level changes by itself.

    Args:
        pattern: The pattern; None for none.

    Returns:
        Such as `` in turns of 100% for 0.2 s and 0% for 0.3 s, 3 times``; empty for none.
    """
    if pattern is None:
        return ""
    turns = " and ".join(f"{level:.0%} for {duration(for_s)}" for level, for_s in pattern.steps)
    return f" in turns of {turns}" + (f", {pattern.times} times" if pattern.times else "")


def consequences(rule: AlarmRule, verb: Verb) -> str:
    """Say what an alarm does besides, and what becomes of it.

    Args:
        rule: The alarm.
        verb: Names what an output does.

    Returns:
        Sentences, each with a space before it; empty for a plain alarm.
    """
    return "".join(f" {sentence}." for sentence in _sentences(rule, verb))


def duration(seconds: float) -> str:
    """Write a duration in the largest unit that leaves it a short number.

    Args:
        seconds: The duration.

    Returns:
        Such as ``0.2 s``, ``5 min`` or ``8 h``.
    """
    for unit, size_s in (("h", 3600.0), ("min", 60.0)):
        if seconds >= size_s and (seconds / size_s * 2).is_integer():
            return f"{seconds / size_s:g} {unit}"
    return f"{seconds:g} s"


def _sentences(rule: AlarmRule, verb: Verb) -> Iterator[str]:
    if rule.observe:
        yield "Is only observed: it drives nothing and sends nothing"
    for step in rule.sequence:
        yield _step(step, verb)
    if rule.latch:
        yield "Latches: stands until somebody resets it"
    if rule.needs_ack:
        yield "Somebody must acknowledge it"
    if rule.realarm_s is not None:
        yield f"Is reported again every {duration(rule.realarm_s)} while it stands"
    yield from _governor(rule)
    if rule.group:
        yield f"Of the alarms of the group `{rule.group}`, the first is marked"
    if rule.suppress_when is not None:
        yield f"Keeps quiet while {begins(rule.suppress_when)}"


def _governor(rule: AlarmRule) -> Iterator[str]:
    most = rule.raises_per_minute_max
    if most == 0:
        yield "Is never taken for chattering"
    elif most != _RAISES_MAX:
        yield f"Chatters when it comes {most} times within a minute, and then stands until it has calmed down"


def _step(step: SequenceStep, verb: Verb) -> str:
    when = "When it clears" if step.on == "cleared" else "When raised"
    after = f", {duration(step.after_s)} later" if step.after_s else ""
    unless = " unless somebody has acknowledged it" if step.only_unacknowledged else ""
    return f"{when}{after} {_does(step, verb)}{unless}"


def _does(step: SequenceStep, verb: Verb) -> str:
    if step.output is not None:
        level = "" if step.level == 1 or step.pattern is not None else f" at {step.level:.0%}"
        lasting = "" if math.isinf(step.for_s) else f" for {duration(step.for_s)}"
        return f"{verb(step.output)} `{step.output}`{level}{rhythm(step.pattern)}{lasting}"
    if step.send is not None and step.send.notifier:
        return f"notifies `{step.send.notifier}`"
    return f"sends `{step.send.topic}`" if step.send is not None else "does nothing"
