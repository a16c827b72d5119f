"""Operations of the workbench process: functions of their arguments, which the page's table of paths names."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from stadimeter.errors import ConfigError


@dataclass(frozen=True, slots=True, kw_only=True)
class DeskReply:
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


# Raises `StadimeterError`; the sentence is shown on the page. An error of another kind is a defect.
Operation = Callable[[Desk, Mapping[str, Any]], DeskReply]

_KNOWN: dict[str, Operation] = {}


def operation(function: Operation) -> Operation:
    """Let a function of this package be asked for, by its module and its name, such as ``editing.check``."""
    _KNOWN[f"{function.__module__.rpartition('.')[2]}.{function.__name__}"] = function
    return function


def find_operation(name: str) -> Operation:
    """Return an operation; a `ConfigError` if there is none. Its module is loaded when it is first asked for."""
    module = name.partition(".")[0]
    if name not in _KNOWN and module.isidentifier() and find_spec(f"{__package__}.{module}"):
        importlib.import_module(f"{__package__}.{module}")
    if name not in _KNOWN:
        raise ConfigError(f"there is no operation {name!r}")
    return _KNOWN[name]
