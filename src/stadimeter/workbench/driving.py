"""Turning the wheels of a robot one at a time: to learn which motor drives which wheel, and which way.

The motors are driven as in a run: through a lease that the guard ends, with the watchdog process beside it where they
do not stop by themselves, and by commands of one moment each. So the wheels stand still when this program ends,
however it does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any

from msgspec import Struct

from stadimeter.app.ending import stopping_on_signals
from stadimeter.app.guard import Guard, LeasedOutput, retire_all
from stadimeter.app.service import held_lines
from stadimeter.config.loader import Configuration
from stadimeter.config.plugins import DriverChoice, DriverContext
from stadimeter.config.toml_lines import set_value
from stadimeter.core.clock import Clock
from stadimeter.core.command import TwistCommand
from stadimeter.core.plan import BaseOutput
from stadimeter.errors import ConfigError, DriverError, Problem

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
