"""Ends the real program in every way, and times how long the wheels of its robot base are driven on.

::

    python tests/benchmarks/stopping.py --runs 100 --page docs/benchmarks/stopping.md

``stadimeter run`` drives the emulated base of `base_under_load`, each in a process of its own: a real pseudo-terminal
lies between them. At a random moment something happens, and the time from there to the first service of the board in
which its motors are driven no more is noted. The board is served every 10 ms, and its wheels then run down: by 0.1 s
to a third of their speed.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from base_under_load import Rig

from stadimeter.bases.differential_drive import WheelSpeeds
from stadimeter.bases.serial_base import SerialBaseOptions
from stadimeter.config.loader import load_configuration

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
        for number in (
            signal.SIGTERM,
            signal.SIGINT,
            signal.SIGQUIT,
            signal.SIGUSR1,
            signal.SIGXCPU,
            signal.SIGKILL,
        )
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


def page(results: dict[str, list[float]], costs: dict[str, float]) -> str:
    commit = subprocess.run(["git", "rev-parse", "--short=8", "HEAD"], capture_output=True, text=True, check=True)
    load = os.getloadavg()[0]
    words = ", ".join(f"`{name}` {cost_us:.1f} µs" for name, cost_us in costs.items())
    return f"""# How soon a robot stands

[What happens when](../safety.md) says why. Measured by `tests/benchmarks/stopping.py` (`make bench-stopping`) at commit
{commit.stdout.strip()} (Python {sys.version.split()[0]}, {os.cpu_count()} cores, load {load:.1f} at the end).

The real program drives an emulated `ros-arduino-bridge` at 0.3 m/s, over a real pseudo-terminal: program, watchdog
process and board are three processes. The times are from the event until the board's motors are driven no more; the
board is looked at every 10 ms. Its wheels then run down, to a third of their speed in 0.1 s. *Noticed* is until the
program reports the base's fault.

{table(results)}

While the cable is out nothing reaches a base: it stands by its own time-out, 2 s for this sketch as it comes, or what
`AUTO_STOP_INTERVAL` was set to. The same holds when both processes are killed at one moment. A base without a time-out
of its own drives on then: `stadimeter check` names it.

![Time to stand of every run, one dot each, by event](stopping.svg)

## Cost of a command

Making the bytes of a command, median of 20,000: {words}.
"""


def encoding_costs_us() -> dict[str, float]:
    """Return how long each base on a serial port takes to make the bytes of a command, by its driver."""
    text = (Path(__file__).parents[2] / "config" / "follow-ball.toml").read_text()
    costs_us = {}
    for name in re.findall(r"^\[base\.([\w-]+)\]", text, re.MULTILINE):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "robot.toml"
            path.write_text(text.replace('driver = "gpio-motors"', f'driver = "{name}"'))
            options = load_configuration(path).base.options
        if not isinstance(options, SerialBaseOptions):
            continue
        codec, speeds = options.codec(), [WheelSpeeds(left_mps=0.001 * n, right_mps=-0.002 * n) for n in range(100)]
        times_s = []
        for _ in range(200):
            begun_s = time.perf_counter()
            for each in speeds:
                codec.encode(each)
            times_s.append((time.perf_counter() - begun_s) / len(speeds))
        costs_us[name] = 1e6 * statistics.median(times_s)
    return costs_us


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=1, help="how many runs go on at the same time")
    parser.add_argument("--only", default="", help="the events whose name holds this")
    parser.add_argument("--page", type=Path, help="where to write the page")
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
    if arguments.page is not None:
        arguments.page.write_text(page(results, encoding_costs_us()))
        from plots import draw_times  # without a page, matplotlib is not needed

        draw_times(results, arguments.page.with_suffix(".svg"))


if __name__ == "__main__":
    main()
