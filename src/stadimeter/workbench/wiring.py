"""Wiring drawings: the header and the circuit of each part, in text for a terminal, and as a picture.

The circuits are those of ``circuits.toml``: the picture has the same wires, boxes and words as the text.
"""

from __future__ import annotations

import re
import textwrap
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from msgspec import Struct

from stadimeter.config.loader import Configuration
from stadimeter.config.plugins import DriverChoice, marked_options
from stadimeter.config.units import GROUND, HEADER, POWER_3V3, POWER_5V, PULLED_UP_MAX, PinMark, header_pin
from stadimeter.core.drawing import BLACK, WHITE, Circle, Drawing, Line, Rectangle, Shape, Text


class Circuit(Struct, frozen=True, kw_only=True):
    """A kind of circuit; ``circuits.toml`` says what its parts mean."""

    title: str
    drawing: str
    notes: tuple[str, ...]
    inverse: str = ""
    following: str = ""
    only_active_high: bool = False
    is_input: bool = False


class WiredPin(Struct, frozen=True, kw_only=True):
    """One pin of an actuator or a button, with the pins of the header that it needs.

    Attributes:
        name: The part's name in the configuration.
        title: What hangs on the pin.
        supplies: Pins of the header by what they are, such as `GROUND`.
        lines: The drawing of its circuit.
        notes: What to know about it.
    """

    name: str
    title: str
    gpio: int
    pin: int
    supplies: dict[str, int]
    lines: tuple[str, ...]
    notes: tuple[str, ...]


_FILE = Path(__file__).with_name("circuits.toml")

# By the name that a driver's class of options gives.
_CIRCUITS = {
    kind: Circuit(notes=tuple(table.pop("notes")), **table)
    for kind, table in tomllib.loads(_FILE.read_text(encoding="utf-8")).items()
}

# What stands for a pin of the header in a drawing.
_LABEL = re.compile(r"pin \.\.  (.{7})")
_OWN_PIN = "GPIO .."


def find_outputs(parts: Iterable[DriverChoice]) -> tuple[WiredPin, ...]:
    """Return every part on a pin, in the order given. Wires get pins of their own as long as there are any."""
    used: set[int] = set()
    return tuple(
        _wire(choice, name, gpio, used, is_first=not number)
        for choice in parts
        for number, (name, gpio) in enumerate(_pins(choice))
    )


def parts_of(configuration: Configuration) -> tuple[DriverChoice, ...]:
    """List the parts that may hang on a pin: actuators in the order of the file, the status LED and buttons."""
    return (*configuration.driven, *configuration.buttons)


def _pins(choice: DriverChoice) -> Iterator[tuple[str, int]]:
    found = [(".".join(map(str, path)), pin) for path, pin in marked_options(choice.options, PinMark)]
    for key, pin in found:
        if isinstance(pin, int):
            yield choice.name if len(found) == 1 else f"{choice.name} {key}", pin


def _wire(choice: DriverChoice, name: str, gpio: int, used: set[int], *, is_first: bool) -> WiredPin:
    circuit = _CIRCUITS.get(choice.options.circuit, _CIRCUITS[""])
    active_high = bool(getattr(choice.options, "active_high", True))
    drawing = circuit.drawing if active_high or not circuit.inverse else circuit.inverse
    drawing = drawing if is_first or not circuit.following else circuit.following
    pin = header_pin(gpio)
    needed = dict.fromkeys(what.strip() for what in _LABEL.findall(drawing) if what != _OWN_PIN)
    supplies = {what: _nearest(what, pin, used) for what in needed}

    def label(found: re.Match[str]) -> str:
        what = found[1].strip()
        number, words = (pin, f"GPIO {gpio}") if what == _OWN_PIN else (supplies[what], what)
        return f"pin {number:>2}  {words:<7}"

    return WiredPin(
        name=name,
        title=circuit.title,
        gpio=gpio,
        pin=pin,
        supplies=supplies,
        lines=tuple(_LABEL.sub(label, drawing).splitlines()),
        notes=(*circuit.notes, *_warnings(circuit, gpio, active_high=active_high)),
    )


def _nearest(what: str, pin: int, used: set[int]) -> int:
    """Return the nearest pin of a supply, one that is still free if there is one, and take it."""
    every = [number for number, each in enumerate(HEADER, start=1) if each == what]
    best = min(every, key=lambda number: (number in used, _steps(number, pin)))
    used.add(best)
    return best


