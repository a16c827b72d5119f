"""The outline of a disc, to a few hundredths of a pixel.

Light is read along lines across an ellipse that is near the outline. Where it passes half way from inside to outside is
the edge, see `stadimeter.detectors.sampling`; the ellipse is moved to these edges by least squares, and the light is
read again, until the ellipse stays. So the result does not depend on where it began. Tests then distinguish it from
other outlines.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Flags, Points, Values
from stadimeter.core.frame import Image
from stadimeter.detectors.sampling import CODES, Light, light_table, quantile
from stadimeter.ranging.flat import cone_through

# An ellipse in a picture, the light along lines across it, and where on them the edge is.

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


# Across how many lines the light is read at least; if the effort allows, one for each pixel of the outline.
MIN_LINES = 40

# Number of fits in a look, each with weights that follow from the last.
FIRST_FITS, NEXT_FITS = 3, 2

# Reach on both sides of the outline: past the blur of the edge, and no further.
MIN_REACH_PX = 2.2
REACH_SIGMAS = 2.6
REACH_MORE_PX = 0.8

# Light is read no further inside than this share of the smaller half axis.
NEARLY_REACHED = 1.2
INNER_SHARE = 0.6

# Edges this far from the ellipse do not count for it: what hides a part of the disc, or lies beside it.
MIN_BAND_PX, BAND_SCATTERS = 0.35, 3.5

# Looking ends if the edges on the ellipse are less than this share of the lines, or fewer than that number.
MIN_EDGES = 12
MIN_HOPEFUL_SHARE = 0.4

# It ends as well if they scatter by more than the sum of these: pixels, blurs, and shares of the larger diameter.
HOPELESS_PX, HOPELESS_BLURS, HOPELESS_SHARE = 0.6, 0.4, 0.015

# The standard deviation of a normal distribution in units of its median absolute deviation.
MAD_SIGMAS = 1.4826

# Parts of the outline, of 10 degrees, in which its distance from an ellipse is averaged.
BEND_PARTS = 36

# Points at which the light inside is read, for an ellipse that is the unit circle.
INSIDE = np.concatenate([share * turns(16) for share in (0.15, 0.4, 0.6, 0.75)])

# The rest may be hidden, or printed on.
EVEN_SHARE = 0.7

# A disc turned away further from the line of sight is not accepted: it would be seen at a fourth of its height.
MAX_TILT_RAD = math.radians(75)

# Least contrast of a disc, in levels of 8 bits, on nine tenths of its outline.
MIN_CONTRAST = 8.0

# Least share of the outline that is seen, and greatest share hidden in one place, such as by a finger.
MIN_SUPPORT = 0.6
MAX_GAP = 0.36

# Edges may scatter about the ellipse by the sum of these: pixels, widths of the edge, and shares of the diameter.
SCATTER_PX, SCATTER_BLURS, SCATTER_SHARE = 0.15, 0.15, 0.004

# The outline may differ from an ellipse by the sum of these pixels and share of the diameter: an octagon does by
# 1.1 % of its diameter, a regular polygon of twelve corners by 0.5 %.
BEND_PX, BEND_SHARE = 0.12, 0.003

# The outline of a true disc is this far from an ellipse in a good picture.
EXACT_PX = 0.05

# The light inside may differ from that along the rim by this share of the contrast: that of a ball does by more.
MAX_UNEVENNESS = 0.12

# Greatest blur of the edge, as a share of the smaller diameter: a glow without an edge is no disc.
MAX_BLUR_SHARE = 0.18

# The least smaller diameter, as a share of the least larger one: the end of a bar looks like an ellipse.
MIN_HEIGHT = 0.6


class EllipseEdges(Struct, frozen=True, kw_only=True, eq=False):
    """Measured outline of a disc."""

    ellipse: Ellipse  # the ellipse through its edges, without the lens's distortion and the camera's edge bias
    support: float  # the share of the lines with an edge on the ellipse, of those inside the picture
    widest_gap: float  # the longest part of the outline without an edge on the ellipse, as a share of it
    # How much more light comes from inside than from outside, as a share of the most that a picture can hold:
    # the median of the lines on the ellipse. Negative for a dark disc.
    contrast: float
    weakest: float  # the contrast that nine in ten lines on the ellipse exceed, without sign
    inside: float  # the light inside, median
    outside: float  # the light outside, median
    # How far the light inside is from that along the rim, as a share of the contrast; seven tenths of it are
    # nearer.
    unevenness: float
    scatter_px: float  # standard deviation of the edges on the ellipse about it
    bend_px: float  # the part of that which neighbouring edges have in common: how far the outline is from an ellipse
    edge_px: float  # how blurred the edge is: the standard deviation of a normal distribution
    sigma_px: float  # standard deviation of the larger diameter that follows from the scatter alone


class Effort(NamedTuple):
    """Effort of a measurement."""

    max_lines: int  # across how many lines the light is read at most
    max_looks: int  # how often at most
    stays_px: float  # the ellipse has arrived once a look moves no part of it by more than this


ROUGHLY = Effort(max_lines=48, max_looks=4, stays_px=0.4)
THOROUGHLY = Effort(max_lines=144, max_looks=8, stays_px=0.01)


class _EllipseFit(NamedTuple):
    """An ellipse moved to the edges, by how much, and how well they lie on it."""

    ellipse: Ellipse
    moved_px: float
    left_px: Values
    on_ellipse: Flags
    scatter_px: float
    sigma_px: float


def measure_ellipse(
    picture: EdgePicture, start: Ellipse, *, is_bright: bool, reach_px: float, effort: Effort
) -> EllipseEdges | None:
    """Fit an ellipse to the outline of a disc; None where there is none near the start, which is without distortion.

    Args:
        reach_px: How far from the start the outline may be.
        effort: `ROUGHLY`, to tell what it is, or `THOROUGHLY`.
    """
    ellipse, widest_px, seen = start, 0.0, None
    # How far outwards the camera moves the edges of something bright.
    edge_bias_px = picture.lens.camera.edge_bias_px if picture.lens.camera else 0.0
    outwards_px = edge_bias_px if is_bright else -edge_bias_px
    lines = int(min(max(start.perimeter_px(), MIN_LINES), effort.max_lines))
    # Gauss-Newton, the light read anew after each step: the ellipse that stays is one whose edges are all half way,
    # wherever the search began. The first look takes the steepest place, since both ends of a line may be anywhere.
    for look in range(effort.max_looks):
        rim, smaller = ellipse.rim(lines), ellipse.axes()[1]
        reach = min(reach_px if look == 0 else _reach_px(widest_px, smaller), INNER_SHARE * smaller)
        steps = read_steps(picture, rim, reach, is_bright=is_bright, is_first=look == 0)
        off = steps.off_px + _drawn_in_px(rim, steps) - outwards_px
        fit = _move_ellipse(ellipse, rim, off, steps.is_edge, FIRST_FITS if look == 0 else NEXT_FITS)
        if fit is None or not _is_near(fit.ellipse, start, reach_px) or not _is_hopeful(fit, steps):
            return None
        ellipse, widest_px, seen = fit.ellipse, steps.widest_px, (fit, steps)
        has_arrived = look > 0 and fit.moved_px < effort.stays_px
        if has_arrived and _reach_px(widest_px, smaller) < NEARLY_REACHED * reach:
            break
    return None if seen is None else _describe(picture, *seen)


def _drawn_in_px(rim: Rim, steps: Steps) -> Values:
    """Return the distance inside the outline of the half way places, since the outline bends within the blur.

    Blurred by s along a curve of curvature k, half the light is at ``s (k s / 2 - (k s)³ / 6)`` inside of it, up to the
    fifth power of k s. Each edge shows the blur across itself, ``n' S n``; from all of them S follows by least squares,
    and so the blur along each, which is another one where the camera moves.
    """
    if not steps.edge_px > 0:
        return np.zeros(len(rim.curvature))
    (x, y), weights = rim.outward.T, steps.is_edge.astype(np.float64)
    # S is a symmetric 2x2 matrix in px²: three unknowns, one equation for each line.
    parts = np.array((x * x, 2 * x * y, y * y))
    weighted = parts * weights
    try:
        xx, xy, yy = np.linalg.solve(weighted @ parts.T, weighted @ steps.blur_px**2)
    except np.linalg.LinAlgError:
        return np.zeros(len(rim.curvature))
    along = np.sqrt(np.maximum(yy * x * x - 2 * xy * x * y + xx * y * y, 0.0))
    bend = np.minimum(rim.curvature * along, 1.0)
    return np.asarray(along * (bend / 2 - bend**3 / 6))


def _reach_px(edge_px: float, smaller_px: float) -> float:
    return min(max(MIN_REACH_PX, REACH_SIGMAS * edge_px + REACH_MORE_PX), max(MIN_REACH_PX, smaller_px / 2))


def _is_near(ellipse: Ellipse, start: Ellipse, reach_px: float) -> bool:
    """Check whether an ellipse is still about the one where it began."""
    if not np.isfinite(ellipse.half_axes_px).all():
        return False
    larger, smaller, _ = ellipse.axes()
    began, _, _ = start.axes()
    max_px = 2 * reach_px + 0.25 * began
    moved_px = float(np.abs(ellipse.centre_px - start.centre_px).max())
    return smaller > 1.0 and moved_px < max_px and abs(larger - began) < max_px


def _is_hopeful(fit: _EllipseFit, steps: Steps) -> bool:
    """Check whether enough edges are near the ellipse for more of them to be near it after the next look."""
    larger_px = 2 * fit.ellipse.axes()[0]
    if fit.scatter_px > HOPELESS_PX + HOPELESS_BLURS * steps.edge_px + HOPELESS_SHARE * larger_px:
        return False
    return int(np.count_nonzero(fit.on_ellipse)) >= MIN_HOPEFUL_SHARE * int(np.count_nonzero(steps.visible))


def _move_ellipse(ellipse: Ellipse, rim: Rim, off_px: Values, is_edge: Flags, fits: int) -> _EllipseFit | None:
    """Move an ellipse to the edges: a step of Gauss and Newton, with Tukey's weights against those that do not fit.

    A change of c by dc and of M by dM moves the place at t outwards by ``n · (dc + dM (cos t, sin t))``.
    """
    if np.count_nonzero(is_edge) < MIN_EDGES:
        return None
    (x, y), (cosine, sine) = rim.outward.T, rim.turns.T
    parts = np.array((x, y, x * cosine, y * sine, x * sine + y * cosine))
    # Begin from the middle of the edges, so that a start that is too large or too small all around counts as near.
    left = off_px - quantile(off_px[is_edge]) if fits == FIRST_FITS else off_px
    for _ in range(fits):
        band = max(MIN_BAND_PX, BAND_SCATTERS * MAD_SIGMAS * quantile(np.abs(left[is_edge])))
        weights = np.where(is_edge, np.maximum(1 - (left / band) ** 2, 0.0) ** 2, 0.0)
        weighted = parts * weights
        normal = weighted @ parts.T
        try:
            change = np.linalg.solve(normal, weighted @ off_px)
        except np.linalg.LinAlgError:
            return None
        left = off_px - change @ parts
    on_ellipse = is_edge & (np.abs(left) < band)
    if np.count_nonzero(on_ellipse) < MIN_EDGES:
        return None
    scatter_px = math.sqrt(float(weights @ left**2 / weights.sum()))
    dx, dy, dxx, dyy, dxy = change
    moved = Ellipse(
        centre_px=ellipse.centre_px + np.array((dx, dy)),
        half_axes_px=ellipse.half_axes_px + np.array(((dxx, dxy), (dxy, dyy))),
    )
    return _EllipseFit(
        ellipse=moved,
        moved_px=float(np.abs(change @ parts).max()),
        left_px=left,
        on_ellipse=on_ellipse,
        scatter_px=scatter_px,
        sigma_px=_sigma_px(normal, scatter_px, moved),
    )


def _sigma_px(normal: Values, scatter_px: float, ellipse: Ellipse) -> float:
    """Return the standard deviation of the larger diameter, if edges err each on its own."""
    x, y = ellipse.axes()[2]
    # Gradient of the larger half axis in (dx, dy, dxx, dyy, dxy), along its unit vector (x, y); its variance is g' N⁻¹
    # g times that of an edge, and the diameter's σ twice the root.
    along = np.array((0.0, 0.0, x * x, y * y, 2 * x * y))
    try:
        share = float(along @ np.linalg.solve(normal, along))
    except np.linalg.LinAlgError:
        return math.inf
    return 2 * scatter_px * math.sqrt(max(share, 0.0))


def _describe(picture: EdgePicture, fit: _EllipseFit, steps: Steps) -> EllipseEdges:
    seen = fit.on_ellipse
    contrast = steps.contrast[seen]
    usual = quantile(contrast)
    inside = quantile(steps.inside[seen])
    sign = 1.0 if inside > 0 else -1.0
    return EllipseEdges(
        ellipse=fit.ellipse,
        support=float(seen.sum()) / max(1, int(steps.visible.sum())),
        widest_gap=_widest_gap(seen),
        contrast=sign * usual,
        weakest=quantile(contrast, 0.1),
        inside=abs(inside),
        outside=abs(inside - usual),
        unevenness=_unevenness(picture, fit.ellipse, abs(inside)) / max(usual, MIN_LIGHT),
        scatter_px=fit.scatter_px,
        bend_px=_bend_px(fit.left_px, seen),
        edge_px=steps.edge_px,
        sigma_px=fit.sigma_px,
    )


def _widest_gap(seen: Flags) -> float:
    # Longest run without an edge, around the end of the array as well: the first place is appended one turn on.
    places = np.flatnonzero(seen)
    return float(np.diff(np.append(places, places[0] + len(seen))).max() - 1) / len(seen)


def _bend_px(left_px: Values, seen: Flags) -> float:
    """Return the edges' distance from the ellipse, less what each errs on its own, which is how neighbours differ."""
    # Noise of single edges averages out over a part of the outline, a bend does not: the variance of the means, less
    # the share of it that noise explains, is that of the bend. Differences of neighbours give the noise alone.
    together = max(1, len(seen) // BEND_PARTS)
    both = seen[:-1] & seen[1:]
    alone = float(np.mean((left_px[1:] - left_px[:-1])[both] ** 2)) / 2 if both.any() else 0.0
    count = len(seen) // together * together
    left, weight = (np.where(seen, each, 0.0)[:count].reshape(-1, together) for each in (left_px, seen))
    counts = weight.sum(axis=1)
    means = left.sum(axis=1)[counts > 0] / counts[counts > 0]
    return math.sqrt(max(0.0, float(np.mean(means**2)) - alone / together))


def _unevenness(picture: EdgePicture, ellipse: Ellipse, rim_light: float) -> float:
    """Return the difference of light inside an ellipse from that along its rim, but for the part that differs most."""
    light, is_inside = picture.read(INSIDE @ ellipse.half_axes_px + ellipse.centre_px)
    return quantile(np.abs(light[is_inside] - rim_light), EVEN_SHARE) if is_inside.any() else 0.0


class Trouble(NamedTuple):
    """The reason why an outline is not that of a disc."""

    passed: int  # how many tests it passed before
    text: str  # the test that it failed, with the figure and the limit


def find_trouble(edges: EllipseEdges, min_px: float, light: Light) -> Trouble | None:
    """Return the first test of a disc that an outline failed; None if it is a disc, as far as a picture tells."""
    # Cheap and telling tests first; each text has the figure and its limit, for the user.
    larger, smaller = diameters_px(edges)
    flattest = math.cos(MAX_TILT_RAD)
    weakest = levels_out(edges, light) * edges.weakest / max(abs(edges.contrast), 1e-9)
    scatter_px, bend_px = max_scatter_px(edges), BEND_PX + BEND_SHARE * larger
    tests = (
        (edges.support >= MIN_SUPPORT, f"has an edge on {edges.support:.0%} of its outline, limit {MIN_SUPPORT:.0%}"),
        (
            edges.scatter_px <= scatter_px,
            f"is no ellipse: its edge scatters by {edges.scatter_px:.2f} px, limit {scatter_px:.2f} px",
        ),
        (
            edges.bend_px <= bend_px,
            f"is no ellipse: its outline differs from one by {edges.bend_px:.2f} px, limit {bend_px:.2f} px",
        ),
        (edges.widest_gap <= MAX_GAP, f"lacks {edges.widest_gap:.0%} of its outline in one piece, limit {MAX_GAP:.0%}"),
        (smaller >= flattest * larger, f"is {smaller / larger:.2f} times as high as wide, limit {flattest:.2f}"),
        (weakest >= MIN_CONTRAST, f"stands out by {weakest:.0f} levels, limit {MIN_CONTRAST:.0f}"),
        (
            edges.edge_px <= MAX_BLUR_SHARE * smaller,
            f"has an edge blurred over {edges.edge_px:.1f} px, limit {MAX_BLUR_SHARE * smaller:.1f} px",
        ),
        (
            edges.unevenness <= MAX_UNEVENNESS,
            f"is unevenly bright: by {edges.unevenness:.0%} of its contrast, limit {MAX_UNEVENNESS:.0%}",
        ),
        (smaller >= MIN_HEIGHT * min_px, f"is too thin: {smaller:.1f} px, limit {MIN_HEIGHT * min_px:.1f} px"),
        (larger >= min_px, f"is too small: {larger:.1f} px, limit {min_px:g} px"),
    )
    return next((Trouble(number, text) for number, (passed, text) in enumerate(tests) if not passed), None)


def max_scatter_px(edges: EllipseEdges) -> float:
    """Return by how much the edges of a disc may scatter about its ellipse."""
    return SCATTER_PX + SCATTER_BLURS * edges.edge_px + SCATTER_SHARE * diameters_px(edges)[0]


def diameters_px(edges: EllipseEdges) -> tuple[float, float]:
    """Return the larger and the smaller diameter."""
    larger, smaller, _ = edges.ellipse.axes()
    return 2 * larger, 2 * smaller


def levels_out(edges: EllipseEdges, light: Light) -> float:
    """Return by how many levels of 8 bits a disc stands out: what is seen of it goes with these, not with the light."""
    # The inverse of the tone curve: light back to code values of 0 to 255.
    inside, outside = np.interp((edges.inside, edges.outside), light, np.arange(CODES))
    return abs(float(inside - outside))


def quality(edges: EllipseEdges) -> float:
    """Return the likeness of an outline to that of a disc: from 0 to 1."""
    return edges.support * (1 - edges.unevenness / MAX_UNEVENNESS) * (1 - edges.scatter_px / max_scatter_px(edges) / 2)


def evidence(edges: EllipseEdges, light: Light) -> float:
    """Return the evidence that an outline gives for the disc among others that are elliptical.

    That is contrast, since a disc is put up to be seen, times the square of how round it appears, since who measures a
    disc turns it about towards the camera, over how far it is from an ellipse: the closer, the rarer by chance.
    """
    larger, smaller = diameters_px(edges)
    return levels_out(edges, light) * (smaller / larger) ** 2 * edges.support / (edges.bend_px + EXACT_PX)
