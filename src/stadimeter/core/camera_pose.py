"""The place of the camera: on its robot, above the floor, in the room; and the check that it is still there."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from enum import StrEnum

from msgspec import Struct

from stadimeter.core.decision import Event, EventKind, Severity
from stadimeter.operator_actions import AnyCommand, OperatorAction, OperatorAnswer, OperatorCommand

# The place of a camera on a robot, and of what it sees from there, in the axes of REP-103 -----------------------------

Place = tuple[float, float, float]


class Mount(Struct, frozen=True, kw_only=True):
    """A camera on a robot, whose frame has x ahead, y to the left and z up, from the floor below its middle.

    Source: ROS Enhancement Proposal 103. A camera that is mounted nowhere is straight above the middle and looks ahead.

    Attributes:
        x_m: How far the lens is ahead of the middle of the robot.
        y_m: How far it is to the left of it.
        z_m: How high it is above the floor; 0 if that is not known, so that heights are those above the camera.
        yaw_rad: How far it is turned to the left.
        tilt_rad: How far it looks up from level.
    """

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    yaw_rad: float = 0.0
    tilt_rad: float = 0.0

    def axes(self, tilt_rad: float) -> tuple[Place, Place, Place]:
        """Return the robot's axes in the camera frame (x right, y down, z forward) at a tilt.

        Looking up by t, the camera has level ahead at ``(0, sin t, cos t)``, the left at ``(-1, 0, 0)`` and up at
        ``(0, -cos t, sin t)``. Turned to the left by ψ, the robot's x is ``cos ψ`` ahead and ``-sin ψ`` left.
        """
        up, level = math.sin(tilt_rad), math.cos(tilt_rad)
        turned, straight = math.sin(self.yaw_rad), math.cos(self.yaw_rad)
        return (turned, straight * up, straight * level), (-straight, turned * up, turned * level), (0.0, -level, up)

    def in_robot(self, position_m: Place) -> Place:
        """Return a place in the robot's frame from one in the camera frame."""
        x, y, z = (sum(a * p for a, p in zip(axis, position_m, strict=True)) for axis in self.axes(self.tilt_rad))
        return self.x_m + x, self.y_m + y, self.z_m + z


# Knowledge of a target that stands on the floor, and of the camera above it -------------------------------------------

# Standard deviations of the camera's height and tilt where the configuration states none: a tape measure along a robot,
# and a protractor on a small camera.
HEIGHT_SIGMA_M, TILT_SIGMA_RAD = 0.01, math.radians(1)


class Footing(Struct, frozen=True, kw_only=True):
    """The camera above a level floor, and what of a target is on it.

    Attributes:
        height_m: How high the camera is above the floor.
        tilt_rad: How far it looks up from level.
        tilt_sigma_rad: Standard deviation of the tilt, and of how level the camera is across.
        centre_m: How high the target's centre is above the floor, 0 of what lies flat on it; None for a target that
            stands upright on its lowest edge, or rests on it as a ball does.
    """

    height_m: float
    height_sigma_m: float = HEIGHT_SIGMA_M
    tilt_rad: float = 0.0
    tilt_sigma_rad: float = TILT_SIGMA_RAD
    centre_m: float | None = None
    centre_sigma_m: float = 0.0


# The place of the camera itself: its pose in the room, and the tags whose places tell it ------------------------------
#
# The room's frame is that of REP-103: x and y on the floor, z up. Turns are counter-clockwise as seen from above.

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


# A check that the camera is still mounted as when its view was saved, and how a person confirms that it may be so -----
#
# A camera that was turned, zoomed or refocused measures on, and wrongly: nothing in a single measurement shows it.
# Distances count as *unconfirmed* from then on. They drive outputs as before, unless the configuration says
# otherwise: an alarm that falls silent because its camera was touched would be the greater harm.

MOUNTING = "mounting"


class MountingStatus(StrEnum):
    """The known state of the mounting."""

    AS_SAVED = "as_saved"
    NOT_JUDGED = "not_judged"
    """It cannot be judged at present, such as in the dark; it was as saved before."""
    UNCONFIRMED = "unconfirmed"
    """It is not as it was saved, and no one has confirmed it."""


class Mounting(Struct, frozen=True, kw_only=True):
    """Result of the newest check of the mounting.

    Attributes:
        reason: Why it is unconfirmed or not judged, in words; empty if it is as saved.
    """

    status: MountingStatus = MountingStatus.AS_SAVED
    reason: str = ""

    @property
    def is_unconfirmed(self) -> bool:
        """True while distances are unconfirmed."""
        return self.status is MountingStatus.UNCONFIRMED


def step_mounting(
    *, was_unconfirmed: bool, mounting: Mounting | None, commands: Iterable[AnyCommand], now_s: float
) -> tuple[bool, tuple[OperatorAnswer, ...], tuple[Event, ...]]:
    """Check whether distances are unconfirmed now, and list the answers to those who confirm them and what happened.

    Args:
        mounting: What the newest check says; None where nothing is watched.
    """
    is_unconfirmed = mounting is not None and mounting.is_unconfirmed
    events: list[Event] = []
    answers: list[OperatorAnswer] = []
    if mounting is not None and is_unconfirmed and not was_unconfirmed:
        events.append(_event(EventKind.FAULT, now_s, f"the camera is not mounted as it was saved: {mounting.reason}"))
    elif was_unconfirmed and not is_unconfirmed:
        events.append(_event(EventKind.FAULT_CLEARED, now_s, "the camera is as it was saved again"))
    for command in commands:
        if not isinstance(command, OperatorCommand) or command.action is not OperatorAction.CONFIRM_MOUNTING:
            continue
        words = "nothing is to be confirmed: no check of the mounting has found anything"
        if is_unconfirmed:
            words = "the mounting is confirmed; the present view is saved in place of the former one"
            events.append(_event(EventKind.FAULT_CLEARED, now_s, f"confirmed {command.said}", command.by))
        answers.append(OperatorAnswer(id=command.id, accepted=is_unconfirmed, words=words))
        is_unconfirmed = False
    return is_unconfirmed, tuple(answers), tuple(events)


def _event(kind: EventKind, now_s: float, reason: str, by: str = "") -> Event:
    severity = Severity.SAFETY if kind is EventKind.FAULT else Severity.INFO
    return Event(kind=kind, source=MOUNTING, at_s=now_s, severity=severity, reason=reason, by=by)
