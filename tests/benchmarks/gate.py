"""A gate against creeping cost: what start-up, memory and a cycle cost, as ratios to a floor measured in the same run.

Machines differ, and those of continuous integration are busy; a ratio of two things that take turns on one machine
hardly changes. The kept ratios are in ``gate.json``. A ratio that is more than half as large again fails, after some
more rounds: what only the machine caused does not come again and again.

======================  ================================================================================================
start-up                processor time of a fresh process until its end, against that of ``python -c 'import cv2'``
memory                  the largest resident set of ``run`` over a video of a ball, 640 × 480, against that of a loop of
                        OpenCV that reads and blurs the same video
decide, cycle           median time of ``decide()``, and of a cycle of the loop without vision and with a journal, with
                        30 rules, against a fixed piece of Python
======================  ================================================================================================

``make gate`` compares. After a change that is worth its cost, or one that saves some, ``make gate ARGS=--keep`` keeps
the new ratios; the commit then shows what became dearer, and its message says why.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from time import perf_counter

import cv2
import machinery
import numpy as np
import start_up
from msgspec import Struct

from stadimeter.config.loader import load_configuration

KEPT = Path(__file__).with_name("gate.json")
MARGIN = 1.5
ROUNDS = 5
MORE_ROUNDS = 3
"""So often is everything measured anew, if a figure seems to be too large."""

RULES = 30
FRAMES = 400

BARE_LOOP = """
import cv2
video = cv2.VideoCapture("ball.avi")
while (frame := video.read()[1]) is not None:
    cv2.GaussianBlur(frame, (5, 5), 1)
"""

LAUNCHER = """
import os, sys
pid = os.fork()
if not pid:
    os.dup2(2, 1)
    os.execv(sys.argv[1], sys.argv[1:])
_, status, usage = os.wait4(pid, 0)
print(os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime, usage.ru_maxrss)
"""
"""Runs a command, and says what it took."""

Ratios = dict[str, float]


class Spent(Struct, frozen=True):
    """What a process took: its processor time in seconds, and its largest resident set in MiB."""

    time_s: float
    memory_mib: float


def measure(rounds: int = ROUNDS) -> Ratios:
    """Return every ratio: the median over some rounds, in which everything takes turns."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        round_ = _Round(folder)
        round_()  # fills caches and compiles modules
        found = [round_() for _ in range(rounds)]
    return {key: statistics.median(each[key] for each in found) for key in found[0]}


class _Round:
    """Measures every ratio once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._environment = start_up.environment_in(folder)
        self._commands = start_up.commands_in(folder)
        _write_video(folder / "ball.avi")
        text = start_up.CONFIGURATION.replace('"images"', '"video"').replace('paths = "room.png"', 'path = "ball.avi"')
        (folder / "video.toml").write_text(text)
        self._rules = machinery.configuration(RULES, folder)
        self._plan = load_configuration(self._rules).plan
        self._seen = machinery.observations(FRAMES)

    def __call__(self) -> Ratios:
        bare = self._spent(self._commands[start_up.BARE])
        ratios = {
            f"start-up of {name} / import cv2": self._spent(self._commands[what]).time_s / bare.time_s
            for name, what in (("help", start_up.HELP), ("measure", start_up.MEASURE), ("run", start_up.RUN))
        }
        program = [sys.executable, "-m", "stadimeter", "run", "video.toml", "--speed", "0"]
        floor_mib = self._spent([sys.executable, "-c", BARE_LOOP]).memory_mib
        ratios["memory of run / OpenCV's own loop"] = self._spent(program).memory_mib / floor_mib
        floor_s = statistics.median(_timed_s(workload) for _ in range(2 * FRAMES))
        decide_s = statistics.median(machinery.decide_times_s(self._plan, self._seen))
        cycle_s = statistics.median(machinery.cycle_times_s(self._rules, FRAMES, self._folder / "run.jsonl"))
        ratios[f"decide, {RULES} rules / Python"] = decide_s / floor_s
        ratios[f"cycle without vision, {RULES} rules, journal / Python"] = cycle_s / floor_s
        return ratios

    def _spent(self, command: Sequence[str]) -> Spent:
        """Run a command from a small process: one that is forked from a large one counts that one's memory as its."""
        launched = subprocess.run(
            [sys.executable, "-S", "-c", LAUNCHER, *command],
            cwd=self._folder, env=self._environment, capture_output=True, text=True, check=True,
        )  # fmt: skip
        code, time_s, memory_kib = launched.stdout.splitlines()[-1].split()
        if int(code):
            raise RuntimeError(f"{' '.join(command)}: {launched.stderr}")
        return Spent(float(time_s), float(memory_kib) / 1024)


