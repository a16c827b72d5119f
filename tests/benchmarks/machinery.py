"""What a cycle costs beside vision: deciding, the journal, messages. Run ``python tests/benchmarks/machinery.py``.

The whole loop runs in a simulated world whose camera draws nothing and whose detector knows where the ball is. The
time between two cycles of the loop is taken, less what the camera and the measurement took of it: what is left is
deciding, applying, the journal, composing and sending messages to a simulated broker, and the loop itself.

Machines differ, and this one may be busy. Every row is the quietest of some rounds, which take turns, and stands as a
multiple of a yardstick too that was measured in the same run: one `json.dumps` of a fixed object.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import tempfile
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np
from msgspec import Struct

from stadimeter.app.bootstrap import build
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.recordings.journal import JournalWriter, to_be_recorded
from stadimeter.app.recordings.recorder import Recorder
from stadimeter.config.loader import load_configuration
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.frame import Frame
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import Plan
from support.observing import measured

COUNTS = (1, 10, 100)
FRAMES = 1200
ROUNDS = 5
FRAME_S = 1 / 30
OUTPUTS = 4
WHOLE = "all but vision"
YARDSTICK = {f"figure_{number}_m": number / 7 for number in range(40)}

WORLD = """
[camera]
driver = "simulated"
rate = "30 Hz"
render = false

[camera.model]
width_px = 640
height_px = 480
fx_px = 600.0

[targets.ball]
detector = "ideal"

