"""The tag detectors that people use, and the range from their corners."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points
from stadimeter.core.frame import Image

Finder = Callable[[Image], dict[int, Points]]
"""Takes a picture and gives the four corners of each tag by its number."""


def aruco(refinement: int) -> Finder:
    """Return `cv2.aruco` with its defaults, but for how it refines corners."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = refinement
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    detector = cv2.aruco.ArucoDetector(dictionary, parameters)

    def find(image: Image) -> dict[int, Points]:
        corners, numbers, _ = detector.detectMarkers(image)
        if numbers is None:
            return {}
        return {int(n): np.asarray(c, float).reshape(4, 2) for n, c in zip(numbers.ravel(), corners, strict=True)}

    return find


def apriltags(decimate: float) -> Finder | None:
    """Return `pyapriltags`; None if it is not installed."""
    try:
        from pyapriltags import Detector  # it is optional
    except ImportError:
        return None
    detector = Detector(families="tag36h11", nthreads=1, quad_decimate=decimate)

    def find(image: Image) -> dict[int, Points]:
        found = detector.detect(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
        # Its pixels have (0, 0) at their corner, ours at their centre.
        return {tag.tag_id: np.asarray(tag.corners, float) - 0.5 for tag in found}

    return find


def finders() -> dict[str, Finder]:
    """Return all that are installed, by name."""
    known = {
        "aruco": aruco(cv2.aruco.CORNER_REFINE_NONE),
        "aruco subpix": aruco(cv2.aruco.CORNER_REFINE_SUBPIX),
        "pyapriltags d1": apriltags(1.0),
        "pyapriltags d2": apriltags(2.0),
    }
    return {name: finder for name, finder in known.items() if finder}


def range_m(corners_px: Points, side_m: float, camera: CameraModel) -> float:
    """Return how far away the centre of a square is."""
    x, y = corners_px.T
    clockwise = float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) > 0
    ordered = corners_px if clockwise else corners_px[::-1]
    own = np.array(((-1, 1, 0), (1, 1, 0), (1, -1, 0), (-1, -1, 0))) * side_m / 2
    seen = np.ascontiguousarray(camera.directions(ordered))
    _, _, place = cv2.solvePnP(own, seen, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    return float(np.linalg.norm(place))
