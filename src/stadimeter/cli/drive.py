"""The command ``drive``: turns each wheel a little, and writes down what the motors are connected to.

The motors are driven as in a run: through a lease that the guard ends, with the watchdog process beside it where they
do not stop by themselves, and by commands of one moment each. So the wheels stand still when this program ends,
however it does.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, redirect_stdout
from pathlib import Path
from typing import Any

import typer
from msgspec import Struct

from stadimeter.app.clock import MonotonicClock
from stadimeter.app.control.client import find
from stadimeter.app.ending import stopping_on_signals
from stadimeter.app.guard import Guard, LeasedOutput, retire_all
from stadimeter.app.service import held_lines
from stadimeter.cli.exits import NOT_FOUND, WRONG, ConfigArgument, configuration_path, plain_errors
from stadimeter.cli.operate import JsonOption
from stadimeter.config.files import CONFIGURATION_MAX_BYTES, read_untrusted_text
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.plugins import DriverChoice, DriverContext
from stadimeter.config.toml_lines import set_value
from stadimeter.config.units import parse_length
from stadimeter.core.clock import Clock
from stadimeter.core.command import TwistCommand
from stadimeter.core.plan import BaseOutput
from stadimeter.errors import ConfigError, ControlError, DriverError, Problem
from stadimeter.workbench.saving import check_is_not_ours, save_files

# What a base may say of its wiring, each true or false.
WIRING = ("swap_sides", "invert_left", "invert_right")

# The duties that are tried until a wheel turns: gear motors begin at 0.2 to 0.4, worn ones later.
DUTIES = (0.35, 0.5, 0.8)

# A base that takes speeds gets these shares of its highest one.
SHARES = (0.25, 0.5, 1.0)

# Least duties are looked for in these steps, which motors without encoders do not differ by less than.
LEAST_STEP, LEAST_MAX = 0.05, 0.8

TURN_S = 1.0
LEAST_TURN_S = 0.5

# The two times for which it drives at full duty: the difference of the ways leaves starting and braking out.
SHORT_S, LONG_S = 1.0, 3.0
_COMMAND_EVERY_S = 0.05


class Turned(Struct, frozen=True):
    """The wheel that a person saw turning when one motor was driven forwards."""

    is_right: bool
    is_backwards: bool


class Wheels:
    """A base whose two motors can be driven one at a time, whatever its options say of sides and directions.

    Args:
        output: Its driver, open, below the guard.
        note: Called after each command, for the watchdog process.
        strengths: What is tried until a wheel turns, in the unit of `turn`.
    """

    def __init__(
        self, output: LeasedOutput, clock: Clock, strengths: tuple[float, ...], note: Callable[[], None]
    ) -> None:
        self.strengths = strengths
        self._output = output
        self._clock = clock
        self._note = note

    def turn(self, left: float, right: float, for_s: float) -> None:
        """Drive both motors, and have them stand again. Takes so long.

        Args:
            left: For the motor that the options call left: a duty from -1 to 1, or a speed in m/s of a base that
                takes speeds.
            right: For the other one.

        Raises:
            DriverError: The base does not answer, or does not do it.
        """
        until_s = self._clock.now_s() + for_s
        while (now_s := self._clock.now_s()) < until_s:
            # The track width is 1 m for these commands, so the rate of turn is the difference of both.
            command = TwistCommand(
                output=self._output.name, linear_mps=(left + right) / 2, angular_radps=right - left, captured_at_s=now_s
            )
            if self._output.apply(command) is None:
                raise DriverError(self._output.fault or "the base was stopped")
            self._note()
            self._clock.sleep_until_s(min(until_s, now_s + _COMMAND_EVERY_S))
        self._output.make_safe()
        self._note()


def takes_duties(base: DriverChoice) -> bool:
    """Check whether a base drives its motors by duty alone, so that its least one must be known."""
    return "minimum_duty" in type(base.options).model_fields


def base_with_wheels(configuration: Configuration) -> DriverChoice:
    """Return the base of a configuration; `ConfigError` if there is none, or none with a motor on each side."""
    base = configuration.base
    if base is None:
        raise ConfigError([Problem("there is no base", str(configuration.path), hint="add one below [base]")])
    if not set(WIRING) <= type(base.options).model_fields.keys():
        words = f"a base with the driver '{base.driver}' has no two motors that could be tried here"
        raise ConfigError([Problem(words, str(configuration.path), key="base.driver")])
    return base


@contextmanager
def open_wheels(
    configuration: Configuration, wiring: Mapping[str, bool], clock: Clock, tell: Callable[[str], None]
) -> Iterator[Wheels]:
    """Open the base alone, and close it at the end. On a signal its motors stop, and this ends by `KeyboardInterrupt`.

    Args:
        wiring: What holds of its sides and directions meanwhile, in place of what the configuration says.
        tell: Takes a warning for people.

    Raises:
        DriverError: It cannot be opened.
    """
    base = base_with_wheels(configuration)
    by_duty = takes_duties(base)
    changed: dict[str, Any] = {**dict.fromkeys(WIRING, False), **wiring, "track_width": 1.0}
    if by_duty:  # then speeds in m/s are duties
        changed |= {"minimum_duty": 0.0, "max_wheel_speed": 1.0}
    options: Any = base.options.model_copy(update=changed)
    fastest = 1.0 if by_duty else options.max_wheel_speed
    strengths = DUTIES if by_duty else tuple(share * fastest for share in SHARES)
    context = DriverContext(name=base.name, clock=clock)
    if configuration.world is not None:  # of an emulated base
        configuration.world.options.build(DriverContext(name="world", clock=clock, shared=context.shared))
    (safe,) = (each for each in configuration.plan.outputs if isinstance(each, BaseOutput))
    output = LeasedOutput(
        options.build(context),
        TwistCommand(output=safe.name, linear_mps=0.0, angular_radps=0.0),
        configuration.leases_s[safe.name],
        clock,
        stays_off=True,
    )
    with ExitStack() as closing:
        for close in context.shared.closers:
            closing.callback(close)
        note = closing.enter_context(_held_by_watchdog(configuration, output, clock, tell))
        closing.enter_context(stopping_on_signals(lambda _name: _stop(output), give_up=lambda: retire_all([output])))
        closing.callback(output.close)
        output.open()
        guard = Guard([output], clock)
        guard.start()
        closing.callback(guard.end_watching)
        yield Wheels(output, clock, strengths, note)


def _stop(output: LeasedOutput) -> None:
    """Stop within a signal handler, and leave what is under way in the main thread."""
    retire_all([output])
    raise KeyboardInterrupt


@contextmanager
def _held_by_watchdog(
    configuration: Configuration, output: LeasedOutput, clock: Clock, tell: Callable[[str], None]
) -> Iterator[Callable[[], None]]:
    """Have another process hold what stops the base if this one is killed; yield what tells it of each command."""
    if not (lines := held_lines(configuration)):
        yield lambda: None
        return
    from stadimeter.app.watchdog import WatchdogLink, limit_s  # noqa: PLC0415 - simulations need none of it

    link = WatchdogLink(lines, [output], limit_s(configuration), clock.now_s, tell)
    link.start()
    is_safe = False
    try:
        yield link.note_cycle
        is_safe = True
    finally:
        link.close(is_safe=is_safe or output.acts_since_s() is None)


def wiring_of(left: Turned, right: Turned) -> dict[str, bool]:
    """Return the options of a base that follow from the wheel that each motor turned when driven forwards.

    Raises:
        ConfigError: Both motors turned the same wheel.
    """
    if left.is_right == right.is_right:
        side = "right" if left.is_right else "left"
        raise ConfigError(f"both motors turned the {side} wheel by what was answered: answer again, and see which is")
    wheels = {each.is_right: each.is_backwards for each in (left, right)}
    return {"swap_sides": left.is_right, "invert_left": wheels[False], "invert_right": wheels[True]}


def with_base_options(configuration: Configuration, text: str, found: Mapping[str, bool | float]) -> str:
    """Return the text of a configuration in which the base has other options; what holds already is left alone.

    Args:
        text: What `configuration` was loaded from.
        found: Options of the base by name; a speed is in m/s.
    """
    base = base_with_wheels(configuration)
    for key, value in found.items():
        if getattr(base.options, key) == value:
            continue
        written = str(value).lower() if isinstance(value, bool) else f"{value:g}"
        text = set_value(text, ("base", key), f'"{written} m/s"' if key == "max_wheel_speed" else written)
    return text


# The command ---------------------------------------------------------------------------------------------------------

_ANSWERS = {
    "lf": Turned(is_right=False, is_backwards=False),
    "lb": Turned(is_right=False, is_backwards=True),
    "rf": Turned(is_right=True, is_backwards=False),
    "rb": Turned(is_right=True, is_backwards=True),
    "n": None,
}


def drive(config: ConfigArgument = None, *, as_json: JsonOption = False) -> None:
    """Turn each wheel of a robot a little, to see which motor drives it, and which way.

    Put the robot on something first, so that its wheels turn freely. Then one motor turns for a second at a time,
    gently at first, and you say which wheel that was. Motors that are driven by duty get their least duty and their
    speed found on the floor next, if you want that. What follows from it (`swap_sides`, `invert_left`, `invert_right`,
    `minimum_duty`, `max_wheel_speed`) is shown, and written into CONFIG if you say so. The file as it was is kept in
    the folder versions.

    Ctrl-C stops the motors and leaves. Nothing is opened but the base of CONFIG, and no rule runs. With --json, what is
    asked and said goes to standard error, and one object with file, written and the options that were found is printed.

    **Examples**

    - `stadimeter drive robot.toml`

    **Exit code**: 0 done; 1 you left, or no wheel turned; 2 the configuration has no such base, it cannot be opened, or
    a run drives it.
    """
    with plain_errors(), redirect_stdout(sys.stderr if as_json else sys.stdout), _may_be_left():
        path = configuration_path(config)
        text = read_untrusted_text(path, CONFIGURATION_MAX_BYTES)
        configuration = load_configuration(path, with_tests=False)
        base_with_wheels(configuration)
        _check_no_run(path)
        if not _yes("Are the wheels off the floor, and is the switch of the motors at hand?"):
            typer.echo("put it on a box or a cup first: nothing was driven")
            raise typer.Exit(WRONG)
        found = dict[str, bool | float](_learn_wiring(configuration))
        if takes_duties(base_with_wheels(configuration)):
            sides = {key: bool(value) for key, value in found.items()}
            found |= _learn_least_duty(configuration, sides) | _learn_speed(configuration, sides)
        is_written = _write(path, text, with_base_options(configuration, text, found))
    if as_json:
        typer.echo(json.dumps({"file": str(path), "written": is_written, **found}))


@contextmanager
def _may_be_left() -> Iterator[None]:
    try:
        yield
    except (KeyboardInterrupt, EOFError):
        typer.echo("\nleft: the motors stand, and nothing was written")
        raise typer.Exit(NOT_FOUND) from None


def _check_no_run(path: Path) -> None:
    try:
        socket = find(path)
    except ControlError:  # none runs, or none that could be asked
        return
    raise DriverError(f"a run drives this base (it listens at {socket}): end it first")


def _learn_wiring(configuration: Configuration) -> dict[str, bool]:
    """Turn one motor, then the other, and return what their answers mean."""
    with open_wheels(configuration, {}, MonotonicClock(), _warn) as wheels:
        seen = []
        for name, left, right in (("left", 1, 0), ("right", 0, 1)):
            for strength in wheels.strengths:
                unit = (
                    f"a duty of {strength:.0%}"
                    if takes_duties(base_with_wheels(configuration))
                    else f"{strength:g} m/s"
                )
                file = configuration.path.name
                _ready(f"The motor that {file} calls {name} turns forwards for {TURN_S:g} s at {unit}.")
                wheels.turn(left * strength, right * strength, TURN_S)
                turned = _ANSWERS[
                    _ask("Which wheel turned, and which way?", "lf, lb, rf, rb; n for none", _ANSWERS.__contains__)
                ]
                if turned is not None:
                    seen.append(turned)
                    break
            else:
                typer.echo(
                    f"The {name} motor turned nothing: look at the supply of the motors, at the grounds, which must be "
                    "joined, at `enable`, and at its pins or its cable."
                )
                raise typer.Exit(NOT_FOUND)
    return wiring_of(*seen)


def _learn_least_duty(configuration: Configuration, sides: dict[str, bool]) -> dict[str, float]:
    """Drive both wheels with more and more duty until one turns; empty if that is not wanted."""
    typer.echo(
        "Now the least duty. On the floor a robot needs more than in the air: put it where it will drive, with half a "
        "metre free before it."
    )
    if not _yes("Does it stand there?"):
        return {}
    with open_wheels(configuration, sides, MonotonicClock(), _warn) as wheels:
        duty = LEAST_STEP
        while duty <= LEAST_MAX + 1e-9:
            _ready(f"Both wheels get a duty of {duty:.0%} for {LEAST_TURN_S:g} s.")
            wheels.turn(duty, duty, LEAST_TURN_S)
            if _yes("Did it move?"):
                return {"minimum_duty": round(duty - LEAST_STEP, 2)}
            duty += LEAST_STEP
    typer.echo("It did not move: charge the battery, and try again.")
    raise typer.Exit(NOT_FOUND)


def _learn_speed(configuration: Configuration, sides: dict[str, bool]) -> dict[str, float]:
    """Drive twice at full duty, and return the speed by the difference of the two ways; empty if that is not wanted."""
    if not _yes(f"Now the speed. It drives twice, for {SHORT_S:g} s and {LONG_S:g} s: has it 4 m before it?"):
        return {}
    ways_m = []
    with open_wheels(configuration, sides, MonotonicClock(), _warn) as wheels:
        for for_s in (SHORT_S, LONG_S):
            _ready(f"It drives at full duty for {for_s:g} s.")
            wheels.turn(1.0, 1.0, for_s)
            ways_m.append(parse_length(_ask("How far did it go?", "such as 45 cm", _is_length)))
    # What it needs to speed up and to come to rest is in both ways.
    speed_mps = (ways_m[1] - ways_m[0]) / (LONG_S - SHORT_S)
    if speed_mps <= 0:
        raise ConfigError("it went no further in the longer time by what was answered: measure again")
    return {"max_wheel_speed": round(speed_mps, 3)}


def _write(path: Path, before: str, after: str) -> bool:
    """Write the configuration if it changes and the person says so; return whether it was written."""
    if after == before:
        typer.echo(f"{path} says so already: nothing is to be changed")
        return False
    old = before.splitlines()
    typer.echo("\n".join(f"  {line}" for line in after.splitlines() if line not in old))
    if not _yes(f"Write this into {path}?"):
        typer.echo("nothing was written")
        return False
    check_is_not_ours(path)
    save_files(path.parent, {path.name: after}, lambda: _check_same(path, before))
    typer.echo(f"wrote {path}; `stadimeter check {path}` says what it does")
    return True


def _check_same(path: Path, before: str) -> None:
    if read_untrusted_text(path, CONFIGURATION_MAX_BYTES) != before:
        raise ConfigError(f"{path} was changed meanwhile, so nothing was written: begin again")


def _warn(words: str) -> None:
    typer.echo(words, err=True)


def _ready(words: str) -> None:
    typer.echo(words)
    _typed("Enter turns it; Ctrl-C leaves. ")


def _typed(prompt: str) -> str:
    answer = input(prompt)
    if not sys.stdin.isatty():  # then nobody has seen the answer on the prompt's line
        typer.echo(answer)
    return answer


def _is_length(answer: str) -> bool:
    try:
        return parse_length(answer) > 0
    except ValueError:
        return False


def _yes(question: str) -> bool:
    return _ask(question, "y or n", {"y", "yes", "n", "no"}.__contains__)[0] == "y"


def _ask(question: str, choices: str, is_right: Callable[[str], bool]) -> str:
    """Ask until there is an answer of those: what turns a wheel is never taken for granted."""
    while not is_right(answer := _typed(f"{question} [{choices}] ").strip().lower()):
        typer.echo(f"please answer {choices}")
    return answer
