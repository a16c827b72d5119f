"""Targets, and the patch of a picture in which each is drawn through a lens."""

from __future__ import annotations

import math
from typing import Protocol

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points
from stadimeter.simulation.camera import Vector

# A part of a picture that is worked on at a finer scale.

Plane = NDArray[np.float32]


class Patch(Struct, frozen=True, kw_only=True):
    """A part of a picture in whole pixels, right and bottom excluded, each of them ``finer`` × ``finer`` samples.

    Attributes:
        left: First column.
        top: First row.
        right: The column after the last.
        bottom: The row after the last.
        finer: How many samples there are along a pixel.
    """

    left: int
    top: int
    right: int
    bottom: int
    finer: int

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.right - self.left, self.bottom - self.top

    @property
    def rows_and_columns(self) -> tuple[slice, slice]:
        """What cuts it out of a picture."""
        return slice(self.top, self.bottom), slice(self.left, self.right)

    def samples_of(self, picture: Plane) -> Plane:
        """Cut the patch out of a picture and repeat each pixel in its samples."""
        part = picture[self.rows_and_columns]
        return np.repeat(np.repeat(part, self.finer, axis=0), self.finer, axis=1)

    def averaged(self, samples: Plane) -> Plane:
        """Return the mean of each pixel's samples."""
        return np.asarray(cv2.resize(samples, self.size, interpolation=cv2.INTER_AREA), np.float32)

    def shrunk(self, margin_px: int, width_px: int, height_px: int) -> Patch:
        """Return the patch without a margin, which stays along the borders of the picture."""
        return Patch(
            left=self.left + (margin_px if self.left > 0 else 0),
            top=self.top + (margin_px if self.top > 0 else 0),
            right=self.right - (margin_px if self.right < width_px else 0),
            bottom=self.bottom - (margin_px if self.bottom < height_px else 0),
            finer=self.finer,
        )


def patch_around(points_px: Points, margin_px: int, size_px: tuple[int, int], finer: int) -> Patch | None:
    """Return the part of a picture around some points.

    Args:
        points_px: Shape ``(n, 2)``.
        margin_px: How much is added on each side.
        size_px: Width and height of the picture.
        finer: How many samples there are along a pixel.

    Returns:
        The part; None if it lies outside the picture.
    """
    (left, top), (right, bottom) = points_px.min(axis=0), points_px.max(axis=0)
    patch = Patch(
        left=max(0, math.floor(left) - margin_px),
        top=max(0, math.floor(top) - margin_px),
        right=min(size_px[0], math.ceil(right) + 1 + margin_px),
        bottom=min(size_px[1], math.ceil(bottom) + 1 + margin_px),
        finer=finer,
    )
    return patch if patch.left < patch.right and patch.top < patch.bottom else None


# From pixels to rays and back: the camera model, and a rolling shutter on top.
#
# A ray is written as x and y per unit of depth. A rolling shutter reads one row after the other while the picture moves
# on: row v shows the picture shifted by ``skew · (v - reference) / height``.

Floats = NDArray[np.float64]
Rays = tuple[Floats, Floats]


class Lens(Struct, frozen=True, kw_only=True):
    """How directions become pixels.

    Attributes:
        camera: Focal lengths, centre, distortion and resolution.
        skew_px: By how much the picture moves, right and down, while all its rows are read.
        reference_row_px: The row that shows things where they truly are; the target's own.
    """

    camera: CameraModel
    skew_px: tuple[float, float] = (0.0, 0.0)
    reference_row_px: float = 0.0

    def rays(self, patch: Patch) -> Rays:
        """Return the ray of each sample of a patch: x and y per unit of depth, each of the samples' shape.

        Distortion is undone once a pixel and interpolated between: it is smooth, and that errs by less than 0.001 px.
        """
        if not (self.camera.distortion or any(self.skew_px)):
            columns, rows = _places(patch.left, patch.right, patch.finer), _places(patch.top, patch.bottom, patch.finer)
            x, y = (columns - self.camera.cx_px) / self.camera.fx_px, (rows - self.camera.cy_px) / self.camera.fy_px
            across, down = np.broadcast_arrays(x[None, :], y[:, None])
            return np.asarray(across), np.asarray(down)
        columns, rows = _places(patch.left - 1, patch.right + 1, 1), _places(patch.top - 1, patch.bottom + 1, 1)
        u, v = (grid.astype(np.float64) for grid in np.meshgrid(columns, rows))
        late = (v - self.reference_row_px) / self.camera.height_px
        still = np.column_stack(((u - self.skew_px[0] * late).ravel(), (v - self.skew_px[1] * late).ravel()))
        x, y = self.camera.directions(still).T.reshape(2, *u.shape)
        return _refined(x, patch.finer), _refined(y, patch.finer)

    def project(self, points_m: Points) -> Points:
        """Return where points appear.

        Args:
            points_m: Shape ``(n, 3)`` in the camera frame, in front of the camera.

        Returns:
            Shape ``(n, 2)`` in pixels.
        """
        u, v = self.camera.project(points_m[:, :2] / points_m[:, 2:]).T
        right, down = (skew / self.camera.height_px for skew in self.skew_px)
        row = (v - down * self.reference_row_px) / (1 - down)
        return np.column_stack((u + right * (row - self.reference_row_px), row))


def _places(first: int, end: int, finer: int) -> Floats:
    return first + (np.arange((end - first) * finer) + 0.5) / finer - 0.5


def _refined(grid: Floats, finer: int) -> Floats:
    height, width = grid.shape
    fine = cv2.resize(grid, (width * finer, height * finer), interpolation=cv2.INTER_LINEAR)
    return np.asarray(fine, np.float64)[finer:-finer, finer:-finer]


# What a thing in a scene must be able to do.

Colour = tuple[int, int, int]
"""An sRGB colour as OpenCV has it: blue, green, red, 0 to 255. It is what the camera would show of it in full light."""


class Layer(Struct, frozen=True, eq=False):
    """What a target adds to samples.

    Attributes:
        cover: How much of each sample it covers, from 0 to 1, shape ``(h, w)``.
        light: The light that comes from it there, shape ``(h, w, 3)``, blue first.
    """

    cover: Plane
    light: Plane


class Target(Protocol):
    """A thing whose place and shape are known exactly."""

    @property
    def position_m(self) -> Vector:
        """Its centre in the camera frame: x right, y down, z forward."""
        ...

    @property
    def tilt_rad(self) -> float:
        """Angle between its normal and the optical axis; 0 for a ball."""
        ...

    def outline_m(self) -> Points:
        """Return points in the camera frame on what is measured: the corners of a sheet, the limb of a ball."""
        ...

    def extent_m(self) -> Points:
        """Return points around all of it that is drawn."""
        ...

    def apparent_px(self, camera: CameraModel) -> float:
        """Return how large its diameter or longer side appears; of a flat one, as if it were not tilted."""
        ...

    def layer(self, rays: Rays) -> Layer:
        """Return what it adds to the samples that look along some rays."""
        ...


def inside(distance: Floats) -> Plane:
    """Return how much of each sample lies inside an edge.

    The distance to the edge in samples is the value over its own gradient; a straight edge at that distance covers
    that share of the sample. So the edge is exact to a small part of a sample.

    Args:
        distance: A smooth function, positive inside and zero on the edge, shape ``(h, w)``.

    Returns:
        From 0 to 1.
    """
    return np.clip(distance / slope(distance) + 0.5, 0, 1).astype(np.float32)


def slope(values: Floats) -> Floats:
    """Return how steep a function is, per sample."""
    down, across = np.gradient(values)
    return np.asarray(np.hypot(down, across) + 1e-300)
