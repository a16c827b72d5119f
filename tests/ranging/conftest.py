"""Targets projected through a pinhole, whose truth is exact."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus

CAMERA = CameraModel.with_focal_length(600.0, 640, 480)


def project_ball(position_m: tuple[float, float, float], radius_m: float, sigma_px: float = 0.2) -> Detection:
    """Return the outline of a ball: the rays that graze it, which make a cone about the ray to its centre."""
    centre = np.array(position_m)
    distance = float(np.linalg.norm(centre))
    axis = centre / distance
    first = np.cross(axis, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    angles = np.linspace(0, 2 * math.pi, 3600, endpoint=False)[:, None]
    half = math.asin(radius_m / distance)
    rays = math.cos(half) * axis + math.sin(half) * (np.cos(angles) * first + np.sin(angles) * second)
    outline = rays[:, :2] / rays[:, 2:] * CAMERA.fx_px + (CAMERA.cx_px, CAMERA.cy_px)
    middle = _middle(outline)
    distances = np.linalg.norm(outline - middle, axis=1)
    smaller = 2 * float(distances.min())
    return Detection(
        target="ball",
        status=DetectionStatus.FOUND,
        outline_px=outline[::60],
        centre_px=(float(middle[0]), float(middle[1])),
        width_px=smaller,
        height_px=smaller,
        size_sigma_px=sigma_px,
        quality=1.0,
    )


def _middle(outline: np.ndarray) -> np.ndarray:
    """Return the centre of the ellipse through the points, from its conic."""
    x, y = (outline - outline.mean(axis=0)).T / 100
    rows = np.column_stack([x * x, x * y, y * y, x, y])
    a, b, c, d, e = np.linalg.lstsq(rows, np.ones(len(x)), rcond=None)[0]
    centre = np.linalg.solve([[2 * a, b], [b, 2 * c]], [-d, -e])
    return centre * 100 + outline.mean(axis=0)


def sheet(width_px: float, height_px: float, centre_px: tuple[float, float], sigma_px: float = 0.3) -> Detection:
    return Detection(
        target="paper",
        status=DetectionStatus.FOUND,
        centre_px=centre_px,
        width_px=width_px,
        height_px=height_px,
        size_sigma_px=sigma_px,
        quality=1.0,
    )


@pytest.fixture(scope="session")
def camera() -> CameraModel:
    """Return a camera of 640x480 with a focal length of 600 px."""
    return CAMERA


@pytest.fixture(scope="session")
def seen_ball() -> Callable[..., Detection]:
    """Return a function that gives the detection of a ball at a position."""
    return project_ball


@pytest.fixture(scope="session")
def seen_sheet() -> Callable[..., Detection]:
    """Return a function that gives the detection of a sheet of an apparent size."""
    return sheet
