"""The place of the camera itself: its pose in the room, and the tags whose places tell it.

The room's frame is that of REP-103: x and y on the floor, z up. Turns are counter-clockwise as seen from above.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from msgspec import Struct

Vector = tuple[float, float, float]


class PlacedTag(Struct, frozen=True, kw_only=True):
    """A tag whose place in the room is known. Without a roll its top points up, or to its back if it looks up.

    Attributes:
        side_m: The side of its black square.
        position_m: Its centre in the room.
        facing_rad: Which way it looks: the angle of its normal from the x axis, as seen from above.
        tilt_rad: How far it looks up from level; a quarter turn if it lies on the floor.
        roll_rad: How far it is turned in its own plane, clockwise as one looks at it.
    """

    number: int
    side_m: float
    position_m: Vector
    facing_rad: float = 0.0
    tilt_rad: float = 0.0
    roll_rad: float = 0.0

    @property
    def normal(self) -> Vector:
        """The direction in which it looks, of length 1."""
        level = math.cos(self.tilt_rad)
        return level * math.cos(self.facing_rad), level * math.sin(self.facing_rad), math.sin(self.tilt_rad)


class Landmarks(Struct, frozen=True, kw_only=True):
    """The tags whose places are known, and how well.

    Attributes:
        place_sigma_m: Standard deviation of each coordinate of a tag's centre.
        facing_sigma_rad: Standard deviation of a tag's turn about each axis.
        size_relative_sigma: Standard deviation of all sides together, as a share: tags come from one printer.
    """

    tags: tuple[PlacedTag, ...]
    place_sigma_m: float = 0.005
    facing_sigma_rad: float = math.radians(0.5)
    size_relative_sigma: float = 0.0


class CameraPose(Struct, frozen=True, kw_only=True):
    """The place of the camera in the room and how it is turned, for one frame; or why that is not known.

    Attributes:
        captured_at_s: When the frame was taken, on the run's monotonic clock.
        position_m: Where it is; None if that is not known.
        orientation: How its body (x forward, y left, z up) is turned: a quaternion x, y, z, w; None with no position.
        covariance: Of x, y, z and the turns about the room's x, y and z axes, row by row, in m² and rad², all known
            causes included: 36 numbers as in ROS's ``PoseWithCovariance``. Empty with no position.
        tags: The numbers of the tags that it follows from.
        moved: The numbers of tags in sight that are not where the configuration says.
        reason: Why the pose is not known; empty if it is.
    """

    captured_at_s: float
    position_m: Vector | None = None
    orientation: tuple[float, float, float, float] | None = None
    covariance: tuple[float, ...] = ()
    tags: tuple[int, ...] = ()
    moved: tuple[int, ...] = ()
    reason: str = ""

    @property
    def angles_rad(self) -> Vector | None:
        """Its yaw (where it looks, from the x axis), tilt (up from level) and roll (its right side down)."""
        if self.orientation is None:
            return None
        x, y, z, w = self.orientation
        # Of the matrix of the quaternion: the first column is the direction forwards, the last row has what is up.
        forward_z = max(-1.0, min(1.0, 2 * (x * z - y * w)))
        yaw = math.atan2(2 * (x * y + z * w), 1 - 2 * (y * y + z * z))
        return yaw, math.asin(forward_z), math.atan2(2 * (y * z + x * w), 1 - 2 * (x * x + y * y))

    @property
    def sigmas(self) -> tuple[float, ...]:
        """Standard deviations of x, y, z, yaw, tilt and roll; none if the pose is not known."""
        angles = self.angles_rad
        if angles is None or len(self.covariance) != 36:
            return ()
        (sine, cosine), (up, level) = _both(angles[0]), _both(angles[1])
        level = max(level, 1e-9)
        # How the angles change with small turns w about the room's axes: a turn moves the direction forwards f by
        # w × f, and what of it is about the level direction ahead is roll.
        slopes = (
            (-up * cosine / level, -up * sine / level, 1.0),
            (sine, -cosine, 0.0),
            (cosine / level, sine / level, 0.0),
        )
        turns = [self.covariance[6 * row + 3 : 6 * row + 6] for row in (3, 4, 5)]
        variances = [self.covariance[7 * axis] for axis in range(3)]
        variances += [_dot(slope, [_dot(row, slope) for row in turns]) for slope in slopes]
        return tuple([math.sqrt(max(each, 0.0)) for each in variances])

    @property
    def moved_words(self) -> str:
        """The tags that are not where the configuration says, in words; empty for none."""
        return "; ".join(f"tag {each} is not where the configuration says" for each in self.moved)

    def in_words(self) -> str:
        """Return the pose, or why it is not known."""
        angles = self.angles_rad
        if self.position_m is None or angles is None:
            return self.reason
        sigmas = self.sigmas
        places = zip("xyz", self.position_m, sigmas, strict=False)
        turns = zip(("yaw", "tilt", "roll"), angles, sigmas[3:], strict=False)
        # Nothing is shown as ± 0.
        words = [f"{name} {value:.3f} m ± {max(sigma, 0.001):.3f}" for name, value, sigma in places]
        words += [f"{name} {math.degrees(turn):.1f}° ± {max(math.degrees(off), 0.1):.1f}" for name, turn, off in turns]
        by = f"by tag{'s' if len(self.tags) > 1 else ''} {', '.join(map(str, self.tags))}"
        return "; ".join([", ".join([*words, by]), *([self.moved_words] if self.moved else [])])


def _both(angle_rad: float) -> tuple[float, float]:
    return math.sin(angle_rad), math.cos(angle_rad)


def _dot(one: Sequence[float], other: Sequence[float]) -> float:
    return sum([a * b for a, b in zip(one, other, strict=True)])
