"""The shapes of flat targets, disc, sheet and tag, and where one is: from its pose, or else by one length."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import cv2
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, Points, Reading, Values
from stadimeter.ranging.plane_pose import (
    COORDINATES,
    RectanglePose,
    ambiguity,
    distance_share,
    doubt_share,
    nearest_pose,
    plane_poses,
    rectangle,
    rectangle_poses,
)
from stadimeter.ranging.similar_triangles import read_by_one_length, size_noise_share

# The place of a circle of known size, from the ellipse that it is seen as ---------------------------------------------
#
# The rays to the rim of a circle form an elliptical cone ``d' Q d = 0``. A circle of that size cuts out of the cone
# in two ways, mirrored about the cone's axis (R. Safaee-Rad et al., "Three-dimensional location estimation of
# circular features for machine vision", IEEE Transactions on Robotics and Automation 8, 1992; Q. Chen, H. Wu and T.
# Wada, "Camera calibration with two arbitrary coplanar circles", ECCV 2004).
#
# With λ₁ ≥ λ₂ > 0 > λ₃ the eigenvalues of Q, and x and z along the eigenvectors of λ₁ and λ₃, the plane's normal is
# ``(± sqrt((λ₁ - λ₂) / (λ₁ - λ₃)), 0, sqrt((λ₂ - λ₃) / (λ₁ - λ₃)))``, and the centre of a circle of radius r is at
# ``Q⁻¹ n`` times ``-r sqrt(-λ₁ λ₃)``: the centre of the ellipse is not the picture of the circle's centre. Being
# mirrored about the cone's axis, both poses have the same distance and are turned away from their line of sight by
# the same angle. Written with the tangents a ≥ b of the cone's half angles, the distance is ``r sqrt(1 + (1 - b²) /
# a²)``: from far away the larger one alone determines it.

# An ellipse has five unknowns.
MIN_POINTS = 5


class CirclePose(Struct, frozen=True, kw_only=True, eq=False):
    """A pose of a circle, in the camera frame: x right, y down, z forward."""

    position_m: Points  # its centre, shape ``(3,)``
    normal: Points  # the unit vector at right angles to its plane, towards the camera, shape ``(3,)``

    @property
    def distance_m(self) -> float:
        """Length of the straight line from the camera to the centre."""
        return float(np.linalg.norm(self.position_m))

    @property
    def tilt_rad(self) -> float:
        """Angle between the normal and the line of sight: 0 for face on."""
        return math.acos(min(1.0, -float(self.normal @ self.position_m) / self.distance_m))


class CirclePoses(Struct, frozen=True, kw_only=True, eq=False):
    """Both poses that an outline allows."""

    poses: tuple[CirclePose, CirclePose]  # they explain the outline equally well
    axis: Points  # the axis of the cone, half way between their lines of sight, as a unit vector of shape ``(3,)``

    @property
    def distance_m(self) -> float:
        """The distance of the centre, the same in both poses."""
        return self.poses[0].distance_m

    @property
    def tilt_rad(self) -> float:
        """The angle between normal and line of sight, the same in both poses."""
        return self.poses[0].tilt_rad


def cone_through(directions: Points) -> Values | None:
    """Return Q of the elliptical cone ``d' Q d = 0`` through rays, by linear least squares, positive outside.

    None if they are on no such cone. The rays are x and y per unit of depth, ``(n, 2)``, and should lie all around it.
    """
    if len(directions) < MIN_POINTS or not np.isfinite(directions).all():
        return None
    # Centred and of unit size: the five unknowns are of one magnitude, and the normal equations well conditioned.
    middle = directions.mean(axis=0)
    size = math.sqrt(float(np.mean((directions - middle) ** 2)))
    if not size > 0:
        return None
    # a x² + b x y + c y² + d x + e y = 1 for all rays: five unknowns, and the algebraic distance is close to the
    # geometric one for points all around the outline.
    x, y = ((directions - middle) / size).T
    rows = np.column_stack((x * x, x * y, y * y, x, y))
    try:
        a, b, c, d, e = np.linalg.solve(rows.T @ rows, rows.sum(axis=0))
    except np.linalg.LinAlgError:
        return None
    # The constant term is fixed at -1, so the centre is inside; of all conics only an ellipse has b² < 4 a c.
    if not (a > 0 and 4 * a * c > b * b):
        return None
    # Back from the centred coordinates: with d = T d₀ the cone d₀' Q d₀ = 0 becomes d' (T' Q T) d = 0.
    conic = np.array(((a, b / 2, d / 2), (b / 2, c, e / 2), (d / 2, e / 2, -1.0)))
    to_unit = np.array(((1 / size, 0.0, -middle[0] / size), (0.0, 1 / size, -middle[1] / size), (0.0, 0.0, 1.0)))
    return np.asarray(to_unit.T @ conic @ to_unit)


def circle_poses(cone: Values, diameter_m: float) -> CirclePoses | None:
    """Return the two poses of a circle in front of the camera that is seen on a cone; None if that is not elliptic."""
    # Eigenvalues come in rising order, λ₃ < λ₂ ≤ λ₁. The axis of the cone belongs to λ₃, the only one below zero.
    (third, second, first), axes = np.linalg.eigh(cone)
    if not third < 0 < second:
        return None
    # An eigenvector may point either way; the circle is before the camera.
    forward = axes[:, 0] if axes[2, 0] > 0 else -axes[:, 0]
    sideways = axes[:, 2]
    # Parts of the unit normal along the cone's axis and across it, towards the eigenvector of λ₁.
    along, across = math.sqrt((second - third) / (first - third)), math.sqrt((first - second) / (first - third))
    radius_m, steep = diameter_m / 2, math.sqrt(-first / third)
    # Mirrored about the axis: the part along it is the same, the part along λ₁'s eigenvector changes its sign.
    one, other = (
        CirclePose(
            position_m=radius_m * (steep * along * forward + sign / steep * across * sideways),
            normal=sign * across * sideways - along * forward,
        )
        for sign in (1, -1)
    )
    return CirclePoses(poses=(one, other), axis=forward)


KnownSide = Literal["auto", "width", "height"]

# The ambiguity of every disc: its outline fits two mirrored poses equally well.
NO_IDEA = 1.0

# Poses are ordered by how likely they are; of two that are so to rounding, the one as the sheet hangs comes first.
CLOSER = 1e-9

# How a sheet hangs is decided before its pose is refined, where the other way is this many times as far off.
CONTENDER = 10.0

# Standard deviation of the tilt of sheets: mostly they face the camera. Chosen on rendered cards cut by hand, of which
# without it one in five was taken to hang the other way, turned away by 50 to 60 degrees.
_USUAL_TILT_RAD = math.radians(25)

# Of sheets with a named side, the share whose other side is not as stated; and the most by which the distances of both
# sides may differ, as a logarithm, for a turn to explain it: one of 42 degrees.
_NOT_AS_STATED, _MAX_LOG_NEARER = 0.3, 0.3

# How much less likely a sheet hangs the other way than its sides are stated, as a logarithm: one of five does.
_OTHER_WAY = 1.5

# The detectors' standard deviation on rendered pictures: a floor, and for tags a part inverse to the apparent side.
_SIGMA_FLOOR_PX = 0.015
_SIGMA_OF_SMALL_TAG_PX2 = 1.35


# Standard deviation of the place of a sheet's edges that all four have in common and that stays from frame to frame,
# from sharpening, glare and tone curves that are not quite those assumed; and where colour is subsampled, which smears
# it across the edges. Fitted on rendered pictures of such cameras.
_EDGE_BIAS_PX = 0.03
_EDGE_BIAS_OF_CHROMA_PX = 0.05


# What hands and rough edges add to the corners of a sheet, in pixels and as a share of its size, besides this multiple
# of its tolerance, while its pose is chosen. Without it 19 of 143 rendered A4 sheets cut so were off by more than
# 10 %, most of them taken to hang the other way; with it 6.
_ROUGH_PX, _ROUGH_SHARE, _TOLERANCE_FACTOR = 0.3, 0.003, 0.4

# The share of sheets that are exact rectangles. Of 308 rendered sheets and cards, sharp and cut by hand, 0.1 to 0.3 are
# off as often as with none, and 0.5 more often; below 0.2, exact corners that face away are taken the wrong way round.
_EXACT_SHARE = 0.2


# By how much aligning a picture's light errs beyond its residuals, the same in frames that are alike: as a share of
# the size, and in pixels. Chosen so that intervals hold on rendered posters of 60, 120 and 300 px: without it 90, 69
# and 64 %.
_ALIGNMENT_SHARE, _ALIGNMENT_PX = 0.0008, 0.1


class FlatShape:
    """Base of flat shapes. Their outline is their rim, however they are turned."""

    __slots__ = ()

    @property
    def longest_m(self) -> float:
        """The longest length that is known of it."""
        raise NotImplementedError

    @property
    def shortest_m(self) -> float:
        """The same, of a shape with one known length."""
        return self.longest_m

    @property
    def limb_radius_m(self) -> float:
        """None: the outline is the rim."""
        return 0.0

    @property
    def has_corners(self) -> bool:
        """Yes, four, unless the shape is round."""
        return True

    def size_sigma_px(self, size_px: float) -> float:  # noqa: ARG002 - the same for all sizes
        """Return the standard deviation of the apparent size in a good picture."""
        return _SIGMA_FLOOR_PX


class RectangleShape(FlatShape):
    """Base of rectangles with two sides, in metres."""

    __slots__ = ()

    width_m: float
    height_m: float

    @property
    def longest_m(self) -> float:
        """The longer side."""
        return max(self.width_m, self.height_m)

    @property
    def shortest_m(self) -> float:
        """The shorter side."""
        return min(self.width_m, self.height_m)


class DiscShape(FlatShape, Struct, frozen=True, kw_only=True):
    """A flat circle, such as a sticker, a lid or a printed dot."""

    diameter_m: float
    relative_sigma: float = 0.0  # standard deviation of the diameter, as a share: how well it is known

    @property
    def label(self) -> str:
        """Kind and diameter."""
        return f"disc of {self.diameter_m:g} m"

    @property
    def longest_m(self) -> float:
        """The diameter."""
        return self.diameter_m

    @property
    def has_corners(self) -> bool:
        """No: its outline is points on its rim."""
        return False

    def locate(self, detection: Detection, camera: CameraModel) -> Reading:
        """Return where the centre is, from the ellipse that the disc is seen as; by its larger diameter without points.

        Distance and tilt are exact at any tilt: they are the same in both poses of `stadimeter.ranging.flat`, so
        not knowing which of them it is adds nothing to the uncertainty of the distance. The position is put half way
        between them, on the axis of the cone; their lines of sight are at most some degrees apart, near by and tilted,
        and much less from afar.
        """
        apparent = max(detection.width_px / camera.fx_px, detection.height_px / camera.fy_px)
        found = self.poses(detection, camera)
        if found is None:
            return read_by_one_length(detection, camera, self.diameter_m, apparent)
        x_m, y_m, z_m = (float(each) * found.distance_m for each in found.axis)
        return Reading(
            position_m=(x_m, y_m, z_m),
            noise_share=size_noise_share(detection, camera, apparent),
            tilt_rad=found.tilt_rad,
            ambiguity=NO_IDEA,
        )

    def poses(self, detection: Detection, camera: CameraModel) -> CirclePoses | None:
        """Return both poses that its outline allows; None if that is no ellipse, or there are no points of it."""
        # Directions: x and y per unit of depth, distortion undone.
        cone = cone_through(camera.directions(detection.outline_px))
        return None if cone is None else circle_poses(cone, self.diameter_m)


class SheetShape(RectangleShape, Struct, frozen=True, kw_only=True):
    """A flat rectangle, such as a sheet of paper."""

    width_m: float  # its horizontal side as it hangs
    height_m: float  # its vertical side as it hangs
    # Which side the distance is computed from, as if it were square to the line of sight: the other one may be
    # unknown, or curled. ``auto`` takes all four corners.
    known_side: KnownSide = "auto"
    relative_sigma: float = 0.0  # standard deviation of the sides, as a share: how well they are known

    @property
    def label(self) -> str:
        """Kind and sides."""
        return f"sheet of {self.width_m:g} x {self.height_m:g} m"

    def locate(self, detection: Detection, camera: CameraModel) -> Reading:
        """Return where the centre is. Four corners tell how a sheet is turned, so its distance is right at any tilt.

        It may hang upright or across; both are tried, and the likelier one is taken: that which explains the corners
        better, and is turned away less, since small or roughly cut sheets look nearly the same either way. How probable
        the others are counts in the systematic share.
        """
        # Without four corners one side gives the distance, as if it were square to the line of sight.
        size_m, apparent = self._one_side(detection.width_px / camera.fx_px, detection.height_px / camera.fy_px)
        # A side is the difference of two corners, so each of these errs by its share of the square root of two.
        corner_sigma = detection.size_sigma_px / math.sqrt(2 * camera.fx_px * camera.fy_px)
        # How many times nearer it is by the other side, where one is named: that is longer than stated, or the named
        # one is turned away. What a turn explains is corrected, and else the distance is unsure by so much.
        nearer = detection.width_px * detection.height_px / (camera.fx_px * camera.fy_px)
        nearer = (
            1.0 if self.known_side == "auto" else nearer * (size_m / apparent) ** 2 / (self.width_m * self.height_m)
        )
        has_pose = len(detection.outline_px) == 4 and abs(math.log(nearer)) < _MAX_LOG_NEARER
        hung = self._poses(detection, camera, corner_sigma) if has_pose else []
        bias_share = _edge_bias_share(detection, camera)
        if not hung:
            doubt = math.hypot(bias_share, max(nearer - 1, 0.0))
            return replace(read_by_one_length(detection, camera, size_m, apparent), systematic_share=doubt)
        best = hung[0]
        corners_m = rectangle(best.width_m, best.height_m)
        noise_share = distance_share(best.pose, corners_m, corner_sigma)
        if not math.isfinite(noise_share):
            noise_share = size_noise_share(detection, camera, apparent)
        every = tuple([each.pose for each in hung])
        turned = 0.0 if self.known_side == "auto" else best.pose.position_m[2] * apparent / size_m - 1
        doubt = math.hypot(_doubt_share(hung), bias_share, math.sqrt(_NOT_AS_STATED) * turned)
        return _of_pose(every, doubt, noise_share)

    def _poses(self, detection: Detection, camera: CameraModel, corner_sigma: float) -> list[HungSheet]:
        """Return the poses that it may have, knowing that hands cut no exact rectangle."""
        share = math.hypot(_ROUGH_SHARE, _TOLERANCE_FACTOR * self.relative_sigma)
        rough_px = math.hypot(_ROUGH_PX, share * max(detection.width_px, detection.height_px))
        rough_sigma = math.hypot(corner_sigma, rough_px / math.sqrt(camera.fx_px * camera.fy_px))
        return sheet_poses(camera.directions(detection.outline_px), self, corner_sigma, rough_sigma)

    def _one_side(self, width: float, height: float) -> tuple[float, float]:
        """Return the side that the distance is computed from, in metres and as it appears per unit of depth.

        With ``auto`` that is the one that gives the nearer distance: turning a sheet away from the camera can only
        shorten a side. The longer side in the picture is taken for the longer side of the sheet, however it hangs. Once
        it is turned so far that its longer side appears as the shorter one (40 degrees for letter paper), that is
        wrong; naming the side then helps.
        """
        if self.known_side == "width":
            return self.width_m, width
        if self.known_side == "height":
            return self.height_m, height
        sides = (self.longest_m, max(width, height)), (self.shortest_m, min(width, height))
        return max(sides, key=lambda side: side[1] / side[0])


def _edge_bias_share(detection: Detection, camera: CameraModel) -> float:
    """Return the standard deviation of the distance because all sides of a sheet appear too far out, or in, alike."""
    pitch_px = max(camera.chroma_pitch_px)
    bias_px = _EDGE_BIAS_PX if pitch_px == 1 else _EDGE_BIAS_OF_CHROMA_PX
    return 2 * bias_px / math.sqrt(detection.width_px * detection.height_px)


class HungSheet(NamedTuple):
    """A pose that a sheet may have."""

    pose: RectanglePose
    width_m: float  # its side across the picture
    height_m: float
    unlikely: float  # the negative logarithm of its probability, but for a constant


def sheet_poses(directions: Points, size: SheetShape, corner_sigma: float, rough_sigma: float) -> list[HungSheet]:
    """Return the poses that a sheet may have, with its width across the picture or down it, the likeliest first.

    None where the corners are not those of a rectangle in front of the camera. ``directions`` are where its corners
    appear, x and y per unit of depth with the lens's distortion undone, clockwise in the picture, shape ``(4, 2)``;
    ``corner_sigma`` is their standard deviation for an exact rectangle, ``rough_sigma`` for one that was cut by hand.
    """
    seen = directions.tolist()
    ways = []
    both = (size.width_m, size.height_m), (size.height_m, size.width_m)
    for width_m, height_m in dict.fromkeys(both if size.known_side == "auto" else both[:1]):
        poses = rectangle_poses(width_m / 2, height_m / 2, seen)
        if poses:
            ways.append((poses, width_m, height_m))
    ways.sort(key=lambda way: way[0][0].misfit)
    found, contender, as_it_hangs = [], math.inf, size.width_m
    for poses, width_m, height_m in ways:
        if poses[0].misfit <= contender:
            poses[0] = nearest_pose(poses[0], rectangle(width_m, height_m).tolist(), seen)
        contender = min(contender, CONTENDER * max(poses[0].misfit, rough_sigma, CLOSER))
        other_way = _OTHER_WAY * (width_m != as_it_hangs)
        found += [
            HungSheet(pose, width_m, height_m, _unlikely(pose, corner_sigma, rough_sigma) + other_way) for pose in poses
        ]
    # Of what is equal but for rounding, the one as the sheet hangs comes first.
    found.sort(key=lambda each: (round(each.unlikely / CLOSER), each.width_m != as_it_hangs))
    return found


def _unlikely(pose: RectanglePose, corner_sigma: float, rough_sigma: float) -> float:
    """Return the negative logarithm of a pose's probability: corners err normally, tilts are spread about facing.

    Corners err as much as was measured where a sheet is an exact rectangle, and more where it was cut by hand: a
    mixture of both, so that a pose that explains the corners as exactly as they were measured is not given up for one
    that faces the camera more.
    """
    # Bayes' rule: chi-square of the coordinates, and of a tilt with a standard deviation of 25 degrees about facing.
    # Eight coordinates less the six of a pose leave a normal density in two dimensions: 1 / σ² exp(-Σ / 2 σ²).
    square = COORDINATES * pose.misfit**2 / 2
    variances = max(corner_sigma, CLOSER) ** 2, max(rough_sigma, CLOSER) ** 2
    exact, rough = (-square / variance - math.log(variance) for variance in variances)
    most = max(exact, rough)
    likely = most + math.log(_EXACT_SHARE * math.exp(exact - most) + (1 - _EXACT_SHARE) * math.exp(rough - most))
    return (pose.tilt_rad / _USUAL_TILT_RAD) ** 2 / 2 - likely


def _doubt_share(hung: Sequence[HungSheet]) -> float:
    """Return the standard deviation of the distance, as a share, because another pose than the first may be true."""
    best_m, least = hung[0].pose.distance_m, hung[0].unlikely
    share = 0.0
    for other in hung[1:]:
        # p of the other pose, from the difference of the negative log-probabilities. The first one is taken, so with
        # the probability p the distance is off by their difference: a root mean square of √p times that.
        probability = 1 / (1 + math.exp(min(other.unlikely - least, 700.0)))
        share += math.sqrt(probability) * abs(other.pose.distance_m / best_m - 1)
    return share


class TagShape(FlatShape, Struct, frozen=True, kw_only=True):
    """A square fiducial, such as an ArUco marker or an AprilTag."""

    side_m: float  # the side of its black square, without the white around it
    relative_sigma: float = 0.0  # standard deviation of the side, as a share: how well it is known

    @property
    def label(self) -> str:
        """Kind and side."""
        return f"tag of {self.side_m:g} m"

    @property
    def longest_m(self) -> float:
        """The side."""
        return self.side_m

    def size_sigma_px(self, size_px: float) -> float:
        """Return the standard deviation of the apparent side in a good picture."""
        return math.hypot(_SIGMA_FLOOR_PX, _SIGMA_OF_SMALL_TAG_PX2 / size_px)

    def locate(self, detection: Detection, camera: CameraModel) -> Reading:
        """Return where the centre is: see `_locate_upright`."""
        return _locate_upright(detection, camera, self.side_m, self.side_m)


class PictureShape(RectangleShape, Struct, frozen=True, kw_only=True):
    """A flat picture, such as a poster or a book cover, whose corners are known by what is on it."""

    width_m: float
    height_m: float
    relative_sigma: float = 0.0  # standard deviation of its sides, as a share: how well its size is known

    @property
    def label(self) -> str:
        """Kind and sides."""
        return f"picture of {self.width_m:g} x {self.height_m:g} m"

    def locate(self, detection: Detection, camera: CameraModel) -> Reading:
        """Return where the centre is: see `_locate_upright`."""
        reading = _locate_upright(detection, camera, self.width_m, self.height_m)
        off_share = _ALIGNMENT_PX / ((detection.width_px + detection.height_px) / 2)
        systematic_share = math.hypot(reading.systematic_share, _ALIGNMENT_SHARE, off_share)
        return replace(reading, systematic_share=systematic_share)


def _locate_upright(detection: Detection, camera: CameraModel, width_m: float, height_m: float) -> Reading:
    """Return where a rectangle is whose corners come in its own order, its top left one first.

    Seen from far, it has two poses that explain its corners nearly equally well, mirrored about the line of sight.
    Their distances and directions hardly differ; how much they do counts in the systematic share, the more so the less
    is known which of them it is.
    """
    # The mean of the sides, not the longest: turned, it is measured less well.
    apparent = (detection.width_px / camera.fx_px + detection.height_px / camera.fy_px) / 2
    has_pose = len(detection.outline_px) == 4
    poses = upright_poses(camera.directions(detection.outline_px), width_m, height_m) if has_pose else ()
    if not poses:
        return read_by_one_length(detection, camera, (width_m + height_m) / 2, apparent)
    noise_share = size_noise_share(detection, camera, apparent)
    return _of_pose(poses, doubt_share(poses, noise_share * apparent / math.sqrt(2)), noise_share)


def upright_poses(directions: Points, width_m: float, height_m: float) -> tuple[RectanglePose, ...]:
    """Return the two poses that such a rectangle may have, the one that explains its corners best first.

    They are fewer where the corners are not those of one in front of the camera. ``directions`` are where its corners
    appear, x and y per unit of depth with the lens's distortion undone, clockwise from its own top left one.
    """
    return plane_poses(rectangle(width_m, height_m), directions)


def _of_pose(poses: tuple[RectanglePose, ...], doubt: float, noise_share: float) -> Reading:
    """Return the reading of the best of some poses; the doubt which of them is true counts as systematic."""
    best = poses[0]
    return Reading(
        position_m=best.position_m,
        noise_share=noise_share,
        systematic_share=doubt,
        tilt_rad=best.tilt_rad,
        ambiguity=ambiguity(poses[:2]),
    )


# The shape of an upright thing of which one length is known, such as a person, and where one is by that length --------
#
# A network tells where a thing is by a box, whose sides err by some percent, and things of a kind differ: adults by
# 4 % in height. Both are in the standard deviation, and by one picture no more can be known.

KnownLength = Literal["height", "width", "eye_distance"]


class UprightShape(FlatShape, Struct, frozen=True, kw_only=True):
    """Something upright, whose outline is a box around it in one plane.

    Attributes:
        known: Which of its lengths is known.
        length_m: That length.
        relative_sigma: Standard deviation of the length among things of this kind, as a share of it.
        box_sigma: Standard deviation of that length in the picture, as a network finds it, of what is seen large: as a
            share of it. Half of that variance stays with a thing, its hair, shoes and posture, and half comes anew.
    """

    known: KnownLength
    length_m: float
    relative_sigma: float = 0.0
    box_sigma: float = 0.0

    @property
    def label(self) -> str:
        """A description of what is known of it."""
        article = "an" if self.known == "eye_distance" else "a"
        return f"thing with {article} {self.known.replace('_', ' ')} of {self.length_m:g} m"

    @property
    def longest_m(self) -> float:
        """The known length."""
        return self.length_m

    def size_sigma_px(self, size_px: float) -> float:
        """Return the standard deviation of the known length in the picture."""
        return self.box_sigma * size_px

    def locate(self, detection: Detection, camera: CameraModel) -> Reading:
        """Return where its centre is.

        A height is measured as that of something upright before a level camera: similar triangles are exact for this,
        wherever in the picture it is. Turned up or down by 15 degrees, the camera sees it 3 % too short. A width is
        taken to be square to the optical axis, and eyes to look at the camera.
        """
        x_px, y_px = detection.centre_px
        half = np.array((0.0, detection.height_px / 2) if self.known == "height" else (detection.width_px / 2, 0.0))
        # Both ends of the length, so that the lens's distortion is undone at each.
        ends = camera.directions(np.array(detection.centre_px) + np.stack((-half, half)))
        lasting_share = self.box_sigma / math.sqrt(2)
        if self.known != "eye_distance":
            reading = read_by_one_length(detection, camera, self.length_m, float(np.hypot(*(ends[1] - ends[0]))))
            return replace(reading, systematic_share=lasting_share)
        rays = np.column_stack((ends, np.ones(2)))
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        # Two eyes L apart, square to the line of sight, appear under the angle γ: D = L / 2 / tan(γ / 2).
        half_tangent = float(np.linalg.norm(rays[1] - rays[0]) / np.linalg.norm(rays[1] + rays[0]))
        distance_m = self.length_m / 2 / half_tangent
        x, y = camera.direction(x_px, y_px)
        per_depth_m = distance_m / math.sqrt(1 + x * x + y * y)
        return Reading(
            position_m=(x * per_depth_m, y * per_depth_m, per_depth_m),
            noise_share=detection.size_sigma_px / detection.width_px,
            systematic_share=lasting_share,
        )


# Three equal discs at the corners of an equilateral triangle, and where that is from the ellipses they are seen as ----
#
# Blur, glare and sharpening make every disc seem larger or smaller, but leave its centre where it is. So the size
# that counts is the triangle's, which is known; the discs' common diameter is fitted beside the pose. Three centres
# alone allow several poses: the shapes and the relative sizes of the ellipses tell which one it is.
#
# The triangle is the same whichever disc is called the first, so their order is not asked for.

# Corners of the triangle about its centre, as shares of its side: the circumscribed circle has the radius 1 / √3.
_ANGLES = np.arange(3) * 2 * math.pi / 3
CORNERS = np.column_stack((np.cos(_ANGLES), np.sin(_ANGLES))) / math.sqrt(3)

# Gauss-Newton steps at most, and the step, as a share, that no longer matters; differences for derivatives.
MAX_STEPS = 12
SETTLED = 1e-8
DIFFERENCE = 1e-6

# The detector's standard deviation of the side, on sharp rendered pictures.
_CIRCLES_SIGMA_FLOOR_PX = 0.005


class CirclesShape(FlatShape, Struct, frozen=True, kw_only=True):
    """Three equal discs whose centres are equally far apart."""

    diameter_m: float
    spacing_m: float  # from centre to centre
    relative_sigma: float = 0.0  # standard deviation of the spacing, as a share: how well it is known

    @property
    def label(self) -> str:
        """Kind, spacing and diameter."""
        return f"three circles of {self.diameter_m:g} m, {self.spacing_m:g} m apart"

    @property
    def longest_m(self) -> float:
        """The spacing, which is what is measured."""
        return self.spacing_m

    @property
    def shortest_m(self) -> float:
        """The diameter: each disc must be large enough to be found."""
        return self.diameter_m

    @property
    def has_corners(self) -> bool:
        """No: its outline is points on three rims."""
        return False

    def size_sigma_px(self, size_px: float) -> float:  # noqa: ARG002 - the same for all sizes
        """Return the standard deviation of the apparent diameter that stands for that of the spacing."""
        return _CIRCLES_SIGMA_FLOOR_PX * self.diameter_m / self.spacing_m

    def locate(self, detection: Detection, camera: CameraModel) -> Reading:
        """Return where the triangle's centre is; by its apparent side where there are no three ellipses."""
        apparent = max(detection.width_px / camera.fx_px, detection.height_px / camera.fy_px)
        count = len(detection.outline_px)
        rims = camera.directions(detection.outline_px).reshape(3, -1, 2) if count and count % 3 == 0 else None
        fitted = None if rims is None else _fit(rims, self.diameter_m / 2, self.spacing_m)
        if fitted is None:
            return read_by_one_length(detection, camera, self.spacing_m, apparent)
        # The side errs by √2 times what a coordinate of a centre does. A centre is as exact as the mean of n points
        # that err by √(n / 2) times as much each, and so is the fit through n points on each rim.
        point_sigma = detection.size_sigma_px / math.sqrt(2 * camera.fx_px * camera.fy_px) * math.sqrt(count / 6)
        x_m, y_m, z_m = fitted.centre_m.tolist()
        return Reading(
            position_m=(x_m, y_m, z_m),
            noise_share=point_sigma * fitted.share_of_noise,
            tilt_rad=fitted.tilt_rad,
            ambiguity=fitted.ambiguity,
        )


