"""The command ``run``, and how any command runs the loop."""

from __future__ import annotations

import gc
import json
import os
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Annotated

import typer

from stadimeter.app.bootstrap import build
from stadimeter.app.ending import end_with, stopping_on_signals
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.restarts import ENV_PARENT_PAGE_PID, begin_anew
from stadimeter.cli.exits import DONE, ConfigArgument, configuration_path, plain_errors
from stadimeter.cli.keyboard import RunKeys
from stadimeter.cli.run_options import (
    Frames,
    ImageQuality,
    ImageRate,
    JournalFile,
    NoState,
    RecordFile,
    RecordImages,
    RecordingOptions,
    Seconds,
    ServiceOptions,
    SocketFile,
    Speed,
    StateFile,
    TrustClock,
    Unit,
)
from stadimeter.cli.run_services import open_recordings, open_services, start_service
from stadimeter.cli.viewing import Showing, View, in_words, live_or_plain, show, summarise
from stadimeter.config.loader import load_configuration
from stadimeter.core.track import TrackStatus
from stadimeter.detectors.protocol import ProposesColour


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("run")(run)


def run(
    config: ConfigArgument = None,
    frames: Frames = None,
    seconds: Seconds = None,
    journal: JournalFile = None,
    record: RecordFile = None,
    record_images: RecordImages = "all",
    image_rate: ImageRate = None,
    image_quality: ImageQuality = 90,
    state: StateFile = None,
    no_state: NoState = False,
    socket: SocketFile = None,
    trust_clock: TrustClock = False,
    watch: Annotated[bool, typer.Option("--watch", help="Show the live view instead of lines.")] = False,
    speed: Speed = 1.0,
    unit: Unit = "m",
    as_json: Annotated[bool, typer.Option("--json", help="Print nothing but one JSON object, at the end.")] = False,
) -> None:
    """Measure, decide and act, until stopped.

    Opens the camera and every output that CONFIG names, and runs its rules on every frame. Without CONFIG, that is
    stadimeter.toml in this folder. Prints a line a second, and each event at once. A recording ends when its frames
    do; Ctrl-C and SIGTERM stop every output first and then end the run, within 2 s. So does SIGHUP, which says that
    the terminal is gone, wherever the input comes from. To a service, which has no terminal, SIGHUP says to read
    CONFIG again, as `stadimeter reload` does. Ctrl-Z puts every output at its safe value before the process is
    suspended.

    Alarms of a live camera are remembered: after a restart they go on as if nothing had happened. A running instance
    takes operator commands: `stadimeter alarm ack`, `shelve` and so on.

    **Examples**

    - `stadimeter run config/distance-alert.toml --watch`

    - `stadimeter run config/follow-ball.toml --seconds 60 --journal run.jsonl`

    - `stadimeter run config/follow-ball.toml --record run.mcap --image-rate 5`

    **Exit code**: 0 the run ended as it should; 1 a driver has a defect; 2 a device or the configuration is wrong, a
    journal or recording cannot be begun, or there is no memory left; 128 and the number of a signal if something hung,
    so that the process was ended before all was done. A journal that cannot go on, for a full disk for example, is a
    warning: the run goes on without it.
    """
    view: View = "json" if as_json else live_or_plain() if watch else "plain"
    with plain_errors():
        path = configuration_path(config)
        service = start_service(path)
        loop = Loop(build(load_configuration(path, with_tests=False), speed=speed or None))
        recording = RecordingOptions(
            journal=journal,
            record=record,
            images=record_images,
            image_rate_hz=image_rate,
            image_quality_percent=image_quality,
            is_quiet=view != "plain",
        )
        services = ServiceOptions(
            state=state,
            no_state=no_state,
            socket=socket,
            trust_clock=trust_clock,
            is_unhurried=loop.parts.is_live or speed > 0,
            is_quiet=view == "live",
            service=service,
        )
        showing = Showing(view, path.name, unit, RunKeys(loop))
        run_loop(loop, Limits(frames=frames, seconds=seconds), recording, services, showing)


