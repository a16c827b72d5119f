"""An ellipse in a picture, the light along lines across it, and where on them the edge is."""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Flags, Points, Values
from stadimeter.core.frame import Image
from stadimeter.detectors.sampling import Light, light_table, quantile
from stadimeter.ranging.flat import cone_through

# An ellipse is taken through the lens by this many points around it.
RIM_POINTS = 32

# Half axes shorter than this are no ellipse in a picture.
MIN_HALF_AXIS_PX = 0.5


@cache
def turns(count: int) -> Points:
    """Return points evenly around the unit circle, shape ``(count, 2)``. Read-only."""
    angles = np.linspace(0, 2 * math.pi, count, endpoint=False)
    places = np.column_stack((np.cos(angles), np.sin(angles)))
    places.setflags(write=False)
    return places


class Rim(Struct, frozen=True, kw_only=True, eq=False):
    """Places around an ellipse."""

    turns: Points  # the cosine and sine that each belongs to, shape ``(n, 2)``
    points_px: Points  # where they are, x and y, shape ``(n, 2)``
    outward: Points  # the unit vectors at right angles to the ellipse there, shape ``(n, 2)``
    curvature: Values  # one over the radius of the circle that follows the ellipse there, in 1/px, shape ``(n,)``


class Ellipse(Struct, frozen=True, kw_only=True, eq=False):
    """The points ``c + M (cos t, sin t)`` with M symmetric: five numbers, none of which is undefined for a circle."""

    centre_px: Points  # c, x and y, shape ``(2,)``
    half_axes_px: Values  # M, shape ``(2, 2)``; its eigenvalues are the half axes, its eigenvectors their directions

    def axes(self) -> tuple[float, float, tuple[float, float]]:
        """Return the larger and the smaller half axis in pixels, and the unit vector along the larger one."""
        (xx, xy), (_, yy) = self.half_axes_px.tolist()
        # Eigenvalues of a symmetric 2x2 matrix: the mean of its diagonal, more and less by the radius of Mohr's circle;
        # the eigenvector is at half the angle.
        middle, apart = (xx + yy) / 2, math.hypot((xx - yy) / 2, xy)
        angle = math.atan2(xy, (xx - yy) / 2) / 2
        return middle + apart, middle - apart, (math.cos(angle), math.sin(angle))

    def rim(self, count: int) -> Rim:
        """Return points around it, the closer together the more it bends there."""
        circle = turns(count)
        (xx, xy), (_, yy) = self.half_axes_px
        area = xx * yy - xy * xy
        # The normal is along the inverse of M times (cos t, sin t); times the determinant, it has the tangent's length.
        steep = circle @ np.array(((yy, -xy), (-xy, xx)))
        speed = np.hypot(steep[:, 0], steep[:, 1])
        return Rim(
            turns=circle,
            points_px=circle @ self.half_axes_px + self.centre_px,
            outward=steep / speed[:, None],
            curvature=area / speed**3,
        )

    def distances_px(self, points_px: Points) -> Values:
        """Return about how far outside of it points are, inside negative, along the line to its centre."""
        (xx, xy), (_, yy) = self.half_axes_px.tolist()
        area = xx * yy - xy * xy
        x, y = points_px[:, 0] - self.centre_px[0], points_px[:, 1] - self.centre_px[1]
        # |M⁻¹ (p - c)|: 1 on the ellipse, and the share of the way from the centre to it elsewhere.
        share = np.hypot(yy * x - xy * y, xx * y - xy * x) / area
        return np.asarray(np.hypot(x, y) * (1 - 1 / np.maximum(share, 1e-9)))

    def perimeter_px(self) -> float:
        """Return about how long it is all around (S. Ramanujan's first approximation)."""
        a, b, _ = self.axes()
        return math.pi * (3 * (a + b) - math.sqrt((3 * a + b) * (a + 3 * b)))


def ellipse_from_moments(
    area: float, centre: tuple[float, float], spread: tuple[float, float, float]
) -> Ellipse | None:
    """Return the ellipse with the central second moments xx, xy and yy of a shape, in px⁴; None if it has no width.

    A full ellipse with the half axes M has the covariance ``M² / 4``.
    """
    xx, xy, yy = (4 * each / area for each in spread)
    # The root of a symmetric 2x2 matrix A is (A + sqrt(det A) 1) / sqrt(trace A + 2 sqrt(det A)).
    squared = xx * yy - xy * xy
    if not squared > MIN_HALF_AXIS_PX**4:
        return None
    root = math.sqrt(squared)
    half_axes = np.array(((xx + root, xy), (xy, yy + root))) / math.sqrt(xx + yy + 2 * root)
    return Ellipse(centre_px=np.array(centre), half_axes_px=half_axes)