class _Pose(NamedTuple):
    turn: Values  # columns are the plane's axes in the camera frame, the normal last
    centre_m: Values
    radius_m: float

    def moved(self, step: Values) -> _Pose:
        """Return the pose turned about the camera's axes and shifted, lengths as shares of the distance."""
        turn = np.asarray(cv2.Rodrigues(step[:3])[0], np.float64) @ self.turn
        centre_m = self.centre_m + step[3:6] * float(np.linalg.norm(self.centre_m))
        return _Pose(turn, centre_m, self.radius_m * math.exp(float(step[6])))

    def mirrored(self) -> _Pose:
        """Return the pose turned as much towards the other side, which from afar looks nearly the same."""
        sight = self.centre_m / np.linalg.norm(self.centre_m)
        flip = np.eye(3) - 2 * np.outer(sight, sight)
        turn = flip @ self.turn
        return self._replace(turn=np.column_stack((turn[:, :2], -turn[:, 2])))

    def off(self, rims: Points, spacing_m: float) -> Values:
        """Measure how far rays, ``(3, n, 3)``, are outside of the ellipses as this pose has them, per unit of depth."""
        # A point X, Y of the plane is seen at H (X, Y, 1); a circle C of the plane as the conic H⁻ᵀ C H⁻¹.
        back = np.linalg.inv(np.column_stack((self.turn[:, :2], self.centre_m)))
        on_plane = rims @ back.T
        circles = np.zeros((3, 3, 3))
        corners_m = CORNERS * spacing_m
        circles[:, 0, 0] = circles[:, 1, 1] = 1.0
        circles[:, :2, 2] = circles[:, 2, :2] = -corners_m
        circles[:, 2, 2] = (corners_m**2).sum(axis=1) - self.radius_m**2
        polar = on_plane @ circles
        # The distance from a conic to first order (P. Sampson, 1982): its value over its gradient in the picture.
        gradient = 2 * polar @ back
        steepness = np.hypot(gradient[..., 0], gradient[..., 1])
        return np.asarray(((polar * on_plane).sum(axis=2) / np.maximum(steepness, 1e-300)).ravel())


