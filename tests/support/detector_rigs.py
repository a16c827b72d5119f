"""Rigs for the detector contract: every registered detector with rendered frames whose truth is known."""

from __future__ import annotations

import atexit
import math
import shutil
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from stadimeter.config.plugins import DETECTORS, WORLDS, DriverContext, load_driver
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame, Image
from stadimeter.detectors.protocol import Detector
from stadimeter.simulation.camera import Vector
from stadimeter.testing.detector_contract import DetectorRig, KnownTarget
from stadimeter.testing.rig import ManualClock
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.circles import CirclesTarget
from support.scenes.plane import DiscTarget, Pose, SheetTarget, TagTarget
from support.scenes.poster import PosterTarget, poster
from support.scenes.render import render
from support.scenes.scene import Scene, Truth
from support.scenes.target import Target

CAMERA = CameraModel.with_focal_length(600.0, 640, 480)
WALL = PlainBackdrop(bgr=(70, 75, 80))
LEFT, RIGHT = (-0.25, 0.05, 1.0), (0.35, -0.1, 1.3)
POSTER = 5
Place = Callable[[Vector], Target]


def ball_at(position_m: Vector) -> Target:
    """Return a tennis ball."""
    return BallTarget(position_m=position_m, diameter_m=0.067)


def sheet_at(position_m: Vector) -> Target:
    """Return a sheet of A4, tilted so that its pose is told well."""
    pose = Pose(position_m=position_m, tilt_rad=0.4, tilt_towards_rad=1.0, roll_rad=0.1)
    return SheetTarget(pose=pose, width_m=0.297, height_m=0.21)


def disc_at(position_m: Vector) -> Target:
    """Return a disc of 12 cm."""
    return DiscTarget(pose=Pose(position_m=position_m, tilt_rad=0.5, tilt_towards_rad=0.7), diameter_m=0.12)


def tag_at(position_m: Vector) -> Target:
    """Return an AprilTag of 10 cm."""
    return TagTarget(pose=Pose(position_m=position_m, tilt_rad=0.3, tilt_towards_rad=2.0), side_m=0.10, number=7)


def poster_at(position_m: Vector) -> Target:
    """Return a poster of 40 x 30 cm."""
    return PosterTarget(pose=Pose(position_m=position_m, tilt_rad=0.3, tilt_towards_rad=2.0), number=POSTER)


def circles_at(position_m: Vector) -> Target:
    """Return three discs of 5 cm, 10 cm apart."""
    return CirclesTarget(pose=Pose(position_m=position_m, tilt_rad=0.3, tilt_towards_rad=2.0))


@cache
def poster_file(number: int) -> Path:
    """Return a file that shows what is on a poster."""
    path = Path(tempfile.mkdtemp(prefix="stadimeter-poster-")) / f"{number}.png"
    cv2.imwrite(str(path), poster(number))
    return path


SCENES: dict[str, tuple[dict[str, Any], Place, Vector]] = {
    "ball": ({"diameter": "6.7 cm", "hsv": "29,86,6:64,255,255"}, ball_at, (-0.51, 0.05, 1.0)),
    "sheet": ({"width": "29.7 cm", "height": "21 cm"}, sheet_at, (-0.45, 0.05, 1.0)),
    "disc": ({"diameter": "12 cm"}, disc_at, (-0.50, 0.05, 1.0)),
    "circles": ({"diameter": "5 cm", "spacing": "10 cm"}, circles_at, (-0.50, 0.05, 1.0)),
    "tag": ({"side": "10 cm"}, tag_at, (-0.485, 0.05, 1.0)),
    "picture": ({"width": "40 cm"}, poster_at, (-0.42, 0.05, 1.0)),
}
"""For each driver its options, its target at a place, and a place at which the left border cuts the target off."""


def detector_rig(driver: str) -> DetectorRig:
    """Return the rig of a registered detector.

    Raises:
        KeyError: There are no scenes for a driver of that name; add them.
    """
    rigs = {"ideal": ideal_rig, "object": object_rig}
    return rigs[driver]() if driver in rigs else _rendered_rig(driver)


def build(driver: str, options: dict[str, Any], context: DriverContext) -> Detector:
    """Build a detector by its entry point."""
    model = load_driver(DETECTORS, driver)
    made: Detector = model.model_validate(options).build(context)
    return made


