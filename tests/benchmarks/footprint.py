"""What the program takes on an appliance: memory over an hour at full speed, and how soon after its start it acts.

Run ``python tests/benchmarks/footprint.py --minutes 65``; docs/benchmarks/footprint.md tells what came of it. The world
and the camera are simulated, the messages go to a real mosquitto, and alarms are kept on the disk. With ``--quota 0.5``
(root, Linux' control groups of the first version) each start has one core, of that share; without files in memory for
``--cold``.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import start_up
from msgspec import Struct

from support.broker import MosquittoBroker

CONFIGURATION = """
[camera]
driver = "simulated"
rate = "30 Hz"
[camera.model]
width_px = 640
height_px = 480
fx_px = 600.0
fy_px = 600.0
cx_px = 319.5
cy_px = 239.5

[targets.ball]
detector = "ball"
diameter = "20 cm"
hsv = "29,86,6:64,255,255"

[actuators.buzzer]
driver = "simulated"

[messenger]
driver = "mqtt"
host = "127.0.0.1"
port = {port}
node = "footprint"

[rules.too-close]
severity = "alarm"
actuator = "buzzer"
when = {{ below = "1.5 m", deadband = "5 cm" }}
off_delay = "2 s"
[rules.gone]
when = {{ lost = true }}
on_delay = "1 s"

[world]
seed = 7
ball_diameter = "20 cm"
camera_height = "12 cm"
path = [
  {{ at = "0 s", x = "1.0 m", y = "0.1 m" }},
  {{ at = "10 s", x = "2.5 m", y = "-0.4 m" }},
  {{ at = "30 s", x = "1.0 m", y = "0.1 m" }},
]
faults = [{{ at = "13 s", for = "3 s", kind = "hide-target" }}]
"""

EVERY_S = 10.0
SETTLED_S = 60.0
"""From here on memory counts as grown: by then every library is loaded and most buffers are full."""
BLOCKS = 10
MINUTES_MIN = 5
STUDENT_T = 2.306
"""The 97.5 % point of Student's t for ten blocks less the two parameters of a line."""

GROUP = Path("/sys/fs/cgroup/cpu/stadimeter-footprint")
STARTS = 9


class Growth(Struct, frozen=True):
    """A slope of memory in kB in an hour, with the half width of its 95 % interval."""

    kb_per_hour: float
    interval_kb_per_hour: float


def growth(times_s: Sequence[float], memory_kb: Sequence[float]) -> Growth:
    """Fit a line to memory after it has settled.

    Neighbouring samples are alike, so the line goes through the medians of ten stretches of equal length, whose scatter
    gives the interval.
    """
    times_h, memory = np.asarray(times_s) / 3600, np.asarray(memory_kb, float)
    settled = times_h > SETTLED_S / 3600
    pairs = zip(*(np.array_split(each[settled], BLOCKS) for each in (times_h, memory)), strict=True)
    at_h, medians = np.array([(np.mean(block_h), np.median(block)) for block_h, block in pairs]).T
    slope, offset = np.polyfit(at_h, medians, 1)
    scatter = np.sum((medians - slope * at_h - offset) ** 2) / (BLOCKS - 2)
    return Growth(float(slope), float(STUDENT_T * np.sqrt(scatter / np.sum((at_h - at_h.mean()) ** 2))))


def sampled(folder: Path, minutes: float) -> list[tuple[float, float]]:
    """Run at full speed, and return after how many seconds it had how many kB in memory (``VmRSS``)."""
    program = [sys.executable, "-m", "stadimeter", "run", "run.toml", "--speed", "0", "--state", "state.sqlite3"]
    began_s, samples = time.monotonic(), []
    with (folder / "out.txt").open("w") as out, subprocess.Popen(program, cwd=folder, stdout=out) as run:
        while run.poll() is None and time.monotonic() - began_s < 60 * minutes:
            time.sleep(EVERY_S)
            status = Path(f"/proc/{run.pid}/status").read_text()
            samples.append((time.monotonic() - began_s, float(status.partition("VmRSS:")[2].split()[0])))
        run.terminate()
    return samples


def first_commands_s(folder: Path, quota: float | None, is_cold: bool) -> list[float]:
    """Start the program again and again on one core; return how old it was each time when it first acted."""
    program = [sys.executable, "-m", "stadimeter", "run", "run.toml", "--frames", "1", "--speed", "0", "--json"]
    if quota is not None:
        GROUP.mkdir(exist_ok=True)
        (GROUP / "cpu.cfs_quota_us").write_text(str(round(100_000 * quota)))

    def confine() -> None:
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
        if quota is not None:
            (GROUP / "cgroup.procs").write_text(str(os.getpid()))

    found = []
    for _ in range(STARTS + 1):  # the first compiles modules
        if is_cold:
            os.sync()
            Path("/proc/sys/vm/drop_caches").write_text("3")
        ran = subprocess.run(
            program, cwd=folder, env=start_up.environment_in(folder), capture_output=True, check=True,
            preexec_fn=confine,
        )  # fmt: skip
        found.append(json.loads(ran.stdout)["first_command_s"])
    return found[1:]


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=65)
    parser.add_argument("--quota", type=float)
    parser.add_argument("--cold", action="store_true")
    asked = parser.parse_args()
    if asked.minutes < MINUTES_MIN:
        parser.error(f"--minutes: at least {MINUTES_MIN}, or there is nothing to fit a line to")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        broker = MosquittoBroker(folder)
        broker.start()
        try:
            (folder / "run.toml").write_text(CONFIGURATION.format(port=broker.port))
            starts_s = first_commands_s(folder, asked.quota, asked.cold)
            print(
                f"first command: median {statistics.median(starts_s):.2f} s, {min(starts_s):.2f} to {max(starts_s):.2f}"
            )
            times_s, memory_kb = zip(*sampled(folder, asked.minutes), strict=True)
        finally:
            broker.stop()
    slope = growth(times_s, memory_kb)
    print(f"memory: {memory_kb[0]:.0f} kB at first, {memory_kb[-1]:.0f} kB at the end")
    print(f"growth: {slope.kb_per_hour:.0f} ± {slope.interval_kb_per_hour:.0f} kB in an hour")


if __name__ == "__main__":
    main()
