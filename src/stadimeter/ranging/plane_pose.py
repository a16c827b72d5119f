"""The place of a flat rectangle and its turn, from its four corners: both poses that its picture may have.

The poses come in closed form from T. Collins and A. Bartoli, "Infinitesimal plane-based pose estimation", International
Journal of Computer Vision 109, 2014: the homography from the plane to the picture, and its derivatives at the plane's
middle, give the plane's turn but for a mirror image about the line of sight. OpenCV has it as ``SOLVEPNP_IPPE``, but
loses a pose where something is seen exactly from the front. Here nothing is divided by what then becomes zero. For four
corners plain numbers are faster than arrays.

From such a pose, least squares lead to the one whose corners appear nearest to where they were seen: Levenberg's and
Marquardt's method with derivatives in closed form (R. Hartley and A. Zisserman, "Multiple View Geometry", appendix 6).
Two steps are enough.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from stadimeter.core.detection import Points, Values

Vector = tuple[float, float, float]
Seen = Sequence[Sequence[float]]

# A step that would take less than this share off the sum of squares is the last one.
MAX_STEPS = 8
SETTLED_SHARE = 1e-3

# The first damping, a share of the normal matrix's diagonal, and what it grows by where a step makes things worse.
DAMPING, GROWTH = 1e-6, 30.0


class PlanePose(NamedTuple):
    """A pose of a plane: its axes in the camera frame, towards its right and its top, and where its centre is."""

    right: Vector
    up: Vector
    position_m: Vector


def linearise(pose: PlanePose, corners_m: Seen, seen: Seen) -> tuple[Values, Values] | None:
    """Return the change of seen corners with a small turn about the camera's axes and a shift, and their errors.

    The shapes are ``(2 n, 6)`` and ``(2 n,)``, per unit of depth. None where a corner is not in front of the camera.
    """
    (ax, ay, az), (bx, by, bz), (px, py, pz) = pose
    rows: list[tuple[float, ...]] = []
    off: list[float] = []
    for (a, b, *_), (seen_x, seen_y) in zip(corners_m, seen, strict=True):
        x, y, z = a * ax + b * bx, a * ay + b * by, a * az + b * bz
        depth = z + pz
        if not depth > 0:
            return None
        nearness = 1 / depth
        u, v = (x + px) * nearness, (y + py) * nearness
        # Derivatives of u = X / Z and v = Y / Z: a turn w moves the corner by w × (x, y, z), a shift by itself.
        # Columns: turn about x, y, z, then shift along x, y, z.
        rows.append((-u * y * nearness, (z + u * x) * nearness, -y * nearness, nearness, 0.0, -u * nearness))
        rows.append((-(z + v * y) * nearness, v * x * nearness, x * nearness, 0.0, nearness, -v * nearness))
        off += (seen_x - u, seen_y - v)
    return np.array(rows), np.array(off)


def refine(pose: PlanePose, corners_m: Seen, seen: Seen) -> PlanePose:
    """Return the pose nearby whose corners, x and y in its plane, appear nearest to where they were seen."""
    now = linearise(pose, corners_m, seen)
    damping = DAMPING
    for _ in range(MAX_STEPS):
        if now is None:
            return pose
        jacobian, off = now
        square = float(off @ off)
        normal = jacobian.T @ jacobian
        # Every seventh element of a flat 6 by 6 matrix is its diagonal.
        normal.flat[::7] *= 1 + damping
        slope = jacobian.T @ off
        try:
            step = np.linalg.solve(normal, slope)
        except np.linalg.LinAlgError:
            return pose
        # What the step would take off the sum of squares if all were linear; below 0.1 % of it nothing is gained.
        gain = float(step @ slope)
        if not gain > SETTLED_SHARE * square:
            return pose
        moved = _move(pose, step.tolist())
        then = linearise(moved, corners_m, seen)
        if then is not None and float(then[1] @ then[1]) < square:
            pose, now, damping = moved, then, damping / GROWTH
        else:
            damping *= GROWTH
    return pose


def _move(pose: PlanePose, step: Sequence[float]) -> PlanePose:
    """Return a pose turned about the camera's axes and shifted."""
    turn, shift = (step[0], step[1], step[2]), step[3:]
    right, up = _turn(pose.right, turn), _turn(pose.up, turn)
    x, y, z = pose.position_m
    return PlanePose(right, up, (x + shift[0], y + shift[1], z + shift[2]))


