"""From requests to exactly one command for each output: safety first, then the winner, then limits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from stadimeter.core.command import Command, LevelCommand, TwistCommand
from stadimeter.core.decision import OutputTrace, SafetyMode
from stadimeter.core.observation import OutputFault
from stadimeter.core.plan import BaseOutput, LevelOutput, Output
from stadimeter.core.rule_step import LevelRequest, Request, TwistRequest
from stadimeter.core.safety import SafetyState

NOBODY = "no rule drives it"


@dataclass(frozen=True, slots=True, kw_only=True)
class OutputStep:
    """What one output does in one cycle."""

    command: Command
    trace: OutputTrace
    wanted: Sequence[Request] = ()
    """What the rules want of it, the winner first."""


def new_output(output: Output) -> OutputStep:
    """Return an output at the start of a run: at its safe value."""
    return OutputStep(command=safe_command(output), trace=OutputTrace(output=output.name, winner="safe", reason=NOBODY))


def safe_command(output: Output) -> Command:
    """Return what an output does when nothing asks for more, or nothing may: its safe level; a base stands still."""
    if isinstance(output, BaseOutput):
        return TwistCommand(output=output.name, linear_mps=0.0, angular_radps=0.0)
    return LevelCommand(output=output.name, level=output.safe_level)


def command_all(
    outputs: tuple[Output, ...],
    before: tuple[OutputStep, ...],
    requests: Mapping[str, Sequence[Request]],
    safety: SafetyState,
    forbidden: Mapping[str, str],
    step_s: float,
) -> tuple[OutputStep, ...]:
    """Return one command for each output, and why.

    Args:
        before: Their steps in the cycle before.
        requests: What is wanted of them, for each output the winner first.
        forbidden: The outputs that may not act, and why.
    """
    return tuple(
        _step(output, last, requests.get(output.name, ()), safety, forbidden.get(output.name, ""), step_s)
        for output, last in zip(outputs, before, strict=True)
    )


def forbidden_outputs(
    outputs: tuple[Output, ...], safety: SafetyState, faults: tuple[OutputFault, ...]
) -> dict[str, str]:
    """Return the outputs that may not act, and why: one that is out of order, or all of them."""
    if safety.mode is SafetyMode.ACTIVE and not faults:
        return {}
    none_may = {} if safety.mode is SafetyMode.ACTIVE else {output.name: safety.reason for output in outputs}
    return none_may | {fault.output: fault.reason for fault in faults}


def _step(
    output: Output, before: OutputStep, wanted: Sequence[Request], safety: SafetyState, forbidden: str, step_s: float
) -> OutputStep:
    if forbidden or safety.frame is None:
        trace = _trace(before, ("safety", forbidden, ""), wanted, losing_from=0)
        return OutputStep(command=safe_command(output), trace=trace, wanted=wanted)
    winner = wanted[0] if wanted else None
    command = _command(output, before.command, winner, safety.frame.captured_at_s, step_s)
    told = (winner.rule, "", winner.by) if winner else ("safe", NOBODY, "")
    trace = _trace(before, told, wanted, losing_from=1)
    if command is before.command and trace is before.trace and wanted is before.wanted:
        return before
    return OutputStep(command=command, trace=trace, wanted=wanted)


def _trace(
    before: OutputStep, told: tuple[str, str, str], wanted: Sequence[Request], *, losing_from: int
) -> OutputTrace:
    """Return the trace of the cycle before while it says the same: the winner, the reason, and who holds the output."""
    last = before.trace
    is_as_before = told == (last.winner, last.reason, last.held_by)
    if wanted is before.wanted and is_as_before:
        return last
    losers = tuple([request.rule for request in wanted[losing_from:]])
    if is_as_before and losers == last.losers:
        return last
    winner, reason, held_by = told
    return OutputTrace(output=last.output, winner=winner, reason=reason, losers=losers, held_by=held_by)


def _command(output: Output, before: Command, request: Request | None, captured_at_s: float, step_s: float) -> Command:
    if isinstance(output, LevelOutput) and isinstance(before, LevelCommand):
        return _level(output, before, request, captured_at_s, step_s)
    if isinstance(output, BaseOutput) and isinstance(before, TwistCommand) and isinstance(request, TwistRequest):
        linear_mps, angular_radps = limit_twist(
            output,
            (before.linear_mps, before.angular_radps),
            (request.linear_mps, request.angular_radps),
            step_s,
        )
        return TwistCommand(
            output=output.name, linear_mps=linear_mps, angular_radps=angular_radps, captured_at_s=captured_at_s
        )
    return safe_command(output)  # nobody asks a base to move: it stands still at once


def _level(
    output: LevelOutput, before: LevelCommand, request: Request | None, captured_at_s: float, step_s: float
) -> Command:
    if request is None and before.level == output.safe_level and before.captured_at_s is None:
        return before  # at rest, and nobody asks for more
    wanted = request.level if isinstance(request, LevelRequest) else output.safe_level
    level = slew_level(output, before.level, wanted, step_s)
    if request is None and level == output.safe_level:
        return safe_command(output)
    return LevelCommand(output=output.name, level=level, captured_at_s=captured_at_s)


# How fast an output may change, and how far it may go


def slew_level(output: LevelOutput, before: float, wanted: float, step_s: float) -> float:
    """Return the level that an actuator may have now on its way from the one before to the one that is wanted."""
    per_s = output.rise_per_s if wanted > before else output.fall_per_s
    if math.isinf(per_s):
        return wanted
    step = per_s * max(step_s, 0.0)
    return min(max(wanted, before - step), before + step)


def limit_speed(before: float, wanted: float, largest: float, acceleration: float, step_s: float) -> float:
    """Return the speed that a base may have now on its way to the one that is wanted.

    Only speeding up is limited: slowing down always helps. A base that shall go the other way passes through zero.
    """
    wanted = min(max(wanted, -largest), largest)
    start = before if (before > 0) is (wanted > 0) else 0.0
    gain = acceleration * max(step_s, 0.0)
    if wanted > start:
        return min(wanted, start + gain) if wanted > 0 else wanted
    if wanted < start:
        return max(wanted, start - gain) if wanted < 0 else wanted
    return wanted


def limit_twist(
    output: BaseOutput, before: tuple[float, float], wanted: tuple[float, float], step_s: float
) -> tuple[float, float]:
    """Return the speed forwards in m/s and the rate of turn in rad/s that a base may have now."""
    linear_mps = limit_speed(before[0], wanted[0], output.linear_max_mps, output.linear_accel_mps2, step_s)
    angular_radps = limit_speed(before[1], wanted[1], output.angular_max_radps, output.angular_accel_radps2, step_s)
    return linear_mps, angular_radps
