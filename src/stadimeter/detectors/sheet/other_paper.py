"""Whether an outline looks like another sheet of paper than the one that is looked for."""

from __future__ import annotations

import math

from stadimeter.config.paper import PAPER
from stadimeter.config.units import parse_length
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points
from stadimeter.detectors.sides import quad_shapes
from stadimeter.ranging.flat import SheetShape
from stadimeter.ranging.plane_pose import seen_sides

# Two ratios of sides are different, or the same, that differ by more, or less, than this share.
OTHER_SHAPE = 0.04
SAME_SHAPE = 0.02

# Papers whose areas differ by more than this factor, as a logarithm, are not mistaken for each other.
LIKE_IN_SIZE = math.log(1.5)

# Greatest cosine of a corner in space that is a right one.
RIGHT_ANGLE = 0.05

# Opposite sides of a sheet that faces the camera differ by this factor at most.
FACING_RATIO = 1.03

# A sheet has a name if both its sides are those of the paper, to this share.
NAMED = 0.005

_SIDES_M = {name: tuple(sorted(map(parse_length, each))) for name, each in PAPER.items()}


def other_paper(corners_px: Points, size: SheetShape, lens: CameraModel | None) -> str:
    """Say which paper an outline is rather than the sheet: ``sides 1.29 : 1, not 1.41 : 1: letter instead of A4?``.

    Empty where no paper that it may be mistaken for explains it better. Without the lens only what faces the camera
    tells its shape.
    """
    seen = _seen_aspect(corners_px, lens)
    wanted = size.longest_m / size.shortest_m
    if seen is None or _apart(seen, wanted) < OTHER_SHAPE:
        return ""
    alike = [name for name in mistaken_for(size) if _apart(_aspect(_SIDES_M[name]), seen) < SAME_SHAPE]
    return f"sides {seen:.2f} : 1, not {wanted:.2f} : 1: {alike[0]} instead of {_name(size)}?" if alike else ""


def mistaken_for(size: SheetShape) -> list[str]:
    """Return the papers that a sheet with a name may be mistaken for, the likeliest first; none for any other sheet.

    They are of about its size, but of another shape: one of the same, such as A5 for A4, looks just alike, so it
    explains nothing.
    """
    if not _name(size):
        return []
    off = {name: _apart(each[0] * each[1], size.shortest_m * size.longest_m) for name, each in _SIDES_M.items()}
    own = size.longest_m / size.shortest_m
    others = (name for name, each in _SIDES_M.items() if _apart(_aspect(each), own) >= OTHER_SHAPE)
    return sorted((name for name in others if off[name] < LIKE_IN_SIZE), key=lambda name: off[name])


def _name(size: SheetShape) -> str:
    return next((name for name, each in _SIDES_M.items() if _is_size(each, size)), "")


def _aspect(sides_m: tuple[float, ...]) -> float:
    return sides_m[1] / sides_m[0]


def _seen_aspect(corners_px: Points, lens: CameraModel | None) -> float | None:
    if lens is None:
        shapes = quad_shapes(corners_px[None])
        is_turned = shapes.side_ratio[0] > FACING_RATIO or math.cos(shapes.sharpest_rad[0]) > RIGHT_ANGLE
        return None if is_turned else float(shapes.aspect[0])
    cosine, ratio = seen_sides(lens.directions(corners_px))
    return max(ratio, 1 / ratio) if abs(cosine) < RIGHT_ANGLE and ratio > 0 else None


def _apart(one: float, other: float) -> float:
    return abs(math.log(one / other))


def _is_size(sides_m: tuple[float, ...], size: SheetShape) -> bool:
    return _apart(sides_m[0], size.shortest_m) < NAMED and _apart(sides_m[1], size.longest_m) < NAMED