def _turn(vector: Vector, turn: Vector) -> Vector:
    """Return a vector turned about an axis by its length in radians (Rodrigues)."""
    angle = math.hypot(*turn)
    sine, rest = (math.sin(angle) / angle, (1 - math.cos(angle)) / angle**2) if angle > 1e-9 else (1.0, 0.5)
    (x, y, z), (a, b, c) = vector, turn
    across = (b * z - c * y, c * x - a * z, a * y - b * x)
    p, q, r = across
    again = (b * r - c * q, c * p - a * r, a * q - b * p)
    turned = [old + sine * one + rest * two for old, one, two in zip(vector, across, again, strict=True)]
    return turned[0], turned[1], turned[2]


# The corners of a square with a side of 1 in its own frame, x right, y up, from the top left one on.
SQUARE = np.array(((-0.5, 0.5, 0.0), (0.5, 0.5, 0.0), (0.5, -0.5, 0.0), (-0.5, -0.5, 0.0)))

# Corners that are seen anywhere: how they change with the pose does not depend on it.
NOWHERE = ((0.0, 0.0),) * 4

COORDINATES = 8


class RectanglePose(NamedTuple):
    """A pose of a rectangle."""

    right: Vector  # its x axis, towards its right, in the camera frame: x right, y down, z forward
    up: Vector  # its y axis, towards its top
    position_m: Vector  # its centre in the camera frame
    # How far the corners appear from where the pose has them, root mean square of their coordinates, per unit
    # of depth.
    misfit: float

    @property
    def normal(self) -> Vector:
        """Its z axis, towards who looks at its front."""
        (a, b, c), (d, e, f) = self.right, self.up
        return b * f - c * e, c * d - a * f, a * e - b * d

    @property
    def distance_m(self) -> float:
        """Length of the straight line from the camera to the centre."""
        return math.hypot(*self.position_m)

    @property
    def tilt_rad(self) -> float:
        """Angle between the normal and the line of sight, 0 for face on."""
        (a, b, c), (x, y, z) = self.normal, self.position_m
        return math.acos(min(abs(a * x + b * y + c * z) / self.distance_m, 1.0))


class _Middle(NamedTuple):
    """The place at which a rectangle's middle appears, and its change per metre to its right and towards its top."""

    x: float
    y: float
    x_right: float
    x_up: float
    y_right: float
    y_up: float


def rectangle_poses(half_width_m: float, half_height_m: float, seen: Seen) -> list[RectanglePose]:
    """Return the two poses that explain best where the corners of a rectangle appear, the better one first.

    They are the same for something seen from the front; fewer where that would have it behind the camera, none where
    the corners are not those of a plane. They appear at `seen`, x and y per unit of depth, from its own top left one on
    clockwise as it is seen from the front.
    """
    middle = _middle(half_width_m, half_height_m, seen)
    if middle is None:
        return []
    poses = [_place(right, up, half_width_m, half_height_m, seen) for right, up in _turns(middle)]
    return sorted([pose for pose in poses if pose is not None], key=lambda pose: pose.misfit)


def misfit(
    right: Sequence[float], up: Sequence[float], position_m: Sequence[float], corners_m: Seen, seen: Seen
) -> float:
    """Measure how far corners appear from where a pose has them, root mean square of x and y per unit of depth.

    Infinite for a corner that is not in front of the camera. `corners_m` are in the plane, x and y first; `right` is
    the plane's x axis in the camera frame.
    """
    total = 0.0
    for (a, b, *_), (x, y) in zip(corners_m, seen, strict=True):
        depth = a * right[2] + b * up[2] + position_m[2]
        if not depth > 0:
            return math.inf
        total += (x - (a * right[0] + b * up[0] + position_m[0]) / depth) ** 2
        total += (y - (a * right[1] + b * up[1] + position_m[1]) / depth) ** 2
    return math.sqrt(total / (2 * len(seen)))


def _middle(half_width_m: float, half_height_m: float, seen: Seen) -> _Middle | None:
    """Return the homography's value and derivatives at the centre.

    It is P. Heckbert's for a unit square with u to the right and v down ("Fundamentals of texture mapping and image
    warping", 1989).
    """
    (x0, y0), (x1, y1), (x2, y2), (x3, y3) = seen
    x12, x32, y12, y32 = x1 - x2, x3 - x2, y1 - y2, y3 - y2
    x_sum, y_sum = x0 - x1 + x2 - x3, y0 - y1 + y2 - y3
    determinant = x12 * y32 - x32 * y12
    if not determinant:
        return None
    g, h = (x_sum * y32 - x32 * y_sum) / determinant, (x12 * y_sum - x_sum * y12) / determinant
    # The denominator of the homography at the centre, where u = v = 1/2; it is 0 on the horizon of the plane.
    depth = 1 + (g + h) / 2
    if not depth > 0:
        return None
    x_u, x_v, y_u, y_v = x1 - x0 + g * x1, x3 - x0 + h * x3, y1 - y0 + g * y1, y3 - y0 + h * y3
    x, y = (x0 + (x_u + x_v) / 2) / depth, (y0 + (y_u + y_v) / 2) / depth
    across, down = 2 * half_width_m * depth, -2 * half_height_m * depth
    return _Middle(x, y, (x_u - g * x) / across, (x_v - h * x) / down, (y_u - g * y) / across, (y_v - h * y) / down)


