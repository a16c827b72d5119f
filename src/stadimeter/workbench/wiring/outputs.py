"""The parts of a configuration that are on pins of the header, each with the supplies that it gets."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from stadimeter.config.gpio_header import HEADER, header_pin
from stadimeter.config.loader import Configuration
from stadimeter.config.plugins import DriverChoice, marked_options
from stadimeter.config.units import PinMark
from stadimeter.workbench.wiring.circuits import CIRCUITS, Output


def wired_outputs(parts: Iterable[DriverChoice]) -> tuple[Output, ...]:
    """Return every part on a pin, in the order given. Wires get pins of their own as long as there are any."""
    used: set[int] = set()
    return tuple(_output(choice, name, gpio, used) for choice in parts for name, gpio in _pins(choice))


def parts_of(configuration: Configuration) -> tuple[DriverChoice, ...]:
    """Return what may hang on a pin: the actuators in the order of the file, then the status LED and the buttons."""
    return (*configuration.driven, *configuration.buttons)


def _pins(choice: DriverChoice) -> Iterator[tuple[str, int]]:
    found = [(".".join(map(str, path)), pin) for path, pin in marked_options(choice.options, PinMark)]
    for key, pin in found:
        if isinstance(pin, int):
            yield choice.name if len(found) == 1 else f"{choice.name} {key}", pin


def _output(choice: DriverChoice, name: str, gpio: int, used: set[int]) -> Output:
    kind = choice.plugin.circuit if choice.plugin.circuit in CIRCUITS else ""
    active_high = bool(getattr(choice.options, "active_high", True))
    pin = header_pin(gpio)
    supplies = {what: _nearest(what, pin, used) for what in CIRCUITS[kind].supplies(active_high)}
    return Output(name=name, circuit=kind, gpio=gpio, pin=pin, active_high=active_high, supplies=supplies)


def _nearest(what: str, pin: int, used: set[int]) -> int:
    """Return the nearest pin of a supply, one that is still free if there is one, and take it."""
    every = [number for number, each in enumerate(HEADER, start=1) if each == what]
    best = min(every, key=lambda number: (number in used, _steps(number, pin)))
    used.add(best)
    return best


def _steps(one: int, other: int) -> int:
    """Return how far apart two pins are: in rows, and a pin across less than a row away."""
    return 2 * abs((one - 1) // 2 - (other - 1) // 2) + (one + other) % 2


def header_labels(outputs: Sequence[Output]) -> dict[int, tuple[str, ...]]:
    """Return the names of the outputs on each pin of the header that is used."""
    labels: dict[int, tuple[str, ...]] = {}
    for output in outputs:
        for pin in (output.pin, *output.supplies.values()):
            labels[pin] = (*labels.get(pin, ()), output.name)
    return labels


def pin_name(pin: int) -> str:
    """Return what a pin of the header is, such as ``GPIO 18``."""
    what = HEADER[pin - 1]
    return f"GPIO {what}" if isinstance(what, int) else what