def run_loop(
    loop: Loop, limits: Limits, recording: RecordingOptions, services: ServiceOptions, showing: Showing
) -> None:
    """Run, and raise `typer.Exit`; or leave the process at once, if a signal has asked for the end and all is done.

    To take down the interpreter takes a small computer half a second, and for ever if a thread of a library hangs.
    """

    def stop(why: str) -> None:
        loop.services.cancel_restart()
        try:
            loop.stop(why)
        finally:
            showing.keys.keyboard.restore()

    with stopping_on_signals(stop, loop.services.reload, loop.give_up, loop.make_safe), _telling_of_threads(loop):
        end_with(os.environ.get(ENV_PARENT_PAGE_PID, ""))
        try:
            with plain_errors():
                _run_to_the_end(loop, limits, recording, services, showing)
                _say_end(loop, showing)
            code = DONE
        except typer.Exit as left:
            code = left.exit_code
        except KeyboardInterrupt as error:  # Ctrl-C is a signal of which the loop learns
            raise RuntimeError(f"a driver or library ended the run: {error!r}") from error
        if loop.deadline.is_set and not loop.services.is_restart_due:
            os._exit(code)
    if loop.services.is_restart_due:
        begin_anew()
    raise typer.Exit(code)


@contextmanager
def _telling_of_threads(loop: Loop) -> Iterator[None]:
    """Report a thread that ends by an uncaught error. Of a ``SystemExit``, Python would say nothing."""
    before = threading.excepthook

    def tell(args: threading.ExceptHookArgs) -> None:
        name = args.thread.name if args.thread is not None else "?"
        kind = args.exc_type.__name__
        loop.services.tell(f"warning: the thread {name!r} has ended: {kind}: {args.exc_value}")
        before(args)

    threading.excepthook = tell
    try:
        yield
    finally:
        threading.excepthook = before


def _run_to_the_end(
    loop: Loop, limits: Limits, recording: RecordingOptions, services: ServiceOptions, showing: Showing
) -> None:
    with open_services(loop, services), open_recordings(loop, recording), show(loop, showing):
        if loop.parts.recording_drives:
            loop.listeners.append(_RealOutputsWarning(loop.parts.recording_drives))
        gc.freeze()  # else all threads stand still now and then, while the collector walks through every library
        loop.run(limits)


def _say_end(loop: Loop, showing: Showing) -> None:
    for trouble in loop.troubles:
        typer.echo(f"warning: while ending: {trouble}", err=True)
    summary = summarise(loop.health, loop.ending)
    if showing.view == "json":
        typer.echo(json.dumps(summary))
    else:
        advice = (*_never_seen(loop, summary["tracks"]), *loop.parts.cycle.perceiver.motion_blur.advice())
        typer.echo("\n".join([in_words(summary), *advice]))
    if showing.last and not loop.services.is_restart_due:
        typer.echo(f"\n{showing.last}")


def _never_seen(loop: Loop, tracks: Mapping[str, Mapping[str, int]]) -> Iterator[str]:
    """Yield what to try for each target that goes by its colour and was in no frame."""
    configuration = loop.parts.configuration
    for target in configuration.targets:
        if isinstance(target.options, ProposesColour) and set(tracks.get(target.name, ())) == {TrackStatus.SEARCHING}:
            file = configuration.path
            yield f"{target.name} was never seen. `stadimeter colour --live {file}` proposes its range of colours."


class _RealOutputsWarning:
    """Warns once, when the first frame has come, that a recording drives something real."""

    def __init__(self, outputs: tuple[str, ...]) -> None:
        self._words = f"warning: a recording or simulation drives real outputs: {', '.join(outputs)}"

    def __call__(self, *_: object) -> None:
        if self._words:
            typer.echo(self._words, err=True)
        self._words = ""