def _turns(middle: _Middle) -> list[tuple[Vector, Vector]]:
    """Return the two pairs of axes of a plane that looks so in its middle (section 5 of the paper)."""
    x, y = middle.x, middle.y
    # The rotation that takes the optical axis into the line of sight; its last row and column are (-x, -y, 1) cosine.
    cosine = 1 / math.sqrt(1 + x * x + y * y)
    share = cosine * cosine / (1 + cosine)
    xx, xy, yy = 1 - share * x * x, -share * x * y, 1 - share * y * y
    # How a small shift in the turned plane moves what is seen, and the plane's own shifts behind it.
    a, b, d = xx + x * x * cosine, xy + x * y * cosine, yy + y * y * cosine
    m00, m10 = (d * middle.x_right - b * middle.y_right), (a * middle.y_right - b * middle.x_right)
    m01, m11 = (d * middle.x_up - b * middle.y_up), (a * middle.y_up - b * middle.x_up)
    # But for a factor these are part of a rotation matrix, whose largest singular value is 1.
    t00, t01, t11 = m00 * m00 + m01 * m01, m00 * m10 + m01 * m11, m10 * m10 + m11 * m11
    largest = math.sqrt((t00 + t11 + math.hypot(t00 - t11, 2 * t01)) / 2)
    if not largest > 0:
        return []
    m00, m01, m10, m11 = m00 / largest, m01 / largest, m10 / largest, m11 / largest
    # The columns of a rotation have length 1, so the third components follow but for a common sign: the two poses.
    # Their relative sign follows from the columns being at right angles.
    right_z = math.sqrt(max(0.0, 1 - m00 * m00 - m10 * m10))
    up_z = math.copysign(math.sqrt(max(0.0, 1 - m01 * m01 - m11 * m11)), -(m00 * m01 + m10 * m11))
    turns = []
    for sign in (1.0, -1.0):
        axes = []
        for p, q, r in ((m00, m10, sign * right_z), (m01, m11, sign * up_z)):
            axes.append(
                (xx * p + xy * q + x * cosine * r, xy * p + yy * q + y * cosine * r, cosine * (r - x * p - y * q))
            )
        turns.append((axes[0], axes[1]))
    return turns


def _place(right: Vector, up: Vector, half_width_m: float, half_height_m: float, seen: Seen) -> RectanglePose | None:
    """Return the pose with the position that explains the corners best: linear least squares (ibid., section 5.4)."""
    ax, ay, az = right[0] * half_width_m, right[1] * half_width_m, right[2] * half_width_m
    bx, by, bz = up[0] * half_height_m, up[1] * half_height_m, up[2] * half_height_m
    # The corners as seen from the centre: two, and their opposites.
    corners = (
        (bx - ax, by - ay, bz - az),
        (ax + bx, ay + by, az + bz),
        (ax - bx, ay - by, az - bz),
        (-ax - bx, -ay - by, -az - bz),
    )
    sum_x = sum_y = squares = first = second = third = 0.0
    for (across, down, depth), (x, y) in zip(corners, seen, strict=True):
        off_x, off_y = x * depth - across, y * depth - down
        sum_x += x
        sum_y += y
        squares += x * x + y * y
        first += off_x
        second += off_y
        third += x * off_x + y * off_y
    # Each corner gives X - x Z = off_x and Y - y Z = off_y in the position (X, Y, Z). X and Y are eliminated from the
    # normal equations, which leaves one for Z; its coefficient is the scatter of the seen corners about their mean.
    spread = squares - (sum_x * sum_x + sum_y * sum_y) / 4
    if not spread > 0:
        return None
    z_m = ((sum_x * first + sum_y * second) / 4 - third) / spread
    x_m, y_m = (first + sum_x * z_m) / 4, (second + sum_y * z_m) / 4
    missed = 0.0
    for (across, down, depth), (x, y) in zip(corners, seen, strict=True):
        if not depth + z_m > 0:
            return None
        nearness = 1 / (depth + z_m)
        miss_x, miss_y = x - (across + x_m) * nearness, y - (down + y_m) * nearness
        missed += miss_x * miss_x + miss_y * miss_y
    return RectanglePose(right, up, (x_m, y_m, z_m), math.sqrt(missed / COORDINATES))


