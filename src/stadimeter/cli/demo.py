"""The command ``demo``: says at once what it is, and only then loads what it runs."""

from __future__ import annotations

from typing import Annotated

import typer

from stadimeter.cli.run_options import JournalFile, RecordFile, Seconds, Speed, Unit


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("demo")(demo)


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
    stops. A line says what happens and why.

    Keys: `q` ends it, `?` explains the screen, `space` pauses, `h` hides the ball, `f` freezes the camera and `u`
    unplugs the robot; each again undoes it. Without a terminal it prints lines.

    The configuration is config/demo.toml: copy it, change it, and `stadimeter run` it.
    """
    typer.echo("The demonstration: a simulated ball, camera and robot. Ctrl-C ends it.")
    from stadimeter.cli.demonstration import demonstrate  # noqa: PLC0415 - it takes long

    demonstrate(seconds, journal, record, speed, unit, wants_lines=plain)
