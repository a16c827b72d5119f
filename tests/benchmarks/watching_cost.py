"""What it costs the loop to be watched.

Run ``python tests/benchmarks/watching_cost.py --minutes 10``.

A run looks for a ball in pictures of 640 x 480, drawn beforehand, which a camera delivers 30 times a second on the
computer's clock. Others watch it from a process of their own: nobody, three who subscribe to snapshots with pictures,
the same beside 200 further connections, the same beside one who subscribes and never reads. Blocks of a few seconds
follow each other in random order within one run, so that whatever else the computer does falls on all of them.

A cycle's cost is the time that it computes, as the record of each cycle has it, and what follows until its listeners
are done. "To its end" is the time from the capture of a frame until then, so that it includes how long the loop waits
to be given the processor and the interpreter.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import socket
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
from msgspec import Struct, field

from stadimeter.app.bootstrap import Parts, build, demo_configuration
from stadimeter.app.capture import LiveCapture
from stadimeter.app.clock import MonotonicClock
from stadimeter.app.cycle import Cycle
from stadimeter.app.leased_output import LeasedOutput
from stadimeter.app.loop import Limits, Loop
from stadimeter.cli.run_services import RunOptions, open_services
from stadimeter.core.command import LevelCommand, TwistCommand
from stadimeter.core.frame import Frame, Image
from stadimeter.core.outputs import safe_command
from stadimeter.errors import DeviceClosedError
from support.recording_doubles import RecordingActuator, RecordingBase

RATE_HZ = 30.0
PICTURES = 90
CONDITIONS = ("nobody", "three", "three and 200 connections", "three and one that never reads")
SETTLE_S = 0.5


class LiveCamera(Struct):
    """Delivers pictures again and again at their own pace, on the computer's clock."""

    pictures: list[Image]
    clock: MonotonicClock
    is_live: bool = True
    remarks: tuple[str, ...] = ()
    not_for_motion: str = ""
    closed: threading.Event = field(default_factory=threading.Event)
    count: int = 0
    noise: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))
    due_s: float = 0.0

    def open(self) -> None:
        self.closed.clear()
        self.due_s = self.clock.now_s()

    def read(self) -> Frame:
        self.due_s += 1 / RATE_HZ
        if self.closed.wait(max(0.0, self.due_s - self.clock.now_s())):
            raise DeviceClosedError("closed")
        self.count += 1
        image = self.pictures[self.count % len(self.pictures)].copy()
        image[:1] = self.noise.integers(0, 256, image[:1].shape, np.uint8)  # no picture comes again
        return Frame(image=image, captured_at_s=self.clock.now_s(), sequence=self.count)

    def close(self) -> None:
        self.closed.set()


def drawn_beforehand(count: int) -> list[Image]:
    """Return pictures of the demonstration, there and back, so that the ball never jumps."""
    pictures: list[Image] = []
    loop = Loop(build(demo_configuration(), speed=None))
    loop.listeners.append(lambda _record, frame: pictures.append(frame.image) if frame is not None else None)
    loop.run(Limits(frames=count))
    return [*pictures, *pictures[-2:0:-1]]


def live_loop(pictures: list[Image]) -> Loop:
    """Return the demonstration's loop with a live camera, its real detector, and outputs that only remember."""
    configuration = demo_configuration()
    built, clock = build(configuration), MonotonicClock()
    capture = LiveCapture(LiveCamera(pictures, clock), clock)
    kinds = {LevelCommand: RecordingActuator, TwistCommand: RecordingBase}
    safe = [safe_command(output) for output in configuration.plan.outputs]
    outputs = tuple(LeasedOutput(kinds[type(each)](clock, each.output), each, 0.3, clock) for each in safe)
    parts = Parts(
        configuration=configuration,
        clock=clock,
        capture=capture,
        outputs=outputs,
        messenger=None,
        cycle=Cycle(
            clock=clock,
            capture=capture,
            camera_model=configuration.camera_model,
            detectors=built.cycle.detectors,
            outputs=outputs,
            max_frame_age_s=0.2,
        ),
        is_live=True,
    )
    return Loop(parts)


def run_live(path: Path, seconds: float, cycles_file: Path, *, is_first: bool) -> None:
    """Run, listening at a socket, and write down when each cycle ended, what it computed, and how old its frame was."""
    if is_first:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    loop = live_loop(drawn_beforehand(PICTURES))
    clock, rows = loop.parts.clock, np.zeros((int(seconds * RATE_HZ * 1.2) + 100, 4))
    count = 0
    with open_services(loop, RunOptions(socket=path, no_state=True), is_quiet=True):
        first, after = loop.listeners[:], time.perf_counter
        began = [0.0]

        def note(record: object, frame: Frame | None) -> None:
            nonlocal count
            if frame is not None and count < len(rows):
                listeners_s = after() - began[0]
                rows[count] = time.time(), record.busy_s + listeners_s, clock.now_s() - frame.captured_at_s, listeners_s
                count += 1

        loop.listeners[:] = [lambda *_: began.__setitem__(0, after()), *first, note]
        loop.run(Limits(seconds=seconds))
    np.save(cycles_file, rows[:count])