def workload() -> float:
    """Do what a cycle is made of, a fixed amount of it: small objects, tables, comparisons, arithmetic and text."""
    known = {f"rule-{number}": (number, number / 7) for number in range(60)}
    states = [_State(name, value, math.sqrt(value) < 2) for name, (_, value) in known.items()]
    changed = [state for state in states if state.is_raised and state.level > 0.5]
    return sum(known[state.name][1] for state in changed) + len(",".join([state.name for state in changed]))


class _State:
    __slots__ = ("is_raised", "level", "name")

    def __init__(self, name: str, level: float, is_raised: bool) -> None:
        self.name, self.level, self.is_raised = name, level, is_raised


def _timed_s(work: Callable[[], object]) -> float:
    began_s = perf_counter()
    work()
    return perf_counter() - began_s


def _write_video(path: Path) -> None:
    """Write two seconds of a ball that rolls across a noisy grey picture."""
    noise = np.random.default_rng(1)
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (640, 480))
    for number in range(60):
        picture = noise.integers(80, 100, (480, 640, 3), dtype=np.uint8)
        cv2.circle(picture, (200 + 3 * number, 240), 40, (60, 200, 120), -1, cv2.LINE_AA)
        video.write(cv2.GaussianBlur(picture, (5, 5), 1.0))
    video.release()


def too_large(ratios: Mapping[str, float], kept: Mapping[str, float], margin: float = MARGIN) -> list[str]:
    """Return the ratios that are beyond the margin, in words; those that are not kept count as such, too."""
    return [
        f"{name}: {ratio:.2f}, kept {kept.get(name, math.nan):.2f}, at most {margin * kept.get(name, math.nan):.2f}"
        for name, ratio in ratios.items()
        if not ratio <= margin * kept.get(name, math.nan)
    ]


def judged(
    kept: Mapping[str, float], measured: Callable[[], Ratios], more: int = MORE_ROUNDS
) -> tuple[Ratios, list[str]]:
    """Measure until every ratio was within its margin once, or often enough.

    Args:
        kept: The ratios to compare with.
        measured: Measures every ratio.
        more: How often to measure again.

    Returns:
        The smallest ratios, and what is wrong with them, in words; nothing if they are all within the margin.
    """
    best = measured()
    for _ in range(more):
        if not too_large(best, kept):
            break
        best = {name: min(ratio, best[name]) for name, ratio in measured().items()}
    gone = [f"{name}: kept, and not measured any more" for name in kept if name not in best]
    return best, too_large(best, kept) + gone


def main() -> int:
    """Compare with the kept ratios, or keep new ones; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", action="store_true", help="keep the ratios of now in gate.json")
    if parser.parse_args().keep:
        ratios = measure(2 * ROUNDS)
        KEPT.write_text(json.dumps({name: round(ratio, 2) for name, ratio in ratios.items()}, indent=2) + "\n")
        print(KEPT.read_text(), end="")
        return 0
    kept = json.loads(KEPT.read_text())
    ratios, wrong = judged(kept, measure)
    for name, ratio in ratios.items():
        print(f"{name}: {ratio:.2f}, kept {kept.get(name, math.nan):.2f}")
    if wrong:
        print("\nCosts have grown by more than half (make gate ARGS=--keep keeps them, if they are worth it):")
        print("\n".join(wrong))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
