"""Flat things: a sheet, a disc, a tag.

A point X, Y of the plane lies at ``t + X r1 + Y r2``, so ``H = [r1 r2 t]`` takes it to its ray, and the inverse of H
takes each ray to the point that it hits (R. Hartley and A. Zisserman, "Multiple View Geometry", section 8.1.1).
"""

from __future__ import annotations

import math
from functools import cache

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points
from stadimeter.simulation.camera import Vector
from support.scenes.target import Colour, Floats, Layer, Rays, inside, slope
from support.scenes.tone import decode_srgb

Plane = NDArray[np.float32]

PAPER_BGR: Colour = (232, 236, 236)
INK_BGR: Colour = (38, 36, 34)
RIM_POINTS = 360

TAG_FAMILIES = {
    "apriltag-16h5": cv2.aruco.DICT_APRILTAG_16h5,
    "apriltag-25h9": cv2.aruco.DICT_APRILTAG_25h9,
    "apriltag-36h11": cv2.aruco.DICT_APRILTAG_36h11,
    "aruco-4x4-50": cv2.aruco.DICT_4X4_50,
    "aruco-6x6-250": cv2.aruco.DICT_6X6_250,
}


class Pose(Struct, frozen=True, kw_only=True):
    """Where a flat thing is, and how it is turned.

    Attributes:
        position_m: Its centre in the camera frame: x right, y down, z forward.
        tilt_rad: Angle between its normal and the optical axis.
        tilt_towards_rad: Which side of it comes nearer, as an angle in the picture from right towards down.
        roll_rad: How it is turned in its own plane before it is tilted, from right towards down.
    """

    position_m: Vector
    tilt_rad: float = 0.0
    tilt_towards_rad: float = 0.0
    roll_rad: float = 0.0

    def rotation(self) -> Floats:
        """Return the matrix whose columns are its own x, y and z axes in the camera frame."""
        towards = _turned(self.tilt_towards_rad)
        cosine, sine = math.cos(self.tilt_rad), math.sin(self.tilt_rad)
        tilted = np.array(((cosine, 0.0, sine), (0.0, 1.0, 0.0), (-sine, 0.0, cosine)))
        return np.asarray(towards @ tilted @ towards.T @ _turned(self.roll_rad))

    def placed(self, points_m: Points) -> Points:
        """Return points of the plane, shape ``(n, 2)``, in the camera frame, shape ``(n, 3)``."""
        return np.asarray(points_m @ self.rotation()[:, :2].T + self.position_m)

    def hit(self, rays: Rays) -> tuple[Floats, Floats, Plane]:
        """Return which point of the plane each ray hits, as X and Y, and 1 where that lies in front of the camera."""
        rotation = self.rotation()
        back = np.linalg.inv(np.column_stack((rotation[:, 0], rotation[:, 1], self.position_m)))
        across, down, scale = (row[0] * rays[0] + row[1] * rays[1] + row[2] for row in back)
        front = scale > 1e-9
        safe = np.where(front, scale, 1.0)
        return across / safe, down / safe, front.astype(np.float32)


class Posed:
    """The base of flat things in one plane, which have a pose."""

    __slots__ = ()

    pose: Pose

    @property
    def position_m(self) -> Vector:
        """Its centre in the camera frame; of a sheet that was cut by hand, that of the rectangle that was meant."""
        return self.pose.position_m

    @property
    def tilt_rad(self) -> float:
        """Angle between its normal and the optical axis."""
        return self.pose.tilt_rad


class SheetTarget(Posed, Struct, frozen=True, kw_only=True):
    """A plain rectangle.

    Attributes:
        pose: Where it is.
        width_m: Its side along its own x axis.
        height_m: The other one.
        bgr: Its colour.
    """

    pose: Pose
    width_m: float
    height_m: float
    bgr: Colour = PAPER_BGR

    def outline_m(self) -> Points:
        """Return its corners, in order around it."""
        return self.pose.placed(_rectangle(self.width_m, self.height_m))

    def extent_m(self) -> Points:
        """Return its corners."""
        return self.outline_m()

    def apparent_px(self, camera: CameraModel) -> float:
        """Return how long its longer side appears if it is not tilted."""
        return camera.fx_px * max(self.width_m, self.height_m) / self.position_m[2]

    def layer(self, rays: Rays) -> Layer:
        """Return what it covers, evenly lit."""
        x, y, front = self.pose.hit(rays)
        cover = _inside_rectangle(x, y, self.width_m, self.height_m) * front
        return Layer(cover, _even(self.bgr, cover))


