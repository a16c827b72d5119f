"""What a run has beside its cycles: the options for it, and how it is made."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from stadimeter.app.loop import Loop
from stadimeter.app.persistence.state_file import state_file
from stadimeter.app.wall_time import TimeOfDay, is_synchronised
from stadimeter.errors import ControlError

StateFile = Annotated[
    Path | None,
    typer.Option(
        "--state",
        metavar="FILE",
        help="Where alarms are remembered beyond the end of the run. A live camera has one by itself.",
    ),
]
NoState = Annotated[bool, typer.Option("--no-state", help="Remember nothing beyond the end of the run.")]
SocketFile = Annotated[
    Path | None,
    typer.Option("--socket", metavar="PATH", help="Where to listen for `stadimeter ack`, `reload` and the like."),
]
TrustClock = Annotated[
    bool,
    typer.Option("--trust-clock", help="Take the computer's clock for right, though no time server vouches for it."),
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Serving:
    """What a run has beside its cycles.

    Attributes:
        state: The state file; None for the usual one.
        no_state: Whether there shall be none.
        socket: Where to listen; None for the usual place.
        trust_clock: Whether the computer's clock counts as right.
        is_unhurried: Whether the run takes time, so that somebody can ask for something meanwhile.
        is_quiet: Whether nothing is printed about it while it runs: the screen is in use.
    """

    state: Path | None = None
    no_state: bool = False
    socket: Path | None = None
    trust_clock: bool = False
    is_unhurried: bool = True
    is_quiet: bool = False


@contextmanager
def served(loop: Loop, serving: Serving) -> Iterator[None]:
    """Give a run its services."""
    is_right = (lambda: True) if serving.trust_clock else is_synchronised
    with ExitStack() as closing:
        services = loop.services
        late = _Teller(is_quiet=serving.is_quiet)
        closing.callback(late.tell_all)
        services.tell = late
        services.time_of_day = TimeOfDay(is_live=loop.parts.is_live, is_right=is_right)
        _remember(loop, serving, is_right)
        _listen(loop, serving, closing)
        yield


def _remember(loop: Loop, serving: Serving, is_right: Callable[[], bool]) -> None:
    configuration = loop.parts.configuration
    usual = state_file(configuration.path) if loop.parts.is_live else None
    path = None if serving.no_state else serving.state or usual
    if path is None:
        return
    from stadimeter.app.persistence.alarm_store import AlarmStore  # noqa: PLC0415 - likewise
    from stadimeter.app.persistence.resumption import clock_name, moment  # noqa: PLC0415 - likewise
    from stadimeter.app.persistence.state_writer import StateWriter  # noqa: PLC0415 - it takes long, and simulations have none

    clock = clock_name(is_live=loop.parts.is_live)
    store = AlarmStore(path, is_named=serving.state is not None)
    if serving.state is not None:
        store.check()  # whoever names a wrong file wants to know, and before anything moves
    loop.services.memory = StateWriter(store, partial(moment, clock, is_right=is_right), loop.deliveries)


def _listen(loop: Loop, serving: Serving, closing: ExitStack) -> None:
    """Listen for people; a run without a socket runs all the same, unless that was asked for."""
    if serving.socket is None and not serving.is_unhurried:
        return
    from stadimeter.app.control.places import runtime_folder, socket_path, usable_folder  # noqa: PLC0415 - likewise
    from stadimeter.app.control.reloading import Reloader  # noqa: PLC0415 - likewise
    from stadimeter.app.control.requests import Control  # noqa: PLC0415 - it takes long, and short runs have none
    from stadimeter.app.control.socket_server import ControlSocket  # noqa: PLC0415 - likewise

    configuration = loop.parts.configuration
    hello = {"configuration": str(configuration.path.resolve()), "pid": os.getpid()}
    try:
        path = serving.socket or socket_path(configuration.path, usable_folder(runtime_folder()))
        listener = ControlSocket(path, lambda: hello)
        closing.callback(listener.close)
        listener.open()
    except ControlError as error:
        if serving.socket is not None:
            raise
        loop.services.tell(f"warning: {error}; this run takes no operator commands")
    else:
        loop.services.control = Control(listener, Reloader(configuration), deliveries=loop.deliveries.figures)


class _Teller:
    """Writes on standard error; at the end, if the screen is in use until then."""

    def __init__(self, *, is_quiet: bool) -> None:
        self._is_quiet = is_quiet
        self._waiting: list[str] = []

    def __call__(self, words: str) -> None:
        if self._is_quiet:
            self._waiting.append(words)
        else:
            typer.echo(words, err=True)

    def tell_all(self) -> None:
        """Tell what has waited."""
        self._is_quiet = False
        while self._waiting:
            self(self._waiting.pop(0))
