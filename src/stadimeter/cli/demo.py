"""The command ``demo``: a run in a simulated world, in which things go wrong at the press of a key."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from subprocess import DEVNULL, PIPE, Popen
from typing import Annotated

import typer

from stadimeter.app.bootstrap import build, demo_configuration
from stadimeter.app.loop import Limits, Loop
from stadimeter.cli.exits import plain_errors
from stadimeter.cli.keyboard import Key, RunKeys
from stadimeter.cli.run import JournalFile, RecordFile, Seconds, Speed, Unit, run_loop
from stadimeter.cli.run_services import RunOptions
from stadimeter.cli.viewing import Showing, live_or_plain
from stadimeter.cli.web import page_command
from stadimeter.config.extras import missing
from stadimeter.config.models import WebTable

# Keys, what they do and undo, and the fault of the simulated world.
FAULTS = (
    ("h", "hide ball", "show ball", "hide-target"),
    ("f", "freeze camera", "thaw camera", "freeze-camera"),
    ("u", "unplug robot", "plug robot in", "unplug-base"),
)

# Where the page of the demonstration is: at this port, or at the next free one.
LOOPBACK, PORT = "127.0.0.1", 8080

# The end of the demonstration.
NEXT = """\
Next, with your own camera and ball:
  stadimeter init                 asks a few questions, writes a configuration
  stadimeter calibrate distance   finds out the focal length, from one distance
  stadimeter check CONFIG         says what it does, and every mistake in it"""


def demo(
    seconds: Seconds = None,
    plain: Annotated[bool, typer.Option("--plain", help="Print lines instead of the live view.")] = False,
    journal: JournalFile = None,
    record: RecordFile = None,
    speed: Speed = 1.0,
    unit: Unit = "m",
) -> None:
    """Watch a simulated ball being measured and followed. No hardware.

    A ball rolls through a simulated room. A camera on a simulated robot measures its distance in the pictures that it
    takes. Rules drive a vibration motor, a buzzer and the robot's base (through real serial bytes to an emulated
    firmware) and send alerts to a simulated broker. Now and then the ball hides or the camera freezes, and everything
    stops. A line says what happens and why.

    Keys: `q` ends it, `?` explains the screen, `space` pauses, `h` hides the ball, `f` freezes the camera and `u`
    unplugs the robot; each again undoes it. Without a terminal it prints lines.

    The configuration is config/demo.toml: copy it, change it, and `stadimeter run` it.
    """
    typer.echo("The demonstration: a simulated ball, camera and robot. Ctrl-C ends it.")
    with plain_errors():
        loop = Loop(build(demo_configuration(), speed=speed or None))
        view = "plain" if plain else live_or_plain()
        options = RunOptions(journal=journal, record=record, is_unhurried=speed > 0)
        keys = RunKeys(loop, fault_keys(loop), can_pause=True)
        has_page = speed > 0 and not missing("web")
        with _open_page(loop, is_quiet=view == "live") if has_page else nullcontext("") as address:
            title = f"demo, also on {address}" if address else "demo"
            run_loop(loop, Limits(seconds=seconds), options, Showing(view, title, unit, keys, last=NEXT))


@contextmanager
def _open_page(loop: Loop, *, is_quiet: bool) -> Iterator[str]:
    """Serve the page for this computer only while in the context, at the first free port; return its address.

    It ends with its standard input, so with this process, however that ends.
    """
    port = next(filter(_is_free, range(PORT, PORT + 100)), PORT)
    options = WebTable(host=LOOPBACK, port=port)
    command = page_command(loop.parts.configuration.path, options, ends_with_input=True)
    said = DEVNULL if is_quiet else None
    with Popen(command, stdin=PIPE, stdout=said, stderr=said, process_group=0):  # noqa: S603 - our own
        yield f"http://{LOOPBACK}:{port}/"


def _is_free(port: int) -> bool:
    with socket.socket() as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            trial.bind((LOOPBACK, port))
        except OSError:
            return False
    return True


def fault_keys(loop: Loop) -> tuple[Key, ...]:
    """Return the keys that make something go wrong in the world of a run, and put it right again."""
    world = loop.parts.world
    if world is None:
        return ()
    return tuple(
        Key(
            presses=key,
            name=key,
            does=does,
            undoes=undoes,
            act=partial(world.toggle, fault),
            is_on=partial(world.goes_wrong, fault),
        )
        for key, does, undoes, fault in FAULTS
    )
