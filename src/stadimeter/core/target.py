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
    """

    diameter_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetSize:
    """A flat rectangle, such as a sheet of paper.

    Attributes:
        width_m: Its horizontal side as it hangs.
        height_m: Its vertical side as it hangs.
        known_side: Which side the distance is computed from. ``auto`` takes the side that is the least foreshortened:
            turning a sheet away from the camera can only shorten a side.
    """

    width_m: float
    height_m: float
    known_side: KnownSide = "auto"


@dataclass(frozen=True, slots=True, kw_only=True)
class TagSize:
    """A square fiducial, such as an ArUco marker or an AprilTag.

    Attributes:
        side_m: The side of its black square, without the white around it.
    """

    side_m: float


TargetSize = BallSize | SheetSize | TagSize