class DiscTarget(Posed, Struct, frozen=True, kw_only=True):
    """A flat circle, such as a lid, a sticker or a printed dot.

    Attributes:
        pose: Where it is.
        diameter_m: Its diameter.
        bgr: Its colour.
    """

    pose: Pose
    diameter_m: float
    bgr: Colour = PAPER_BGR

    def outline_m(self) -> Points:
        """Return points on its rim."""
        angles = np.linspace(0, 2 * math.pi, RIM_POINTS, endpoint=False)
        return self.pose.placed(np.column_stack((np.cos(angles), np.sin(angles))) * (self.diameter_m / 2))

    def extent_m(self) -> Points:
        """Return its rim."""
        return self.outline_m()

    def apparent_px(self, camera: CameraModel) -> float:
        """Return how long its diameter appears if it is not tilted."""
        return camera.fx_px * self.diameter_m / self.position_m[2]

    def layer(self, rays: Rays) -> Layer:
        """Return what it covers, evenly lit."""
        x, y, front = self.pose.hit(rays)
        cover = inside(self.diameter_m / 2 - np.hypot(x, y)) * front
        return Layer(cover, _even(self.bgr, cover))


class TagTarget(Posed, Struct, frozen=True, kw_only=True):
    """A square fiducial, black and white, with a white margin of one cell.

    Attributes:
        pose: Where it is.
        side_m: The side of its black square.
        family: One of `TAG_FAMILIES`.
        number: Which one of the family.
    """

    pose: Pose
    side_m: float
    family: str = "apriltag-36h11"
    number: int = 0

    @property
    def paper_side_m(self) -> float:
        """The side of the paper that it is printed on."""
        cells = len(_cells(self.family, self.number))
        return self.side_m * cells / (cells - 2)

    def outline_m(self) -> Points:
        """Return the corners of the black square, in order around it."""
        return self.pose.placed(_rectangle(self.side_m, self.side_m))

    def extent_m(self) -> Points:
        """Return the corners of the paper."""
        return self.pose.placed(_rectangle(self.paper_side_m, self.paper_side_m))

    def apparent_px(self, camera: CameraModel) -> float:
        """Return how long its side appears if it is not tilted."""
        return camera.fx_px * self.side_m / self.position_m[2]

    def layer(self, rays: Rays) -> Layer:
        """Return what its paper covers, evenly lit, with its cells."""
        x, y, front = self.pose.hit(rays)
        cover = _inside_rectangle(x, y, self.paper_side_m, self.paper_side_m) * front
        cells = _cells(self.family, self.number)
        per_m = len(cells) / self.paper_side_m
        white = _looked_up(cells, x * per_m + len(cells) / 2, y * per_m + len(cells) / 2)[:, :, None]
        paper, ink = decode_srgb(PAPER_BGR), decode_srgb(INK_BGR)
        return Layer(cover, np.asarray(ink + white * (paper - ink), np.float32))


@cache
def _cells(family: str, number: int) -> Plane:
    """Return a tag's cells and a margin of one, 1 for white."""
    dictionary = cv2.aruco.getPredefinedDictionary(TAG_FAMILIES[family])
    side = dictionary.markerSize + 2
    marker = cv2.aruco.generateImageMarker(dictionary, number, side)
    return np.pad(np.asarray(marker, np.float32) / 255, 1, constant_values=1.0)


def _looked_up(cells: Plane, x: Floats, y: Floats) -> Plane:
    """Return the value of the cells at places in cells; borders between them are shared out as edges are."""
    (left, right, is_right), (top, bottom, is_below) = _neighbours(x, len(cells)), _neighbours(y, len(cells))
    above = cells[top, left] * (1 - is_right) + cells[top, right] * is_right
    below = cells[bottom, left] * (1 - is_right) + cells[bottom, right] * is_right
    return np.asarray(above * (1 - is_below) + below * is_below, np.float32)


def _neighbours(place: Floats, count: int) -> tuple[NDArray[np.intp], NDArray[np.intp], Plane]:
    """Return the cells on both sides of the nearest border, and how much of the sample lies in the second."""
    border = np.rint(place)
    second = np.clip((place - border) / slope(place) + 0.5, 0, 1).astype(np.float32)
    after = border.astype(np.intp)
    return np.clip(after - 1, 0, count - 1), np.clip(after, 0, count - 1), second


def _inside_rectangle(x: Floats, y: Floats, width_m: float, height_m: float) -> Plane:
    across = np.clip((width_m / 2 - np.abs(x)) / slope(x) + 0.5, 0, 1)
    down = np.clip((height_m / 2 - np.abs(y)) / slope(y) + 0.5, 0, 1)
    return (across * down).astype(np.float32)


def _rectangle(width_m: float, height_m: float) -> Points:
    return np.array(((-1, -1), (1, -1), (1, 1), (-1, 1))) * (width_m / 2, height_m / 2)


def _turned(angle_rad: float) -> Floats:
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return np.array(((cosine, -sine, 0.0), (sine, cosine, 0.0), (0.0, 0.0, 1.0)))


def _even(bgr: Colour, cover: Plane) -> Plane:
    return np.broadcast_to(decode_srgb(bgr), (*cover.shape, 3))
