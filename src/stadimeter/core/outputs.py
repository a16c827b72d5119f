"""From requests to exactly one command for each output: safety first, then the winner, then limits."""

from __future__ import annotations

from stadimeter.core.command import Command, LevelCommand, TwistCommand
from stadimeter.core.decision import OutputTrace, SafetyMode
from stadimeter.core.observation import OutputFault
from stadimeter.core.plan import BaseOutput, LevelOutput, Output
from stadimeter.core.rules.limits import limited_twist, slewed_level
from stadimeter.core.rules.request import LevelRequest, Request, TwistRequest
from stadimeter.core.safety import SafetyState


def safe_command(output: Output) -> Command:
    """Return what an output does when nothing asks for more, or nothing may.

    Args:
        output: The output.

    Returns:
        Its safe level; for a base, standing still.
    """
    if isinstance(output, BaseOutput):
        return TwistCommand(output=output.name, linear_mps=0.0, angular_radps=0.0)
    return LevelCommand(output=output.name, level=output.safe_level)


def command_all(
    outputs: tuple[Output, ...],
    before: tuple[Command, ...],
    requests: dict[str, tuple[Request, ...]],
    safety: SafetyState,
    faults: tuple[OutputFault, ...],
    step_s: float,
) -> tuple[tuple[Command, ...], tuple[OutputTrace, ...]]:
    """Return one command for each output, and why.

    Args:
        outputs: The outputs.
        before: Their commands in the cycle before.
        requests: What the rules want, for each output the winner first.
        safety: Whether outputs may act.
        faults: The outputs that are out of order.
        step_s: Time since the cycle before.

    Returns:
        The commands and the reasons, in the order of the outputs.
    """
    out_of_order = {fault.output: fault.reason for fault in faults}
    commands: list[Command] = []
    traces: list[OutputTrace] = []
    for output, last in zip(outputs, before, strict=True):
        wanted = requests.get(output.name, ())
        losers = tuple(request.rule for request in wanted)
        forbidden = out_of_order.get(output.name) or (safety.reason if safety.mode is not SafetyMode.ACTIVE else "")
        if forbidden or safety.frame is None:
            commands.append(safe_command(output))
            traces.append(OutputTrace(output=output.name, winner="safety", reason=forbidden, losers=losers))
            continue
        winner = wanted[0] if wanted else None
        commands.append(_command(output, last, winner, safety.frame.captured_at_s, step_s))
        who, why = (winner.rule, winner.reason) if winner else ("safe", "nothing is asked of it")
        traces.append(OutputTrace(output=output.name, winner=who, reason=why, losers=losers[1:]))
    return tuple(commands), tuple(traces)


def _command(output: Output, before: Command, request: Request | None, captured_at_s: float, step_s: float) -> Command:
    if isinstance(output, LevelOutput) and isinstance(before, LevelCommand):
        return _level(output, before.level, request, captured_at_s, step_s)
    if isinstance(output, BaseOutput) and isinstance(before, TwistCommand) and isinstance(request, TwistRequest):
        linear_mps, angular_radps = limited_twist(
            output,
            (before.linear_mps, before.angular_radps),
            (request.linear_mps, request.angular_radps),
            step_s,
        )
        return TwistCommand(
            output=output.name, linear_mps=linear_mps, angular_radps=angular_radps, captured_at_s=captured_at_s
        )
    return safe_command(output)  # nobody asks a base to move: it stands still at once


def _level(output: LevelOutput, before: float, request: Request | None, captured_at_s: float, step_s: float) -> Command:
    wanted = request.level if isinstance(request, LevelRequest) else output.safe_level
    level = slewed_level(output, before, wanted, step_s)
    if request is None and level == output.safe_level:
        return safe_command(output)
    return LevelCommand(output=output.name, level=level, captured_at_s=captured_at_s)
