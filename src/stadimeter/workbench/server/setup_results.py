"""What the set-up comes to: how far the camera sees, what a wish would do, the wiring, and the files of Save."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stadimeter.config.driver_tables import ACTUATOR
from stadimeter.config.gpio_header import HEADER, TAKEN
from stadimeter.config.loader import Configuration
from stadimeter.config.plugins import DriverChoice
from stadimeter.errors import ConfigError
from stadimeter.workbench.drawing import svg_of
from stadimeter.workbench.rule_tests.running import lanes_of
from stadimeter.workbench.server import editing
from stadimeter.workbench.server.arguments import get_text, get_texts
from stadimeter.workbench.server.operations import Desk, DeskReply, operation
from stadimeter.workbench.server.setup_operations import setup_of
from stadimeter.workbench.setup.files import configuration_files
from stadimeter.workbench.setup.question import CONFIGURATION, Known
from stadimeter.workbench.setup.trying import complete_answers, outlook, recent_observations, simulate_approach
from stadimeter.workbench.setup.wish_steps import NOTHING, SCREEN, actuator_table
from stadimeter.workbench.wiring.circuits import CIRCUITS, find_outputs, header_labels, parts_of, pin_name
from stadimeter.workbench.wiring.drawings import circuits_picture, wiring_picture


@operation
def show_outlook(desk: Desk, _args: Mapping[str, Any]) -> DeskReply:
    """Answer how sure the distance to this target will be, near and far."""
    return DeskReply(data=outlook(setup_of(desk).known))


@operation
def try_wishes(desk: Desk, args: Mapping[str, Any]) -> DeskReply:
    """Answer what the wishes would do, on what the camera saw lately and on a target that is made up.

    ``answers`` may hold answers that are not given yet, by their keys, such as blanks that are being filled in.
    """
    setup = setup_of(desk)
    answers = complete_answers(setup.known, get_texts(args, "answers"))
    configuration = _loaded(desk, setup.known, answers)
    seen = lanes_of(configuration.plan, recent_observations(setup.history))
    checked = editing.check(desk, _as_text(setup.known, answers, with_tests=True)).data
    return DeskReply(
        data={
            "words": checked["words"],
            "problems": checked["problems"],
            "tests": checked["tests"],
            "seen": seen.as_json() if seen.took_s else None,
            "made_up": lanes_of(configuration.plan, simulate_approach(configuration, answers)).as_json(),
        }
    )


@operation
def wiring(desk: Desk, args: Mapping[str, Any]) -> DeskReply:
    """Answer the header and the circuits as SVG: of a text, or of the outputs that are chosen.

    ``output`` is one that is not chosen yet, such as ``buzzer 23``. Then the drawing is its circuit alone: ``wires``
    has the pins of the header that it goes to, and ``notes`` what is to be minded.
    """
    written, proposed = get_text(args, "text", ""), get_text(args, "output", "")
    parts = parts_of(editing.loaded(desk, written, {})) if written else _chosen_parts(desk, proposed)
    outputs = find_outputs(parts)
    alone = outputs[-1:] if proposed and not written else ()
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
    notes = [note for each in alone for note in CIRCUITS[each.circuit].notes_on(each)]
    drawing = circuits_picture(alone) if alone else wiring_picture(parts)
    return DeskReply(data={"pins": pins, "wires": wires, "notes": notes}, attached=svg_of(drawing).encode())


@operation
def files(desk: Desk, _args: Mapping[str, Any]) -> DeskReply:
    """Answer the files that Save would write, what `check` finds in them, and what their tests come to."""
    setup = setup_of(desk)
    if setup.interview.next_key:
        raise ConfigError("there are questions left")
    asked = _as_text(setup.known, setup.known.answers, with_tests=True)
    others = [{"name": name, "text": each} for name, each in asked["files"].items()]
    checked = editing.check(desk, asked).data
    return DeskReply(
        data={
            "files": [{"name": desk.configuration.name, "text": asked["text"]}, *others],
            "findings": checked["problems"],
            "words": checked["words"],
            "tests": checked["tests"],
            "base_version": editing.version_of(editing.saved_text(desk)),
        }
    )


def _as_text(known: Known, answers: Mapping[str, str], *, with_tests: bool) -> dict[str, Any]:
    """Return what answers come to, as the arguments of ``check`` and ``save`` have it."""
    if known.camera_model is None:
        raise ConfigError("the camera is not calibrated yet")
    made = configuration_files(answers, known.camera_model, known.model_file)
    return {"text": made.pop(CONFIGURATION), "files": made, "tests": with_tests}


def _loaded(desk: Desk, known: Known, answers: Mapping[str, str]) -> Configuration:
    asked = _as_text(known, answers, with_tests=False)
    return editing.loaded(desk, asked["text"], asked["files"])


def _chosen_parts(desk: Desk, proposed: str) -> tuple[DriverChoice, ...]:
    known = setup_of(desk).known
    answers = [answer for key, answer in known.answers.items() if key.endswith("_output")]
    chosen = dict.fromkeys([*(each for each in answers if each != proposed), *([proposed] if proposed else [])])
    return tuple(
        known.chosen(ACTUATOR, ("actuators", _name(each)), actuator_table(each))
        for each in chosen
        if each not in {NOTHING, SCREEN}
    )


def _name(answer: str) -> str:
    return (answer.split() or [""])[0]
