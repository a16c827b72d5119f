"""The tables of docs/benchmarks/boards.md, from the files beside it that `make board` wrote.

``PYTHONPATH=tests python docs/pictures/boards_table.py`` checks the files, and writes the tables into the page.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path

from msgspec import DecodeError, json

from stadimeter.config.files import JSON_MAX_BYTES, read_untrusted
from stadimeter.errors import UnreadableError
from support.board_figures import DetectorSpeed, Figures, Heat, Times

PAGE = Path(__file__).parents[1] / "benchmarks" / "boards.md"
FOLDER = PAGE.with_suffix("")
MARKED = re.compile(r"(<!-- table: (\w+) -->\n).*?(<!-- end of table -->\n)", re.DOTALL)

DETECTORS = ("ball", "sheet", "tag", "disc")
SIZES_PX = ((640, 480), (1280, 720))
NONE = "–"


def read_figures(path: Path) -> Figures:
    """Read a file that `make board` wrote.

    Raises:
        UnreadableError: It is none; the message says what is wrong with it first, in one line.
    """
    try:
        return json.decode(read_untrusted(path, JSON_MAX_BYTES), type=Figures)
    except DecodeError as error:
        words = f"it is not what `make board` of this version writes: {error}"
        raise UnreadableError(path, words) from error


def all_figures(folder: Path = FOLDER) -> dict[str, Figures]:
    """Return the figures of every file of a folder by its name, measured boards before limited processors."""
    read = {path.stem: read_figures(path) for path in sorted(folder.glob("*.json"))}
    return dict(sorted(read.items(), key=lambda item: item[1].computer.processor_limit is not None))


def computers_table(figures: dict[str, Figures]) -> str:
    """Return what was measured on, and what a run of the program takes there."""
    head = (
        "| file | computer | system, versions | first command | memory | frame to actuator, median, p95 | heat |",
        "| --- | --- | --- | ---: | ---: | ---: | --- |",
    )
    return "\n".join([*head, *(_computer_row(name, each) for name, each in figures.items()), ""])


def speeds_table(figures: dict[str, Figures], size_px: tuple[int, int]) -> str:
    """Return how many milliseconds each detector takes for a picture of a size."""
    columns = [f"{name}, {how}" for name in DETECTORS for how in ("search", "track")]
    lines = [f"| file | {' | '.join(columns)} |", f"| --- |{' ---: |' * len(columns)}"]
    for name, each in figures.items():
        cells = (cell for detector in DETECTORS for cell in _speed_cells(each, detector, size_px))
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join([*lines, ""])


def _computer_row(name: str, figures: Figures) -> str:
    on, run, latency = figures.computer, figures.run, figures.latency
    limited = "" if on.processor_limit is None else f", **limited to {on.processor_limit:.2g} of a core**"
    board = f"{_safe(on.board)}, cores: {on.cores}{limited}"
    told = f"{board}; {_safe(figures.note)}" if figures.note else board
    versions = f"{on.system}; stadimeter {on.stadimeter}, Python {on.python}, OpenCV {on.opencv}, numpy {on.numpy}"
    ages = NONE if latency.p50_ms is None else f"{latency.p50_ms:.1f}, {latency.p95_ms:.1f} ms"
    cells = [f"[{name}](boards/{name}.json)", told, _safe(versions)]
    cells += [
        f"{run.first_command_s:.1f} s",
        f"{run.peak_memory_mb:.0f} MB",
        ages,
        _heat(figures.before, figures.after),
    ]
    return f"| {' | '.join(cells)} |"


def _heat(before: Heat, after: Heat) -> str:
    if before.temperature_c is None or after.temperature_c is None:
        return NONE
    slowed = f", throttled {after.throttled}" if after.throttled not in {None, "0x0"} else ""
    return f"{before.temperature_c:.0f} to {after.temperature_c:.0f} °C{slowed}"


def _speed_cells(figures: Figures, detector: str, size_px: tuple[int, int]) -> tuple[str, str]:
    found = (each for each in figures.detectors if _is(each, detector, size_px))
    speed = next(found, None)
    limited = figures.computer.processor_limit is not None
    return (NONE, NONE) if speed is None else (_ms(speed.search, limited), _ms(speed.track, limited))


def _is(speed: DetectorSpeed, detector: str, size_px: tuple[int, int]) -> bool:
    return speed.detector == detector and (speed.width_px, speed.height_px) == size_px


def _ms(times: Times | None, limited: bool) -> str:
    """Return the usual time: the median, or under a processor limit the mean, and the 95th percentile."""
    if times is None:
        return NONE
    return f"{times.mean_ms:.3g} (mean)" if limited else f"{times.median_ms:.3g}, {times.p95_ms:.3g}"


def _safe(text: str) -> str:
    """Return text from a file that anybody may have sent, as nothing but text in a cell."""
    return re.sub(r"([\\`*_{}\[\]<>|&#])", r"\\\1", " ".join(text.split()))


TABLES: dict[str, Callable[[dict[str, Figures]], str]] = {
    "computers": computers_table,
    "speeds_vga": lambda figures: speeds_table(figures, SIZES_PX[0]),
    "speeds_hd": lambda figures: speeds_table(figures, SIZES_PX[1]),
}


def with_tables(page: str, figures: dict[str, Figures]) -> str:
    """Return the page with its tables made of figures."""
    return MARKED.sub(lambda found: f"{found[1]}\n{TABLES[found[2]](figures)}\n{found[3]}", page)


def main() -> int:
    """Write the tables into the page; return the exit code, 2 for a file that is none."""
    try:
        page = with_tables(PAGE.read_text(encoding="utf-8"), all_figures())
    except UnreadableError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    PAGE.write_text(page, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
