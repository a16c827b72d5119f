"""Operations of the workbench process: functions of their arguments, which the page's table of paths names."""

from __future__ import annotations

import importlib
import inspect
import json
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from msgspec import Struct, convert, defstruct, field
from msgspec.structs import asdict

from stadimeter.errors import ConfigError

T = TypeVar("T")


class DeskReply(Struct, frozen=True, kw_only=True):
    """The result that an operation gives back.

    Attributes:
        data: As JSON has it: objects, lists, texts, finite numbers and null.
        attached: A picture or a drawing that the data is about; empty for none.
    """

    data: Any = None
    attached: bytes = b""


class Desk(Struct, kw_only=True):
    """State shared by the operations of one workbench process.

    Attributes:
        configuration: The file that the page is for; it need not be there yet.
        run_socket: Where the run of that configuration listens; None to look for it each time.
        kept: What an operation remembers for the next one, by the module that remembers it.
        at_end: What to do at the end, such as to close a camera.
    """

    configuration: Path
    run_socket: Path | None = None
    kept: dict[str, Any] = field(default_factory=dict)
    at_end: list[Callable[[], None]] = field(default_factory=list)

    def remember(self, name: str, key: object, make: Callable[[], T]) -> T:
        """Return the value that was made for a key; for another key than the last time it is made anew."""
        if name not in self.kept or self.kept[name][0] != key:
            self.kept[name] = key, make()
        found: T = self.kept[name][1]
        return found


# Raises `StadimeterError`; the sentence is shown on the page. An error of another kind is a defect.
Operation = Callable[[Desk, Mapping[str, Any]], DeskReply]
FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])

_KNOWN: dict[str, Operation] = {}


def operation(function: FunctionT) -> FunctionT:
    """Let a function of this package be asked for, by its module and its name, such as ``editing.check``.

    What comes from a browser must have the types of the function's parameters behind the desk. A ``_`` at the end of a
    name is not part of the key. The function returns data, or a `DeskReply` where bytes belong to it.
    """
    hints = get_type_hints(function)
    parameters = list(inspect.signature(function).parameters.values())[1:]
    fields = [
        (each.name, hints[each.name], *([] if each.default is each.empty else [each.default])) for each in parameters
    ]
    arguments = defstruct("Arguments", fields, kw_only=True, rename=lambda name: name.rstrip("_"))

    def answer(desk: Desk, args: Mapping[str, Any]) -> DeskReply:
        try:
            json.dumps(args, ensure_ascii=False, allow_nan=False).encode()
            given = convert(args, arguments)
        except ValueError as error:  # half of a character and infinity too: no file can hold them
            raise ConfigError(f"this cannot be asked for: {error}") from error
        reply = function(desk, **asdict(given))
        return reply if isinstance(reply, DeskReply) else DeskReply(data=reply)

    _KNOWN[f"{function.__module__.rpartition('.')[2]}.{function.__name__}"] = answer
    return function


def find_operation(name: str) -> Operation:
    """Return an operation; a `ConfigError` if there is none. Its module is loaded when it is first asked for."""
    module = name.partition(".")[0]
    if name not in _KNOWN and module.isidentifier() and find_spec(f"{__package__}.{module}"):
        importlib.import_module(f"{__package__}.{module}")
    if name not in _KNOWN:
        raise ConfigError(f"there is no operation {name!r}")
    return _KNOWN[name]
