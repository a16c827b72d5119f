"""The command ``bench``: a computer's own figures."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from stadimeter.cli.exits import plain_errors
from stadimeter.cli.progress import working
from stadimeter.workbench.bench import DetectorSpeed, Figures, Latency, measure


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("bench")(bench)


def bench(
    seconds: Annotated[
        float, typer.Option("--seconds", min=0.1, max=3600, metavar="S", help="Measure for about this long.")
    ] = 20.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object, for programs.")] = False,
) -> None:
    """Print how fast this computer measures and acts.

    Needs no camera: the pictures are drawn at the start. Prints how many pictures in a second each detector manages at
    three sizes, searching the whole picture and following a target that was seen before; how long it takes from a frame
    to the actuators in the demonstration; and how much memory that takes. Close other programs first, and compare
    computers with the same version of stadimeter.

    **Examples**

    - `stadimeter bench`

    - `stadimeter bench --seconds 60 --json > my-board.json`
    """
    with plain_errors():
        with working("measuring speed"):
            figures = measure(seconds)
        if as_json:
            typer.echo(json.dumps(asdict(figures)))
            return
        for line in _heading(figures):
            typer.echo(line)
        Console().print(_table(figures.detectors))
        typer.echo(_latency_in_words(figures.latency))
        typer.echo(f"Memory: {figures.peak_memory_mb:.0f} MB at most in the demonstration.")


def _heading(figures: Figures) -> Iterator[str]:
    on = figures.computer
    yield f"{on.board}, {on.cores} cores, {on.opencv_threads} OpenCV threads"
    yield f"stadimeter {on.stadimeter}, Python {on.python}, OpenCV {on.opencv}, numpy {on.numpy}"


def _table(speeds: tuple[DetectorSpeed, ...]) -> Table:
    table = Table()
    table.add_column("detector")
    table.add_column("picture")
    for heading in ("search fps", "track fps", "found"):
        table.add_column(heading, justify="right")
    for speed in speeds:
        table.add_row(
            speed.detector,
            f"{speed.width_px}x{speed.height_px}",
            f"{speed.search_fps:.0f}",
            "-" if speed.track_fps is None else f"{speed.track_fps:.0f}",
            f"{100 * speed.found:.0f} %",
        )
    return table


def _latency_in_words(latency: Latency) -> str:
    if latency.p50_ms is None:
        return "Latency from frame to actuator: not measured."
    return (
        f"Latency from frame to actuator: median {latency.p50_ms:.2f} ms, p95 {latency.p95_ms:.2f} ms, "
        f"p99 {latency.p99_ms:.2f} ms, over {latency.frames} frames of the demonstration."
    )
