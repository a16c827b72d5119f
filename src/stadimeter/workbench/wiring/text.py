"""Wiring drawings in text, for a terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence

from stadimeter.config.plugins import DriverChoice
from stadimeter.workbench.wiring.circuits import CIRCUITS, Output
from stadimeter.workbench.wiring.outputs import header_labels, pin_name, wired_outputs

ORIENTATION = "The header as you see it with the USB sockets at the bottom: pin 2 is in the corner of the board."
_BOX = str.maketrans("─│┌┐└┘├┤┬┴┼●○", "-|+++++++++*o")


def wiring_text(parts: Sequence[DriverChoice], *, width: int = 80, ascii_only: bool = False) -> str:
    """Return a drawing of the header and of the circuit of every part on a pin.

    Args:
        parts: Of a configuration, such as its actuators.
        width: Columns of the terminal. Circuits that do not fit are lists of connections instead.
        ascii_only: Whether the terminal knows only ASCII.
    """
    outputs = wired_outputs(parts)
    if not outputs:
        return "no part is on a pin of the header"
    text = "\n".join([*_wrapped(ORIENTATION, width), "", *_header(outputs, width), *_circuits(outputs, width)])
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
        yield from _wrapped(f"{output.name}: {circuit.title}", width)
        yield ""
        lines = circuit.draw(output)
        if max(map(len, lines)) <= width:
            yield from lines
        else:
            for wire in circuit.wires(output):
                yield from _wrapped(f"- {' '.join(wire.split())}", width, "  ")
        new = [note for note in circuit.notes_on(output) if note not in said]
        said.update(new)
        if new:
            yield ""
        for note in new:
            yield from _wrapped(note, width)


def _wrapped(text: str, width: int, indent: str = "") -> list[str]:
    return textwrap.wrap(text, width, subsequent_indent=indent)
