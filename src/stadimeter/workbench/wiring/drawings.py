"""Wiring drawings: the header and the circuit of each part, in text for a terminal, and as a picture."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Sequence

from stadimeter.config.gpio_header import GROUND, HEADER, POWER_3V3, POWER_5V
from stadimeter.config.plugins import DriverChoice
from stadimeter.core.drawing import BLACK, WHITE, Circle, Drawing, Line, Rectangle, Shape, Text
from stadimeter.workbench.wiring.circuits import CIRCUITS, Output, find_outputs, header_labels, pin_name

ORIENTATION = "The header as you see it with the USB sockets at the bottom: pin 2 is in the corner of the board."
_BOX = str.maketrans("─│┌┐└┘├┤┬┴┼●○", "-|+++++++++*o")


def wiring_text(parts: Sequence[DriverChoice], *, width: int = 80, ascii_only: bool = False) -> str:
    """Return a drawing of the header and of the circuit of every part on a pin.

    Args:
        parts: Of a configuration, such as its actuators.
        width: Columns of the terminal. Circuits that do not fit are lists of connections instead.
        ascii_only: Whether the terminal knows only ASCII.
    """
    outputs = find_outputs(parts)
    if not outputs:
        return "no part is on a pin of the header"
    text = "\n".join([*_wrap(ORIENTATION, width), "", *_header(outputs, width), *_circuits(outputs, width)])
    return text.translate(_BOX) if ascii_only else text


def _header(outputs: Sequence[Output], width: int) -> Iterator[str]:
    labels = header_labels(outputs)
    side = (width - len(" 11 ● ● 12 ")) // 2
    left = max(len(_label(pin, labels, side)) for pin in range(1, 41, 2))
    for pin in range(1, 41, 2):
        yield (
            f"{_label(pin, labels, side):>{left}} {pin:>2} {_dot(pin, labels)} {_dot(pin + 1, labels)} {pin + 1:<2} "
            f"{_label(pin + 1, labels, side)}"
        ).rstrip()


def _label(pin: int, labels: dict[int, tuple[str, ...]], room: int) -> str:
    """Return what a pin is and what hangs on it, cut where it is too long; on the left side the pin comes last."""
    if pin not in labels:
        return pin_name(pin)
    names = ", ".join(labels[pin])
    left = max(4, room - len(pin_name(pin)) - 2)
    names = names if len(names) <= left else names[: left - 2] + ".."
    return f"{names}: {pin_name(pin)}" if pin % 2 else f"{pin_name(pin)}: {names}"


def _dot(pin: int, labels: dict[int, tuple[str, ...]]) -> str:
    return "●" if pin in labels else "○"


def _circuits(outputs: Sequence[Output], width: int) -> Iterator[str]:
    said: set[str] = set()
    for output in outputs:
        circuit = CIRCUITS[output.circuit]
        yield ""
        yield from _wrap(f"{output.name}: {circuit.title}", width)
        yield ""
        lines = circuit.draw(output)
        if max(map(len, lines)) <= width:
            yield from lines
        else:
            for wire in circuit.wires(output):
                yield from _wrap(f"- {' '.join(wire.split())}", width, "  ")
        new = [note for note in circuit.notes_on(output) if note not in said]
        said.update(new)
        if new:
            yield ""
        for note in new:
            yield from _wrap(note, width)


def _wrap(text: str, width: int, indent: str = "") -> list[str]:
    return textwrap.wrap(text, width, subsequent_indent=indent)


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
        top_m += (len(_lines(output)) + len(_notes(output)) + 3) * ROW_M
    return Drawing(WIDTH_M + 2 * MARGIN_M, top_m + MARGIN_M, tuple(shapes))


def circuit_picture(part: DriverChoice) -> Drawing:
    """Return a drawing of a part's circuits by themselves, for parts lists."""
    return circuits_picture(find_outputs([part]))


def circuits_picture(outputs: Sequence[Output]) -> Drawing:
    """Return a drawing of circuits, without the header and without notes."""
    shapes: list[Shape] = []
    top_m = MARGIN_M
    columns = max(len(line) for output in outputs for line in _lines(output))
    for output in outputs:
        shapes += _circuit(output, top_m, has_notes=False)
        top_m += (len(_lines(output)) + 2) * ROW_M
    return Drawing(columns * COLUMN_M + 2 * MARGIN_M, top_m, tuple(shapes))


def _draw_header(outputs: Sequence[Output]) -> Iterator[Shape]:
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


def _lines(output: Output) -> tuple[str, ...]:
    return CIRCUITS[output.circuit].draw(output)


def _notes(output: Output) -> list[str]:
    return [
        line
        for note in CIRCUITS[output.circuit].notes_on(output)
        for line in textwrap.wrap(note, NOTE_COLUMNS, subsequent_indent="  ")
    ]


def _circuit(output: Output, top_m: float, *, has_notes: bool = True) -> Iterator[Shape]:
    yield Text(MARGIN_M, top_m, f"{output.name}: {CIRCUITS[output.circuit].title}", 1.25 * SIZE_M)
    lines, notes = _lines(output), _notes(output) if has_notes else []
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
