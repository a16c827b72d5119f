"""The things a run has beside its cycles, and those it leaves behind: recordings, the event log, systemd."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer
from msgspec import Struct

import stadimeter
from stadimeter.app.clock import TimeOfDay, is_synchronised, wall_time
from stadimeter.app.event_log import EventLog, event_log_path
from stadimeter.app.places import mounting_places, state_directory
from stadimeter.app.service import (
    Service,
    held_lines,
    safe_outputs_path,
    service,
    without_stop_from_outside,
    write_safe_outputs,
)
from stadimeter.config.extras import missing
from stadimeter.config.files import is_file
from stadimeter.config.optional_tables import TIMELINE_S
from stadimeter.operator_actions import OperatorAction

if TYPE_CHECKING:
    from stadimeter.app.loop import Loop


class RunOptions(Struct, frozen=True, kw_only=True):
    """The files that a run writes, and its optional services: alarm store and control socket.

    Attributes:
        state: The state file; None for the usual one.
        no_state: Whether there shall be none.
        socket: Where to listen; None for the usual place.
        trust_clock: Whether the computer's clock counts as right.
        is_unhurried: Whether the run takes time, so that operator commands can arrive meanwhile.
        service: What tells systemd of the run; None if systemd does not wait for that.
        ends_with_input: Whether the run ends with its standard input, so with the page that started it.
    """

    journal: Path | None = None
    record: Path | None = None
    images: Literal["all", "events", "none"] = "all"
    image_rate_hz: float | None = None
    image_quality_percent: int = 90
    state: Path | None = None
    no_state: bool = False
    socket: Path | None = None
    trust_clock: bool = False
    is_unhurried: bool = True
    service: Service | None = None
    ends_with_input: bool = False


@contextmanager
def open_services(loop: Loop, options: RunOptions, *, is_quiet: bool = False) -> Iterator[None]:
    """Open the optional services of a run, and close them at its end; if it is quiet, nothing is printed before."""
    is_right = (lambda: True) if options.trust_clock else is_synchronised
    with ExitStack() as closing:
        services = loop.services
        late = _ErrorLines(is_quiet=is_quiet)
        closing.callback(late.tell_all)
        services.tell = late
        services.time_of_day = TimeOfDay(
            is_live=loop.parts.is_live, is_right=is_right, shown=lambda now: wall_time(now, loop.parts.configuration)
        )
        _keep_past(loop, is_right, closing)
        _list_safe_outputs(loop)
        closing.enter_context(_watchdog_process(loop))
        closing.enter_context(_watch_mounting(loop))
        if options.service is not None:
            closing.enter_context(_notify_systemd(loop, options.service))
        remembers = not options.no_state and (loop.parts.is_live or options.state is not None)
        listens = options.is_unhurried or options.socket is not None
        if remembers or listens:
            from stadimeter.cli import run_control  # noqa: PLC0415 - short runs of recordings need none of it

            if remembers:
                run_control.open_alarm_store(loop, options.state, is_right)
            if listens:
                run_control.open_control_socket(loop, options.socket, closing)
        if loop.parts.configuration.black_box is not None:
            open_black_box(loop, closing)
        if loop.parts.configuration.web is not None and not options.ends_with_input:
            by_hand = f"stadimeter web {loop.parts.configuration.path}"
            is_service = options.service is not None
            services.tell(f"the page: {'sudo systemctl enable --now stadimeter-web' if is_service else by_hand}")
        yield


def _keep_past(loop: Loop, is_right: Callable[[], bool], closing: ExitStack) -> None:
    """Keep the timeline and the event log of a run that has them: a service has a timeline also without a table."""
    path, table = loop.parts.configuration.path, loop.parts.configuration.timeline
    events = event_log_path(path)
    usual_s = TIMELINE_S if state_directory() is not None else 0.0
    if keep_s := table.keep if table is not None else usual_s:
        # Few runs at a desk keep one.
        from stadimeter.app.timeline import event_log_beside, keep_timeline  # noqa: PLC0415

        folder = closing.enter_context(keep_timeline(loop.listeners, path, keep_s))
        events = events or event_log_beside(folder)
    if events is not None:
        closing.enter_context(_open_event_log(loop, is_right, events))


def open_black_box(loop: Loop, closing: ExitStack) -> None:
    """Keep the last seconds in memory. Without the library that writes clips, a run goes on with a warning."""
    services = loop.services
    if trouble := missing("record"):
        services.tell(f"warning: the black box keeps nothing: {trouble}")
        return
    from stadimeter.app.control.black_box import BlackBox  # noqa: PLC0415 - it takes long, and few runs have one

    box = BlackBox(loop.parts, lambda: loop.state, services.tell, loop.deadline)
    closing.callback(box.close)
    services.black_box, loop.reporter.clips = box, box.clips
    loop.listeners.append(box)
    if services.control is not None:
        services.control.acts[OperatorAction.CLIP.command] = box.act


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
def _open_event_log(loop: Loop, is_right: Callable[[], bool], path: Path) -> Iterator[None]:
    configuration, tell = loop.parts.configuration.path, loop.services.tell
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
    configuration, path = loop.parts.configuration, safe_outputs_path()
    troubles = [] if path is None else write_safe_outputs(configuration, path)
    for trouble in (*troubles, *without_stop_from_outside(configuration)):
        loop.services.tell(f"warning: {trouble}")


@contextmanager
def _watchdog_process(loop: Loop) -> Iterator[None]:
    """Have another process hold what makes the outputs safe, from before they are opened until they are closed."""
    if not (lines := held_lines(loop.parts.configuration)):
        yield
        return
    from stadimeter.app.watchdog import WatchdogLink, limit_s  # noqa: PLC0415 - simulations need none of it

    parts = loop.parts
    now_s = parts.clock.now_s if parts.is_live else None
    link = WatchdogLink(lines, parts.outputs, limit_s(parts.configuration), now_s, loop.services.tell)
    link.start()
    loop.services.watchdog = link
    try:
        yield
    finally:
        ours = ("guard:", *(f"{each.name}:" for each in parts.driven))
        link.close(is_safe=not any(trouble.startswith(ours) for trouble in loop.troubles))


@contextmanager
def _watch_mounting(loop: Loop) -> Iterator[None]:
    """Watch whether the camera stays where it is, if its view was saved and it is a real one."""
    parts = loop.parts
    table = parts.configuration.mounting
    is_wanted = any(map(is_file, mounting_places(parts.configuration.path))) if table.watch is None else table.watch
    if not (parts.is_live and is_wanted):
        yield
        return
    from stadimeter.app.mounting import watch_of  # noqa: PLC0415 - runs without a saved view need none of it

    watch, why = watch_of(parts.configuration)
    if why:
        loop.services.tell(f"warning: {why}")
    if watch is None:
        yield
        return
    parts.cycle.mounting_watch = watch
    loop.listeners.append(watch)
    try:
        yield
    finally:
        watch.close()


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
