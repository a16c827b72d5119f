"""What a run has beside its cycles, and what it leaves behind: the options for both, and how they are made."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

import stadimeter
from stadimeter.app.persistence.state_file import state_file
from stadimeter.app.restarts import HANDED_ON, HAS_PAGE
from stadimeter.app.service_folders import runtime_directory, state_directory
from stadimeter.app.wall_time import TimeOfDay, is_synchronised
from stadimeter.errors import ControlError, JournalError

if TYPE_CHECKING:
    from stadimeter.app.loop import Loop
    from stadimeter.app.recordings.recorded_configuration import RecordedConfiguration
    from stadimeter.app.recordings.recorder import Recorder, Writer
    from stadimeter.app.service import Service
    from stadimeter.config.models import WebTable


Seconds = Annotated[float | None, typer.Option("--seconds", min=0.0, metavar="S", help="End after this long.")]
Frames = Annotated[int | None, typer.Option("--frames", min=1, metavar="N", help="End after this many frames.")]
MIN_SPEED, MAX_SPEED = 1e-3, 1e6


def _check_speed(speed: float) -> float:
    if speed and not MIN_SPEED <= speed <= MAX_SPEED:
        raise typer.BadParameter(f"{speed:g} is neither 0 nor between {MIN_SPEED:g} and {MAX_SPEED:g}")
    return speed


Speed = Annotated[
    float,
    typer.Option(
        "--speed",
        callback=_check_speed,
        help="How fast recordings and simulations run: 1 is real time, 0 has no brake.",
    ),
]
Unit = Annotated[Literal["m", "cm", "ft", "in"], typer.Option("--unit", help="The unit to show distances in.")]
JournalFile = Annotated[
    Path | None, typer.Option("--journal", metavar="FILE", help="Record every cycle, for `stadimeter replay`.")
]
RecordFile = Annotated[
    Path | None,
    typer.Option(
        "--record", metavar="FILE.mcap", help="Record every cycle with its picture, for `replay` and for Foxglove."
    ),
]
RecordImages = Annotated[
    Literal["all", "events", "none"],
    typer.Option("--record-images", help="Which pictures --record takes: those of `events` show what changed."),
]
ImageRate = Annotated[
    float | None,
    typer.Option("--image-rate", min=0.01, metavar="HZ", help="Upper limit of recorded pictures a second."),
]
ImageQuality = Annotated[
    int,
    typer.Option("--image-quality", min=1, max=100, metavar="PERCENT", help="Quality of JPEGs; 95 measures best."),
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Keeping:
    """What is kept of a run. With `is_quiet`, trouble is printed at the end only: the view has shown it."""

    journal: Path | None = None
    record: Path | None = None
    images: Literal["all", "events", "none"] = "all"
    image_rate_hz: float | None = None
    image_quality_percent: int = 90
    is_quiet: bool = False


@contextmanager
def kept(loop: Loop, keeping: Keeping) -> Iterator[None]:
    """Record a run while in the context."""
    if keeping.journal is not None and keeping.record is not None and keeping.journal == keeping.record:
        raise JournalError(f"--journal and --record both name {keeping.journal}; they need a file each")
    with ExitStack() as closing:
        recorders: list[Recorder] = []
        teller = _RecordingTroubles(recorders, loop.services.tell, is_quiet=keeping.is_quiet)
        closing.callback(teller.at_end)
        for writer in _writers(loop, keeping):
            recorders.append(_recorder(writer, loop))
            closing.callback(recorders[-1].close)
        loop.listeners += [*recorders, teller]
        yield
        for recorder in recorders:  # both at once
            recorder.end()


def _recorder(writer: Writer, loop: Loop) -> Recorder:
    from stadimeter.app.recordings.recorder import Recorder  # noqa: PLC0415 - it takes long, and few runs have one

    return Recorder(writer, is_live=loop.parts.is_live, deadline=loop.deadline)


def _writers(loop: Loop, keeping: Keeping) -> Iterator[Writer]:
    if keeping.journal is None and keeping.record is None:
        return
    from stadimeter.app.recordings.recorded_configuration import to_be_recorded  # noqa: PLC0415 - likewise

    if keeping.record is not None:
        from stadimeter.app.recordings.recording import require_mcap  # noqa: PLC0415 - likewise

        require_mcap("recording to an MCAP file")  # before a journal is begun that would stay empty
    configuration = to_be_recorded(loop.parts.configuration)
    if keeping.journal is not None:
        from stadimeter.app.recordings.journal import JournalWriter  # noqa: PLC0415 - likewise

        yield JournalWriter(keeping.journal, configuration)
    if keeping.record is not None:
        yield _recording_writer(loop, keeping, keeping.record, configuration)


def _recording_writer(loop: Loop, keeping: Keeping, path: Path, configuration: RecordedConfiguration) -> Writer:
    from stadimeter.app.recordings.recording import ImageOptions, Recorded, RecordingWriter  # noqa: PLC0415 - likewise

    recorded = Recorded(
        configuration=configuration,
        camera=loop.parts.configuration.camera_model,
        sizes={name: detector.target_shape for name, detector in loop.parts.cycle.detectors.items()},
    )
    options = ImageOptions(
        images=keeping.images, rate_hz=keeping.image_rate_hz, quality_percent=keeping.image_quality_percent
    )
    return RecordingWriter(path, recorded, options)


class _RecordingTroubles:
    """Reports what becomes of the files: each thing once, and what is missing in a file again at the end."""

    def __init__(self, recorders: Sequence[Recorder], tell: Callable[[str], None], *, is_quiet: bool) -> None:
        self._recorders = recorders
        self._tell = tell
        self._is_quiet = is_quiet
        self._said: set[str] = set()

    def __call__(self, *_: object) -> None:
        for recorder in self._recorders:
            self._say_kept(recorder)
            if recorder.failure and not self._is_quiet:
                self._say(f"warning: {recorder.failure}; the run goes on without it")

    def at_end(self) -> None:
        """Tell which files are not whole, after the files were closed."""
        for recorder in self._recorders:
            self._say_kept(recorder)
            if recorder.failure:
                self._say(f"warning: the {recorder.kind} is not whole: {recorder.failure}")
            elif recorder.images_left_out:
                count = recorder.images_left_out
                self._say(f"warning: recording: {count} pictures were left out, since the disk did not keep up")

    def _say_kept(self, recorder: Recorder) -> None:
        if recorder.kept():
            self._say(recorder.kept())

    def _say(self, words: str) -> None:
        if words not in self._said:
            self._said.add(words)
            self._tell(words)


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
    typer.Option("--socket", metavar="PATH", help="Where to listen for `stadimeter alarm ack`, `reload` and the like."),
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
        service: What tells systemd of the run; None if systemd does not wait for that.
        web: The page to have beside it; None for that of its configuration.
    """

    state: Path | None = None
    no_state: bool = False
    socket: Path | None = None
    trust_clock: bool = False
    is_unhurried: bool = True
    is_quiet: bool = False
    service: Service | None = None
    web: WebTable | None = None


