"""The known size that turns pixels into metres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

KnownSide = Literal["auto", "width", "height"]


@dataclass(frozen=True, slots=True, kw_only=True)
class BallSize:
    """A sphere.

    Attributes:
        diameter_m: Its diameter.
        relative_sigma: Standard deviation of the diameter, as a share: how well it is known.
    """

    diameter_m: float
    relative_sigma: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetSize:
    """A flat rectangle, such as a sheet of paper.

    Attributes:
        width_m: Its horizontal side as it hangs.
        height_m: Its vertical side as it hangs.
        known_side: Which side the distance is computed from. ``auto`` takes the side that is the least foreshortened:
            turning a sheet away from the camera can only shorten a side.
        relative_sigma: Standard deviation of the sides, as a share: how well they are known.
    """

    width_m: float
    height_m: float
    known_side: KnownSide = "auto"
    relative_sigma: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TagSize:
    """A square fiducial, such as an ArUco marker or an AprilTag.

    Attributes:
        side_m: The side of its black square, without the white around it.
        relative_sigma: Standard deviation of the side, as a share: how well it is known.
    """

    side_m: float
    relative_sigma: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class DiscSize:
    """A flat circle, such as a sticker, a lid or a printed dot.

    Attributes:
        diameter_m: Its diameter.
        relative_sigma: Standard deviation of the diameter, as a share: how well it is known.
    """

    diameter_m: float
    relative_sigma: float = 0.0


TargetSize = BallSize | SheetSize | TagSize | DiscSize
