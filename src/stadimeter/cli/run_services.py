"""What a run has beside its cycles, and what it leaves behind: recordings, the event log, systemd."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import typer

import stadimeter
from stadimeter.app.event_log import EventLog, event_log_path
from stadimeter.app.page_process import PageProcess
from stadimeter.app.restarts import ENV_PAGE_LEFT
from stadimeter.app.safe_outputs import safe_outputs_path, write_safe_outputs
from stadimeter.app.service import Service, service
from stadimeter.app.service_folders import runtime_directory, state_directory
from stadimeter.app.wall_time import TimeOfDay, is_synchronised
from stadimeter.cli.run_options import RecordingOptions, ServiceOptions

if TYPE_CHECKING:
    from stadimeter.app.loop import Loop


def open_recordings(loop: Loop, options: RecordingOptions) -> AbstractContextManager[None]:
    """Record a run while in the context."""
    if options.journal is None and options.record is None:
        return nullcontext()
    from stadimeter.cli.run_recording import recording  # noqa: PLC0415 - it takes long, and few runs are recorded

    return recording(loop, options)


@contextmanager
def open_services(loop: Loop, options: ServiceOptions) -> Iterator[None]:
    """Open the optional services of a run, and close them at its end."""
    is_right = (lambda: True) if options.trust_clock else is_synchronised
    with ExitStack() as closing:
        services = loop.services
        late = _ErrorLines(is_quiet=options.is_quiet)
        closing.callback(late.tell_all)
        services.tell = late
        services.time_of_day = TimeOfDay(is_live=loop.parts.is_live, is_right=is_right)
        if state_directory() is not None:
            closing.enter_context(_open_event_log(loop, is_right))
        if runtime_directory() is not None:
            _list_safe_outputs(loop)
        if options.service is not None:
            closing.enter_context(_notify_systemd(loop, options.service))
        remembers = not options.no_state and (loop.parts.is_live or options.state is not None)
        listens = options.is_unhurried or options.socket is not None
        if remembers or listens:
            from stadimeter.cli import run_control  # noqa: PLC0415 - short runs of recordings need none of it

            if remembers:
                run_control.open_alarm_store(loop, options.state, is_right)
            if listens:
                run_control.open_control_socket(loop, options.socket, options.web, closing)
        if ENV_PAGE_LEFT in os.environ:
            _end_previous_page(services.tell)
        yield


def start_service(configuration: Path) -> Service | None:
    """Return the link to systemd, after a pause if earlier starts have failed; None if this is no service."""
    if not os.environ.get("NOTIFY_SOCKET"):
        return None
    found = service(configuration)
    found.pause()
    return found


@contextmanager
def _notify_systemd(loop: Loop, service: Service) -> Iterator[None]:
    service.trouble, service.hung = loop.trouble, loop.parts.capture.hung
    loop.services.service = service
    loop.listeners.append(service)
    yield
    if loop.deadline.is_set:
        service.ended_as_asked()


@contextmanager
def _open_event_log(loop: Loop, is_right: Callable[[], bool]) -> Iterator[None]:
    """Keep the event log of a run."""
    configuration, tell = loop.parts.configuration.path, loop.services.tell
    path = event_log_path(configuration)
    if path is None:
        yield
        return
    log = EventLog(path, is_right=is_right)

    def tell_and_log(words: str) -> None:
        tell(words)
        log.say(words)

    loop.services.tell = tell_and_log
    loop.listeners.append(log)
    log.start(f"stadimeter {stadimeter.__version__}, {configuration}")
    try:
        yield
    except BaseException as error:
        log.end(str(error) or type(error).__name__)
        raise
    log.end(loop.ending)


def _list_safe_outputs(loop: Loop) -> None:
    path = safe_outputs_path()
    if path is not None:
        for trouble in write_safe_outputs(loop.parts.configuration, path):
            loop.services.tell(f"warning: {trouble}")


def _end_previous_page(tell: Callable[[str], None]) -> None:
    """End the page that was handed on to this program, which has none."""
    PageProcess((), tell).end_left()


class _ErrorLines:
    """Writes on standard error; at the end, if the screen is in use until then."""

    def __init__(self, *, is_quiet: bool) -> None:
        self._is_quiet = is_quiet
        self._waiting: list[str] = []

    def __call__(self, words: str) -> None:
        if self._is_quiet:
            self._waiting.append(words)
            return
        try:
            typer.echo(words, err=True)
        except OSError as error:
            if error.errno != errno.ENOSPC:  # a warning that the disk is full must not end the run, if it goes there
                raise

    def tell_all(self) -> None:
        """Tell what has waited."""
        self._is_quiet = False
        while self._waiting:
            self(self._waiting.pop(0))
