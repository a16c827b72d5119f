"""The commands that run the loop: ``run`` and ``demo``."""

from __future__ import annotations

import gc
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

from stadimeter.app.bootstrap import build, demo_configuration
from stadimeter.app.ending import stopping_on_signals
from stadimeter.app.loop import Limits, Loop
from stadimeter.cli.exits import DONE, plain_errors
from stadimeter.cli.run_options import (
    ImageQuality,
    ImageRate,
    JournalFile,
    Keeping,
    NoState,
    RecordFile,
    RecordImages,
    Serving,
    SocketFile,
    StateFile,
    TrustClock,
    kept,
    served,
)
from stadimeter.cli.viewing import View, in_words, show, summarise
from stadimeter.config.loader import load_configuration

ConfigFile = Annotated[Path, typer.Argument(metavar="CONFIG", help="The configuration, a TOML file.")]
Seconds = Annotated[float | None, typer.Option("--seconds", min=0.0, metavar="S", help="End after this long.")]
Frames = Annotated[int | None, typer.Option("--frames", min=1, metavar="N", help="End after this many frames.")]
Speed = Annotated[
    float,
    typer.Option("--speed", min=0.0, help="How fast recordings and simulations run: 1 is real time, 0 has no brake."),
]
Unit = Annotated[Literal["m", "cm", "ft", "in"], typer.Option("--unit", help="The unit to show distances in.")]


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command("run")(run)
    app.command("demo")(demo)


def run(
    config: ConfigFile,
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

    Opens the camera and every output that CONFIG names, and runs its rules on every frame. Prints a line a second,
    and each event at once. A recording ends when its frames do; Ctrl-C and SIGTERM stop every output first and then
    end the run, within 2 s. So does SIGHUP, which says that the terminal is gone, wherever the input comes from. To a
    service, which has no terminal, SIGHUP says to read CONFIG again, as `stadimeter reload` does.

    Alarms of a live camera are remembered: after a restart they go on as if nothing had happened. A running instance
    takes operator commands: `stadimeter alarm ack`, `shelve` and so on.

    **Examples**

    - `stadimeter run config/distance-alert.toml --watch`

    - `stadimeter run config/follow-ball.toml --seconds 60 --journal run.jsonl`

    - `stadimeter run config/follow-ball.toml --record run.mcap --image-rate 5`

    **Exit code**: 0 the run ended as it should; 2 a device or the configuration is wrong, or a journal or recording
    cannot be begun; 128 and the number of a signal if something hung, so that the process was ended before all was
    done. A journal that cannot go on, for a full disk for example, is a warning: the run goes on without it.
    """
    view: View = "json" if as_json else "live" if watch else "plain"
    with plain_errors():
        loop = Loop(build(load_configuration(config, with_tests=False), speed=speed or None))
        keeping = Keeping(
            journal=journal,
            record=record,
            images=record_images,
            image_rate_hz=image_rate,
            image_quality_percent=image_quality,
            is_quiet=view != "plain",
        )
        serving = Serving(
            state=state,
            no_state=no_state,
            socket=socket,
            trust_clock=trust_clock,
            is_unhurried=loop.parts.is_live or speed > 0,
            is_quiet=view == "live",
        )
        _run(loop, Limits(frames=frames, seconds=seconds), keeping, serving, Showing(view, config.name, unit))


def demo(
    seconds: Seconds = None,
    plain: Annotated[bool, typer.Option("--plain", help="Print lines instead of the live view.")] = False,
    journal: JournalFile = None,
    record: RecordFile = None,
    speed: Speed = 1.0,
    unit: Unit = "m",
) -> None:
    """Watch a simulated ball being measured, followed and reported. Needs no hardware.

    A ball rolls through a simulated room. A camera on a simulated robot measures its distance in the pictures that it
    takes. Rules drive a vibration motor, a buzzer and the robot's base (through real serial bytes to an emulated
    firmware) and send alerts to a simulated broker. Now and then the ball hides or the camera freezes, and everything
    stops. Ctrl-C ends it.

    The configuration is config/demo.toml: copy it, change it, and `stadimeter run` it.
    """
    with plain_errors():
        loop = Loop(build(demo_configuration(), speed=speed or None))
        keeping = Keeping(journal=journal, record=record, is_quiet=not plain)
        serving = Serving(is_unhurried=speed > 0, is_quiet=not plain)
        _run(loop, Limits(seconds=seconds), keeping, serving, Showing("plain" if plain else "live", "demo", unit))


@dataclass(frozen=True, slots=True)
class Showing:
    """How a run is shown."""

    view: View
    title: str
    unit: str


def _run(loop: Loop, limits: Limits, keeping: Keeping, serving: Serving, showing: Showing) -> None:
    """Run, and raise `typer.Exit`; or leave the process at once, if a signal has asked for the end and all is done.

    To take down the interpreter takes a small computer half a second, and for ever if a thread of a library hangs.
    """
    with stopping_on_signals(loop.stop, loop.services.reload, loop.give_up):
        try:
            with plain_errors():
                _run_to_the_end(loop, limits, keeping, serving, showing)
                _say_end(loop, showing.view)
            code = DONE
        except typer.Exit as left:
            code = left.exit_code
        if loop.deadline.is_set:
            os._exit(code)
    raise typer.Exit(code)


def _run_to_the_end(loop: Loop, limits: Limits, keeping: Keeping, serving: Serving, showing: Showing) -> None:
    with served(loop, serving), kept(loop, keeping), show(loop, showing.view, showing.title, showing.unit):
        if loop.parts.recording_drives:
            loop.listeners.append(_RealOutputsWarning(loop.parts.recording_drives))
        gc.freeze()  # else all threads stand still now and then, while the collector walks through every library
        loop.run(limits)


def _say_end(loop: Loop, view: View) -> None:
    for trouble in loop.troubles:
        typer.echo(f"warning: while ending: {trouble}", err=True)
    summary = summarise(loop.health, loop.ending)
    typer.echo(json.dumps(summary) if view == "json" else in_words(summary))


class _RealOutputsWarning:
    """Warns once, when the first frame has come, that a recording drives something real."""

    def __init__(self, outputs: tuple[str, ...]) -> None:
        self._words = f"warning: a recording or simulation drives real outputs: {', '.join(outputs)}"

    def __call__(self, *_: object) -> None:
        if self._words:
            typer.echo(self._words, err=True)
        self._words = ""
