"""A computer's own figures: how fast it finds targets, how long from a frame to the actuator, how much memory.

`make board ARGS='--seconds 60 --note "in a case" --out my-board.json'` writes them as a file to send.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import cv2
import numpy as np

from stadimeter.app.bootstrap import build, demo_configuration
from stadimeter.app.clock import SteppedClock
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.live.health import percentile
from stadimeter.app.loop import Loop
from stadimeter.cameras.protocol import Camera
from stadimeter.config.plugins import (
    CAMERAS,
    DETECTORS,
    WORLDS,
    DriverContext,
    Shared,
    load_driver,
)
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Prediction, TargetShape
from stadimeter.core.frame import Frame, Image
from stadimeter.detectors.protocol import Detector
from stadimeter.errors import StadimeterError
from support.board_figures import (
    SCHEMA_VERSION,
    DetectorSpeed,
    Figures,
    Latency,
    OwnRun,
    Times,
    heat,
    this_computer,
    to_json,
)

# The share of the time that the simulated run gets; the detectors get the rest.
SIZES_PX = ((640, 480), (1280, 720), (1920, 1080))
SHARE_OF_RUN = 0.3

# A tracked target is expected within this share of its size.
EXPECTED_WITHIN = 0.03


# A run of the program as a user starts it. It reads its pictures: to draw a room takes more memory than a camera.
OWN_RUN_FRAMES = 300
OWN_RUN = """
[camera]
driver = "images"
paths = [{paths}]

[camera.model]
width_px = 640
height_px = 480
fx_px = 600.0

[targets.ball]
detector = "ball"
diameter = "20 cm"
hsv = "29,86,6:64,255,255"

[actuators.buzzer]
driver = "simulated"

[rules.near]
actuator = "buzzer"
when = {{ below = "2 m" }}
"""


def measure(seconds: float, sizes_px: Sequence[tuple[int, int]] = SIZES_PX, note: str = "") -> Figures:
    """Measure this computer.

    Args:
        seconds: For about how long; drawing the pictures and a run of the program come on top.
        note: What to keep with the figures.

    Raises:
        StadimeterError: A driver cannot be built, or the program's own run failed.
    """
    before, own = heat(), own_run()
    latency = _latency(seconds * SHARE_OF_RUN)
    each_s = seconds * (1 - SHARE_OF_RUN) / (max(1, len(exercises())) * len(sizes_px))
    return Figures(
        schema_version=SCHEMA_VERSION,
        note=note,
        computer=this_computer(),
        before=before,
        run=own,
        latency=latency,
        detectors=tuple(speed for size_px in sizes_px for speed in _detector_speeds(size_px, each_s)),
        after=heat(),
    )


def own_run(frames: int = OWN_RUN_FRAMES) -> OwnRun:
    """Start the program on pictures of a ball, and return how soon it acted and how much memory it took.

    Raises:
        StadimeterError: It failed; the message is its own.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for number, frame in enumerate(room_frames(lens_for(640, 480))):
            cv2.imwrite(str(folder / f"{number}.jpg"), frame.image)
        paths = ", ".join(f'"{number % PICTURES}.jpg"' for number in range(frames))
        (folder / "run.toml").write_text(OWN_RUN.format(paths=paths), encoding="utf-8")
        program = [sys.executable, "-m", "stadimeter", "run", str(folder / "run.toml"), "--json", "--speed", "0"]
        ran = subprocess.run(program, capture_output=True, text=True, check=False)
    if ran.returncode:
        raise StadimeterError(f"the program's own run failed: {ran.stderr.strip()}")
    summary = json.loads(ran.stdout)
    return OwnRun(first_command_s=summary["first_command_s"], peak_memory_mb=summary["peak_memory_mb"])


class Exercise(NamedTuple):
    """A target that a detector is to find while its speed is measured."""

    options: dict[str, str]
    patch: Image | None = None
    """The target with its surroundings, as it looks in a picture that is 480 px high; None for the green ball of 20 cm
    that is in the simulated room."""


def exercises() -> dict[str, Exercise]:
    """Return what detectors are to find, by their names."""
    sheet = np.full((145, 170, 3), 60, np.uint8)  # a narrow rim would be a picture's frame
    sheet[30:115, 30:140] = 225
    finer = 8
    disc = np.full((110 * finer, 110 * finer, 3), 60, np.uint8)
    cv2.circle(disc, (55 * finer, 55 * finer), 40 * finer, (225, 225, 225), cv2.FILLED)
    tag = np.full((100, 100), 225, np.uint8)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    tag[15:85, 15:85] = np.maximum(cv2.aruco.generateImageMarker(dictionary, 0, 70), 20)
    return {
        "ball": Exercise({"diameter": "20 cm", "hsv": "29,86,6:64,255,255"}),
        "disc": Exercise(
            {"diameter": "8 cm"}, np.asarray(cv2.resize(disc, (110, 110), interpolation=cv2.INTER_AREA), np.uint8)
        ),
        "sheet": Exercise({"width": "11 in", "height": "8.5 in"}, sheet),
        "tag": Exercise({"side": "8 cm", "family": "apriltag-36h11"}, np.repeat(tag[:, :, np.newaxis], 3, axis=2)),
    }


