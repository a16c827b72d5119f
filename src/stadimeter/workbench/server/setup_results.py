"""The results of the set-up: the wiring, and the files of Save."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stadimeter.config.driver_tables import DRIVER_KINDS
from stadimeter.config.plugins import DriverChoice
from stadimeter.config.units import HEADER, TAKEN
from stadimeter.errors import ConfigError
from stadimeter.workbench.printing import svg_of
from stadimeter.workbench.server import editing
from stadimeter.workbench.server.operations import Desk, DeskReply, operation
from stadimeter.workbench.server.setup_operations import setup_of
from stadimeter.workbench.setup.files import (
    configuration_files,
    parts_of_answers,
)
from stadimeter.workbench.setup.question import CONFIGURATION, Known
from stadimeter.workbench.setup.recipes import SCREEN, part_table
from stadimeter.workbench.wiring import (
    circuits_picture,
    find_outputs,
    header_labels,
    pin_name,
    wiring_picture,
)


@operation
def wiring(desk: Desk, output: str = "") -> DeskReply:
    """Answer the header and the circuits of the outputs that are chosen, as SVG.

    ``output`` is one that is not chosen yet, such as ``buzzer 23``. Then the drawing is its circuit alone: ``wires``
    has the pins of the header that it goes to, and ``notes`` what is to be minded.
    """
    parts = _chosen_parts(desk, output)
    outputs = find_outputs(parts)
    alone = outputs[-1:] if output else ()
    labels = header_labels(outputs)
    pins = [
        {
            "number": number,
            "name": pin_name(number),
            "gpio": what if isinstance(what, int) else None,
            "taken_by": list(labels.get(number, ())),
            "warning": TAKEN.get(what, "") if isinstance(what, int) else "",
        }
        for number, what in enumerate(HEADER, start=1)
    ]
    wires = [{"number": number, "name": pin_name(number)} for number in sorted(header_labels(alone))]
    notes = [note for each in alone for note in each.notes]
    drawing = circuits_picture(alone) if alone else wiring_picture(parts)
    return DeskReply(data={"pins": pins, "wires": wires, "notes": notes}, attached=svg_of(drawing).encode())


@operation
def files(desk: Desk) -> dict[str, Any]:
    """Answer the files that Save would write, what `check` finds in them, and what their tests come to."""
    setup = setup_of(desk)
    if setup.interview.next_key:
        raise ConfigError("there are questions left")
    text, others = _as_text(setup.known, setup.known.answers)
    checked = editing.check(desk, text, others, tests=True)
    return {
        "files": [{"name": name, "text": each} for name, each in {desk.configuration.name: text, **others}.items()],
        "findings": checked["problems"],
        "words": checked["words"],
        "tests": checked["tests"],
        "base_version": editing.version_of(editing.saved_text(desk)),
    }


def _as_text(known: Known, answers: Mapping[str, str]) -> tuple[str, dict[str, str]]:
    """Return the configuration that answers come to, and the files beside it by their names."""
    made = configuration_files(answers, known.lens, known.model_file)
    return made.pop(CONFIGURATION), made


def _chosen_parts(desk: Desk, proposed: str) -> tuple[DriverChoice, ...]:
    """Return what is wired by the answers, the proposed output last."""
    known = setup_of(desk).known
    outputs = [each for each in parts_of_answers(known.answers, "output").values() if each != proposed]
    pressed = parts_of_answers(known.answers, "button").values()
    return tuple(
        known.choose(DRIVER_KINDS[section], (section, answer.split()[0]), part_table(answer))
        for section, answers in (("buttons", pressed), ("actuators", [*dict.fromkeys(outputs), proposed]))
        for answer in answers
        if answer and answer != SCREEN
    )
