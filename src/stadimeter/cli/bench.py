"""The command ``bench``: a computer's own figures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from stadimeter.cli.exits import plain_errors
from stadimeter.cli.progress import working
from stadimeter.workbench.bench import measure
from stadimeter.workbench.board_figures import DetectorSpeed, Figures, Heat, Latency, Times, to_json


def bench(
    seconds: Annotated[
        float, typer.Option("--seconds", min=0.1, max=3600, metavar="S", help="Measure for about this long.")
    ] = 20.0,
    note: Annotated[
        str, typer.Option("--note", metavar="TEXT", help="Goes with the figures, such as the case and the cooling.")
    ] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object: the file to send.")] = False,
) -> None:
    """Print how fast this computer measures and acts.

    Needs no camera: the pictures are drawn at the start. Prints how many pictures in a second each detector manages at
    three sizes, searching the whole picture and following a target that was seen before; how long it takes from a frame
    to the actuators in the demonstration; how soon after its start the program acts; and how much memory that takes.
    Close other programs first, and compare computers with the same version of stadimeter.

    **Examples**

    - `stadimeter bench`

    - `stadimeter bench --seconds 60 --note "small heat sink" --json > my-board.json`
    """
    with plain_errors():
        with working("measuring speed"):
            figures = measure(seconds, note=note)
        if as_json:
            typer.echo(to_json(figures))
            return
        for line in _heading(figures):
            typer.echo(line)
        Console().print(_table(figures.detectors))
        typer.echo(_latency_in_words(figures.latency))
        run = figures.run
        typer.echo(
            f"A run of the program: first command {run.first_command_s:.1f} s after its start, "
            f"{run.peak_memory_mb:.0f} MB of memory at most."
        )


def _heading(figures: Figures) -> Iterator[str]:
    on = figures.computer
    yield f"{on.board}, {on.cores} cores, {on.opencv_threads} OpenCV threads"
    if on.processor_limit is not None:
        yield f"The system limits this program to {on.processor_limit:.2g} cores: it works, and is then made to wait."
    yield f"stadimeter {on.stadimeter}, Python {on.python}, OpenCV {on.opencv}, numpy {on.numpy}"
    heats = (_heat_in_words(figures.before), _heat_in_words(figures.after))
    if all(heats):
        yield f"{heats[0]} before, {heats[1]} after"


def _heat_in_words(at: Heat) -> str:
    warm = "" if at.temperature_c is None else f"{at.temperature_c:.0f} °C"
    return ", ".join(part for part in (warm, at.throttled and f"throttled={at.throttled}") if part)


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
            _rate(speed.search),
            _rate(speed.track),
            f"{100 * speed.found:.0f} %",
        )
    return table


def _rate(times: Times | None) -> str:
    """Return how many pictures in a second, by the median: another program's second does not count."""
    return "-" if times is None else f"{1e3 / times.median_ms:.0f}"


def _latency_in_words(latency: Latency) -> str:
    if latency.p50_ms is None:
        return "Latency from frame to actuator: not measured."
    return (
        f"Latency from frame to actuator: median {latency.p50_ms:.2f} ms, p95 {latency.p95_ms:.2f} ms, "
        f"p99 {latency.p99_ms:.2f} ms, over {latency.frames} frames of the demonstration."
    )
