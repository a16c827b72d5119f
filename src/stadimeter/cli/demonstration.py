"""The demonstration: a run in a simulated world, in which things go wrong at the press of a key."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from stadimeter.app.bootstrap import build, demo_configuration
from stadimeter.app.loop import Limits, Loop
from stadimeter.cli.exits import plain_errors
from stadimeter.cli.keyboard import Key, RunKeys
from stadimeter.cli.run import run_loop
from stadimeter.cli.run_options import Keeping, Serving
from stadimeter.cli.viewing import Showing, live_or_plain

FAULTS = (
    ("h", "hide ball", "show ball", "hide-target"),
    ("f", "freeze camera", "thaw camera", "freeze-camera"),
    ("u", "unplug robot", "plug robot in", "unplug-base"),
)
"""Keys, what they do and undo, and the fault of the simulated world."""

NEXT = """\
Next, with your own camera and ball:
  stadimeter init                 asks a few questions, writes a configuration
  stadimeter calibrate distance   finds out the focal length, from one distance
  stadimeter check CONFIG         says what it does, and every mistake in it"""
"""The end of the demonstration."""


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
        keeping = Keeping(journal=journal, record=record, is_quiet=view == "live")
        serving = Serving(is_unhurried=speed > 0, is_quiet=view == "live")
        keys = RunKeys(loop, fault_keys(loop), can_pause=True)
        run_loop(loop, Limits(seconds=seconds), keeping, serving, Showing(view, "demo", unit, keys, last=NEXT))


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
