"""The command ``run``, and how any command runs the loop."""

from __future__ import annotations

import gc
import json
import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from stadimeter.app.bootstrap import build
from stadimeter.app.ending import end_with_input, stopping_on_signals
from stadimeter.app.live.health import peak_memory_mb, percentile
from stadimeter.app.live.history import RunHistory
from stadimeter.app.loop import Limits, Loop
from stadimeter.cli.exits import DONE, ConfigArgument, configuration_path, plain_errors
from stadimeter.cli.keyboard import RunKeys
from stadimeter.cli.run_services import RunOptions, open_services, start_service
from stadimeter.cli.viewing import Showing, View, live_or_plain, show
from stadimeter.config.loader import load_configuration
from stadimeter.core.measurement import TrackStatus
from stadimeter.detectors.protocol import ProposesColour

Seconds = Annotated[float | None, typer.Option("--seconds", min=0.0, metavar="S", help="End after this long.")]
Frames = Annotated[int | None, typer.Option("--frames", min=1, metavar="N", help="End after this many frames.")]
Speed = Annotated[
    float,
    typer.Option("--speed", min=0.0, help="How fast recordings and simulations run: 1 is real time, 0 has no brake."),
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
    int, typer.Option("--image-quality", min=1, max=100, metavar="PERCENT", help="Quality of JPEGs; 95 measures best.")
]


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
    ends_with_input: Annotated[bool, typer.Option("--end-with-input", hidden=True)] = False,
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
        options = RunOptions(
            journal=journal,
            record=record,
            images=record_images,
            image_rate_hz=image_rate,
            image_quality_percent=image_quality,
            state=state,
            no_state=no_state,
            socket=socket,
            trust_clock=trust_clock,
            is_unhurried=loop.parts.is_live or speed > 0,
            service=service,
            ends_with_input=ends_with_input,
        )
        run_loop(loop, Limits(frames=frames, seconds=seconds), options, Showing(view, path.name, unit, RunKeys(loop)))


def run_loop(loop: Loop, limits: Limits, options: RunOptions, showing: Showing) -> None:
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
        if options.ends_with_input:
            end_with_input()
        try:
            with plain_errors():
                _run_to_the_end(loop, limits, options, showing)
                _say_end(loop, showing)
            code = DONE
        except typer.Exit as left:
            code = left.exit_code
        except KeyboardInterrupt as error:  # Ctrl-C is a signal of which the loop learns
            raise RuntimeError(f"a driver or library ended the run: {error!r}") from error
        if loop.deadline.is_set and not loop.services.is_restart_due:
            os._exit(code)
    if loop.services.is_restart_due:
        _begin_again()
    raise typer.Exit(code)


def _begin_again() -> None:
    """Replace this program by a new one with the same command line and process id. Does not return."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os.closerange(3, os.sysconf("SC_OPEN_MAX"))  # also what a library opened that knows nothing of it
    os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])  # noqa: S606 - our own command line


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


def _run_to_the_end(loop: Loop, limits: Limits, options: RunOptions, showing: Showing) -> None:
    with (
        open_services(loop, options, is_quiet=showing.view == "live"),
        open_recordings(loop, options, is_quiet=showing.view != "plain"),
        show(loop, showing),
    ):
        if loop.parts.recording_drives:
            loop.listeners.append(_warn_of_real_outputs(loop.parts.recording_drives))
        gc.freeze()  # else all threads stand still now and then, while the collector walks through every library
        loop.run(limits)


def open_recordings(loop: Loop, options: RunOptions, *, is_quiet: bool = False) -> AbstractContextManager[None]:
    """Record a run while in the context; if it is quiet, trouble is printed at the end only: the view has shown it."""
    if options.journal is None and options.record is None:
        return nullcontext()
    from stadimeter.cli.run_recording import recording  # noqa: PLC0415 - it takes long, and few runs are recorded

    return recording(loop, options, is_quiet=is_quiet)


def _say_end(loop: Loop, showing: Showing) -> None:
    for trouble in loop.troubles:
        typer.echo(f"warning: while ending: {trouble}", err=True)
    summary = summarise(loop.history, loop.ending)
    if showing.view == "json":
        typer.echo(json.dumps(summary))
    else:
        advice = (*_never_seen(loop, summary["tracks"]), *loop.parts.cycle.perceiver.motion_blur.advice())
        typer.echo("\n".join([_in_words(summary), *advice]))
    if showing.last and not loop.services.is_restart_due:
        typer.echo(f"\n{showing.last}")


def summarise(history: RunHistory, ending: str) -> dict[str, Any]:
    """Return the figures of a run, as ``run --json`` prints them: counts, and times in milliseconds."""
    return {
        "ended": ending,
        "cycles": history.cycles,
        "frames": history.frames,
        "tracks": {target: dict(counts) for target, counts in history.track_statuses.items()},
        "events": dict(history.event_counts),
        "data_age_ms": _milliseconds(history.data_ages_s),
        "cycle_ms": _milliseconds(history.cycle_times_s),
        "first_command_s": None if history.first_command_s is None else round(history.first_command_s, 3),
        "peak_memory_mb": round(peak_memory_mb(), 1),
    }


def _in_words(summary: dict[str, Any]) -> str:
    """Return the figures of a run as a few lines."""
    lines = [f"Ended: {summary['ended'] or 'unknown'}. {summary['frames']} frames in {summary['cycles']} cycles."]
    for target, counts in summary["tracks"].items():
        lines.append(f"{target}: {_list_counts(counts)}.")
    if summary["events"]:
        lines.append(f"Events: {_list_counts(summary['events'])}.")
    if summary["cycle_ms"]["p50"] is not None:
        lines.append(
            f"Cycle time: median {summary['cycle_ms']['p50']:.1f} ms, p95 {summary['cycle_ms']['p95']:.1f} ms."
        )
    return "\n".join(lines)


def _list_counts(counts: dict[str, int]) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in counts.items())


def _milliseconds(seconds: Iterable[float]) -> dict[str, float | None]:
    ordered = sorted(seconds)
    shares = {name: percentile(ordered, share) for name, share in (("p50", 0.5), ("p95", 0.95))}
    return {name: None if at_s is None else round(at_s * 1000, 3) for name, at_s in shares.items()}


def _never_seen(loop: Loop, tracks: Mapping[str, Mapping[str, int]]) -> Iterator[str]:
    """Yield what to try for each target that goes by its colour and was in no frame."""
    configuration = loop.parts.configuration
    for target in configuration.targets:
        seen = {status for member in target.members for status in tracks.get(member, ())}
        if isinstance(target.options, ProposesColour) and seen == {TrackStatus.SEARCHING}:
            file = configuration.path
            yield f"{target.name} was never seen. `stadimeter colour --live {file}` proposes its range of colours."


def _warn_of_real_outputs(outputs: tuple[str, ...]) -> Callable[..., None]:
    """Return a listener that warns once, when the first frame has come, that a recording drives something real."""
    words = [f"warning: a recording or simulation drives real outputs: {', '.join(outputs)}"]

    def warn(*_: object) -> None:
        while words:
            typer.echo(words.pop(), err=True)

    return warn