def ellipse_through(points_px: Points) -> Ellipse | None:
    """Return the ellipse through points on most of it, by linear least squares; None if they are on none."""
    conic = cone_through(points_px)
    if conic is None:
        return None
    # Centre: where the gradient of the conic vanishes. Divided by its value there, the eigenvalues of the quadratic
    # part are 1 / a² and 1 / b².
    centre = -np.linalg.solve(conic[:2, :2], conic[:2, 2])
    value = -float(conic[2, 2] + conic[2, :2] @ centre)
    if not value > 0:
        return None
    shares, directions = np.linalg.eigh(conic[:2, :2] / value)
    half_axes = np.asarray(1 / np.sqrt(shares), np.float64)
    if not half_axes.min() > MIN_HALF_AXIS_PX:
        return None
    return Ellipse(centre_px=np.asarray(centre), half_axes_px=(directions * half_axes) @ directions.T)


class Lens(Struct, frozen=True, kw_only=True, eq=False):
    """Leads between places in a picture and where they would be without distortion."""

    # The camera at the picture's resolution; None if it is not known, and then nothing is bent.
    camera: CameraModel | None

    @property
    def light(self) -> Light:
        """The light of code values through the camera's tone curve; that of sRGB if it is not known."""
        return light_table("srgb" if self.camera is None else self.camera.tone_curve)

    @property
    def is_compressed(self) -> bool:
        """True if pictures store colour at a lower resolution than brightness, as JPEG does."""
        return self.camera is not None and self.camera.chroma_pitch_px != (1, 1)

    def bent(self, points_px: Points) -> Points:
        """Return where points appear, any shape that ends with x and y."""
        if self.camera is None or not self.camera.distortion:
            return points_px
        straight = (points_px.reshape(-1, 2) - self._centre()) / self._focal()
        return self.camera.project(straight).reshape(points_px.shape)

    def straighten(self, ellipse: Ellipse) -> Ellipse | None:
        """Return the ellipse that appears as one; None for one that none appears as."""
        if self.camera is None or not self.camera.distortion:
            return ellipse
        # An ellipse bent by the lens is none any more: 32 points are undone one by one, and an ellipse is fitted
        # through them. It is a start only.
        straight = self.camera.directions(ellipse.rim(RIM_POINTS).points_px) * self._focal() + self._centre()
        return ellipse_through(straight)

    def _focal(self) -> Points:
        return np.array([self.camera.fx_px, self.camera.fy_px]) if self.camera else np.ones(2)

    def _centre(self) -> Points:
        return np.array([self.camera.cx_px, self.camera.cy_px]) if self.camera else np.zeros(2)


# Shares of blue, green and red in the light (ITU-R BT.709). Channels are decoded one by one and added as light: the
# luma of a pixel that is half white and half blue stands for too much of it.
LUMINANCE = np.array((0.0722, 0.7152, 0.2126), np.float32)

# Spacing of the samples on a line; on long lines more, so that there are no more than 17 of them.
STEP_PX = 0.5
MAX_STEPS = 8

# The blur that the reach follows from: that many edges are sharper. What moves is blurred on two sides only.
WIDE_BLUR_QUANTILE = 0.85

# The standard deviation of a distribution in units of its mean absolute value: 1.25 if it is normal, as that of a
# sharp lens, 1.18 out of focus, 1.15 for a straight motion.
SHARP_SPREAD_PX, WIDE_SPREAD_PX = 0.75, 1.75
SIGMA_OF_SHARP, SIGMA_OF_WIDE = 1.25, 1.17

# The standard deviation of a normal distribution, times its greatest value.
SIGMA_OF_STEEPNESS = 1 / math.sqrt(2 * math.pi)

# An edge that seems more times as blurred as usual has something beside it.
MAX_BLUR_FACTOR = 3.0

# Least change of the light from one sample to the next at the edge, as a share of that from inside to outside.
MIN_RISE = 0.02

# Lines over which the median of the light inside is taken.
MIN_LIGHT = 1e-4
LEVEL_LINES = 9


class EdgePicture(Struct, frozen=True, kw_only=True, eq=False):
    """A picture in which edges are looked for."""

    image: Image  # the picture, 2 pixels each way at least
    lens: Lens

    def read(self, points_px: Points) -> tuple[Values, Flags]:
        """Return the light at undistorted places, ``(..., 2)``, bilinearly, and whether each is inside the picture."""
        height, width = self.image.shape[:2]
        places = self.lens.bent(points_px)
        x, y = places[..., 0], places[..., 1]
        inside = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
        x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
        left, top = np.minimum(x.astype(np.intp), width - 2), np.minimum(y.astype(np.intp), height - 2)
        right, below = x - left, y - top
        # Bilinear: the four neighbours of every place in one gather, shape (4, …, 3), decoded to light and weighted to
        # luminance before they are mixed, since light adds up and code values do not.
        first = top * width + left
        neighbours = np.array((first, first + 1, first + width, first + width + 1))
        light = self.lens.light.take(self.image.reshape(-1, 3).take(neighbours, axis=0)) @ LUMINANCE
        upper = light[0] * (1 - right) + light[1] * right
        lower = light[2] * (1 - right) + light[3] * right
        return upper * (1 - below) + lower * below, inside


