"""What the black box costs: the loop, and the computer's memory.

Run ``python tests/benchmarks/black_box_cost.py --minutes 8``, or with ``--memory``.

A run looks for a ball in pictures of 640 x 480, drawn beforehand, which a camera delivers 30 times a second on the
computer's clock. In one process, blocks of a few seconds with the black box and without follow each other in random
order, so that whatever else the computer does falls on both alike. The figures are medians of those of the blocks.

A cycle's cost is the time that it computes, as the record of each cycle has it, with the look at what is worth a clip
and with what follows until its listeners are done. "To its end" is the time from the capture of a frame until then, so
that it includes how long the loop waits to be given the processor and the interpreter.

For the memory a box is fed until it is full, with pictures that compress well and with noise; what the process has more
of the computer's memory than before stands beside what is configured.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from stadimeter.app.control.black_box import BlackBox
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.recordings.black_box import BlackBoxMemory
from stadimeter.app.recordings.recorded_configuration import RecordedConfiguration
from stadimeter.app.recordings.recording import Recorded
from stadimeter.config.optional_tables import BlackBoxTable
from stadimeter.core.frame import Frame
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import Plan
from support.observing import Rehearsal

sys.path.insert(0, str(Path(__file__).parent))
from watching_cost import PICTURES, RATE_HZ, drawn_beforehand, live_loop

# What follows a change is not counted: the camera's next frames are on their way.
SETTLE_S = 0.5


class Switched:
    """A black box that is now there and now not, and a note of what each cycle cost.

    Attributes:
        rows: When a cycle ended, what it cost and how old its frame was then, in seconds; and whether the box was on.
    """

    def __init__(self, loop: Loop, box: BlackBox, block_s: float, blocks: int) -> None:
        self.rows: list[tuple[float, float, float, bool]] = []
        self._loop, self._box, self._block_s = loop, box, block_s
        self._order = [is_on for _ in range(blocks) for is_on in random.sample((True, False), 2)]
        self._began_s = loop.parts.clock.now_s()
        self._looked_s = 0.0

    @property
    def now(self) -> tuple[bool, bool]:
        """Whether the box is on, and whether that counts."""
        block, into_s = divmod(self._loop.parts.clock.now_s() - self._began_s, self._block_s)
        is_counted = block < len(self._order) and into_s >= SETTLE_S
        return self._order[min(int(block), len(self._order) - 1)], is_counted

    def look(self, record: CycleRecord) -> None:
        began_s = time.perf_counter()
        if self.now[0]:
            self._box.look(record)
        self._looked_s = time.perf_counter() - began_s

    def __call__(self, record: CycleRecord, frame: Frame | None) -> None:
        began_s = time.perf_counter()
        is_on, is_counted = self.now
        if is_on:
            self._box(record, frame)
        listened_s = time.perf_counter() - began_s
        if frame is not None and is_counted:
            clock_s = self._loop.parts.clock.now_s()
            cost_s = record.busy_s + self._looked_s + listened_s
            self.rows.append((clock_s - self._began_s, cost_s, clock_s - frame.captured_at_s, is_on))


def measure(minutes: float, block_s: float, *, is_first: bool = False) -> dict[str, object]:
    """Return the medians of the blocks' medians and 99th percentiles, with the box and without, in milliseconds."""
    blocks = max(2, round(minutes * 60 / block_s / 2))
    if is_first:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    loop = live_loop(drawn_beforehand(PICTURES))
    with tempfile.TemporaryDirectory() as name:
        loop.parts.configuration = replace(loop.parts.configuration, path=Path(name) / "demo.toml")
        box = BlackBox(loop.parts, lambda: loop.state, print, loop.deadline)
        switched = Switched(loop, box, block_s, blocks)
        loop.services.black_box = switched  # type: ignore[assignment]
        loop.listeners.append(switched)
        gc.freeze()  # as a run does
        loop.run(Limits(seconds=2 * blocks * block_s))
        box.close()
        clips = len(list(Path(name).rglob("*.mcap")))
    rows = np.array(switched.rows)
    found: dict[str, object] = {"blocks": blocks, "cycles": len(rows), "clips": clips, "load": os.getloadavg()[0]}
    for what, column in (("cycle", 1), ("to its end", 2)):
        for share in (50, 99):
            on, off = (of_blocks(rows, column, share, block_s, is_on=is_on) for is_on in (True, False))
            more = f"{100 * (np.median(on) / np.median(off) - 1):+.1f} %"
            # How far the same figure goes apart without any difference: the halves of the blocks without the box.
            half = f"{100 * (np.median(off[::2]) / np.median(off[1::2]) - 1):+.1f} %"
            found[f"{what} p{share} ms"] = {
                "with": round(float(np.median(on)), 3), "without": round(float(np.median(off)), 3), "more": more,
                "between halves without": half,
            }  # fmt: skip
    return found