def _steps(one: int, other: int) -> int:
    """Return the distance between two pins: in rows, and a pin across less than a row away."""
    return 2 * abs((one - 1) // 2 - (other - 1) // 2) + (one + other) % 2


def _warnings(circuit: Circuit, gpio: int, *, active_high: bool) -> Iterator[str]:
    """Say what is contrary to the circuit: the level that is on, or the pull of a pin that no program has taken yet."""
    if circuit.only_active_high and not active_high:
        yield "This circuit is on while the pin is high: write active_high = true."
    pulled_up = gpio <= PULLED_UP_MAX
    if pulled_up is active_high and not circuit.is_input:
        better = "one of GPIO 9 to 27, except 14 and 15," if active_high else "one of GPIO 4, 5 and 6"
        way = "up" if pulled_up else "down"
        yield f"GPIO {gpio} is weakly pulled {way} while the Pi boots, towards on: {better} is better."


def header_labels(outputs: Sequence[WiredPin]) -> dict[int, tuple[str, ...]]:
    """Return the names of the outputs on each pin of the header that is used."""
    labels: dict[int, tuple[str, ...]] = {}
    for output in outputs:
        for pin in (output.pin, *output.supplies.values()):
            labels[pin] = (*labels.get(pin, ()), output.name)
    return labels


def pin_name(pin: int) -> str:
    """Name a pin of the header, such as ``GPIO 18``."""
    what = HEADER[pin - 1]
    return f"GPIO {what}" if isinstance(what, int) else what


ORIENTATION = "The header as you see it with the USB sockets at the bottom: pin 2 is in the corner of the board."

# Columns of the text: as many as any terminal has.
WIDTH = 80


def wiring_text(parts: Sequence[DriverChoice]) -> str:
    """Return a drawing of the header and of the circuit of every part on a pin."""
    outputs = find_outputs(parts)
    if not outputs:
        return "no part is on a pin of the header"
    return "\n".join([*textwrap.wrap(ORIENTATION, WIDTH), "", *_header(outputs), *_circuits(outputs)])


def _header(outputs: Sequence[WiredPin]) -> Iterator[str]:
    labels = header_labels(outputs)
    side = (WIDTH - len(" 11 ● ● 12 ")) // 2
    left = max(len(_label(pin, labels, side)) for pin in range(1, 41, 2))
    dots = {pin: "●" if pin in labels else "○" for pin in range(1, 41)}
    for pin in range(1, 41, 2):
        rows = f"{pin:>2} {dots[pin]} {dots[pin + 1]} {pin + 1:<2}"
        yield f"{_label(pin, labels, side):>{left}} {rows} {_label(pin + 1, labels, side)}".rstrip()


def _label(pin: int, labels: dict[int, tuple[str, ...]], room: int) -> str:
    """Name a pin and what hangs on it, cut where it is too long; on the left side the pin comes last."""
    if pin not in labels:
        return pin_name(pin)
    names = ", ".join(labels[pin])
    left = max(4, room - len(pin_name(pin)) - 2)
    names = names if len(names) <= left else names[: left - 2] + ".."
    return f"{names}: {pin_name(pin)}" if pin % 2 else f"{pin_name(pin)}: {names}"


def _circuits(outputs: Sequence[WiredPin]) -> Iterator[str]:
    said: set[str] = set()
    for output in outputs:
        yield ""
        yield from textwrap.wrap(f"{output.name}: {output.title}", WIDTH)
        yield ""
        yield from output.lines
        new = [note for note in output.notes if note not in said]
        said.update(new)
        if new:
            yield ""
        for note in new:
            yield from textwrap.wrap(note, WIDTH)


# The cell of a character.
COLUMN_M, ROW_M = 0.0019, 0.0042

# From one pin of the header to the next.
SIZE_M = 0.0031
PITCH_M = 0.0058

# The widest circuit, that of a motor.
MARGIN_M = 0.008
WIDTH_M = 0.122

# As many letters as a phone shows of the page's drawing.
NOTE_COLUMNS = 60

HEADER_TOP_M = 2 * MARGIN_M + ROW_M
UNUSED, GREY = "#9aa0a6", "#666666"
COLOURS = {POWER_3V3: "#d9822b", POWER_5V: "#c62828", GROUND: BLACK}
SIGNAL = "#1565c0"

# Which sides of its cell a box character reaches.
ENDS = {
    "─": "we", "│": "ns", "┌": "se", "┐": "sw", "└": "ne", "┘": "nw", "├": "nse", "┤": "nsw", "┬": "wes", "┴": "wen",
    "┼": "nswe",
}  # fmt: skip

_WAY = {"n": (0.0, -0.5), "s": (0.0, 0.5), "w": (-0.5, 0.0), "e": (0.5, 0.0)}
_RUN = re.compile(r"\[[^]]*\]|[^\s─│┌┐└┘├┤┬┴┼\[]+(?: [^\s─│┌┐└┘├┤┬┴┼\[]+)*")


def wiring_picture(parts: Sequence[DriverChoice]) -> Drawing:
    """Return a drawing of the header and of the circuit of every part on a pin."""
    outputs = find_outputs(parts)
    shapes: list[Shape] = [*_draw_header(outputs)]
    top_m = HEADER_TOP_M + 20 * PITCH_M + ROW_M
    for output in outputs:
        shapes += _circuit(output, top_m)
        top_m += (len(output.lines) + len(_notes(output)) + 3) * ROW_M
    return Drawing(WIDTH_M + 2 * MARGIN_M, top_m + MARGIN_M, tuple(shapes))


def circuits_picture(outputs: Sequence[WiredPin]) -> Drawing:
    """Return a drawing of circuits, without the header and without notes."""
    shapes: list[Shape] = []
    top_m = MARGIN_M
    columns = max(len(line) for output in outputs for line in output.lines)
    for output in outputs:
        shapes += _circuit(output, top_m, has_notes=False)
        top_m += (len(output.lines) + 2) * ROW_M
    return Drawing(columns * COLUMN_M + 2 * MARGIN_M, top_m, tuple(shapes))


def _draw_header(outputs: Sequence[WiredPin]) -> Iterator[Shape]:
    for row, line in enumerate(textwrap.wrap(ORIENTATION, NOTE_COLUMNS)):
        yield Text(MARGIN_M, MARGIN_M + row * ROW_M, line, SIZE_M, colour=GREY)
    labels = header_labels(outputs)
    middle_m, top_m = MARGIN_M + WIDTH_M / 2, HEADER_TOP_M
    yield Rectangle(middle_m - 1.1 * PITCH_M, top_m - PITCH_M / 2, 2.2 * PITCH_M, 20 * PITCH_M, "#2e3b2e")
    for pin in range(1, 41):
        side = 1 if pin % 2 == 0 else -1
        at = (middle_m + side * PITCH_M / 2, top_m + (pin - 1) // 2 * PITCH_M)
        yield from _pin(pin, labels.get(pin, ()), at, side)


def _pin(pin: int, names: tuple[str, ...], at: tuple[float, float], side: int) -> Iterator[Shape]:
    x_m, y_m = at
    colour = COLOURS.get(str(HEADER[pin - 1]), SIGNAL) if names else UNUSED
    label_x_m, base_m = x_m + side * 1.4 * PITCH_M, y_m + 0.35 * SIZE_M
    if names:
        yield Line(x_m + side * 0.4 * PITCH_M, y_m, label_x_m - side * 0.001, y_m, 0.0008, colour)
    yield Circle(x_m, y_m, 0.42 * PITCH_M, colour)
    yield Text(x_m, base_m, str(pin), SIZE_M, "middle", colour=WHITE)
    words = (pin_name(pin), *([", ".join(names)] if names else []))
    label = ": ".join(words if side > 0 else reversed(words))
    ink = colour if names else UNUSED
    yield Text(label_x_m, base_m, label, SIZE_M, "start" if side > 0 else "end", colour=ink)


def _notes(output: WiredPin) -> list[str]:
    return [line for note in output.notes for line in textwrap.wrap(note, NOTE_COLUMNS, subsequent_indent="  ")]


def _circuit(output: WiredPin, top_m: float, *, has_notes: bool = True) -> Iterator[Shape]:
    yield Text(MARGIN_M, top_m, f"{output.name}: {output.title}", 1.25 * SIZE_M)
    lines, notes = output.lines, _notes(output) if has_notes else []
    for row, line in enumerate(lines, start=1):
        yield from _trace(line, top_m + row * ROW_M)
    for row, note in enumerate(notes, start=len(lines) + 1):
        yield Text(MARGIN_M, top_m + (row + 0.4) * ROW_M + 0.8 * SIZE_M, note, SIZE_M, colour=GREY)


def _trace(line: str, top_m: float) -> Iterator[Shape]:
    """Yield the wires and the words of a line of text; a part in brackets gets a box."""
    middle_m = top_m + ROW_M / 2
    for column, character in enumerate(line):
        x_m = MARGIN_M + (column + 0.5) * COLUMN_M
        for end in ENDS.get(character, ""):
            across, down = _WAY[end]
            yield Line(x_m, middle_m, x_m + across * COLUMN_M, middle_m + down * ROW_M, 0.0004)
    for run in _RUN.finditer(line):
        words, left_m = run[0], MARGIN_M + run.start() * COLUMN_M
        if words.startswith("["):
            yield Rectangle(left_m, top_m, len(words) * COLUMN_M, ROW_M, WHITE)
            yield Rectangle(left_m, top_m, len(words) * COLUMN_M, ROW_M, outline_m=0.0003)
        yield Text(
            left_m + len(words) * COLUMN_M / 2, middle_m + 0.35 * SIZE_M, words.strip("[]"), SIZE_M, "middle",
            is_fixed_width=True,
        )  # fmt: skip