class Steps(NamedTuple):
    """Edges on n lines."""

    off_px: Values  # how far outside the ellipse the edge is, shape ``(n,)``
    is_edge: Flags  # whether there is one
    visible: Flags  # whether all of the line is inside the picture
    contrast: Values  # how much more light comes from inside; of a dark disc, how much less
    inside: Values  # the light inside; of a dark disc, below zero
    blur_px: Values  # how blurred the edge is: the standard deviation of a distribution
    edge_px: float  # the median of that
    widest_px: float  # the blur that nearly all edges are below


def read_steps(picture: EdgePicture, rim: Rim, reach_px: float, *, is_bright: bool, is_first: bool) -> Steps:
    """Find the edges of a disc on lines that cross an ellipse and reach equally far to both sides.

    At the first look the steepest place is taken, since both ends of the line may be anywhere, instead of that half way
    from inside to outside.
    """
    # Samples from -reach to +reach, 17 at most, outwards positive, in pixels without distortion.
    half = min(MAX_STEPS, math.ceil(reach_px / STEP_PX))
    along: Values = np.arange(-half, half + 1, dtype=np.float64) * (reach_px / half)
    light, is_inside = picture.read(rim.points_px[:, None, :] + along[None, :, None] * rim.outward[:, None, :])
    visible: Flags = np.asarray(is_inside.all(axis=1), np.bool_)
    bright = light if is_bright else -light
    return (_find_steepest if is_first else _find_half_way)(bright, visible, along)


def _find_steepest(bright: Values, visible: Flags, along: Values) -> Steps:
    # Central differences, outwards; a dark disc has its sign turned, so that its edge falls as well.
    fall = bright[:, :-2] - bright[:, 2:]
    best = np.argmax(fall, axis=1)
    height = fall[np.arange(len(fall)), best]
    contrast = bright.max(axis=1) - bright.min(axis=1)
    usual = quantile(height[visible]) if visible.any() else 0.0
    is_edge = visible & (height > max(MIN_LIGHT, usual / 4))
    # Contrast over steepest fall is the width of the step in samples two apart; the density of a normal distribution
    # has its peak at 1 / (σ √2π).
    steps_wide = quantile(contrast[is_edge] / height[is_edge]) if is_edge.any() else 0.0
    return Steps(
        off_px=along[best + 1],
        is_edge=is_edge,
        visible=visible,
        contrast=contrast,
        inside=bright[:, 0],
        blur_px=np.zeros(len(bright)),
        edge_px=0.0,
        widest_px=SIGMA_OF_STEEPNESS * 2 * float(along[1] - along[0]) * steps_wide,
    )


def _find_half_way(bright: Values, visible: Flags, along: Values) -> Steps:
    lines = np.arange(len(bright))
    # Levels are the means of the two samples at either end of the line; inside the median of nine lines is taken, since
    # print and gloss lie there, outside each line's own, since what is behind the disc changes.
    inside = _smooth((bright[:, 0] + bright[:, 1]) / 2)
    outside = (bright[:, -1] + bright[:, -2]) / 2
    contrast = inside - outside
    safe = np.where(contrast > MIN_LIGHT, contrast, np.inf)
    # -1/2 outside to 1/2 inside, 0 half way; the steepest passage through 0 is the edge, placed by linear
    # interpolation.
    share = (bright - ((inside + outside) / 2)[:, None]) / safe[:, None]
    before, after = share[:, :-1], share[:, 1:]
    fall = (before - after) * ((before > 0) & (after <= 0))
    best = np.argmax(fall, axis=1)
    height = fall[lines, best]
    is_edge = visible & (height > MIN_RISE)
    step_px = along[1] - along[0]
    off = along[best] + step_px * before[lines, best] / np.where(is_edge, height, 1.0)
    # The mean distance of the light from an ideal step is the mean absolute deviation of the blur, whatever its shape.
    towards = np.where(along < off[:, None], 1.0, -1.0)
    blur = _deviation_px(step_px * (0.5 - share * towards).sum(axis=1))
    seen = blur[is_edge] if is_edge.any() else np.ones(1)
    usual_px = max(quantile(seen), 0.0)
    return Steps(
        off_px=off,
        is_edge=is_edge,
        visible=visible,
        contrast=contrast,
        inside=inside,
        blur_px=np.clip(blur, 0.0, MAX_BLUR_FACTOR * usual_px),
        edge_px=usual_px,
        widest_px=max(quantile(seen, WIDE_BLUR_QUANTILE), 0.0),
    )


def _deviation_px(spread_px: Values) -> Values:
    """Return the standard deviation of blurs from their mean absolute value."""
    # Between a sharp lens and one out of focus the factor goes over linearly.
    wide = np.clip((spread_px - SHARP_SPREAD_PX) / (WIDE_SPREAD_PX - SHARP_SPREAD_PX), 0.0, 1.0)
    return np.asarray(spread_px * (SIGMA_OF_SHARP + (SIGMA_OF_WIDE - SIGMA_OF_SHARP) * wide))


def _smooth(values: Values) -> Values:
    """Return the median of each value and its neighbours, around the outline."""
    side = LEVEL_LINES // 2
    around = np.concatenate((values[-side:], values, values[:side]))
    neighbours = np.lib.stride_tricks.sliding_window_view(around, LEVEL_LINES)
    return np.asarray(np.partition(neighbours, side, axis=1)[:, side])