class _Fitted(NamedTuple):
    centre_m: Values
    tilt_rad: float
    share_of_noise: float  # standard deviation of the distance, as a share, where each point errs by 1
    ambiguity: float


def _fit(directions: Points, radius_m: float, spacing_m: float) -> _Fitted | None:
    """Return the pose by least squares over all three rims, x and y per unit of depth, shape ``(3, n, 2)``."""
    rims = np.concatenate((directions, np.ones((*directions.shape[:2], 1))), axis=2)
    pose = _start(directions, radius_m)
    if pose is None:
        return None
    try:
        for _ in range(MAX_STEPS):
            off = pose.off(rims, spacing_m)
            slopes = [(pose.moved(d).off(rims, spacing_m) - off) / DIFFERENCE for d in np.eye(7) * DIFFERENCE]
            jacobian = np.stack(slopes, axis=1)
            covariance = np.linalg.inv(jacobian.T @ jacobian)
            step = -covariance @ (jacobian.T @ off)
            pose = pose.moved(step)
            if np.abs(step).max() < SETTLED:
                break
    except np.linalg.LinAlgError:
        return None
    if not (np.isfinite(pose.centre_m).all() and pose.centre_m[2] > 0):
        return None
    sight = pose.centre_m / np.linalg.norm(pose.centre_m)
    misfit, other = (float(np.linalg.norm(each.off(rims, spacing_m))) for each in (pose, pose.mirrored()))
    return _Fitted(
        centre_m=pose.centre_m,
        tilt_rad=math.acos(min(1.0, abs(float(pose.turn[:, 2] @ sight)))),
        share_of_noise=math.sqrt(max(float(sight @ covariance[3:6, 3:6] @ sight), 0.0)),
        ambiguity=min(1.0, misfit / other) if other > 0 else 1.0,
    )


def _start(directions: Points, radius_m: float) -> _Pose | None:
    """Return the plane through the places that the discs have by their own sizes; None if one is no ellipse."""
    places = []
    for rim in directions:
        cone = cone_through(rim)
        poses = None if cone is None else circle_poses(cone, 2 * radius_m)
        if poses is None:
            return None
        places.append(poses.axis * poses.distance_m)
    centre_m = np.mean(places, axis=0)
    right = (places[0] - centre_m) / max(float(np.linalg.norm(places[0] - centre_m)), 1e-300)
    normal = np.cross(places[1] - places[0], places[2] - places[0])
    normal /= max(float(np.linalg.norm(normal)), 1e-300)
    return _Pose(np.column_stack((right, np.cross(normal, right), normal)), centre_m, radius_m)
