"""Whether an outline looks like another sheet of paper than the one that is looked for."""

from __future__ import annotations

import math

from stadimeter.config.paper import PAPER
from stadimeter.config.units import parse_length
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points
from stadimeter.detectors.sides import width_and_height
from stadimeter.ranging.flat import SheetShape
from stadimeter.ranging.plane_pose import seen_sides

OTHER_SHAPE = 0.04
SAME_SHAPE = 0.02
"""Two ratios of sides are different, or the same, that differ by more, or less, than this share."""

RIGHT_ANGLE = 0.05
"""Greatest cosine of a corner in space that is a right one."""

NAMED = 0.005
"""A sheet has a name if both its sides are those of the paper, to this share."""


def other_paper(corners_px: Points, size: SheetShape, lens: CameraModel | None) -> str:
    """Say which paper an outline is rather than the sheet: ``sides 1.29 : 1, not 1.41 : 1: letter instead of A4?``.

    Empty where no paper with a name explains it better. Without the lens the sheet is taken to face the camera, as it
    should while a camera is calibrated.
    """
    seen = _seen_aspect(corners_px, lens)
    wanted = size.longest_m / size.shortest_m
    if seen is None or _apart(seen, wanted) < OTHER_SHAPE:
        return ""
    sides = {name: tuple(sorted(map(parse_length, each))) for name, each in PAPER.items()}
    alike = {name: each for name, each in sides.items() if _apart(each[1] / each[0], seen) < SAME_SHAPE}
    if not alike:
        return ""
    # Of papers of one shape, such as A3 and A4, the one that is nearest in size is the likeliest to be mistaken.
    other = min(alike, key=lambda name: _apart(alike[name][0] * alike[name][1], size.shortest_m * size.longest_m))
    named = (name for name, each in sides.items() if _is_size(each, size))
    return f"sides {seen:.2f} : 1, not {wanted:.2f} : 1: {other} instead of {next(named, 'the sheet given')}?"


def _seen_aspect(corners_px: Points, lens: CameraModel | None) -> float | None:
    if lens is None:
        width_px, height_px = width_and_height(corners_px)
        return max(width_px, height_px) / min(width_px, height_px)
    cosine, ratio = seen_sides(lens.directions(corners_px))
    return max(ratio, 1 / ratio) if abs(cosine) < RIGHT_ANGLE and ratio > 0 else None


def _apart(one: float, other: float) -> float:
    return abs(math.log(one / other))


def _is_size(sides_m: tuple[float, ...], size: SheetShape) -> bool:
    return _apart(sides_m[0], size.shortest_m) < NAMED and _apart(sides_m[1], size.longest_m) < NAMED
