"""The command ``drive``: turns each wheel a little, and writes down what the motors are connected to."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import typer

from stadimeter.app.clock import MonotonicClock
from stadimeter.app.control.client import find
from stadimeter.cli.exits import NOT_FOUND, WRONG, ConfigArgument, configuration_path, plain_errors
from stadimeter.config.files import CONFIGURATION_MAX_BYTES, read_untrusted_text
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.units import parse_length
from stadimeter.errors import ConfigError, ControlError, DriverError
from stadimeter.workbench import driving
from stadimeter.workbench.saving import check_is_not_ours, save_files

_ANSWERS = {
    "lf": driving.Turned(is_right=False, is_backwards=False),
    "lb": driving.Turned(is_right=False, is_backwards=True),
    "rf": driving.Turned(is_right=True, is_backwards=False),
    "rb": driving.Turned(is_right=True, is_backwards=True),
    "n": None,
}


def drive(config: ConfigArgument = None) -> None:
    """Turn each wheel of a robot a little, to learn which motor drives it, and which way.

    Put the robot on something first, so that its wheels turn freely. Then one motor turns for a second at a time,
    gently at first, and you say which wheel that was. Motors that are driven by duty get their least duty and their
    speed found on the floor next, if you want that. What follows from it (`swap_sides`, `invert_left`, `invert_right`,
    `minimum_duty`, `max_wheel_speed`) is shown, and written into CONFIG if you say so. The file as it was is kept in
    the folder versions.

    Ctrl-C stops the motors and leaves. Nothing is opened but the base of CONFIG, and no rule runs.

    **Examples**

    - `stadimeter drive robot.toml`

    **Exit code**: 0 done; 1 you left, or no wheel turned; 2 the configuration has no such base, it cannot be opened, or
    a run drives it.
    """
    with plain_errors(), _may_be_left():
        path = configuration_path(config)
        text = read_untrusted_text(path, CONFIGURATION_MAX_BYTES)
        configuration = load_configuration(path, with_tests=False)
        driving.base_with_wheels(configuration)
        _check_no_run(path)
        _require("Are the wheels off the floor, and is the switch of the motors at hand?")
        found = dict[str, bool | float](_learn_wiring(configuration))
        if driving.takes_duties(driving.base_with_wheels(configuration)):
            sides = {key: bool(value) for key, value in found.items()}
            found |= _learn_least_duty(configuration, sides) | _learn_speed(configuration, sides)
        _write(path, text, driving.with_base_options(configuration, text, found))


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
    with driving.open_wheels(configuration, {}, MonotonicClock(), _warn) as wheels:
        seen = []
        for name, left, right in (("left", 1, 0), ("right", 0, 1)):
            for strength in wheels.strengths:
                unit = (
                    f"a duty of {strength:.0%}"
                    if driving.takes_duties(driving.base_with_wheels(configuration))
                    else f"{strength:g} m/s"
                )
                _ready(f"The motor that CONFIG calls {name} turns forwards for {driving.TURN_S:g} s at {unit}.")
                wheels.turn(left * strength, right * strength, driving.TURN_S)
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
    return driving.wiring_of(*seen)


def _learn_least_duty(configuration: Configuration, sides: dict[str, bool]) -> dict[str, float]:
    """Drive both wheels with more and more duty until one turns; empty if that is not wanted."""
    typer.echo(
        "Now the least duty. On the floor a robot needs more than in the air: put it where it will drive, with half a "
        "metre free before it."
    )
    if not _yes("Does it stand there?"):
        return {}
    with driving.open_wheels(configuration, sides, MonotonicClock(), _warn) as wheels:
        duty = driving.LEAST_STEP
        while duty <= driving.LEAST_MAX + 1e-9:
            _ready(f"Both wheels get a duty of {duty:.0%} for {driving.LEAST_TURN_S:g} s.")
            wheels.turn(duty, duty, driving.LEAST_TURN_S)
            if _yes("Did it move?"):
                return {"minimum_duty": round(duty - driving.LEAST_STEP, 2)}
            duty += driving.LEAST_STEP
    typer.echo("It did not move: charge the battery, and try again.")
    raise typer.Exit(NOT_FOUND)


def _learn_speed(configuration: Configuration, sides: dict[str, bool]) -> dict[str, float]:
    """Drive twice at full duty, and return the speed by the difference of the two ways; empty if that is not wanted."""
    if not _yes(
        f"Now the speed. It drives twice, for {driving.SHORT_S:g} s and {driving.LONG_S:g} s: has it 4 m before it?"
    ):
        return {}
    ways_m = []
    with driving.open_wheels(configuration, sides, MonotonicClock(), _warn) as wheels:
        for for_s in (driving.SHORT_S, driving.LONG_S):
            _ready(f"It drives at full duty for {for_s:g} s.")
            wheels.turn(1.0, 1.0, for_s)
            ways_m.append(parse_length(_ask("How far did it go?", "such as 45 cm", _is_length)))
    # What it needs to speed up and to come to rest is in both ways.
    speed_mps = (ways_m[1] - ways_m[0]) / (driving.LONG_S - driving.SHORT_S)
    if speed_mps <= 0:
        raise ConfigError("it went no further in the longer time by what was answered: measure again")
    return {"max_wheel_speed": round(speed_mps, 3)}


def _write(path: Path, before: str, after: str) -> None:
    if after == before:
        typer.echo(f"{path} says so already: nothing is to be changed")
        return
    old = before.splitlines()
    typer.echo("\n".join(f"  {line}" for line in after.splitlines() if line not in old))
    if not _yes(f"Write this into {path}?"):
        typer.echo("nothing was written")
        return
    check_is_not_ours(path)
    save_files(path.parent, {path.name: after}, lambda: _check_same(path, before))
    typer.echo(f"wrote {path}; `stadimeter check {path}` says what it does")


def _check_same(path: Path, before: str) -> None:
    if read_untrusted_text(path, CONFIGURATION_MAX_BYTES) != before:
        raise ConfigError(f"{path} was changed meanwhile, so nothing was written: begin again")


def _warn(words: str) -> None:
    typer.echo(words, err=True)


def _require(question: str) -> None:
    if not _yes(question):
        typer.echo("put it on a box or a cup first: nothing was driven")
        raise typer.Exit(WRONG)


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
