"""Ends the real program in every way, and times how long the wheels of its robot base are driven on.

::

    PYTHONPATH=tests python tests/benchmarks/stopping.py --runs 100

``stadimeter run`` drives the board of `support.program_and_board`, each in a process of its own: a real pseudo-terminal
lies between them. At a random moment something happens, and the time from there to the first service of the board in
which its motors are driven no more is noted. The board is served every 10 ms, and its wheels then run down: by 0.1 s
to a third of their speed.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import statistics
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from support.program_and_board import Rig

PATIENCE_S = 6.0
RUN_S = 60.0
SETTLED_S = (0.3, 1.0)
"""The event comes at a random moment of this time after the robot drives at full speed."""


def signalled(number: signal.Signals) -> Callable[[Rig], None]:
    return lambda rig: rig.program.send_signal(number)


def kill_watchdog(rig: Rig) -> None:
    os.kill(watchdog_of(rig.program.pid), signal.SIGKILL)


def kill_both(rig: Rig) -> None:
    watchdog = watchdog_of(rig.program.pid)
    for process in (watchdog, rig.program.pid):
        os.kill(process, signal.SIGSTOP)  # neither sees the other die
    for process in (watchdog, rig.program.pid):
        os.kill(process, signal.SIGKILL)


def watchdog_of(program: int) -> int:
    """Return the number of the watchdog process that a program has started."""
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            command = (entry / "cmdline").read_bytes()
        except OSError:
            continue
        if b"watchdog" in command and f"hold\0{program}".encode() in command:
            return int(entry.name)
    raise RuntimeError(f"the program {program} has no watchdog process")


EVENTS: dict[str, tuple[Callable[[Rig], None], str]] = {
    "an exception in the loop": (lambda rig: rig.fail_in_loop(), "100 ms"),
    **{
        f"{number.name} to the program": (signalled(number), "100 ms")
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGQUIT, signal.SIGUSR1, signal.SIGXCPU, signal.SIGKILL)
    },
    "SIGSTOP to the program": (signalled(signal.SIGSTOP), "its limit, 1 s, + 100 ms"),
    "SIGKILL to the watchdog process": (kill_watchdog, "100 ms"),
    "SIGKILL to both": (kill_both, "the base's own time-out, 2 s"),
    "the cable is pulled": (lambda rig: rig.tell_board("unplug"), "the base's own time-out, 2 s"),
    "the port takes no more bytes": (lambda rig: rig.tell_board("do not read"), "the base's own time-out, 2 s"),
}


NOTICED = {name: f"{name}: noticed" for name in ("the cable is pulled", "the port takes no more bytes")}
"""Events after which only the base's own time-out can stop it: the program must at least say so soon."""


def time_to_stand_s(event: Callable[[Rig], None], rng: random.Random) -> float:
    """Return for how long the motors are driven after an event; infinite if they are not seen to stop."""
    with driving(rng) as rig:
        begun_s = time.monotonic()
        event(rig)
        while time.monotonic() < begun_s + PATIENCE_S:
            if (stopped_s := rig.board()["stopped_at_s"]) > begun_s:
                return stopped_s - begun_s
            time.sleep(0.02)
    return float("inf")


def time_to_notice_s(event: Callable[[Rig], None], rng: random.Random) -> float:
    """Return how soon the program reports a fault of the base after an event; infinite if it never does."""
    with driving(rng) as rig:
        begun_s = time.monotonic()
        event(rig)
        while time.monotonic() < begun_s + PATIENCE_S:
            if rig.faults():
                return time.monotonic() - begun_s
            time.sleep(0.001)
    return float("inf")


@contextmanager
def driving(rng: random.Random) -> Iterator[Rig]:
    """Yield a robot that drives at full speed, at a random moment."""
    with Rig(RUN_S, is_port_real=True) as rig:
        rig.wait_for("base 0.3")
        time.sleep(rng.uniform(*SETTLED_S))
        assert rig.board()["driven_mps"] > 0, "the robot does not drive"
        yield rig


def table(results: dict[str, list[float]]) -> str:
    lines = ["| event | asked for | runs | median | worst |", "| --- | --- | --- | --- | --- |"]
    for name, times_s in results.items():
        median, worst = (f"{1e3 * each:.0f} ms" for each in (statistics.median(times_s), max(times_s)))
        asked = EVENTS[name][1] if name in EVENTS else "100 ms"
        lines.append(f"| {name} | {asked} | {len(times_s)} | {median} | {worst} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=1, help="how many runs go on at the same time")
    parser.add_argument("--only", default="", help="the events whose name holds this")
    arguments = parser.parse_args()
    for number in (signal.SIGINT, signal.SIGQUIT):  # a shell's background ignores them, and a program inherits that
        signal.signal(number, signal.SIG_DFL)
    rng, results = random.Random(1), {name: [] for name in (*EVENTS, *NOTICED.values()) if arguments.only in name}  # noqa: S311

    def measure(name: str) -> None:
        how = time_to_stand_s if name in EVENTS else time_to_notice_s
        results[name].append(how(EVENTS[name.partition(":")[0]][0], rng))

    with ThreadPoolExecutor(arguments.jobs) as pool:  # in turn, so that what else the machine does falls on all of them
        list(pool.map(measure, list(results) * arguments.runs))
    print(table(results))


if __name__ == "__main__":
    main()