[world]
path = [
  { at = "0 s", x = "1 m", y = "0 m" },
  { at = "20 s", x = "6 m", y = "0 m" },
  { at = "40 s", x = "1 m", y = "0 m" },
]
"""


class Row(Struct, frozen=True, kw_only=True):
    """One line of the report: what was measured with how many rules, and the quantiles in microseconds."""

    what: str
    rules: int
    median_us: float
    p95_us: float
    yardsticks: float


def configuration(count: int, folder: Path) -> Path:
    """Write a configuration with this many rules: near and far alarms all along the ball's way, with other delays each.

    One rule in twenty-five is a ramp. They share four outputs, so many ask for the same one.
    """
    outputs = "\n".join(f'[actuators.output-{number}]\ndriver = "simulated"' for number in range(min(count, OUTPUTS)))
    rules = "\n".join(_rule(number, count) for number in range(count))
    path = folder / f"{count}-rules.toml"
    path.write_text(f'{WORLD}\n[messenger]\ndriver = "simulated"\n{outputs}\n{rules}\n')
    return path


def _rule(number: int, count: int) -> str:
    limit_m = 0.5 + 6 * (number + 0.5) / count
    if number % 25 == 24:
        does = f'ramp = {{ from = "{limit_m:.3f} m", to = "{limit_m + 1:.3f} m" }}'
    else:
        side = "below" if number % 2 else "above"
        does = f'when = {{ {side} = "{limit_m:.3f} m" }}\noff_delay = "{number % 5 / 4} s"'
    return f'[rules.rule-{number}]\nactuator = "output-{number % OUTPUTS}"\npriority = {number}\n{does}\n'


def observations(frames: int) -> list[Observation]:
    """Return what is seen of a ball that comes and goes between 1 m and 6 m, with noise."""
    noise = np.random.default_rng(7)
    seen = []
    for number in range(frames):
        at_s = number * FRAME_S
        distance_m = 3.5 + 2.5 * math.sin(at_s * 2 * math.pi / 40)
        sigma_m = 0.002 * distance_m**2
        ball = measured("ball", at_s, distance_m + noise.normal(0, sigma_m), sigma_m)
        seen.append(
            Observation(now_s=at_s + 0.01, frame=FrameStamp(sequence=number, captured_at_s=at_s), measurements=(ball,))
        )
    return seen


def decide_times_s(plan: Plan, seen: Sequence[Observation]) -> list[float]:
    """Return how long each decision took."""
    state = initial_state(plan)
    times_s = []
    for observation in seen:
        began_s = perf_counter()
        state, _ = decide(state, observation)
        times_s.append(perf_counter() - began_s)
    return times_s


class CycleTimes:
    """Listens to a loop and takes the time of each cycle, without the camera and the measurement."""

    def __init__(self) -> None:
        self.times_s: list[float] = []
        self._last_s = perf_counter()

    def __call__(self, record: CycleRecord, _frame: Frame | None) -> None:
        now_s = perf_counter()
        vision_s = record.timings_s["capture"] + record.timings_s["measure"]
        self.times_s.append(now_s - self._last_s - vision_s)
        self._last_s = now_s


def cycle_times_s(path: Path, frames: int, journal: Path | None) -> list[float]:
    """Return how long each cycle of the whole loop took, without the camera and the measurement."""
    loop = Loop(build(load_configuration(path), speed=None))
    cycles = CycleTimes()
    loop.listeners.append(cycles)
    if journal is None:
        loop.run(Limits(frames=frames))
        return cycles.times_s[10:]
    recorder = Recorder(JournalWriter(journal, to_be_recorded(loop.parts.configuration)), is_live=False)
    loop.listeners.insert(0, recorder)
    with closing(recorder):
        loop.run(Limits(frames=frames))
    return cycles.times_s[10:]


def yardstick_times_s() -> list[float]:
    """Return how long `json.dumps` of a fixed object takes on this machine, now, many times."""
    return [_timed(lambda: json.dumps(YARDSTICK)) for _ in range(2000)]


def _timed(work: Callable[[], object]) -> float:
    began_s = perf_counter()
    work()
    return perf_counter() - began_s


def measure_all(counts: Sequence[int] = COUNTS, frames: int = FRAMES, rounds: int = ROUNDS) -> list[Row]:
    """Return every row of the report.

    Args:
        counts: With how many rules.
        frames: Over how many frames.
        rounds: How often each row is measured, in turn with the others.

    Returns:
        The rows.
    """
    seen = observations(frames)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        work: dict[tuple[str, int], Callable[[], list[float]]] = {("yardstick", 0): yardstick_times_s}
        for count in counts:
            path = configuration(count, folder)
            plan = load_configuration(path).plan
            work["decide", count] = partial(decide_times_s, plan, seen)
            work["all but vision, no journal", count] = partial(cycle_times_s, path, frames, None)
            work[WHOLE, count] = partial(cycle_times_s, path, frames, folder / "run.jsonl")
        times_s: dict[tuple[str, int], list[list[float]]] = {key: [] for key in work}
        for _ in range(rounds):
            for key, measure in work.items():
                times_s[key].append(measure())
    quietest_s = {key: min(rounds_s, key=statistics.median) for key, rounds_s in times_s.items()}
    yardstick_s = statistics.median(quietest_s.pop(("yardstick", 0)))
    return [_row(what, count, row_s, yardstick_s) for (what, count), row_s in quietest_s.items()]


def _row(what: str, rules: int, times_s: Sequence[float], yardstick_s: float) -> Row:
    median_s = statistics.median(times_s)
    return Row(
        what=what,
        rules=rules,
        median_us=median_s * 1e6,
        p95_us=statistics.quantiles(times_s, n=20)[-1] * 1e6,
        yardsticks=median_s / yardstick_s,
    )


def markdown(rows: Sequence[Row]) -> str:
    """Return the rows as a Markdown table."""
    lines = ["| what | rules | median µs | p95 µs | × json.dumps |", "| --- | ---: | ---: | ---: | ---: |"]
    lines += [f"| {r.what} | {r.rules} | {r.median_us:.1f} | {r.p95_us:.1f} | {r.yardsticks:.2f} |" for r in rows]
    return "\n".join(lines)


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=FRAMES)
    print(markdown(measure_all(frames=parser.parse_args().frames)))


if __name__ == "__main__":
    main()