def _rendered_rig(driver: str) -> DetectorRig:
    options, place, cut_off = SCENES[driver]
    if driver == "picture":
        options = options | {"file": str(poster_file(POSTER))}
    whole, truth = _picture(place, LEFT)
    other, other_truth = _picture(place, RIGHT)
    known = known_target(truth)
    half = CAMERA.width_px // 2
    return DetectorRig(
        detector=build(driver, options, DriverContext(name="it", clock=ManualClock(), camera_model=CAMERA)),
        camera=CAMERA,
        whole=framed(whole),
        target=known,
        empty=framed(_empty()),
        cut_off=framed(_picture(place, cut_off)[0]),
        two=framed(np.hstack((whole[:, :half], other[:, half:]))),
        both=(known, known_target(other_truth)),
    )


def framed(image: Image) -> Frame:
    """Return a frame with a copy of the picture."""
    return Frame(image.copy(), 0.0, 0)


@cache
def _picture(place: Place, position_m: Vector) -> tuple[Image, Truth]:
    rendered = render(Scene(camera=CAMERA, target=place(position_m), seed=3, backdrop=WALL))
    assert rendered.truth is not None
    return rendered.image, rendered.truth


@cache
def _empty() -> Image:
    return render(Scene(camera=CAMERA, target=None, seed=3, backdrop=WALL)).image


def known_target(truth: Truth) -> KnownTarget:
    """Return what a tracker would know of the target of a rendered scene."""
    outline = truth.outline_px
    x, y = (outline.min(axis=0) + outline.max(axis=0)) / 2
    longest_px = float(np.linalg.norm(np.roll(outline, 1, axis=0) - outline, axis=1).max())
    return KnownTarget(
        distance_m=truth.distance_m,
        centre_px=(float(x), float(y)),
        size_px=longest_px if len(outline) == 4 else truth.apparent_px,
    )


@cache
def _network() -> Path:
    """Write a network that finds what is bright, once."""
    from support.networks import write_network

    folder = Path(tempfile.mkdtemp(prefix="networks-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return write_network(folder / "yolox.onnx", "yolox")


def object_rig() -> DetectorRig:
    """Return the rig of a network that finds people, with bright figures 1.7 m tall before a dark wall."""
    from support.networks import bright_figure, put_figure

    def drawn(*figures: tuple[int, int, int]) -> Frame:
        image = np.full((480, 640, 3), 60, np.uint8)
        for left, top, height in figures:
            put_figure(image, bright_figure(height, height // 2), left, top)
        return Frame(image, 0.0, 0)

    def known(left: int, top: int, height: int) -> KnownTarget:
        x_px, y_px, depth_m = left + height / 4 - 0.5, top + height / 2 - 0.5, 1.7 * 600 / height
        x, y = CAMERA.direction(x_px, y_px)
        distance_m = depth_m * math.sqrt(1 + x * x + y * y)
        return KnownTarget(distance_m=distance_m, centre_px=(x_px, y_px), size_px=float(height))

    near, far = (100, 120, 240), (420, 160, 160)
    options = {"model": str(_network()), "height": "1.7 m ± 7 cm", "engine": "opencv"}
    return DetectorRig(
        detector=build("object", options, DriverContext(name="it", clock=ManualClock(), camera_model=CAMERA)),
        camera=CAMERA,
        whole=drawn(near),
        target=known(*near),
        empty=drawn(),
        cut_off=drawn((100, 300, 240)),
        two=drawn(near, far),
        both=(known(*near), known(*far)),
        takes_nearest=True,
    )


def ideal_rig() -> DetectorRig:
    """Return the rig of the detector that asks the simulated world: its frames differ in when they were captured."""
    clock = ManualClock()
    context = DriverContext(name="it", clock=clock, camera_model=CAMERA)
    places = (("0 s", "2 m", "0.3 m"), ("1 s", "2 m", "1.05 m"), ("2 s", "2 m", "2 m"), ("3 s", "2 m", "2 m"))
    path = [{"at": at, "x": x, "y": y} for at, x, y in places]
    truth = load_driver(WORLDS, "simulated").model_validate({"path": path, "loop": False}).build(context)
    clock.advance_s(3.0)
    black = np.zeros((480, 640, 3), np.uint8)
    x, y, depth_m = truth.target_in_camera(0.0)
    return DetectorRig(
        detector=build("ideal", {}, context),
        camera=CAMERA,
        whole=Frame(black.copy(), 0.0, 0),
        target=KnownTarget(
            distance_m=math.hypot(x, y, depth_m),
            centre_px=(CAMERA.cx_px + CAMERA.fx_px * x / depth_m, CAMERA.cy_px + CAMERA.fy_px * y / depth_m),
            size_px=CAMERA.fx_px * truth.ball.diameter_m / depth_m,
        ),
        empty=Frame(black.copy(), 2.5, 2),
        cut_off=Frame(black.copy(), 1.0, 1),
    )
