"""The two pipelines that everyone starts from, as the tutorials have them. They are what we are compared with.

The ball is from "Ball Tracking with OpenCV", the sheet from "Find distance from camera to object/marker using Python
and OpenCV", both on pyimagesearch.com (A. Rosebrock, 2015). They were written anew from their steps. Both say
``distance = F · W / P`` with a focal length from one picture at a known distance.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from stadimeter.core.frame import Image

BALL_WIDTH_PX = 600
BALL_LOWER, BALL_UPPER = np.array((29, 86, 6)), np.array((64, 255, 255))


def ball_radius_px(image: Image) -> float | None:
    """Return the radius of the ball in pixels of the given picture; None if no pixel has its colour."""
    found = ball_circle(image, BALL_LOWER, BALL_UPPER)
    return found[2] if found else None


def ball_circle(image: Image, lower: NDArray[np.int_], upper: NDArray[np.int_]) -> tuple[float, float, float] | None:
    """Return centre and radius of what has a colour, in pixels of the given picture; a range of hues may pass red."""
    height, width = image.shape[:2]
    scale = BALL_WIDTH_PX / width
    small = cv2.resize(image, (BALL_WIDTH_PX, int(height * scale)), interpolation=cv2.INTER_AREA)
    hsv = cv2.cvtColor(cv2.GaussianBlur(small, (11, 11), 0), cv2.COLOR_BGR2HSV)
    mask = _in_range(hsv, lower, upper)
    mask = cv2.dilate(cv2.erode(mask, None, iterations=2), None, iterations=2)
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    if not contours:
        return None
    (x, y), radius = cv2.minEnclosingCircle(max(contours, key=cv2.contourArea))
    return x / scale, y / scale, radius / scale


def _in_range(hsv: Image, lower: NDArray[np.int_], upper: NDArray[np.int_]) -> Image:
    if lower[0] <= upper[0]:
        return np.asarray(cv2.inRange(hsv, lower, upper))
    last, first = upper.copy(), lower.copy()
    last[0], first[0] = 180, 0
    return np.asarray(cv2.inRange(hsv, lower, last) | cv2.inRange(hsv, first, upper))


def sheet_box(image: Image) -> tuple[tuple[float, float], tuple[float, float], float] | None:
    """Return the smallest box around the largest contour, as OpenCV has it: centre, sides, angle."""
    grey = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), (5, 5), 0)
    contours, _ = cv2.findContours(cv2.Canny(grey, 35, 125), cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
    return cv2.minAreaRect(max(contours, key=cv2.contourArea)) if contours else None


def sheet_long_side_px(image: Image) -> float | None:
    """Return the longer side of the box.

    The tutorial takes the first one, which is the shorter or the longer one by chance and by OpenCV's version. Taking
    the longer one is charity.
    """
    box = sheet_box(image)
    return max(box[1]) if box else None


def is_the_sheet(image: Image, outline_px: Points) -> bool:
    """Return whether the box is about the sheet at all: its centre inside, its area within a factor of two."""
    box = sheet_box(image)
    if box is None:
        return False
    outline = outline_px.astype(np.float32)
    share = box[1][0] * box[1][1] / cv2.contourArea(outline)
    return 0.5 < share < 2 and cv2.pointPolygonTest(outline, box[0], measureDist=False) > 0
