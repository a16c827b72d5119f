"""What may be asked of the workbench process: one table of operations, each a function of its arguments."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stadimeter.errors import ConfigError


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """What an operation gives back.

    Attributes:
        data: As JSON has it: objects, lists, texts, finite numbers and null.
        attached: A picture or a drawing that the data is about; empty for none.
    """

    data: Any = None
    attached: bytes = b""


@dataclass(slots=True, kw_only=True)
class Desk:
    """What the operations of one workbench process share.

    Attributes:
        configuration: The file that the page is for; it need not be there yet.
        run_socket: Where the run of that configuration listens; None to look for it each time.
        kept: What an operation remembers for the next one, by the module that remembers it.
        at_rest: What to do when nothing was asked for a while, and at the end: such as to close a camera.
    """

    configuration: Path
    run_socket: Path | None = None
    kept: dict[str, Any] = field(default_factory=dict)
    at_rest: list[Callable[[], None]] = field(default_factory=list)


Operation = Callable[[Desk, Mapping[str, Any]], Reply]
"""Raises `StadimeterError`; the sentence is shown on the page. An error of another kind is a defect."""

_EDITING = "stadimeter.workbench.server.editing"
_RECORDINGS = "stadimeter.workbench.server.recordings"
_SETUP = "stadimeter.workbench.server.setup_operations"

_SETUP_RESULTS = "stadimeter.workbench.server.setup_results"

_SETUP_NAMES = "state begin answer back leave picture camera colour take world"

MODULES: dict[str, str] = {
    **dict.fromkeys(("configuration", "check", "save", "version", "versions", "restore"), _EDITING),
    **dict.fromkeys(("recordings", "recording", "recording-delete"), _RECORDINGS),
    **{f"setup-{name}": _SETUP for name in _SETUP_NAMES.split()},
    "setup-board": "stadimeter.workbench.server.setup_board",
    **dict.fromkeys(("setup-outlook", "setup-try", "setup-wiring", "setup-files"), _SETUP_RESULTS),
    "replay-diff": "stadimeter.workbench.server.replaying",
    "recording-frame": "stadimeter.workbench.server.recorded_frame",
}
"""The module of each operation, which is loaded when it is first asked for. Its ``OPERATIONS`` holds it."""


def operation(name: str) -> Operation:
    """Return an operation by its name; a `ConfigError` if there is none."""
    module = MODULES.get(name)
    if module is None:
        raise ConfigError(f"there is no operation {name!r}; there are {', '.join(MODULES)}")
    found: Operation = importlib.import_module(module).OPERATIONS[name]
    return found
