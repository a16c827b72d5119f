"""The demonstration: a run in a simulated world, in which things go wrong at the press of a key."""

from __future__ import annotations

import os
import socket
from functools import partial
from pathlib import Path

from stadimeter.app.bootstrap import build, demo_configuration
from stadimeter.app.loop import Limits, Loop
from stadimeter.cli.exits import plain_errors
from stadimeter.cli.keyboard import Key, RunKeys
from stadimeter.cli.run import run_loop
from stadimeter.cli.run_options import RecordingOptions, ServiceOptions
from stadimeter.cli.viewing import Showing, live_or_plain
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

# A demonstration that is restarted finds its port here, which its own page has taken.
KEPT_PORT = "STADIMETER_DEMO_PORT"

# The end of the demonstration.
NEXT = """\
Next, with your own camera and ball:
  stadimeter init                 asks a few questions, writes a configuration
  stadimeter calibrate distance   finds out the focal length, from one distance
  stadimeter check CONFIG         says what it does, and every mistake in it"""


def demonstrate(
    seconds: float | None,
    journal: Path | None,
    record: Path | None,
    speed: float,
    unit: str,
    *,
    wants_lines: bool,
) -> None:
    """Run the demonstration as the options of ``demo`` say, and raise `typer.Exit`."""
    with plain_errors():
        loop = Loop(build(demo_configuration(), speed=speed or None))
        view = "plain" if wants_lines else live_or_plain()
        recording = RecordingOptions(journal=journal, record=record, is_quiet=view == "live")
        web = page_on_loopback() if speed > 0 else None
        services = ServiceOptions(is_unhurried=speed > 0, is_quiet=view == "live", web=web)
        keys = RunKeys(loop, fault_keys(loop), can_pause=True)
        title = f"demo, also on http://{web.host}:{web.port}/" if web is not None else "demo"
        run_loop(loop, Limits(seconds=seconds), recording, services, Showing(view, title, unit, keys, last=NEXT))


def page_on_loopback() -> WebTable | None:
    """Return a page for this computer only, at the first free port; None if its libraries are not installed."""
    if missing("web"):
        return None
    free = os.environ.get(KEPT_PORT) or next(filter(_is_free, range(PORT, PORT + 100)), PORT)
    os.environ[KEPT_PORT] = str(free)
    return WebTable(host=LOOPBACK, port=int(free))


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
