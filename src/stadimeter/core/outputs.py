"""From requests to exactly one command for each output: safety first, then the winner, then limits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from msgspec import Struct

from stadimeter.core.command import Command, LevelCommand, TwistCommand
from stadimeter.core.decision import OutputTrace, SafetyMode
from stadimeter.core.observation import OutputFault
from stadimeter.core.plan import BaseOutput, LevelOutput, Output
from stadimeter.core.rule import LevelRequest, Request, TwistRequest
from stadimeter.core.safety import SafetyState

NO_RULE = "no rule is active"

AT_REST = (0.0, 0.0)


class OutputStep(Struct, frozen=True, kw_only=True):
    """The action of one output in one cycle."""

    command: Command
    trace: OutputTrace
    changes: tuple[float, float] = (0.0, 0.0)
    """Of a base, how fast its two speeds change: in m/s² and rad/s²."""


def new_output(output: Output) -> OutputStep:
    """Return an output at the start of a run: at its safe value."""
    trace = OutputTrace(output=output.name, winner="safe", reason=NO_RULE)
    return OutputStep(command=safe_command(output), trace=trace)


def safe_command(output: Output) -> Command:
    """Return an output's command when nothing asks for more, or nothing may: its safe level; a base stands still."""
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
        return OutputStep(command=safe_command(output), trace=_trace(before, ("safety", forbidden, ""), wanted))
    winner = wanted[0] if wanted else None
    command, changes = _command(output, before, winner, safety.frame.captured_at_s, step_s)
    told = (winner.rule, "", winner.by) if winner else ("safe", NO_RULE, "")
    trace = _trace(before, told, wanted[1:])
    if command is before.command and trace is before.trace:
        return before
    return OutputStep(command=command, trace=trace, changes=changes)


def _trace(before: OutputStep, told: tuple[str, str, str], losing: Sequence[Request]) -> OutputTrace:
    """Return the trace of the cycle before while it says the same: the winner, the reason, and who holds the output."""
    last, losers = before.trace, tuple([request.rule for request in losing])
    if (*told, losers) == (last.winner, last.reason, last.held_by, last.losers):
        return last
    winner, reason, held_by = told
    return OutputTrace(output=last.output, winner=winner, reason=reason, losers=losers, held_by=held_by)


def _command(
    output: Output, before: OutputStep, request: Request | None, captured_at_s: float, step_s: float
) -> tuple[Command, tuple[float, float]]:
    """Return a command, and how fast the speeds of a base change with it."""
    last = before.command
    if isinstance(output, LevelOutput) and isinstance(last, LevelCommand):
        return _level(output, last, request, captured_at_s, step_s), AT_REST
    if isinstance(output, BaseOutput) and isinstance(last, TwistCommand) and isinstance(request, TwistRequest):
        changes = AT_REST
        wanted = (request.linear_mps, request.angular_radps)
        if request.is_gentle:
            (linear_mps, angular_radps), changes = ease_twist(output, before, wanted, step_s)
        else:
            linear_mps, angular_radps = limit_twist(output, (last.linear_mps, last.angular_radps), wanted, step_s)
        tilt_radps = limit_speed(
            last.tilt_radps, request.tilt_radps, output.angular_max_radps, output.angular_accel_radps2, step_s
        )
        command = TwistCommand(
            output=output.name,
            linear_mps=linear_mps,
            angular_radps=angular_radps,
            tilt_radps=tilt_radps,
            captured_at_s=captured_at_s,
        )
        return command, changes
    return safe_command(output), AT_REST  # nobody asks a base to move: it stands still at once


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


# A rule that follows goes gently: what tips, slips or loses its load does so when it brakes as well as when it sets
# off, and a jerk shakes the camera that it steers by. Everything else stops at once, without any limit: safety, a
# person, an alarm, a rule that has lost its target or sees it too near. Nothing that a limit protects is worth more
# than what is run into, and a base has limits of its own.


def ease_twist(
    output: BaseOutput, before: OutputStep, wanted: tuple[float, float], step_s: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the speeds that a base may have now where it slows down as gently as it speeds up, and their changes.

    A change grows to the acceleration a, and falls to zero, no faster than the jerk j: it is at most √(2 j Δ) where Δ
    is left, so the speed arrives without overshoot.
    """
    last = before.command
    if not isinstance(last, TwistCommand):
        return AT_REST, AT_REST
    ramp_s = output.linear_accel_mps2 / output.linear_jerk_mps3 if output.linear_jerk_mps3 > 0 else 0.0
    linear_mps = min(max(wanted[0], -output.linear_max_mps), output.linear_max_mps)
    angular_radps = min(max(wanted[1], -output.angular_max_radps), output.angular_max_radps)
    linear = _ease((last.linear_mps, before.changes[0]), linear_mps, output.linear_accel_mps2, ramp_s, step_s)
    angular = _ease((last.angular_radps, before.changes[1]), angular_radps, output.angular_accel_radps2, ramp_s, step_s)
    # While the jerk limit turns a change round, a speed still goes on the old way for a moment: not beyond its limit.
    speeds = (
        min(max(linear[0], -output.linear_max_mps), output.linear_max_mps),
        min(max(angular[0], -output.angular_max_radps), output.angular_max_radps),
    )
    return speeds, (linear[1], angular[1])


def _ease(
    before: tuple[float, float], wanted: float, acceleration: float, ramp_s: float, step_s: float
) -> tuple[float, float]:
    """Return a speed on its way from the one before to the one that is wanted, and how fast it changes.

    Args:
        before: The speed, and how fast it changed.
        ramp_s: In this time the change grows to the acceleration.
    """
    speed, change = before
    left = wanted - speed
    if step_s <= 0.0 or left == 0.0:
        return speed, 0.0
    jerk = acceleration / ramp_s if ramp_s > 0 else math.inf
    most = min(acceleration, math.sqrt(2 * jerk * abs(left)), abs(left) / step_s)
    change = min(max(math.copysign(most, left), change - jerk * step_s), change + jerk * step_s)
    change = min(max(change, -acceleration), acceleration)
    after = speed + change * step_s
    if (wanted - after) * left <= 0.0:
        return wanted + 0.0, change  # it is there; a jerk may take it there, but not beyond
    return after, change
