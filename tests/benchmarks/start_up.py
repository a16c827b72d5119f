"""How long the program takes to start, beside a bare ``import cv2``, which every program with OpenCV must wait for.

Every row is a fresh process: Python itself, what is imported, and one picture. All take turns, so that what else the
machine does slows down all. Run ``python tests/benchmarks/start_up.py``.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
from msgspec import Struct

from stadimeter.config.camera_file import save_camera_model
from stadimeter.core.camera_model import CameraModel

PROCESSES = 9
BARE = "import cv2"
HELP = "stadimeter --help"
MEASURE = "stadimeter measure, one picture"
RUN = "stadimeter run, one frame"

CONFIGURATION = """
[camera]
driver = "images"
paths = "room.png"
model = "camera.toml"

[targets.ball]
detector = "ball"
diameter = "6.7 cm"
hsv = "29,86,6:64,255,255"

[actuators.buzzer]
driver = "simulated"

[rules.near]
actuator = "buzzer"
when = { below = "50 cm" }
"""


class StartUp(Struct, frozen=True, kw_only=True):
    """How long one command takes.

    Attributes:
        what: The command.
        median_s: The median, in seconds.
        ratio: As a multiple of the bare import.
    """

    what: str
    median_s: float
    ratio: float


def measure_all(processes: int = PROCESSES) -> list[StartUp]:
    """Time every command.

    Args:
        processes: How many times each is started. One more time before that fills the caches.

    Returns:
        The rows, the bare import first.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        commands = commands_in(folder)
        environment = environment_in(folder)
        times_s: dict[str, list[float]] = {what: [] for what in commands}
        for number in range(processes + 1):
            for what, command in commands.items():
                took_s = _timed_s(command, folder, environment)
                if number:
                    times_s[what].append(took_s)
    medians_s = {what: statistics.median(of_one) for what, of_one in times_s.items()}
    return [
        StartUp(what=what, median_s=median_s, ratio=median_s / medians_s[BARE]) for what, median_s in medians_s.items()
    ]


def commands_in(folder: Path) -> dict[str, list[str]]:
    """Return each command by its name, and write the files that they need into a folder."""
    room = np.full((480, 640, 3), 90, np.uint8)
    cv2.circle(
        room, (320, 240), 40, (60, 200, 120), -1, cv2.LINE_AA
    )  # not found, it would cost a search for its colour
    cv2.imwrite(str(folder / "room.png"), room)
    save_camera_model(folder / "camera.toml", CameraModel.with_focal_length(600.0, 640, 480))
    (folder / "run.toml").write_text(CONFIGURATION)
    program = [sys.executable, "-m", "stadimeter"]
    ball = ["--camera", "camera.toml", "--ball", "6.7cm", "--hsv", "29,86,6:64,255,255"]
    return {
        BARE: [sys.executable, "-c", BARE],
        HELP: [*program, "--help"],
        MEASURE: [*program, "measure", "room.png", *ball],
        RUN: [*program, "run", "run.toml", "--frames", "1", "--speed", "0"],
    }


def environment_in(folder: Path) -> dict[str, str]:
    """Return an environment in which every module is compiled once: start-up is not compiling."""
    environment = os.environ | {"PYTHONPYCACHEPREFIX": str(folder / "compiled")}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    return environment


def _timed_s(command: Sequence[str], folder: Path, environment: Mapping[str, str]) -> float:
    began_s = perf_counter()
    done = subprocess.run(command, check=False, cwd=folder, env=environment, capture_output=True, text=True)
    took_s = perf_counter() - began_s
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr}")
    return took_s


def markdown(rows: Sequence[StartUp]) -> str:
    """Return the rows as a Markdown table."""
    lines = ["| a fresh process | median ms | × `import cv2` |", "| --- | ---: | ---: |"]
    lines += [f"| {row.what} | {1e3 * row.median_s:.0f} | {row.ratio:.2f} |" for row in rows]
    return "\n".join(lines)


def facts(rows: Sequence[StartUp]) -> dict[str, float]:
    """Return the ratios by the names that the goals know them by."""
    return {f"start-up {_word(row.what)}": row.ratio for row in rows if row.what != BARE}


def _word(what: str) -> str:
    return what.split()[1].strip("-,")


if __name__ == "__main__":
    print(markdown(measure_all()))
