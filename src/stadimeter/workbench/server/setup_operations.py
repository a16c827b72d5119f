"""The set-up, one question at a time: the interview of `stadimeter init` with a live picture beside it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stadimeter.errors import ConfigError
from stadimeter.workbench.server.arguments import number, text, truth
from stadimeter.workbench.server.operations import Desk, Operation, Reply
from stadimeter.workbench.server.setup_desk import SetupDesk


def setup_of(desk: Desk) -> SetupDesk:
    """Return the set-up of a workbench process."""
    if "setup" not in desk.kept:
        desk.kept["setup"] = made = SetupDesk(desk.configuration)
        desk.at_rest.append(made.close_camera)
    found: SetupDesk = desk.kept["setup"]
    return found


def _state(desk: Desk, args: Mapping[str, Any]) -> Reply:  # noqa: ARG001
    return Reply(data=setup_of(desk).state())


def _begin(desk: Desk, args: Mapping[str, Any]) -> Reply:
    setup = setup_of(desk)
    setup.begin(anew=truth(args, "anew"))
    return Reply(data=setup.state())


def _answer(desk: Desk, args: Mapping[str, Any]) -> Reply:
    setup = setup_of(desk)
    notes = setup.answer(text(args, "answer"), confirm=truth(args, "confirm", otherwise=True))
    return Reply(data={**setup.state(), "notes": notes})


def _back(desk: Desk, args: Mapping[str, Any]) -> Reply:  # noqa: ARG001
    setup = setup_of(desk)
    if not setup.back():
        raise ConfigError("this is the first question")
    return Reply(data=setup.state())


def _leave(desk: Desk, args: Mapping[str, Any]) -> Reply:  # noqa: ARG001
    setup = setup_of(desk)
    setup.leave()
    return Reply(data=setup.state())


def _picture(desk: Desk, args: Mapping[str, Any]) -> Reply:
    values, jpeg = setup_of(desk).picture(text(args, "draw", "target"), int(number(args, "width_px", 0.0)))
    return Reply(data=values, attached=jpeg)


OPERATIONS: dict[str, Operation] = {
    "setup-state": _state,
    "setup-begin": _begin,
    "setup-answer": _answer,
    "setup-back": _back,
    "setup-leave": _leave,
    "setup-picture": _picture,
}