def of_blocks(rows: np.ndarray, column: int, share: int, block_s: float, *, is_on: bool) -> np.ndarray:
    """Return a percentile of each block with the box, or of each without, in milliseconds."""
    chosen = rows[rows[:, 3] == is_on]
    numbers = (chosen[:, 0] // block_s).astype(int)
    return np.array([np.percentile(chosen[numbers == each, column], share) * 1e3 for each in np.unique(numbers)])


def resident_bytes() -> int:
    """Return how much of the computer's memory this process has."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")


def fill(memory: float, noise: float, seconds: float) -> dict[str, float]:
    """Fill a box until it has dropped as much as it holds; return what it takes beside what is configured.

    Args:
        noise: The standard deviation of the pictures' noise, in grey levels: the JPEG of noise is large.
    """
    rng = np.random.default_rng(1)
    pictures = [np.clip(rng.normal(128, noise, (480, 640, 3)), 0, 255).astype(np.uint8) for _ in range(20)]
    rehearsal = Rehearsal(Plan(targets=("ball",)))
    table = BlackBoxTable.model_validate({"before": "600 s", "memory": f"{memory:.0f} B"})
    box = BlackBoxMemory(Recorded(configuration=RecordedConfiguration(text="")), table, "*")
    decision = rehearsal.see(2.0)
    gc.collect()
    before, held = resident_bytes(), []
    for number in range(round(seconds * RATE_HZ)):
        now_s = number / RATE_HZ
        frame = Frame(pictures[number % len(pictures)], now_s, number)
        observation = Observation(now_s=now_s, frame=FrameStamp(sequence=number, captured_at_s=now_s))
        record = CycleRecord(observation=observation, decision=decision, applied=(), timings_s={})
        box.write(record, frame)
        if number % round(RATE_HZ) == 0:
            box.begin_segment(rehearsal.state)
            held.append(resident_bytes() - before)
    full = held[len(held) // 2 :]
    return {"configured": memory / 1e6, "least MB": min(full) / 1e6, "most MB": max(full) / 1e6}


def main() -> None:
    """Measure, and print the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=8.0)
    parser.add_argument("--block-s", type=float, default=8.0)
    parser.add_argument(
        "--first", action="store_true", help="let the run go before all else that the computer does (needs root)"
    )
    parser.add_argument("--memory", action="store_true")
    parser.add_argument("--fill", nargs=3, type=float, metavar=("BYTES", "NOISE", "SECONDS"))
    args = parser.parse_args()
    if args.fill:
        print(json.dumps(fill(*args.fill)))
    elif args.memory:
        for case in ((16e6, 10, 300), (64e6, 10, 900), (64e6, 60, 120), (256e6, 60, 240)):
            subprocess.run([sys.executable, __file__, "--fill", *map(str, case)], check=True)
    else:
        print(json.dumps(measure(args.minutes, args.block_s, is_first=args.first), indent=1))


if __name__ == "__main__":
    main()
