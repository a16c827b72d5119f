"""The circuit of each kind of part on a pin, drawn in text.

Lines are box characters, ``[…]`` is a part, everything else is text: `stadimeter.workbench.wiring.drawings` draws the
same circuit from it. The facts are those of "Wiring that is safe when no program runs" in
`docs/parts.md`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

from stadimeter.config.gpio_header import GROUND, HEADER, POWER_3V3, POWER_5V, PULLED_UP_MAX, header_pin
from stadimeter.config.loader import Configuration
from stadimeter.config.plugins import DriverChoice, marked_options
from stadimeter.config.units import PinMark

_MOSFET = "MOSFET: N-channel, fully on at 3.3 V, such as AO3400 or IRLML6344. A pin gives a few milliamperes only."
_DIODE = "Diode: such as 1N5819, its stripe to plus. Without it, switching off kills the MOSFET and in time the Pi."
_OWN_SUPPLY = "The supply is not the Pi's: a motor on the Pi's 5 V resets it. The grounds are joined."
_INVERTED = "This circuit is on while the pin is high: write active_high = true."


@dataclass(frozen=True, slots=True, kw_only=True)
class Output:
    """One pin of an actuator or a button, with the pins of the header that it needs.

    Attributes:
        name: The part's name in the configuration.
        supplies: Pins of the header by what they are, such as `GROUND`.
    """

    name: str
    circuit: str
    gpio: int
    pin: int
    active_high: bool
    supplies: dict[str, int]

    def at(self, what: str = "") -> str:
        """Return the label of a wire that begins at the header, 15 columns wide; of the GPIO header by default."""
        pin = self.supplies[what] if what else self.pin
        return f"pin {pin:>2}  {what or f'GPIO {self.gpio}':<7}"


@dataclass(frozen=True, slots=True)
class Circuit:
    """A kind of circuit.

    Attributes:
        title: What hangs on the pin.
        supplies: What it needs of the header besides its GPIO.
        draw: Its lines.
        wires: The same as a list of connections, for narrow terminals.
        notes: What to know about its parts.
        is_input: Whether the pin is read, and not driven.
    """

    title: str
    supplies: Callable[[bool], tuple[str, ...]]
    draw: Callable[[Output], tuple[str, ...]]
    wires: Callable[[Output], tuple[str, ...]]
    notes: tuple[str, ...] = ()
    is_active_high_only: bool = False
    is_input: bool = False

    def notes_on(self, output: Output) -> tuple[str, ...]:
        """Return what to know about this output."""
        return (*self.notes, *_contrary(self, output), *(() if self.is_input else _at_boot(output)))


def _contrary(circuit: Circuit, output: Output) -> tuple[str, ...]:
    return (_INVERTED,) if circuit.is_active_high_only and not output.active_high else ()


def _at_boot(output: Output) -> tuple[str, ...]:
    """Say where the pull of a pin that no program has taken yet works against the resistor."""
    pulled_up = output.gpio <= PULLED_UP_MAX
    if pulled_up is not output.active_high:
        return ()
    better = "one of GPIO 9 to 27, except 14 and 15," if output.active_high else "one of GPIO 4, 5 and 6"
    way = "up" if pulled_up else "down"
    return (f"GPIO {output.gpio} is weakly pulled {way} while the Pi boots, towards on: {better} is better.",)


def _draw_switched(part: str, plus: str, minus: str, output: Output) -> tuple[str, ...]:
    """Draw a part between plus and a MOSFET that joins it to minus while the pin is high."""
    return (
        f"{plus:─<39}┬─────────┐",
        "                                       │         │ stripe",
        f"{'':34}{f'[{part}]':^11} [diode]",
        "                                       │         │",
        "                                       ├─────────┘",
        "                                       │ drain",
        f"{output.at()} ──[220 ohm]──┬── gate [MOSFET]",
        "                             │         │ source",
        "                         [10 kohm]     │",
        "                             │         │",
        f"{output.at(GROUND)} ─────────────┴─────────{minus}",
    )


def _wire_switched(plus: str, part: str, output: Output) -> tuple[str, ...]:
    return (
        f"{plus} to {part}; {part} to drain",
        f"diode across {part}, stripe to plus",
        f"{output.at()} by 220 ohm to gate",
        "10 kohm from gate to source",
        f"{output.at(GROUND)} to source",
    )


def _draw_motor(output: Output) -> tuple[str, ...]:
    return _draw_switched("motor", "plus of its own supply ──[switch]──", "┴── minus of that supply", output)


def _wire_motor(output: Output) -> tuple[str, ...]:
    own = ("minus of the motor's own supply to source",)
    return (*_wire_switched("plus of the motor's own supply", "motor", output), *own)


def _draw_buzzer(output: Output) -> tuple[str, ...]:
    return _draw_switched("buzzer", f"{output.at(POWER_5V)} ", "┘", output)


def _wire_buzzer(output: Output) -> tuple[str, ...]:
    return _wire_switched(output.at(POWER_5V), "buzzer", output)


def _led_ends(output: Output) -> tuple[str, str]:
    """Return what the resistor and what the short leg of the LED go to."""
    return (output.at(), output.at(GROUND)) if output.active_high else (output.at(POWER_3V3), output.at())


def _draw_led(output: Output) -> tuple[str, ...]:
    plus, minus = _led_ends(output)
    return (
        f"{plus} ──[330 ohm]──┐",
        "                             │ long leg",
        "                           [LED]",
        "                             │ short leg",
        f"{minus} ─────────────┘",
    )


def _wire_led(output: Output) -> tuple[str, ...]:
    plus, minus = _led_ends(output)
    return (f"{plus} by 330 ohm to the long leg", f"the short leg to {minus}")


def _draw_relay(output: Output) -> tuple[str, ...]:
    input_, ground, power = output.at(), output.at(GROUND), output.at(POWER_3V3)
    pull, rest = ("                  [10 kohm]", "                      │")
    wires = {power: "─────────────── VCC", input_: "─────────────── IN", ground: "─────────────── GND"}
    joined = {input_, ground if output.active_high else power}
    lines = [f"{output.at(POWER_5V)} ────────────────────── JD-VCC   (jumper to VCC removed)"]
    open_end = False
    for label, wire in wires.items():
        if open_end and label in joined:
            lines += [pull, rest]
        corner = ("┴" if open_end else "┬") if label in joined else "─"
        open_end = label in joined and not open_end
        lines.append(f"{label} ──────{corner}{wire}")
    return tuple(lines)


def _wire_relay(output: Output) -> tuple[str, ...]:
    rest = output.at(GROUND if output.active_high else POWER_3V3)
    return (
        f"{output.at(POWER_5V)} to JD-VCC, its jumper to VCC removed",
        f"{output.at(POWER_3V3)} to VCC",
        f"{output.at()} to IN",
        f"10 kohm from IN to {rest}",
        f"{output.at(GROUND)} to GND",
    )


def _draw_button(output: Output) -> tuple[str, ...]:
    return (f"{output.at()} ──[button]──┐", f"{'':28}│", f"{output.at(GROUND)} ────────────┘")


def _wire_button(output: Output) -> tuple[str, ...]:
    return (f"{output.at()} to one side of the button", f"its other side to {output.at(GROUND)}")


def _draw_signal(output: Output) -> tuple[str, ...]:
    return (f"{output.at()} ── its input, for 3.3 V", f"{output.at(GROUND)} ── its ground")


# By the name that a driver's plugin gives; the last is for drivers that give none.
CIRCUITS = {
    "motor": Circuit(
        "a motor on a transistor",
        lambda _: (GROUND,),
        _draw_motor,
        _wire_motor,
        (_MOSFET, _DIODE, _OWN_SUPPLY),
        is_active_high_only=True,
    ),
    "buzzer": Circuit(
        "an active buzzer for 5 V on a transistor",
        lambda _: (POWER_5V, GROUND),
        _draw_buzzer,
        _wire_buzzer,
        (_MOSFET, _DIODE, "Buzzer: active, for 5 V, up to 100 mA: one that sounds by itself when it gets power."),
        is_active_high_only=True,
    ),
    "led": Circuit(
        "an LED with its resistor",
        lambda active_high: (GROUND,) if active_high else (POWER_3V3,),
        _draw_led,
        _wire_led,
        ("The resistor makes it 4 mA for a red LED. A brighter lamp needs a transistor, as a motor does.",),
    ),
    "relay": Circuit(
        "a relay board with an opto-coupler",
        lambda _: (POWER_5V, POWER_3V3, GROUND),
        _draw_relay,
        _wire_relay,
        ("5 V on a pin kills it: without an opto-coupler and JD-VCC the board needs a level shifter.",),
    ),
    "button": Circuit(
        "a push button to ground",
        lambda _: (GROUND,),
        _draw_button,
        _wire_button,
        ("Button: one that closes while it is pressed. The Pi's own resistor pulls the pin up: no other is needed.",),
        is_input=True,
    ),
    "": Circuit(
        "a signal of 3.3 V",
        lambda _: (GROUND,),
        _draw_signal,
        _draw_signal,
        ("Its driver does not say what hangs on it. A pin gives a few milliamperes, and 5 V on it kills it.",),
    ),
}


def find_outputs(parts: Iterable[DriverChoice]) -> tuple[Output, ...]:
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
    kind = choice.options.circuit if choice.options.circuit in CIRCUITS else ""
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
