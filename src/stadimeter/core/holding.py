"""Holding an output for a moment, so that a person can try it.

A hold lasts `HOLD_S` and no longer: a page repeats the command while its button is held down. It ends
by itself when they let go, when their connection is gone, or when the program stood still.

==================================  ==================================================
what wants the output               what it does
==================================  ==================================================
safety: no fresh frame, or a fault  its safe value; a hold is refused, and forgotten
a rule of ``severity = "safety"``   what that rule wants
a hold                              what the hold wants, as fast as its limits let it
any other rule                      what the rule wants
==================================  ==================================================
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from msgspec import Struct

from stadimeter.core.decision import Severity
from stadimeter.core.plan import BaseOutput, Output
from stadimeter.core.rule import AnyRule, LevelRequest, Request, TwistRequest
from stadimeter.core.rules.scheduler import Wanted
from stadimeter.operator_actions import HoldCommand, OperatorAnswer

# A hold that is not repeated ends after this long on the run's clock.
HOLD_S = 0.5

# A base is tried no faster than this, or than its own limits.
LINEAR_MAX_MPS = 0.2
ANGULAR_MAX_RADPS = 0.5

# Stands in traces for the rule that commands an output while a person holds it.
OPERATOR = "operator"


class Hold(Struct, frozen=True, kw_only=True):
    """An output that a person holds.

    Attributes:
        request: What they want of it.
        until_s: When that ends, on the run's clock.
    """

    request: Request
    until_s: float


def step_holds(
    before: tuple[Hold, ...],
    commands: Sequence[HoldCommand],
    outputs: Sequence[Output],
    forbidden: Mapping[str, str],
    now_s: float,
) -> tuple[tuple[Hold, ...], tuple[OperatorAnswer, ...]]:
    """Return the holds of this cycle, and the answer to each command.

    Args:
        before: The holds of the cycle before.
        forbidden: The outputs that may not act, and why.
    """
    if not before and not commands:
        return (), ()
    held = {each.request.output: each for each in before if now_s < each.until_s}
    answers = tuple([_obey(command, held, outputs, forbidden, now_s) for command in commands])
    return tuple(each for name, each in held.items() if name not in forbidden), answers


def with_holds(wanted: Wanted, holds: tuple[Hold, ...], rules: Sequence[AnyRule]) -> Wanted:
    """Return the requests for each output, those of holds before all but those of safety rules."""
    if not holds:
        return wanted
    of_safety = {rule.name for rule in rules if rule.severity is Severity.SAFETY}
    after = dict(wanted)
    for hold in holds:
        name = hold.request.output
        by_rules = wanted.get(name, ())
        # A request of several rules together has all their names.
        first = [request for request in by_rules if of_safety.intersection(request.rule.split("+"))]
        after[name] = [*first, hold.request, *(request for request in by_rules if request not in first)]
    return after


def _obey(
    command: HoldCommand, held: dict[str, Hold], outputs: Sequence[Output], forbidden: Mapping[str, str], now_s: float
) -> OperatorAnswer:
    """Hold an output, or let go of it; return the answer."""
    name = command.output
    if command.is_release:
        was_held = held.pop(name, None) is not None
        return OperatorAnswer(
            id=command.id, accepted=True, words=f"{name}: {'let go' if was_held else 'it was not held'}"
        )
    output = next((each for each in outputs if each.name == name), None)
    if output is None:
        known = ", ".join(each.name for each in outputs) or "none"
        return _refuse(command, f"there is no output '{name}'; the outputs are: {known}")
    if name in forbidden:
        held.pop(name, None)
        return _refuse(command, f"{name} is kept at its safe value: {forbidden[name]}")
    request = _base_request(output, command) if isinstance(output, BaseOutput) else _level_request(command)
    if isinstance(request, str):
        return _refuse(command, request)
    held[name] = Hold(request=request, until_s=now_s + HOLD_S)
    return OperatorAnswer(id=command.id, accepted=True, words=_words(request))


def _level_request(command: HoldCommand) -> LevelRequest | str:
    """Work out what an actuator shall do, or say in words why it cannot."""
    name, level = command.output, command.level
    if level is None:
        return f"{name} is an actuator: it takes a level from 0 to 1"
    if not 0.0 <= level <= 1.0:  # NaN fails this too
        return f"{name}: level {level:g} is not between 0 and 1"
    return LevelRequest(rule=OPERATOR, output=name, priority=0, level=level, by=command.by or OPERATOR)


def _base_request(base: BaseOutput, command: HoldCommand) -> TwistRequest | str:
    """Work out how a base shall move, no faster than it is tried, or say in words why it cannot."""
    linear_mps, angular_radps = command.linear_mps, command.angular_radps
    if command.level is not None or (linear_mps is None and angular_radps is None):
        return f"{base.name} is a base: it takes a speed in m/s and a rate of turn in rad/s"
    speeds = (linear_mps or 0.0, angular_radps or 0.0)
    if not all(map(math.isfinite, speeds)):
        return f"{base.name}: {speeds[0]} m/s and {speeds[1]} rad/s are not both finite"
    return TwistRequest(
        rule=OPERATOR,
        output=base.name,
        priority=0,
        linear_mps=_within(speeds[0], min(LINEAR_MAX_MPS, base.linear_max_mps)),
        angular_radps=_within(speeds[1], min(ANGULAR_MAX_RADPS, base.angular_max_radps)),
        by=command.by or OPERATOR,
    )


def _within(speed: float, largest: float) -> float:
    return min(max(speed, -largest), largest)


def _refuse(command: HoldCommand, words: str) -> OperatorAnswer:
    return OperatorAnswer(id=command.id, accepted=False, words=words)


def _words(request: Request) -> str:
    if isinstance(request, LevelRequest):
        return f"{request.output}: held at {request.level:.0%}"
    return f"{request.output}: held at {request.linear_mps:.2f} m/s and {request.angular_radps:.2f} rad/s"