def rectangle(width_m: float, height_m: float) -> Points:
    """Return the corners of a rectangle in its own frame, as `plane_poses` takes them, shape ``(4, 3)``."""
    return SQUARE * (width_m, height_m, 0.0)


def plane_poses(corners_m: Points, directions: Points) -> tuple[RectanglePose, ...]:
    """Return the two poses that a rectangle may have, the better one first; fewer if the corners are not those of one.

    The better one is refined by least squares. The other one is not, since from near by that would lead to the better
    one too.

    Args:
        corners_m: Its corners in its own frame, as `rectangle` gives them, shape ``(4, 3)``.
        directions: Where they appear, x and y per unit of depth with the lens's distortion undone, shape ``(4, 2)``.
    """
    half_width_m, half_height_m = float(corners_m[1, 0]), float(corners_m[0, 1])
    seen = directions.tolist()
    found = rectangle_poses(half_width_m, half_height_m, seen)
    if found:
        found[0] = nearest_pose(found[0], corners_m.tolist(), seen)
    return tuple(found)


def ambiguity(poses: tuple[RectanglePose, ...]) -> float:
    """Return the best pose's misfit as a share of the other one's: 0 for certain, 1 for no idea which one it is."""
    if len(poses) < 2:
        return 0.0
    return poses[0].misfit / poses[1].misfit if poses[1].misfit > 0 else 1.0


def doubt_share(poses: tuple[RectanglePose, ...], corner_sigma: float) -> float:
    """Return the standard deviation of the distance, as a share, because another pose may be the true one.

    The corners' standard deviation `corner_sigma` is that of coordinates per unit of depth.
    """
    best = poses[0]
    return sum(
        math.sqrt(_probability(other, best, corner_sigma)) * abs(other.distance_m / best.distance_m - 1)
        for other in poses[1:]
    )


def distance_share(pose: RectanglePose, corners_m: Points, corner_sigma: float) -> float:
    """Return the uncertainty of the distance from that of corners, by propagation through the pose's least squares fit.

    The inverse of the normal matrix is the covariance of the pose (R. Hartley and A. Zisserman, "Multiple View
    Geometry", section 5.2). Where the tilt is poorly determined, a sheet that faces the camera looks tilted, so nearer,
    by half the tilt's variance. It is a standard deviation as a share of the distance, infinite where the corners,
    ``(4, 3)``, do not tell the pose; theirs, `corner_sigma`, is per unit of depth.
    """
    linear = linearise(PlanePose(*pose[:3]), corners_m.tolist(), NOWHERE)
    if linear is None:
        return math.inf
    jacobian, _ = linear
    try:
        covariance = np.linalg.inv(jacobian.T @ jacobian)
    except np.linalg.LinAlgError:
        return math.inf
    # How the tilts about both axes and the distance change with turns about the camera's axes and shifts.
    # Rows of the gradient: turns about the plane's own axes (1, 2), and a shift along the line of sight (3, times the
    # distance). g C g' of each is its variance for corners that err by 1.
    slopes = np.zeros((3, 6))
    slopes[0, :3], slopes[1, :3], slopes[2, 3:] = pose.right, pose.up, pose.position_m
    about_right, about_up, outwards = (slopes @ covariance * slopes).sum(axis=1).tolist()
    distance_m = pose.distance_m
    # Linear share, and the bias of second order by which a poorly determined tilt makes things seem nearer.
    of_distance = math.sqrt(max(outwards, 0.0)) / distance_m**2
    return math.hypot(corner_sigma * of_distance, corner_sigma**2 * max(about_right, about_up) / 2)


def nearest_pose(pose: RectanglePose, corners_m: Seen, seen: Seen) -> RectanglePose:
    """Return the pose nearby whose corners, x and y in its plane, appear nearest to where they were seen."""
    better = refine(PlanePose(*pose[:3]), corners_m, seen)
    missed = misfit(*better, corners_m, seen)
    return RectanglePose(*better, missed) if missed <= pose.misfit else pose


def _probability(other: RectanglePose, best: RectanglePose, corner_sigma: float) -> float:
    """Return the probability of the other pose, if corners err normally: 1/2 at most."""
    # Misfits are root mean squares over eight coordinates: times 8 they are sums, over σ² chi-squares; half their
    # difference is that of the log-likelihoods.
    worse = max(other.misfit**2 - best.misfit**2, 0.0) * COORDINATES / max(corner_sigma, 1e-12) ** 2
    return 1 / (1 + math.exp(min(worse / 2, 700.0)))
