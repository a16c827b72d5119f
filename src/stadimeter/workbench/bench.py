"""A computer's own figures: how fast it finds targets, how long from a frame to the actuator, how much memory."""

from __future__ import annotations

import os
import platform
import resource
import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import cv2
import numpy as np

import stadimeter
from stadimeter.app.bootstrap import build, demo_configuration
from stadimeter.app.clock import SteppedClock
from stadimeter.app.cycle_record import CycleRecord
from stadimeter.app.health import percentile
from stadimeter.app.loop import Loop
from stadimeter.config.plugins import DETECTORS, DriverContext, Exercise, Plugin, driver_names, load_plugin
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import DetectionStatus, Prediction
from stadimeter.core.frame import Frame
from stadimeter.detectors.protocol import Detector
from stadimeter.workbench.bench_pictures import lens_for, room_frames, with_patch

SIZES_PX = ((640, 480), (1280, 720), (1920, 1080))
SHARE_OF_RUN = 0.3
"""The share of the time that the simulated run gets; the detectors get the rest."""
EXPECTED_WITHIN = 0.03
"""A tracked target is expected within this share of its size."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Computer:
    """What was measured on.

    Attributes:
        board: The board, or the processor where there is no board to name.
        cores: How many processor cores this program may use.
        opencv_threads: How many threads OpenCV uses.
        stadimeter: The version of stadimeter.
        python: The version of Python.
        opencv: The version of OpenCV.
        numpy: The version of numpy.
    """

    board: str
    cores: int
    opencv_threads: int
    stadimeter: str
    python: str
    opencv: str
    numpy: str


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectorSpeed:
    """How fast one detector is on pictures of one size.

    Attributes:
        detector: Its name.
        width_px: Width of the pictures.
        height_px: Height of the pictures.
        search_fps: Pictures in a second when nothing is known of where the target is.
        track_fps: Pictures in a second when the target is expected where it is; None if it found none.
        found: In which share of the pictures it found its target.
    """

    detector: str
    width_px: int
    height_px: int
    search_fps: float
    track_fps: float | None
    found: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Latency:
    """How long from the arrival of a frame until the actuators have been told, in the demonstration's run.

    Attributes:
        frames: Over how many frames.
        p50_ms: Half of them took no longer.
        p95_ms: 95 in 100 took no longer.
        p99_ms: 99 in 100 took no longer.
    """

    frames: int
    p50_ms: float | None
    p95_ms: float | None
    p99_ms: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """All figures of a computer.

    Attributes:
        computer: What was measured on.
        detectors: How fast each detector is.
        latency: How long from frame to actuator.
        peak_memory_mb: The most memory that this program had in the demonstration's run, in 10⁶ bytes.
    """

    computer: Computer
    detectors: tuple[DetectorSpeed, ...]
    latency: Latency
    peak_memory_mb: float


def measure(seconds: float, sizes_px: Sequence[tuple[int, int]] = SIZES_PX) -> Figures:
    """Measure this computer.

    Args:
        seconds: For about how long; drawing the pictures comes on top.
        sizes_px: The sizes of pictures, width first.

    Returns:
        The figures.

    Raises:
        StadimeterError: A driver cannot be built.
    """
    latency = _latency(seconds * SHARE_OF_RUN)
    peak_memory_mb = _peak_memory_mb()  # before the large pictures are drawn, which no run keeps
    each_s = seconds * (1 - SHARE_OF_RUN) / (max(1, len(exercises())) * len(sizes_px))
    speeds = tuple(speed for size_px in sizes_px for speed in _detector_speeds(size_px, each_s))
    return Figures(computer=this_computer(), detectors=speeds, latency=latency, peak_memory_mb=peak_memory_mb)


def this_computer() -> Computer:
    """Return what this program runs on."""
    return Computer(
        board=_board(),
        cores=len(os.sched_getaffinity(0)),
        opencv_threads=cv2.getNumThreads(),
        stadimeter=stadimeter.__version__,
        python=platform.python_version(),
        opencv=cv2.__version__,
        numpy=np.__version__,
    )


def exercises() -> dict[str, tuple[Plugin[Any], Exercise]]:
    """Return what each installed detector is to find, by its name; those that bring no exercise are left out."""
    plugins = {name: load_plugin(DETECTORS, name) for name in driver_names(DETECTORS)}
    return {name: (each, each.exercise()) for name, each in plugins.items() if each.exercise is not None}


def _detector_speeds(size_px: tuple[int, int], each_s: float) -> Iterator[DetectorSpeed]:
    lens = lens_for(*size_px)
    room = room_frames(lens)
    for name, (plugin, exercise) in exercises().items():
        context = DriverContext(name=name, clock=SteppedClock(), camera_model=lens)
        detector: Detector = plugin.build(plugin.options.model_validate(dict(exercise.options)), context)
        frames = room if exercise.patch is None else with_patch(room, exercise.patch)
        yield _detector_speed(name, detector, lens, frames, each_s)


def _detector_speed(
    name: str, detector: Detector, lens: CameraModel, frames: Sequence[Frame], each_s: float
) -> DetectorSpeed:
    found = [detector.detect(frame, lens=lens) for frame in frames]  # which warms everything up as well
    seen = [
        (frame, _expected(each.centre_px, max(each.width_px, each.height_px)))
        for frame, each in zip(frames, found, strict=True)
        if each.status is DetectionStatus.FOUND
    ]
    return DetectorSpeed(
        detector=name,
        width_px=frames[0].width_px,
        height_px=frames[0].height_px,
        search_fps=_rate_hz(detector, lens, [(frame, None) for frame in frames], each_s / 2),
        track_fps=_rate_hz(detector, lens, seen, each_s / 2) if seen else None,
        found=len(seen) / len(frames),
    )


def _expected(centre_px: tuple[float, float], size_px: float) -> Prediction:
    return Prediction(centre_px=centre_px, size_px=size_px, sigma_px=max(1.0, EXPECTED_WITHIN * size_px))


def _rate_hz(
    detector: Detector, lens: CameraModel, work: Sequence[tuple[Frame, Prediction | None]], for_s: float
) -> float:
    """Return how many pictures in a second, by the median, so that another program's second does not count."""
    times_s: list[float] = []
    until_s = perf_counter() + for_s
    while not times_s or perf_counter() < until_s:
        for frame, prediction in work:
            began_s = perf_counter()
            detector.detect(frame, prediction, lens=lens)
            times_s.append(perf_counter() - began_s)
    return 1 / statistics.median(times_s)


def _latency(for_s: float) -> Latency:
    """Run the demonstration without a brake, and see how old each frame was when the actuators had been told."""
    loop = Loop(build(demo_configuration(), speed=None))
    until_s = perf_counter() + for_s

    def end_in_time(_record: CycleRecord, _frame: Frame | None) -> None:
        if perf_counter() > until_s and loop.health.frames:
            loop.stop("measured for long enough")

    loop.listeners.append(end_in_time)
    loop.run()
    ages_s = sorted(loop.health.data_ages_s)
    p50_ms, p95_ms, p99_ms = (_milliseconds(percentile(ages_s, share)) for share in (0.5, 0.95, 0.99))
    return Latency(frames=len(ages_s), p50_ms=p50_ms, p95_ms=p95_ms, p99_ms=p99_ms)


def _milliseconds(seconds: float | None) -> float | None:
    return None if seconds is None else seconds * 1e3


def _peak_memory_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6  # Linux counts in KiB


def _board() -> str:
    try:
        return Path("/proc/device-tree/model").read_text(encoding="utf-8").rstrip("\0")
    except OSError:
        return _processor()


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.machine())
