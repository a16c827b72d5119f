"""Pictures in which a code value is a share of cover: white on black, linear, without blur and noise."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.plane import Pose, SheetTarget
from support.scenes.render import render
from support.scenes.scene import Scene
from support.scenes.sensor import Blur, Sensor
from support.scenes.target import Target
from support.scenes.tone import Tone

LENS = CameraModel.with_focal_length(600.0, 640, 480)
WHITE, BLACK = (255, 255, 255), (0, 0, 0)
Cover = NDArray[np.float64]


def bare_scene(target: Target | None, camera: CameraModel = LENS, **changes: Any) -> Scene:
    table = {
        "backdrop": PlainBackdrop(bgr=BLACK, stains=0.0),
        "blur": Blur(sigma_px=0.0),
        "sensor": Sensor(noise=0.0, tone=Tone.LINEAR),
        **changes,
    }
    return Scene(camera=camera, target=target, seed=1, **table)


def flat_ball(position_m: tuple[float, float, float], diameter_m: float) -> BallTarget:
    return BallTarget(position_m=position_m, diameter_m=diameter_m, bgr=WHITE, ambient=1.0)


def white_sheet(pose: Pose, width_m: float = 0.297, height_m: float = 0.21) -> SheetTarget:
    return SheetTarget(pose=pose, width_m=width_m, height_m=height_m, bgr=WHITE)


def cover_of(scene: Scene) -> Cover:
    return render(scene).image[:, :, 1].astype(np.float64) / 255


def edge_errors_px(cover: Cover, edge_px: NDArray[np.float64], outwards: NDArray[np.float64]) -> NDArray[np.float64]:
    """Walk across an edge and return how much further out than the given points it is.

    The cover along a walk adds up to the length of its part inside.
    """
    reach = 3.0
    steps = np.linspace(-reach, reach, 241)
    walk = (edge_px[:, None, :] + outwards[:, None, :] * steps[None, :, None]).astype(np.float32)
    profiles = cv2.remap(cover.astype(np.float32), walk[..., 0], walk[..., 1], cv2.INTER_LINEAR)
    return (profiles[:, 1:] + profiles[:, :-1]).sum(axis=1) / 2 * (steps[1] - steps[0]) - reach


def spread_px(scene: Scene, across: bool) -> float:
    """Return the standard deviation of what a sharp vertical or horizontal edge of a large sheet becomes."""
    cover = cover_of(scene)
    profile = cover[240, :] if across else cover[:, 320]
    steps = np.diff(profile[: 320 if across else 240])
    places = np.arange(len(steps))
    mean = float((steps * places).sum() / steps.sum())
    return math.sqrt(float((steps * (places - mean) ** 2).sum() / steps.sum()))


@pytest.fixture(scope="session")
def bare() -> Callable[..., Scene]:
    """Return a function that makes a scene without any trouble."""
    return bare_scene


@pytest.fixture(scope="session")
def ball() -> Callable[..., BallTarget]:
    """Return a function that makes an evenly white ball."""
    return flat_ball


@pytest.fixture(scope="session")
def sheet() -> Callable[..., SheetTarget]:
    """Return a function that makes a white sheet."""
    return white_sheet


@pytest.fixture(scope="session")
def cover() -> Callable[[Scene], Cover]:
    """Return a function that renders a bare scene and gives the share of each pixel that is covered."""
    return cover_of


@pytest.fixture(scope="session")
def edge_errors() -> Callable[..., NDArray[np.float64]]:
    """Return a function that says how far out an edge is drawn."""
    return edge_errors_px


@pytest.fixture(scope="session")
def spread() -> Callable[[Scene, bool], float]:
    """Return a function that measures how blurred the edge of a sheet is, across or down."""
    return spread_px