class Watchers:
    """Those who watch, in a process of their own."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.ended = threading.Event()
        self.latencies_s: list[float] = []

    def subscribe(self, image: str, *, reads: bool = True) -> None:
        with socket.socket(socket.AF_UNIX) as connection, suppress(OSError):
            connection.connect(str(self.path))
            connection.sendall(json.dumps({"op": "subscribe", "args": {"image": image}}).encode() + b"\n")
            if not reads:
                self.ended.wait()
                return
            connection.settimeout(2.0)
            with connection.makefile("rb") as file:
                while not self.ended.is_set():
                    answer = json.loads(file.readline())
                    if file.read(answer.get("bytes", 0)):
                        self.latencies_s.append(time.time() - answer["data"]["frame"]["captured_unix_s"])

    def stand_by(self, count: int) -> None:
        """Hold connections that say nothing, as many as there may be."""
        with ExitStack() as all_of_them:
            for _ in range(count):
                connection = all_of_them.enter_context(socket.socket(socket.AF_UNIX))
                with suppress(OSError):
                    connection.settimeout(2.0)
                    connection.connect(str(self.path))
            self.ended.wait()


def watch(path: Path, condition: str) -> None:
    """Watch a run under a condition until standard input ends."""
    watchers = Watchers(path)
    jobs = [] if condition == "nobody" else [(watchers.subscribe, image) for image in ("plain", "plain", "drawn")]
    threads = [threading.Thread(target=job, args=(image,)) for job, image in jobs]
    if "200" in condition:
        threads.append(threading.Thread(target=watchers.stand_by, args=(200,)))
    if "never" in condition:
        threads.append(threading.Thread(target=watchers.subscribe, args=("plain",), kwargs={"reads": False}))
    for thread in threads:
        thread.start()
    sys.stdin.read()
    watchers.ended.set()
    for thread in threads:
        thread.join()
    print(json.dumps(watchers.latencies_s))


def measure(minutes: float, block_s: float, *, is_first: bool = False) -> dict[str, dict[str, float]]:
    """Return the figures under each condition."""
    blocks = max(1, round(minutes * 60 / block_s / len(CONDITIONS)))
    order = [condition for _ in range(blocks) for condition in random.sample(CONDITIONS, len(CONDITIONS))]
    spans: list[tuple[str, float, float]] = []
    latencies_s: dict[str, list[float]] = {condition: [] for condition in CONDITIONS}
    with tempfile.TemporaryDirectory() as name:
        path, cycles = Path(name) / "run.sock", Path(name) / "cycles.npy"
        seconds = len(order) * (block_s + 2.0) + 10
        this = [sys.executable, __file__]
        options = ["--seconds", str(seconds), "--cycles", str(cycles), *(["--first"] if is_first else [])]
        run = subprocess.Popen([*this, "--run", str(path), *options])
        while not path.exists():
            time.sleep(0.1)
        time.sleep(2.0)
        for condition in order:
            watching = subprocess.Popen(
                [*this, "--watch", str(path), "--condition", condition], stdin=subprocess.PIPE, stdout=subprocess.PIPE
            )
            time.sleep(1.0 + SETTLE_S)
            began_s = time.time()
            time.sleep(block_s)
            spans.append((condition, began_s, time.time()))
            out, _ = watching.communicate(b"")
            latencies_s[condition] += json.loads(out)
        run.wait()
        rows = np.load(cycles)
    return {
        condition: figures(rows, [span for span in spans if span[0] == condition]) | read(latencies_s[condition])
        for condition in CONDITIONS
    }


def read(latencies_s: list[float]) -> dict[str, float]:
    """Return how many pictures were read, and how long after their capture, in milliseconds."""
    if not latencies_s:
        return {"pictures read": 0.0}
    found = {
        f"capture to read p{share} ms": round(float(np.percentile(latencies_s, share)) * 1e3, 1) for share in (50, 95)
    }
    return found | {"pictures read": float(len(latencies_s))}


def figures(rows: np.ndarray, spans: list[tuple[str, float, float]]) -> dict[str, float]:
    """Return the percentiles of the cycles within some spans of time, in milliseconds."""
    inside = np.zeros(len(rows), bool)
    for _, began_s, ended_s in spans:
        inside |= (rows[:, 0] > began_s) & (rows[:, 0] < ended_s)
    chosen = rows[inside] * 1e3
    found = {"cycles": float(inside.sum())}
    for name, column in (("cycle", 1), ("to its end", 2), ("listeners", 3)):
        for share in (50, 95, 99):
            found[f"{name} p{share} ms"] = round(float(np.percentile(chosen[:, column], share)), 3)
    return found


def main() -> None:
    """Measure, and print the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--block-s", type=float, default=6.0)
    parser.add_argument(
        "--first", action="store_true", help="let the run go before all else that the computer does (needs root)"
    )
    parser.add_argument("--run", type=Path)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--cycles", type=Path)
    parser.add_argument("--watch", type=Path)
    parser.add_argument("--condition", default="nobody")
    args = parser.parse_args()
    if args.run is not None:
        run_live(args.run, args.seconds, args.cycles, is_first=args.first)
    elif args.watch is not None:
        watch(args.watch, args.condition)
    else:
        print(json.dumps(measure(args.minutes, args.block_s, is_first=args.first), indent=1))


if __name__ == "__main__":
    main()