@contextmanager
def served(loop: Loop, serving: Serving) -> Iterator[None]:
    """Give a run its services."""
    is_right = (lambda: True) if serving.trust_clock else is_synchronised
    with ExitStack() as closing:
        services = loop.services
        late = _ErrorLines(is_quiet=serving.is_quiet)
        closing.callback(late.tell_all)
        services.tell = late
        services.time_of_day = TimeOfDay(is_live=loop.parts.is_live, is_right=is_right)
        if state_directory() is not None:
            closing.enter_context(_logged(loop, is_right))
        if runtime_directory() is not None:
            _list_safe_outputs(loop)
        if serving.service is not None:
            closing.enter_context(_as_service(loop, serving.service))
        _remember(loop, serving, is_right)
        _listen(loop, serving, closing)
        if HANDED_ON in os.environ:
            _end_page_of_before(services.tell)
        yield


def begun_service(configuration: Path) -> Service | None:
    """Return the run as systemd sees it, after a wait if earlier starts have failed; None if it is no service."""
    if not os.environ.get("NOTIFY_SOCKET"):
        return None
    from stadimeter.app.service import service  # noqa: PLC0415 - few runs are services

    found = service(configuration)
    found.pause()
    return found


@contextmanager
def _as_service(loop: Loop, service: Service) -> Iterator[None]:
    service.trouble, service.hung = loop.trouble, loop.parts.capture.hung
    loop.services.service = service
    loop.listeners.append(service)
    yield
    if loop.deadline.is_set:
        service.ended_as_asked()


@contextmanager
def _logged(loop: Loop, is_right: Callable[[], bool]) -> Iterator[None]:
    """Keep the event log of a run."""
    from stadimeter.app.event_log import EventLog, event_log_path  # noqa: PLC0415 - few runs are services

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
    from stadimeter.app.safe_outputs import safe_outputs_path, write_safe_outputs  # noqa: PLC0415 - likewise

    path = safe_outputs_path()
    if path is not None:
        for trouble in write_safe_outputs(loop.parts.configuration, path):
            loop.services.tell(f"warning: {trouble}")


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
    from stadimeter.app.control.socket_server import ControlSocket  # noqa: PLC0415 - likewise
    from stadimeter.app.live.subscriptions import Subscriptions  # noqa: PLC0415 - likewise
    from stadimeter.app.live.watching import (  # noqa: PLC0415 - likewise
        introduction,
        live_feed,
        operated,
    )

    configuration = loop.parts.configuration
    try:
        path = serving.socket or socket_path(configuration.path, usable_folder(runtime_folder()))
        listener = ControlSocket(path, partial(introduction, loop), watched=Subscriptions(live_feed(loop)))
        closing.callback(listener.close)
        listener.open()
    except ControlError as error:
        if serving.socket is not None:
            raise
        loop.services.tell(f"warning: {error}; this run takes no operator commands")
    else:
        closing.enter_context(operated(loop, listener))
        if (web := serving.web or configuration.web) is not None and HAS_PAGE not in os.environ:
            closing.enter_context(_page(loop, path, web))


@contextmanager
def _page(loop: Loop, socket: Path, web: WebTable) -> Iterator[None]:
    """Have the page as a process beside the run, if its libraries are there."""
    from stadimeter.app.page_process import PageProcess, page_command  # noqa: PLC0415 - likewise
    from stadimeter.config.extras import missing  # noqa: PLC0415 - likewise

    if trouble := missing("web"):
        loop.services.tell(f"warning: there is no page: {trouble}")
        yield
        return
    page = PageProcess(page_command(loop.parts.configuration.path, socket, web), loop.services.tell)
    page.start()
    try:
        yield
    finally:
        page.hand_on() if loop.services.is_restart_due else page.end()


def _end_page_of_before(tell: Callable[[str], None]) -> None:
    """End the page that was handed on to this program, which has none."""
    from stadimeter.app.page_process import PageProcess  # noqa: PLC0415 - likewise

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
