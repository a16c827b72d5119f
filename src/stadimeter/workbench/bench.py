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
from stadimeter.config.plugins import (
    CAMERAS,
    DETECTORS,
    WORLDS,
    DriverContext,
    Exercise,
    Plugin,
    Shared,
    driver_names,
    load_plugin,
)
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Prediction
from stadimeter.core.frame import Frame, Image
from stadimeter.core.target import TargetShape
from stadimeter.detectors.protocol import Detector

SIZES_PX = ((640, 480), (1280, 720), (1920, 1080))
SHARE_OF_RUN = 0.3
"""The share of the time that the simulated run gets; the detectors get the rest."""
EXPECTED_WITHIN = 0.03
"""A tracked target is expected within this share of its size."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Computer:
    """Computer and versions that were measured.

    Attributes:
        board: The board, or the processor where there is no board to name.
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
    """Latency from the arrival of a frame until every actuator has its command, in the demonstration's run."""

    frames: int
    p50_ms: float | None
    p95_ms: float | None
    p99_ms: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """All figures of a computer.

    Attributes:
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
        (frame, _expected(each, detector.target_shape))
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


def _expected(found: Detection, shape: TargetShape) -> Prediction:
    size_px = max(found.width_px, found.height_px)
    return Prediction(
        centre_px=found.centre_px,
        size_px=size_px,
        sigma_px=max(1.0, EXPECTED_WITHIN * size_px),
        outline_px=found.outline_px if shape.has_corners else None,
    )


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
    """Run the demonstration without a brake, and note how old each frame was when the actuators had their commands."""
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


FIELD_OF_VIEW_FACTOR = 0.94
"""Focal length divided by width: about 56° wide, as most cameras are."""
PICTURES = 6

_PATH_S = 5
_PATH = [
    {"at": "0 s", "x": "1.2 m", "y": "0.2 m"},
    {"at": "5 s", "x": "2.5 m", "y": "-0.4 m"},
    {"at": "10 s", "x": "1.2 m", "y": "0.2 m"},
]


def lens_for(width_px: int, height_px: int) -> CameraModel:
    """Return a camera model for a size of pictures."""
    return CameraModel.with_focal_length(FIELD_OF_VIEW_FACTOR * width_px, width_px, height_px)


def room_frames(lens: CameraModel, count: int = PICTURES) -> list[Frame]:
    """Draw pictures of the simulated room, in which a ball of 20 cm moves, as that camera sees it."""
    context = DriverContext(name="bench", clock=SteppedClock(), camera_model=lens, shared=Shared())
    world, camera = load_plugin(WORLDS, "simulated"), load_plugin(CAMERAS, "simulated")
    options = {"ball_diameter": "20 cm", "camera_height": "12 cm", "path": _PATH}
    world.build(world.options.model_validate(options), context)
    built = camera.build(camera.options.model_validate({"rate": f"{count / _PATH_S} Hz"}), context)
    built.open()
    try:
        return [built.read() for _ in range(count)]
    finally:
        built.close()


def with_patch(frames: Sequence[Frame], patch: Image) -> list[Frame]:
    """Put a flat target into pictures, each time somewhere else.

    Args:
        patch: The target, as it looks in a picture 480 px high.
    """
    return [
        Frame(_pasted(frame.image, patch, (number + 1) / (len(frames) + 1)), frame.captured_at_s, frame.sequence)
        for number, frame in enumerate(frames)
    ]


def _pasted(image: Image, patch: Image, share: float) -> Image:
    scale = image.shape[0] / 480
    scaled = cv2.resize(
        patch, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    )
    height, width = scaled.shape[:2]
    left, top = round(share * (image.shape[1] - width)), round(0.4 * (image.shape[0] - height))
    changed = image.copy()
    changed[top : top + height, left : left + width] = scaled
    changed.flags.writeable = False
    return changed
