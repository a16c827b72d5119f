"""How soon outputs are safe when a ribbon camera hangs or vanishes, and how soon they act again when it is back.

The whole loop runs in real time, with the driver on a double of libcamera; see `support.picamera2_double`.

    python tests/benchmarks/camera_faults.py --runs 10
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
from collections.abc import Generator
from pathlib import Path

import numpy as np
from msgspec import Struct

from stadimeter.app.clock import MonotonicClock
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Limits
from stadimeter.cameras.picamera2_camera import Picamera2Camera, Picamera2Options
from support.live_rig import Rig
from support.picamera2_double import Sensor

OPTIONS = {"width_px": 64, "height_px": 48, "rate": "30 Hz", "exposure": "5 ms", "gain": 4, "focus": "2 m"}
OUTAGE_S = (1.0, 6.0)
FAULTS = {"hangs": {"is_silent": True}, "vanishes": {"is_silent": True, "is_there": False}}
DRIVEN_FRAMES = 20
HEALTHY = {"is_silent": False, "is_there": True}


class Outcome(Struct):
    """Times of one run.

    Attributes:
        stopped_after_s: From the fault until the output was at its safe value.
        safe_after_s: From the capture of the last frame until the output was at its safe value.
        back_after_s: From when the camera worked again until the output acted.
        is_set: Whether it is set as before then.
    """

    stopped_after_s: float = 0.0
    safe_after_s: float = 0.0
    back_after_s: float = 0.0
    is_set: bool = False


def story(
    rig: Rig, sensor: Sensor, fault: str, outage_s: float, outcome: Outcome
) -> Generator[None, CycleRecord, None]:
    """Let a camera drive a motor, fail, and come back; one step after each cycle."""
    now_s, fresh_at_s = rig.clock.now_s, 0.0
    while rig.loop.history.frames < DRIVEN_FRAMES:
        record = yield
        fresh_at_s = record.observation.frame.captured_at_s if record.observation.frame else fresh_at_s
    failed_at_s = now_s()
    vars(sensor).update(FAULTS[fault])
    while rig.motor.level > 0.0:
        record = yield
        fresh_at_s = record.observation.frame.captured_at_s if record.observation.frame else fresh_at_s
    outcome.stopped_after_s, outcome.safe_after_s = now_s() - failed_at_s, now_s() - fresh_at_s
    while now_s() < failed_at_s + outage_s:
        yield
    back_at_s = now_s()
    vars(sensor).update(HEALTHY)
    while not rig.motor.level > 0.0:
        yield
    outcome.back_after_s = now_s() - back_at_s
    controls = [each["controls"] for each in sensor.configurations]
    outcome.is_set = len(controls) > 1 and controls[-1] == controls[0]
    rig.loop.end("it is back")
    yield


def run_once(fault: str, outage_s: float, folder: Path) -> Outcome:
    """Let a camera fail for a while in a run of its own."""
    sensors = list[Sensor]()

    def camera(clock: MonotonicClock) -> Picamera2Camera:
        sensors.append(Sensor(clock, opens_in_s=1.0))
        return Picamera2Camera(Picamera2Options.model_validate(OPTIONS), clock, sensors[0].package, clock.now_s)

    rig = Rig(folder, camera)
    outcome = Outcome()
    steps = story(rig, sensors[0], fault, outage_s, outcome)
    next(steps)
    rig.loop.listeners.append(lambda record, _frame: steps.send(record))
    rig.loop.run(Limits(seconds=60))
    return outcome


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=10)
    runs = parser.parse_args().runs
    outages_s = np.random.default_rng(1)
    print("| the camera | safe after the fault | after the last frame's capture | acts again after | set as before |")
    print("| --- | --- | --- | --- | --- |")
    for fault in FAULTS:
        with tempfile.TemporaryDirectory() as folder:
            outcomes = [run_once(fault, outages_s.uniform(*OUTAGE_S), Path(folder)) for _ in range(runs)]
        stopped = in_words([1e3 * each.stopped_after_s for each in outcomes], "ms", 0)
        safe = in_words([1e3 * each.safe_after_s for each in outcomes], "ms", 0)
        back = in_words([each.back_after_s for each in outcomes], "s", 1)
        print(
            f"| {fault} | {stopped} | {safe} | {back} | {sum(each.is_set for each in outcomes)} of {runs} |", flush=True
        )


def in_words(values: list[float], unit: str, digits: int) -> str:
    """Return the median and the worst value."""
    return f"median {statistics.median(values):.{digits}f} {unit}, worst {max(values):.{digits}f} {unit}"


if __name__ == "__main__":
    main()