def _detector_speeds(size_px: tuple[int, int], each_s: float) -> Iterator[DetectorSpeed]:
    lens = lens_for(*size_px)
    room = room_frames(lens)
    for name, exercise in exercises().items():
        context = DriverContext(name=name, clock=SteppedClock(), camera_model=lens)
        detector: Detector = load_driver(DETECTORS, name).model_validate(exercise.options).build(context)
        frames = room if exercise.patch is None else with_patch(room, exercise.patch)
        yield _detector_speed(name, detector, lens, frames, each_s)


def _detector_speed(
    name: str, detector: Detector, lens: CameraModel, frames: Sequence[Frame], each_s: float
) -> DetectorSpeed:
    found = [detector.detect(frame, lens=lens) for frame in frames]  # which warms everything up as well
    seen = [
        (frame, _prediction(each, detector.target_shape))
        for frame, each in zip(frames, found, strict=True)
        if each.status is DetectionStatus.FOUND
    ]
    return DetectorSpeed(
        detector=name,
        width_px=frames[0].width_px,
        height_px=frames[0].height_px,
        search=_times(detector, lens, [(frame, None) for frame in frames], each_s / 2),
        track=_times(detector, lens, seen, each_s / 2) if seen else None,
        found=len(seen) / len(frames),
    )


def _prediction(found: Detection, shape: TargetShape) -> Prediction:
    size_px = max(found.width_px, found.height_px)
    return Prediction(
        centre_px=found.centre_px,
        size_px=size_px,
        sigma_px=max(1.0, EXPECTED_WITHIN * size_px),
        outline_px=found.outline_px if shape.has_corners else None,
    )


def _times(
    detector: Detector, lens: CameraModel, work: Sequence[tuple[Frame, Prediction | None]], for_s: float
) -> Times:
    times_s: list[float] = []
    until_s = perf_counter() + for_s
    while not times_s or perf_counter() < until_s:
        for frame, prediction in work:
            began_s = perf_counter()
            detector.detect(frame, prediction, lens=lens)
            times_s.append(perf_counter() - began_s)
    return Times.of(times_s)


def _latency(for_s: float) -> Latency:
    """Run the demonstration without a brake, and note how old each frame was when the actuators had their commands."""
    loop = Loop(build(demo_configuration(), speed=None))
    until_s = perf_counter() + for_s

    def end_in_time(_record: CycleRecord, _frame: Frame | None) -> None:
        if perf_counter() > until_s and loop.history.frames:
            loop.stop("measured for long enough")

    loop.listeners.append(end_in_time)
    loop.run()
    ages_s = sorted(loop.history.data_ages_s)
    p50_ms, p95_ms, p99_ms = (_milliseconds(percentile(ages_s, share)) for share in (0.5, 0.95, 0.99))
    return Latency(frames=len(ages_s), p50_ms=p50_ms, p95_ms=p95_ms, p99_ms=p99_ms)


def _milliseconds(seconds: float | None) -> float | None:
    return None if seconds is None else seconds * 1e3


# Focal length divided by width: about 56° wide, as most cameras are.
FIELD_OF_VIEW_FACTOR = 0.94
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
    options = {"ball_diameter": "20 cm", "camera_height": "12 cm", "path": _PATH}
    load_driver(WORLDS, "simulated").model_validate(options).build(context)
    camera: Camera = load_driver(CAMERAS, "simulated").model_validate({"rate": f"{count / _PATH_S} Hz"}).build(context)
    camera.open()
    try:
        return [camera.read() for _ in range(count)]
    finally:
        camera.close()


def with_patch(frames: Sequence[Frame], patch: Image) -> list[Frame]:
    """Put a flat target into pictures, each time somewhere else.

    Args:
        patch: The target, as it looks in a picture 480 px high.
    """
    return [
        Frame(_paste(frame.image, patch, (number + 1) / (len(frames) + 1)), frame.captured_at_s, frame.sequence)
        for number, frame in enumerate(frames)
    ]


def _paste(image: Image, patch: Image, share: float) -> Image:
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


def main() -> None:
    """Measure this computer, and write its figures to a file or print them."""
    parser = argparse.ArgumentParser(description="Measure how fast this computer is.")
    parser.add_argument("--seconds", type=float, default=10.0, help="for about how long")
    parser.add_argument("--note", default="", help="a remark, such as the case and the cooling")
    parser.add_argument("--out", type=Path, help="the file to write")
    options = parser.parse_args()
    text = to_json(measure(options.seconds, note=options.note))
    if options.out is None:
        print(text)
    else:
        options.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
