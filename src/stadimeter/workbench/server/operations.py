"""What may be asked of the workbench process: one table of operations, each a function of its arguments."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


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
    """

    configuration: Path
    run_socket: Path | None = None
    kept: dict[str, Any] = field(default_factory=dict)


Operation = Callable[[Desk, Mapping[str, Any]], Reply]
"""Raises `StadimeterError`; the sentence is shown on the page."""
